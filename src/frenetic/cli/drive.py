"""The command `drive`, which drives single roads of a file or of a campaign's tests."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, chdir
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, announced_compilation, print_facts
from frenetic.cli.drive_facts import facts_of_drive, limit_text, print_measures
from frenetic.cli.drive_manoeuvre import drive_manoeuvre
from frenetic.cli.drive_plan import (
    DrivePlan,
    RoadToDrive,
    plan_for_campaign,
    plan_for_file,
    plan_for_map,
)
from frenetic.cli.drive_recording import (
    compare_drive,
    draw_comparison,
    print_comparison,
    read_compared,
)
from frenetic.cli.drive_trace import TraceFile
from frenetic.cli.entries import entry_option, entry_options, part_options, trust_option
from frenetic.cli.option_types import NewFile
from frenetic.cli.options import (
    as_usage_error,
    file_option,
    json_option,
    lane_option,
    road_option,
    source_arguments,
)
from frenetic.conditions.condition import as_text

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester
    from frenetic.oracle.drive import Drive
    from frenetic.oracle.verdict import Result
    from frenetic.recordings import Recording, RecordingComparison
    from frenetic.road import Road
    from frenetic.spec import Spec


@click.command()
@source_arguments(is_required=False)
@click.option(
    "--manoeuvre",
    metavar="NAME",
    help="Drive a standard manoeuvre and measure it: step,radius=100 ('frenetic list"
    " manoeuvres'). --with speed=100 (km/h).",
)
@entry_option("roads")
@part_options
@entry_options("criteria", "map_size")
@trust_option
@click.option("--dry", is_flag=True, help="Say whether the road is valid; do not drive it.")
@file_option(
    "--plot", "Draw the drive into this PNG, SVG or PDF file.", type=NewFile(is_picture=True)
)
@file_option("--trace", "Write all signals to this CSV or MCAP file.", type=NewFile(is_trace=True))
@click.option(
    "--layouts",
    "has_layouts",
    is_flag=True,
    help="PlotJuggler and Foxglove layouts beside the trace.",
)
@click.option(
    "--compare",
    metavar="RECORDING",
    help="Compare with a recorded drive, CSV or MDF.",
)
@lane_option
@road_option
@json_option
@click.pass_context
def drive(
    context: click.Context,
    /,
    source: Path | None,
    test_ids: tuple[int, ...],
    manoeuvre: str | None,
    dry: bool,
    plot: Path | None,
    trace: Path | None,
    has_layouts: bool,
    compare: str | None,
    lane: int | None,
    map_roads: str | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive the road of a file or of a campaign's tests, and say what happened.

    The tests of a CAMPAIGN, and the file of a failing road, are driven as the campaign drove them.
    Unless options change driver, simulator, rules or conditions, it says whether a test ends in the
    same way. A ROAD is JSON with curvatures (1/m) or road_points, a test file of the
    competition, or OpenDRIVE; ID is the number of a test in a list of tests. A road that lies
    elsewhere is moved into the map; an invalid road is not driven. With --road, roads of a map are
    driven where they lie, valid or not, also beyond where the car leaves its lane. The exit code
    is 1 after INVALID or ERROR.
    """
    options = CommandOptions.of(context)
    trace_file = TraceFile.of(trace, has_layouts=has_layouts)
    if manoeuvre is not None:
        if any(value is not None for value in (source, lane, map_roads, compare)) or dry:
            raise click.UsageError(
                "--manoeuvre has a road of its own: name no road, lane, recording or --dry"
            )
        if options.says("map_size"):
            raise click.UsageError("--manoeuvre needs no map: leave out --map-size")
        with as_usage_error():
            document = drive_manoeuvre(options, manoeuvre, plot, trace_file, is_quiet=as_json)
        documents = [document]
        if as_json:
            echo(json.dumps(document))
    elif source is None:
        raise click.UsageError("Missing argument 'CAMPAIGN|ROAD', or the option --manoeuvre.")
    else:
        plan = _plan(options, source, test_ids, lane, map_roads, is_dry=dry)
        has_one_road = len(plan.targets) == 1
        _require_one_drive(plot, trace, compare, is_one=has_one_road and not dry)
        outputs = Outputs(plot, trace_file, read_compared(compare))
        documents = _judge(plan) if dry else _drive(plan, outputs, is_quiet=as_json)
        if as_json:
            echo(json.dumps(documents[0] if has_one_road and map_roads is None else documents))
        elif dry:
            for document in documents:
                text = "valid" if document["valid"] else f"INVALID  {document['message']}"
                echo(f"{document['road']}: {text}")
    if not all(
        document["valid"] if dry else document["outcome"] in ("PASS", "FAIL")
        for document in documents
    ):
        raise click.exceptions.Exit(1)


