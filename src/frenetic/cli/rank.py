"""The command that says which roads to drive first: rank."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli import complain
from frenetic.cli.console import Log, announced_compilation, counted_progress, print_table
from frenetic.cli.options import (
    GroupedCommand,
    check_map_size,
    count_option,
    json_option,
    lane_option,
)
from frenetic.cli.parts import asked_spec, driver_options
from frenetic.spec import drive_options

if TYPE_CHECKING:
    from frenetic.twin.ranking import RankedRoad


@click.command(cls=GroupedCommand)
@click.argument(
    "roads", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="ROADS..."
)
@driver_options
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
    as_json: bool,
    **_: Any,
) -> None:
    """Say which of many roads to drive first in a slow simulator.

    ROADS are files as 'frenetic drive' takes them, or folders of them. The driver drives each road,
    in the embedded simulator by default, to its end or until the whole car is outside its lane.
    Roads on which more of the car was outside come first; invalid ones come last. A road that is
    'like' another one promises the same problem. How far the order holds elsewhere depends on how
    alike both drivers are. The exit code is 2 if a named file holds no road; the others are ranked.
    """
    from frenetic.twin.ranking import Twin, find_roads
    from frenetic.twin.ranking import rank as in_order

    spec = asked_spec(context, {name: context.params[name] for name in drive_options()})
    check_map_size(spec.map_size)
    found = find_roads(roads, lane=lane)
    log, prospects = Log(), []
    with (
        announced_compilation(log) as compiled,
        Twin.of(spec) as twin,
        counted_progress(log, "Driving") as show,
    ):
        for done, named in enumerate(found.roads, 1):
            prospects.append(twin.prospect(named.name, named.road, anyway=anyway))
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
        log.print(f"{counted(len(found.skipped), 'other file')} without a road left out")
    if found.other_lanes:
        number = counted(len(found.other_lanes), "OpenDRIVE file")
        first = found.other_lanes[0]
        log.print(f"{number} left out that need another --lane, such as {first}", markup=False)
    if found.faults:
        for fault in found.faults:
            complain(fault)
        raise click.exceptions.Exit(2)


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
