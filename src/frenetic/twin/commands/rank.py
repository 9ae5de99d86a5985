"""The command that says which roads to drive first, or serves evaluators: rank."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli import complain
from frenetic.cli.console import Log, announced_compilation, counted_progress, print_table
from frenetic.cli.options import (
    check_map_size,
    count_option,
    json_option,
    lane_option,
)
from frenetic.cli.parts import asked_spec, driver_options, given_options

if TYPE_CHECKING:
    from frenetic.twin.ranking import RankedRoad


_DRIVER: Final = {
    "lateral_acceleration": 6.44,
    "braking": 6.1,
    "lookahead_time": 0.454,
    "lookahead_min": 2.19,
    "speed_gain": 0.517,
}
_SETTING: Final[dict[str, Any]] = {
    "driver": "planner",
    "driver_options": _DRIVER,
    "speed_limit": 120.0,
    "oob_tolerance": 0.5,
}
"""The competitions' setting: BeamNG.AI with risk factor 1.5 at 120 km/h, on lanes of 5 m.

The planner's options were tuned on 93 recorded drives in it, see `docs/ranking.md`.
"""
_HOST: Final = "127.0.0.1"
_PORT: Final = 4545


class Address(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """[HOST:]PORT."""

    name = "[host:]port"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int]:
        """(host, port)."""
        host, _, port = str(value).rpartition(":")
        if not port.isascii() or not port.isdigit() or int(port) > 65535:
            self.fail(f"{value!r} is not [HOST:]PORT, as in 4545 or 0.0.0.0:4545", param, ctx)
        return host or _HOST, int(port)


@click.command()
@click.argument("roads", nargs=-1, type=click.Path(path_type=Path), metavar="[ROADS]...")
@driver_options
@click.option(
    "--serve",
    type=Address(),
    is_flag=False,
    flag_value=str(_PORT),
    help="Rank for the evaluators of the SDC test competitions of 2025 and 2026 instead, over gRPC,"
    f" until Ctrl-C. [default port: {_PORT}; 0: a free one]",
)
@count_option("--top", "Only N roads, each of which promises another problem.")
@click.option("--anyway", is_flag=True, help="Rank invalid roads, too, each where it lies.")
@lane_option
@json_option
@click.pass_context
def rank(
    context: click.Context,
    /,
    roads: tuple[Path, ...],
    top: int | None,
    anyway: bool,
    lane: int | None,
    serve: tuple[str, int] | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Say which of many roads to drive first in a slow simulator.

    ROADS are files as 'frenetic drive' takes them, or folders of them. The driver drives each road,
    in the embedded simulator by default, to its end or until the whole car is outside its lane.
    Roads on which more of the car was outside come first; invalid ones come last. A road that is
    'like' another one promises the same problem. How far the order holds elsewhere depends on how
    alike both drivers are. The exit code is 2 if a named file holds no road; the others are ranked.

    --serve is for one evaluator at a time, without a password, and at this computer alone unless
    its host is 0.0.0.0. Its defaults are the competitions' setting: BeamNG.AI as the planner
    follows it, with risk factor 1.5 at 120 km/h, on lanes of 5 m.
    """
    from frenetic.twin.ranking import Twin, find_roads
    from frenetic.twin.ranking import rank as in_order

    if serve is not None:
        if roads:
            raise click.UsageError(f"--serve gets its roads from an evaluator: without {roads[0]}")
        _serve(context, *serve, as_json=as_json)
        return
    if not roads:
        raise click.UsageError("Missing argument 'ROADS...': files of roads, or folders of them")
    spec = asked_spec(context)
    check_map_size(spec.map_size)
    found = find_roads(roads, lane=lane)
    log, prospects = Log(), []
    with (
        announced_compilation(log) as compiled,
        Twin.of(spec) as twin,
        counted_progress(log, "Driving") as show,
    ):
        for done, (name, road) in enumerate(found.roads.items(), 1):
            prospects.append(twin.prospect(name, road, anyway=anyway))
            compiled()
            show(done, len(found.roads))
    ranked = in_order(prospects, top)
    if as_json:
        click.echo(json.dumps([_as_json(one) for one in ranked]))
    else:
        columns = [">rank", "outcome", ">oob share", ">MOOBD", ">at", "side", ">like", "road"]
        print_table(columns, map(_row, ranked))
        if top is not None and len(ranked) < top:
            click.echo(f"Different problems: {len(ranked)} of the {top} asked for.")
    if found.skipped:
        number, first = counted(len(found.skipped), "other file"), found.skipped[0]
        log.print(f"{number} without such a road left out, the first: {first}", markup=False)
    if found.faults:
        for fault in found.faults:
            complain(fault)
        raise click.exceptions.Exit(2)


def _serve(context: click.Context, host: str, port: int, *, as_json: bool) -> None:
    """Ranks roads for evaluators until Ctrl-C."""
    from frenetic.twin.ranking import Twin
    from frenetic.twin.ranking.service import CompetitionTool, serving

    given = given_options(context)
    usual = {name: value for name, value in _SETTING.items() if name not in given}
    if "driver" in given:
        del usual["driver_options"]
    elif "driver_options" in given:
        usual["driver_options"] = {**_DRIVER, **dict(given["driver_options"])}
    with (
        Twin.of(asked_spec(context, **usual)) as twin,
        serving(CompetitionTool(twin), host, port) as bound,
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


def _row(one: RankedRoad) -> tuple[object, ...]:
    prospect = one.prospect
    if prospect.max_oob_share is None or prospect.moobd is None or prospect.distance is None:
        reason = f"{prospect.name}: {prospect.reason}"
        return one.rank, prospect.outcome, *[None] * 5, reason
    return (
        one.rank,
        prospect.outcome,
        f"{prospect.max_oob_share:.0%}",
        f"{prospect.moobd:.2f} m",
        f"{prospect.distance:.0f} m",
        prospect.side,
        one.like,
        prospect.name,
    )


def _as_json(one: RankedRoad) -> dict[str, object]:
    prospect = one.prospect
    return {
        "rank": one.rank,
        "road": prospect.name,
        "length": prospect.length,
        "outcome": prospect.outcome,
        "reason": prospect.reason,
        "max_oob_share": prospect.max_oob_share,
        "moobd": prospect.moobd,
        "distance": prospect.distance,
        "side": prospect.side,
        "like": one.like,
    }
