"""The command that says which roads to drive first, or serves evaluators: rank."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli import complain, echo
from frenetic.cli.console import Log, announced_compilation, counted_progress, print_table
from frenetic.cli.options import (
    count_option,
    json_option,
)
from frenetic.cli.parts import criteria_option, given_options, part_options, with_given
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.twin import Prospect

_DRIVER: Final = {
    "lateral_acceleration": 6.44,
    "braking": 6.1,
    "lookahead_time": 0.454,
    "lookahead_min": 2.19,
    "speed_gain": 0.517,
}
_SETTING: Final[dict[str, Any]] = {
    "driver": "planner",
    "speed_limit": 120.0,
    "oob_tolerance": 0.5,
}
"""The competitions' setting: BeamNG.AI with risk factor 1.5 at 120 km/h, on lanes of 5 m.

The planner's options were tuned on 93 recorded drives in it, see `docs/ranking.md`.
"""
_HOST: Final = "127.0.0.1"
_PORT: Final = 4545


@click.command()
@click.argument("roads", nargs=-1, type=click.Path(path_type=Path), metavar="[ROADS]...")
@part_options
@criteria_option
@click.option(
    "--serve",
    metavar="[HOST:]PORT",
    is_flag=False,
    flag_value=str(_PORT),
    help="Rank for the evaluators of the SDC test competitions of 2025 and 2026 instead, over gRPC,"
    f" until Ctrl-C. [default port: {_PORT}; 0: a free one]",
)
@count_option("--top", "Only N roads, each of which promises another problem.")
@json_option
@click.pass_context
def rank(
    context: click.Context,
    /,
    roads: tuple[Path, ...],
    top: int | None,
    serve: str | None,
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
    from frenetic.road.files import find_roads
    from frenetic.twin import Twin
    from frenetic.twin import rank as in_order

    if serve is not None:
        if roads:
            raise click.UsageError(f"--serve gets its roads from an evaluator: without {roads[0]}")
        _serve(context, serve, as_json)
        return
    if not roads:
        raise click.UsageError("Missing argument 'ROADS...': files of roads, or folders of them")
    spec = with_given(Spec(), given_options(context), has_roads=False)
    found = find_roads(roads)
    log, prospects = Log(), []
    with (
        announced_compilation(log) as compiled,
        Twin.of(spec) as twin,
        counted_progress(log, "Driving") as show,
    ):
        for done, (name, road) in enumerate(found.roads.items(), 1):
            prospects.append(twin.prospect(name, road))
            compiled()
            show(done, len(found.roads))
    ranked = in_order(prospects, top)
    if as_json:
        echo(json.dumps([_as_json(i, *one) for i, one in enumerate(ranked, 1)]))
    else:
        columns = [">rank", "outcome", ">oob share", ">MOOBD", ">at", "side", ">like", "road"]
        print_table(columns, [_row(i, *one) for i, one in enumerate(ranked, 1)])
        if top is not None and len(ranked) < top:
            echo(f"Different problems: {len(ranked)} of the {top} asked for.")
    if found.skipped:
        number, first = counted(len(found.skipped), "other file"), found.skipped[0]
        log.print(f"{number} without such a road left out, the first: {first}", markup=False)
    if found.faults:
        for fault in found.faults:
            complain(fault)
        raise click.exceptions.Exit(2)


def _serve(context: click.Context, address: str, as_json: bool) -> None:
    """Ranks roads for evaluators until Ctrl-C."""
    host, _, text = address.rpartition(":")
    if not text.isascii() or not text.isdigit() or int(text) > 65535:
        raise click.UsageError(
            f"--serve: {address!r} is not [HOST:]PORT, as in 4545 or 0.0.0.0:4545"
        )
    host, port = host or _HOST, int(text)
    from frenetic.twin import Twin
    from frenetic.twin.service import CompetitionTool, serving

    given = given_options(context)
    setting = {**_SETTING, "driver_options": {} if "driver" in given else _DRIVER}
    with (
        Twin.of(with_given(Spec().replaced(setting), given, has_roads=False)) as twin,
        serving(CompetitionTool(twin), host, port) as bound,
    ):
        if as_json:
            echo(json.dumps({"host": host, "port": bound}))
        else:
            Log().print(f"Listening at {host}:{bound}; Ctrl-C ends it.")
        until_interrupted()


def until_interrupted() -> None:
    """Waits for Ctrl-C."""
    while True:
        time.sleep(60.0)  # on Windows Ctrl-C ends a sleep, but no wait for an event or a lock


def _row(number: int, one: Prospect, like: int | None) -> tuple[object, ...]:
    if one.score is None:
        return number, one.outcome, *[None] * 5, f"{one.name}: {one.reason}"
    share, moobd = one.score[0], -one.score[1]
    place = f"{share:.0%}", f"{moobd:.2f} m", f"{one.distance:.0f} m"
    return number, one.outcome, *place, one.side, like, one.name


def _as_json(number: int, one: Prospect, like: int | None) -> dict[str, object]:
    return {
        "rank": number,
        "road": one.name,
        "length": one.length,
        "outcome": one.outcome,
        "reason": one.reason,
        "max_oob_share": None if one.score is None else one.score[0],
        "moobd": None if one.score is None else -one.score[1],
        "distance": one.distance,
        "side": one.side,
        "like": like,
    }
