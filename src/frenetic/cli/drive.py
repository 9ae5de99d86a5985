"""The command that drives a single road: drive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli.again import file_spec
from frenetic.cli.console import Log, announced_compilation, facts_of_drive, print_facts
from frenetic.cli.options import (
    GroupedCommand,
    NewFile,
    check_map_size,
    file_option,
    json_option,
    lane_option,
)
from frenetic.cli.parts import recorded_options

if TYPE_CHECKING:
    from frenetic.oracle import Result
    from frenetic.road import Road


@click.command(cls=GroupedCommand)
@click.argument("road", type=click.Path(path_type=Path))
@recorded_options
@file_option(
    "--plot", "Draw the drive into this PNG, SVG or PDF file.", type=NewFile(is_picture=True)
)
@lane_option
@click.option("--anyway", is_flag=True, help="Drive the road even if it is invalid.")
@json_option
@click.pass_context
def drive(
    context: click.Context,
    /,
    road: Path,
    plot: Path | None,
    anyway: bool,
    lane: int | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive one road from a file and say what happened.

    ROAD is JSON with curvatures (1/m) and optionally a step (m), or with road_points, or a test
    file of the competition or of a campaign's failures; or it is OpenDRIVE with a single road
    (.xodr). A failing road of a campaign is driven as the campaign drove
    it: its file says with which driver, layers, simulator, rules and map. Options change that. A
    road that lies elsewhere is moved into the map; an invalid one is not driven. The exit code is 0
    if it was driven, 1 if it is INVALID or the simulator or driver broke (ERROR).
    """
    from frenetic.campaign import RoadTester
    from frenetic.oracle import Result, judge
    from frenetic.outcome import Outcome
    from frenetic.road.files import read_road
    from frenetic.spec import describe, part_text
    from frenetic.versions import other_version

    file = read_road(road, lane=lane)
    spec, loaded = file_spec(context, file), file.road()
    the_driver, the_simulator = spec.make_parts(isolate=True)
    driver, simulator = describe(the_driver), describe(the_simulator)
    recorded = file.entries.get("driver")
    now = part_text(driver, recorded)
    who = [f"{now} in {part_text(simulator)}"]
    if isinstance(recorded, dict):
        before = part_text(recorded, driver)
        if before != now:
            who.append(f"recorded with {before}")
        if note := other_version("driver", recorded, driver):
            who.append(note)
    check_map_size(spec.map_size)
    fitted, verdict = loaded.placed(spec.map_size)
    the_road = fitted or loaded
    if not verdict.valid and not anyway:
        result = Result(Outcome.INVALID, verdict.message)
        if plot is not None:
            from frenetic.report.picture import draw_road

            title = f"{road.name}: INVALID"
            draw_road(the_road, plot, title=title, reason=verdict.message)
    else:
        with announced_compilation(Log()) as compiled, the_simulator:
            compiled()
            the_drive = RoadTester(the_simulator, the_driver).drive(the_road)
        result = judge(the_road, the_drive)
        if plot is not None:
            from frenetic.report.picture import draw_drive

            draw_drive(the_road, the_drive, plot, title=f"{road.name}: {result.outcome}")
    if as_json:
        document = {"road": str(road), "length": the_road.length, **result.as_json()}
        document |= {"driver": driver, "simulator": simulator}
        if plot is not None:
            document["plot"] = str(plot)
        click.echo(json.dumps(document))
    else:
        _print_drive(result, the_road, road, plot, "; ".join(who))
    if not result.outcome.is_driven:
        raise click.exceptions.Exit(1)


def _print_drive(result: Result, the_road: Road, road: Path, plot: Path | None, who: str) -> None:
    click.echo(f"{result.outcome}  {result.reason}")
    facts = [("road", f"{the_road.length:.1f} m, {road}"), ("driver", who)]
    facts += facts_of_drive(result, result.duration if result.outcome.is_driven else None)
    if plot is not None:
        facts.append(("picture", str(plot)))
    print_facts(facts)