def _require_one_drive(
    plot: Path | None, trace: Path | None, compare: str | None, *, is_one: bool
) -> None:
    """Refuse options for one drive unless one road is driven.

    Raises:
        click.UsageError: there is such an option.
    """
    uses = (("--plot draws", plot), ("--trace holds", trace), ("--compare is about", compare))
    for use, value in uses:
        if value is not None and not is_one:
            raise click.UsageError(f"{use} one drive: leave it out with --dry or several roads")


def _plan(
    options: CommandOptions,
    source: Path,
    test_ids: tuple[int, ...],
    lane: int | None,
    map_roads: str | None,
    *,
    is_dry: bool,
) -> DrivePlan:
    """Return the plan to drive tests of a campaign, the road of a file, or roads of a map.

    Args:
        options: options of the command line.
        source: the campaign's folder, or the file.
        test_ids: IDs of the tests.
        lane: ID of an OpenDRIVE lane; None for the usual lane.
        map_roads: IDs of the roads of a map; None for other files.
        is_dry: whether nothing is driven.

    Raises:
        click.UsageError: options do not suit the campaign or the file.
        FreneticError: there is no such campaign, file, test or road.
    """
    if source.is_dir():
        if lane is not None or map_roads is not None:
            raise click.UsageError("--lane and --road are for OpenDRIVE, not for a campaign's test")
        return plan_for_campaign(options, source, test_ids, is_dry=is_dry)
    if len(test_ids) > 1:
        raise click.UsageError(
            f"{source} is no campaign's folder: name one ID of its list of tests"
        )
    if map_roads is not None:
        if test_ids:
            raise click.UsageError("--road is for OpenDRIVE, an ID for a list of tests")
        if options.says("map_size"):
            raise click.UsageError("--road drives roads where they lie: leave out --map-size")
        return plan_for_map(options, source, map_roads, lane)
    test_id = test_ids[0] if test_ids else None
    return plan_for_file(options, source, lane, test_id, is_dry=is_dry)


def _judge(plan: DrivePlan) -> list[dict[str, Any]]:
    """Return for JSON which roads are valid, without driving them."""
    from frenetic.campaign import RoadTester

    documents = []
    for target in plan.targets:
        reason = target.verdict.message
        if target.verdict and not target.road.is_plain:  # only then a simulator may refuse it
            with chdir(plan.code_folder):
                tester = RoadTester.of(plan.spec)
            reason = _refusal(tester, target.road)
        notes = {"notes": list(target.notes)} if target.notes else {}
        documents.append({"road": target.name, "valid": not reason, "message": reason, **notes})
    return documents


class Outputs(NamedTuple):
    """What is wanted of the only drive beside its facts."""

    plot: Path | None
    """File for the picture; None for no picture."""
    trace: TraceFile | None
    """File for the trace; None for no trace."""
    recording: Recording | None
    """Recorded drive on the same road; None without one."""


