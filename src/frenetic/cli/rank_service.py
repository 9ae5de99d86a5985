"""The command that ranks roads for the SDC test competitions' evaluators: rank-service."""

from __future__ import annotations

import json
import time
from typing import Any, Final

import click

from frenetic.cli.console import Log
from frenetic.cli.options import GroupedCommand, json_option
from frenetic.cli.parts import asked_spec, driver_options
from frenetic.spec import drive_options

_SETTING: Final = {
    "driver": "planner,lateral_acceleration=6.44,braking=6.1,lookahead_time=0.454,"
    "lookahead_min=2.19,speed_gain=0.517",
    "speed_limit": 120.0,
    "oob_tolerance": 0.5,
}
"""The competitions' setting: BeamNG.AI with risk factor 1.5 at 120 km/h, on lanes of 5 m.

The planner's options were tuned on 93 recorded drives in it, see `docs/ranking.md`.
"""


@click.command("rank-service", cls=GroupedCommand, context_settings={"default_map": _SETTING})
@driver_options
@click.option(
    "--lane-width", type=click.FloatRange(1.0, 20.0), default=5.0, show_default=True, help="m."
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen at; others than this computer are let in with 0.0.0.0.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=4545,
    show_default=True,
    help="0 takes a free one.",
)
@json_option
@click.pass_context
def rank_service(
    context: click.Context, /, lane_width: float, host: str, port: int, as_json: bool, **_: Any
) -> None:
    """Rank roads for the evaluators of the SDC test competitions, over gRPC.

    It answers the calls of the selection competition of 2025 and of the prioritisation competition
    of 2026, until Ctrl-C. The defaults are for their setting: a planner tuned to rank roads as
    BeamNG.AI fares on them with risk factor 1.5 at 120 km/h, on lanes of 5 m. The service is for
    one evaluator at a time, without a password: it listens at this computer alone unless --host
    says otherwise.
    """
    from frenetic.twin.ranking import Twin
    from frenetic.twin.ranking.service import CompetitionTool, serving

    given = {name: context.params[name] for name in drive_options()}
    with (
        Twin.of(asked_spec(context, given)) as twin,
        serving(CompetitionTool(twin, lane_width=lane_width), host, port) as bound,
    ):
        if as_json:
            click.echo(json.dumps({"host": host, "port": bound}))
        else:
            Log().print(f"Listening at {host}:{bound}; Ctrl-C ends it.")
        until_interrupted()


def until_interrupted() -> None:
    """Waits for Ctrl-C."""
    while True:
        time.sleep(60.0)  # on Windows Ctrl-C ends a sleep, but no wait for an event or a lock
