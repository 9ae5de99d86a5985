"""The commands about single roads: drive, validate."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli.console import Log, announced_compilation, complain, facts_of_drive, print_facts
from frenetic.cli.grouping import GroupedCommand
from frenetic.cli.options import check_map_size, driver_options, json_option, lane_option
from frenetic.cli.parts import make_driver, make_simulator
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.oracle import Result
    from frenetic.road import Road


@click.command(cls=GroupedCommand, short_help="Drive one road from a file.")
@click.argument("road", type=click.Path(path_type=Path))
@driver_options
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw the drive into this PNG, SVG or PDF file.",
)
@lane_option
@click.option("--anyway", is_flag=True, help="Drive the road even if it is invalid.")
@json_option
def drive(
    road: Path,
    driver: str,
    driver_options: tuple[tuple[str, Any], ...],
    noise: float | None,
    delay: float | None,
    view: float | None,
    simulator: str,
    simulator_options: tuple[tuple[str, Any], ...],
    speed_limit: float,
    oob_tolerance: float,
    map_size: float,
    wall_limit: float,
    plot: Path | None,
    lane: int | None,
    anyway: bool,
    as_json: bool,
) -> None:
    """Drive one road from a file and say what happened.

    ROAD is JSON with curvatures (1/m) and optionally a step (m), or with road_points, or a test
    file of the competition or of a campaign's failures; or it is OpenDRIVE with a single road
    or a chain of linked ones (.xodr). A road that lies elsewhere is moved into the map; an invalid
    one is not driven. The exit code is 0 if it was driven, 1 if it is INVALID or the simulator or
    driver broke (ERROR).
    """
    from frenetic.campaign import RoadTester
    from frenetic.oracle import Result, judge
    from frenetic.outcome import Outcome
    from frenetic.road.files import read_road

    the_driver = make_driver(driver, dict(driver_options), noise, delay, view)
    the_simulator = make_simulator(
        simulator, dict(simulator_options), speed_limit, oob_tolerance, wall_limit
    )
    loaded = read_road(road, lane=lane).road()
    check_map_size(map_size)
    fitted, verdict = loaded.placed(map_size)
    the_road = fitted or loaded
    if not verdict.valid and not anyway:
        result = Result(Outcome.INVALID, verdict.message, None, None, None, 0.0, None)
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
        document = {"road": str(road), "length": the_road.length, **asdict(result)}
        if plot is not None:
            document["plot"] = str(plot)
        click.echo(json.dumps(document))
    else:
        _print_drive(result, the_road, road, plot)
    if not result.outcome.is_driven:
        raise click.exceptions.Exit(1)


def _print_drive(result: Result, the_road: Road, road: Path, plot: Path | None) -> None:
    click.echo(f"{result.outcome}  {result.reason}")
    facts: list[tuple[str, str]] = [("road", f"{the_road.length:.1f} m, {road}")]
    facts += facts_of_drive(result, result.duration if result.outcome.is_driven else None)
    if plot is not None:
        facts.append(("picture", str(plot)))
    print_facts(facts)


@click.command(short_help="Say whether roads are valid, as the competition does.")
@click.argument(
    "files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE..."
)
@click.option(
    "--map-size", type=float, default=200.0, show_default=True, help="m, side of the map."
)
@lane_option
@json_option
def validate(files: tuple[Path, ...], map_size: float, lane: int | None, as_json: bool) -> None:
    """Say for each road file whether it is valid by the competition's rules.

    Points are judged where they lie, curvatures where they fit the map. The exit code is 1 if any
    road is invalid, 2 if a file cannot be read; the other files are still judged.
    """
    from frenetic.road.files import read_road

    check_map_size(map_size)
    verdicts: list[dict[str, Any]] = []
    unreadable = []
    for path in files:
        try:
            verdict = read_road(path, lane=lane).check_validity(map_size)
        except FreneticError as error:
            unreadable.append(str(error))
            continue
        verdicts.append({"file": str(path), "valid": verdict.valid, "message": verdict.message})
        if not as_json:
            click.echo(f"{path}: {'valid' if verdict.valid else 'INVALID  ' + verdict.message}")
    if as_json:
        click.echo(json.dumps(verdicts))
    if unreadable:
        for message in unreadable:
            complain(message)
        raise click.exceptions.Exit(2)
    if not all(verdict["valid"] for verdict in verdicts):
        raise click.exceptions.Exit(1)