def _drive(plan: DrivePlan, outputs: Outputs, *, is_quiet: bool) -> list[dict[str, Any]]:
    """Drive the valid roads; print what happened, unless quiet, and return it for JSON.

    Args:
        plan: the roads, and how they are driven.
        outputs: what is wanted of the only drive.
        is_quiet: whether nothing is printed.
    """
    from frenetic.campaign import RoadTester
    from frenetic.campaign.workers import driving
    from frenetic.oracle.outcome import Outcome
    from frenetic.oracle.verdict import Result, judge

    with chdir(plan.code_folder):
        tester = RoadTester.of(plan.spec, rules=plan.rules)
    tester = replace(tester, keeps_notes=outputs.trace is not None)
    documents: list[dict[str, Any]] = []
    with ExitStack() as entered:
        compiled = entered.enter_context(announced_compilation(Log()))
        drive_road, waiting = None, deque(plan.targets)
        while waiting:
            target, driven = waiting.popleft(), None
            reason = target.verdict.message or _refusal(tester, target.road)
            result = Result(Outcome.INVALID, reason)
            if not reason:
                if drive_road is None:  # the simulator starts only if there is a valid road
                    drive_road = entered.enter_context(driving(tester, isolate=True))
                    compiled()
                driven = drive_road(target.road, target.conditions)
                result = judge(target.road, driven)
            document = _document(target, result, driven, tester, outputs.plot)
            comparison, files = _write_outputs(outputs, target, result, driven, tester)
            document |= files
            documents.append(document)
            if not is_quiet:
                _print(plan.spec, tester, target, result, document)
                is_only_drive = len(plan.targets) == 1 and target.rest_after is None
                if plan.spec.rules.criteria or is_only_drive:
                    print_measures(document.get("measures", []), plan.spec.rules.criteria)
                if comparison is not None:
                    print_comparison(comparison)
            is_one = any(output is not None for output in outputs)
            if target.rest_after is not None and result.departure is not None and not is_one:
                rest = target.rest_after(result.departure.distance)
                if rest is not None:
                    waiting.appendleft(rest)
    return documents


def _write_outputs(
    outputs: Outputs, target: RoadToDrive, result: Result, driven: Drive | None, tester: RoadTester
) -> tuple[RecordingComparison | None, dict[str, Any]]:
    """Compare a drive, draw it and write its trace, as far as this is wanted.

    Returns:
        The comparison; None if nothing was compared. And what JSON says about all this.
    """
    conditions = tester.terms.conditions_of(target.conditions)
    comparison = None
    if outputs.recording is not None:
        comparison = compare_drive(outputs.recording, target, driven, result, conditions)
    document: dict[str, Any] = {} if comparison is None else {"compared": comparison.as_json()}
    if outputs.plot is not None:
        if comparison is None:
            _draw(target, result, driven, outputs.plot)
        else:
            draw_comparison(comparison, target, outputs.plot)
    if outputs.trace is not None:
        document |= outputs.trace.write(target.road, driven, result, conditions)
    return comparison, document


def _draw(target: RoadToDrive, result: Result, driven: Drive | None, plot: Path) -> None:
    """Draw a drive, or the road alone if it was not driven."""
    from frenetic.report.picture import draw_drive, draw_road  # imports matplotlib

    title = f"{Path(target.name).name}: {result.outcome}"
    if driven is None:
        draw_road(target.road, plot, title=title, reason=result.reason)
    else:
        draw_drive(target.road, driven, plot, title=title)


def _document(
    target: RoadToDrive,
    result: Result,
    driven: Drive | None,
    tester: RoadTester,
    plot: Path | None,
) -> dict[str, Any]:
    """Return what happened on a road, for JSON."""
    from frenetic.oracle.measures import measures_json

    conditions = tester.terms.conditions_of(target.conditions)
    rules = tester.setting.rules_in(target.conditions)
    document = {
        "road": target.name,
        "length": target.road.length,
        "speed_limits": rules.speed_limits_on(target.road).tolist(),
        **result.as_json(),
        **tester.described,
        **({"conditions": conditions} if conditions else {}),
        **({"notes": list(target.notes)} if target.notes else {}),
        **_mistake(target.road, driven, result),
        **_comparison(target, result, driven, tester),
        **({} if plot is None else {"plot": str(plot)}),
    }
    if driven is not None and result.outcome.is_driven and len(driven.trajectory):
        document["measures"] = measures_json(target.road, driven)
    return document


def _mistake(road: Road, driven: Drive | None, result: Result) -> dict[str, Any]:
    """Return cause and evidence of a failure, for JSON; empty if the drive has none."""
    from frenetic.segments.causes import as_text as cause_text
    from frenetic.segments.evidence import evidence_of_drive

    evidence = None if driven is None else evidence_of_drive(road, driven, result)
    if evidence is None:
        return {}
    return {"cause": cause_text(*evidence.cause), "evidence": evidence.as_json()}


def _comparison(
    target: RoadToDrive, result: Result, driven: Drive | None, tester: RoadTester
) -> dict[str, Any]:
    """Return what differs from the campaign's drive, for JSON; empty if not compared.

    Nothing is compared after a drive with another driver, simulator, rules or conditions, nor for a
    road file.
    """
    from frenetic.campaign.second_drive import moobd_difference, outcome_difference

    if target.test is None or not _is_as_recorded(target, tester):
        return {}
    trajectory = None if driven is None else driven.trajectory
    second = replace(target.test, result=result, pose=target.road.pose, trajectory=trajectory)
    difference = outcome_difference(target.test, second)
    return {"differs": difference or moobd_difference(target.test, second, tester.simulator)}


def _is_as_recorded(target: RoadToDrive, tester: RoadTester) -> bool:
    """Return whether a test is driven with its campaign's parts, rules and conditions."""
    from frenetic.parts.records import differences

    test, config, setting = target.test, target.campaign_config, tester.setting
    if test is None or test.setting is None or config is None:
        return False
    return (
        setting.rules == test.setting.rules
        and setting.conditions == test.setting.conditions
        and dict(target.conditions) == dict(test.candidate.conditions)
        and not any(
            differences(kind, config.get(kind), part) for kind, part in tester.described.items()
        )
    )


def _refusal(tester: RoadTester, road: Road) -> str:
    """Return why simulator or driver refuse a valid road; empty if it can be driven."""
    from frenetic.errors import RoadError
    from frenetic.simulators.capabilities import check_road

    try:
        check_road(tester.simulator, tester.driver, road)
    except RoadError as error:
        return str(error)
    return ""


def _driver_texts(spec: Spec, recorded: object, document: Mapping[str, Any]) -> Iterator[str]:
    """Yield which driver drove in which simulator, and how the recorded driver differs.

    Args:
        spec: spec of the drive.
        recorded: record of the driver in the road's file; None without one.
        document: what happened, as `_document` returns it.
    """
    from frenetic.parts.records import other_version
    from frenetic.spec.part_text import part_text

    driver = document["driver"]
    driver_text = part_text(driver, recorded, word=spec.driver)
    yield f"{driver_text} in {part_text(document['simulator'], word=spec.simulator)}"
    if isinstance(recorded, dict):
        recorded_text = part_text(recorded, driver)
        if recorded_text != part_text(driver, recorded):
            yield f"recorded with {recorded_text}"
        yield from filter(None, [other_version("driver", recorded, driver)])


def _print(
    spec: Spec, tester: RoadTester, target: RoadToDrive, result: Result, document: Mapping[str, Any]
) -> None:
    """Print what happened on a road."""
    duration = result.duration if result.outcome.is_driven else None
    comparison = ""  # nothing was compared
    if (difference := document.get("differs")) is not None:
        comparison = "as in the campaign"
        if difference:
            comparison = f"differs from the campaign: {difference}"
    echo(f"{result.outcome}  {result.reason}")
    print_facts(
        [
            ("road", f"{target.road.length:.1f} m, {target.name}"),
            ("driver", "; ".join(_driver_texts(spec, target.recorded_driver, document))),
            ("limit", limit_text(tester.setting, target.road, target.conditions)),
            ("conditions", as_text({**spec.amounts, **target.conditions})),
            *facts_of_drive(result, duration, target.road.lane_width),
            ("cause", document.get("cause", "")),
            ("mistake", document["evidence"]["text"] if "evidence" in document else ""),
            ("result", comparison),
            ("picture", document.get("plot", "")),
            ("trace", document.get("trace", "")),
        ]
    )
