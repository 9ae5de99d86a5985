"""The command that drives single roads, from a file or of a campaign: drive."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, chdir
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, announced_compilation, print_facts, shell
from frenetic.cli.drive_facts import facts_of_drive, limit_text, print_measures
from frenetic.cli.entries import entry_option, entry_options, part_options, trust_option
from frenetic.cli.options import (
    NewFile,
    file_option,
    json_option,
    lane_option,
    road_option,
    source_arguments,
)
from frenetic.cli.rerun_options import campaign_spec, file_spec
from frenetic.conditions.condition import as_text, without
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester, Test
    from frenetic.oracle.drive import Drive, Rules
    from frenetic.oracle.verdict import Result
    from frenetic.road import Road, Verdict
    from frenetic.road.files import RoadFile
    from frenetic.road.opendrive import Stretch


@dataclass(frozen=True)
class Asked:
    """A road to drive."""

    name: str
    road: Road
    """The road, placed on the map if it fits."""
    verdict: Verdict
    test: Test | None = None
    """The test of a campaign; None for a road file."""
    campaign: Mapping[str, Any] | None = None
    """The campaign's configuration."""
    recorded: object = None
    """The driver in a road's file."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of the test without those that the command line sets."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of a map that do not quite meet."""
    behind: Callable[[float], Asked | None] | None = None
    """Distance along a map's stretch, in m -> the road behind it; None for other roads."""


@click.command()
@source_arguments
@entry_option("roads")
@part_options
@entry_options("criteria", "map_size")
@trust_option
@click.option("--dry", is_flag=True, help="Say whether the road is valid; do not drive it.")
@file_option(
    "--plot", "Draw the drive into this PNG, SVG or PDF file.", type=NewFile(is_picture=True)
)
@lane_option
@road_option
@json_option
@click.pass_context
def drive(
    context: click.Context,
    /,
    source: Path,
    test_ids: tuple[int, ...],
    dry: bool,
    plot: Path | None,
    lane: int | None,
    map_roads: str | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive the road of a file or of a campaign's tests, and say what happened.

    The tests of a CAMPAIGN are driven as it drove them, and it is said whether they end as they did
    there; the file of a failing road is driven so, too. With options that change driver, simulator,
    rules or conditions nothing is compared. A ROAD is JSON with curvatures (1/m) or road_points, a
    test file of the competition, or OpenDRIVE; where it holds a list of tests, ID is the number of
    one. A road that lies elsewhere is moved into the map; an invalid one is not driven. With --road
    the roads of a map are driven where they lie, valid or not; where the car leaves its lane the
    drive goes on behind that place as another one. The exit code is 1 if a road is INVALID or the
    simulator broke (ERROR).
    """
    options, rules = CommandOptions.of(context), None
    if source.is_dir():
        if lane is not None or map_roads is not None:
            raise click.UsageError("--lane and --road are for OpenDRIVE, not for a campaign's test")
        (spec, folder), rules, roads = _of_campaign(options, source, test_ids, dry=dry)
    elif len(test_ids) > 1:
        raise click.UsageError(
            f"{source} is no campaign's folder: name one ID of its list of tests"
        )
    elif map_roads is not None:
        if test_ids:
            raise click.UsageError("--road is for OpenDRIVE, an ID for a list of tests")
        if options.says("map_size"):
            raise click.UsageError("--road drives roads where they lie: leave out --map-size")
        (spec, folder), roads = _of_map(options, source, map_roads, lane)
    else:
        number = next(iter(test_ids), None)
        (spec, folder), roads = _of_file(options, source, lane, number, dry=dry)
    if plot is not None and (dry or len(roads) > 1):
        raise click.UsageError("--plot draws one drive: leave it out with --dry or several roads")
    if dry:
        documents = _judged(spec, folder, roads)
    else:
        documents = _driven(spec, folder, rules, roads, plot, is_quiet=as_json)
    if as_json:
        several = len(roads) > 1 or map_roads is not None
        echo(json.dumps(documents if several else documents[0]))
    elif dry:
        for document in documents:
            text = "valid" if document["valid"] else f"INVALID  {document['message']}"
            echo(f"{document['road']}: {text}")
    if not all(
        document["valid"] if dry else document["outcome"] in ("PASS", "FAIL")
        for document in documents
    ):
        raise click.exceptions.Exit(1)


def _of_campaign(
    options: CommandOptions, folder: Path, test_ids: tuple[int, ...], *, dry: bool
) -> tuple[tuple[Spec, Path], Rules | None, list[Asked]]:
    """Return a campaign's spec with the folder of its code, its recorded rules, and the roads."""
    from frenetic.campaign import CampaignStore
    from frenetic.rerun.rerun import recorded_rules

    if not test_ids:
        raise click.UsageError(
            f"{folder} is a folder: say which tests of the campaign, or name a road file"
        )
    if options.says("map_size"):
        raise click.UsageError("--map-size is for a ROAD file: a campaign has its own map")
    with CampaignStore.open(folder) as store:
        tests = [store.test(number) for number in dict.fromkeys(test_ids)]
        is_made = not dry or any(not test.road.is_plain for test in tests)
        config = store.config
        spec, place = campaign_spec(store, options, checked=is_made)
        terms, rules = store.setting, recorded_rules(store, spec)
    instead = options.conditions(spec)
    roads = []
    for test in tests:
        fitted, verdict = test.road.placed(terms.map_size, terms.map_margin, terms.road_class)
        name, conditions = f"{folder} {test.id}", without(test.candidate.conditions, *instead)
        road = fitted or test.road
        roads.append(Asked(name, road, verdict, test, config, conditions=conditions))
    return (spec, place), rules, roads


def _of_file(
    options: CommandOptions, path: Path, lane: int | None, test_id: int | None, *, dry: bool
) -> tuple[tuple[Spec, Path], list[Asked]]:
    """Return spec, folder and road of a road file; ``--dry`` checks its points where they lie."""
    from frenetic.road import Verdict
    from frenetic.road.files import read_road

    file = read_road(path, lane=lane, test=test_id)
    road = file.road()
    spec, folder = file_spec(options, file, checked=not dry or not road.is_plain)
    terms = spec.terms
    fitted, verdict = road.placed(terms.map_size, road_class=terms.road_class)
    if dry:
        verdict = file.check_validity(terms.map_size, terms.road_class)
    if fitted is None:
        verdict = Verdict(False, f"{verdict.message}; {_larger_map(file, road, spec)}")
    name = str(path) if test_id is None else f"{path} {test_id}"
    asked = Asked(name, fitted or road, verdict, recorded=file.entries.get("driver"))
    return (spec, folder), [asked]


def _larger_map(file: RoadFile, road: Road, spec: Spec) -> str:
    """Say what to do with a road that does not fit the map."""
    if file.map_road is not None:
        return f"--road {shell(file.map_road)} drives it where it lies"
    map_size = spec.terms.map_size
    while (fitted := road.fitted(map_size)) is None:
        map_size += 100.0
    verdict = fitted.check_validity(map_size, spec.road_class)
    if not verdict.valid:
        return (
            f"on one of {map_size:g} m it is refused, too: {verdict.message}; export it as"
            " OpenDRIVE and drive that file with --road 1, which drives a road where it lies"
        )
    return f"--map-size {map_size:g} has room for it"


def _of_map(
    options: CommandOptions, path: Path, map_roads: str, lane: int | None
) -> tuple[tuple[Spec, Path], list[Asked]]:
    """Return spec, folder and roads of a map; the roads stay where they lie."""
    from frenetic.errors import RoadError
    from frenetic.road import Verdict
    from frenetic.road.files import read_stretches
    from frenetic.search.continuations import MIN_REST_TIME
    from frenetic.simulators.conditions import rules_in

    spec, folder = options.trusted(options.over(Spec(), has_roads=False))
    road_map, stretches = read_stretches(path, map_roads, lane=lane)

    def asked(stretch: Stretch) -> Asked:
        def behind(place: float) -> Asked | None:
            rules = rules_in(spec.conditions, spec.rules)
            rest_limits = rules.speed_limits_on(stretch.road)[:, 1]
            if stretch.road.length - place < MIN_REST_TIME * float(rest_limits.max()) / 3.6:
                return None
            try:
                (rest,) = road_map.stretches(stretch.rest_name(place), lane=lane)
            except RoadError:
                return None
            return asked(rest)

        verdict = Verdict(True, "")
        if spec.road_class is not None:
            verdict = spec.road_class.verdict(stretch.road)
        name = f"{path} --road {stretch.name}"
        return Asked(name, stretch.road, verdict, notes=stretch.notes, behind=behind)

    for stretch in stretches:
        for note in stretch.notes:
            Log().print(f"Note: {note}", markup=False)
    return (spec, folder), [asked(stretch) for stretch in stretches]


def _judged(spec: Spec, folder: Path, roads: list[Asked]) -> list[dict[str, Any]]:
    """Say which roads are valid; parts are made only for a road that leans, rises or widens."""
    from frenetic.campaign import RoadTester

    documents = []
    for asked in roads:
        reason = asked.verdict.message
        if asked.verdict and not asked.road.is_plain:
            with chdir(folder):
                tester = RoadTester.of(spec)
            reason = _cannot_be_driven(tester, asked.road)
        notes = {"notes": list(asked.notes)} if asked.notes else {}
        documents.append({"road": asked.name, "valid": not reason, "message": reason, **notes})
    return documents


def _driven(
    spec: Spec,
    folder: Path,
    rules: Rules | None,
    roads: list[Asked],
    plot: Path | None,
    *,
    is_quiet: bool,
) -> list[dict[str, Any]]:
    """Drive the valid roads; print what happened, unless quiet, and return it for JSON."""
    from frenetic.campaign import RoadTester
    from frenetic.campaign.workers import driving
    from frenetic.oracle.outcome import Outcome
    from frenetic.oracle.verdict import Result, judge

    with chdir(folder):
        tester = RoadTester.of(spec, rules=rules)
    documents: list[dict[str, Any]] = []
    with ExitStack() as entered:
        compiled = entered.enter_context(announced_compilation(Log()))
        drive_road, waiting = None, deque(roads)
        while waiting:
            asked = waiting.popleft()
            road, the_drive = asked.road, None
            reason = asked.verdict.message or _cannot_be_driven(tester, road)
            result = Result(Outcome.INVALID, reason)
            if not reason:
                if drive_road is None:
                    drive_road = entered.enter_context(driving(tester, isolate=True))
                    compiled()
                the_drive = drive_road(road, asked.conditions)
                result = judge(road, the_drive)
            if plot is not None:
                _draw(asked, result, the_drive, plot)
            document = _document(asked, result, the_drive, tester, plot)
            documents.append(document)
            if not is_quiet:
                _print(spec, tester, asked, result, document)
                if spec.rules.criteria or (len(roads) == 1 and asked.behind is None):
                    print_measures(document.get("measures", []), spec.rules.criteria)
            if asked.behind is not None and result.departure is not None and plot is None:
                rest = asked.behind(result.departure.distance)
                waiting.extendleft([] if rest is None else [rest])
    return documents


def _draw(asked: Asked, result: Result, drive: Drive | None, plot: Path) -> None:
    """Draw a drive, or the road alone if it was not driven."""
    from frenetic.report.picture import draw_drive, draw_road  # too slow for others

    title = f"{Path(asked.name).name}: {result.outcome}"
    if drive is None:
        draw_road(asked.road, plot, title=title, reason=result.reason)
    else:
        draw_drive(asked.road, drive, plot, title=title)


def _document(
    asked: Asked, result: Result, drive: Drive | None, tester: RoadTester, plot: Path | None
) -> dict[str, Any]:
    """Return what happened on a road, for JSON."""
    from frenetic.oracle.measures import measures_json

    road = asked.road
    conditions = tester.terms.conditions_of(asked.conditions)
    document = {
        "road": asked.name,
        "length": road.length,
        "speed_limits": tester.setting.rules_in(asked.conditions).speed_limits_on(road).tolist(),
        **result.as_json(),
        **tester.described,
        **({"conditions": conditions} if conditions else {}),
        **({"notes": list(asked.notes)} if asked.notes else {}),
        **_compared(asked, result, drive, tester),
        **({} if plot is None else {"plot": str(plot)}),
    }
    if drive is not None and result.outcome.is_driven and len(drive.trajectory):
        document["measures"] = measures_json(road, drive)
    return document


def _compared(
    asked: Asked, result: Result, drive: Drive | None, tester: RoadTester
) -> dict[str, Any]:
    """Return what differs from the campaign's drive, for JSON; empty if not compared.

    Nothing is compared after a drive with another driver, simulator, rules or conditions, nor for a
    road file.
    """
    from frenetic.campaign.second_drive import moobd_difference, outcome_difference

    if asked.test is None or not _is_as_recorded(asked, tester):
        return {}
    path = None if drive is None else drive.trajectory
    again = replace(asked.test, result=result, pose=asked.road.pose, trajectory=path)
    differs = outcome_difference(asked.test, again) or moobd_difference(
        asked.test, again, tester.simulator
    )
    return {"differs": differs}


def _is_as_recorded(asked: Asked, tester: RoadTester) -> bool:
    """Tell whether a test is driven with its campaign's parts, rules and conditions."""
    from frenetic.parts.versions import differences

    test, setting = asked.test, tester.setting
    if test is None or test.setting is None or asked.campaign is None:
        return False
    return (
        setting.rules == test.setting.rules
        and setting.conditions == test.setting.conditions
        and dict(asked.conditions) == dict(test.candidate.conditions)
        and not any(
            differences(kind, asked.campaign.get(kind), part)
            for kind, part in tester.described.items()
        )
    )


def _cannot_be_driven(tester: RoadTester, road: Road) -> str:
    """Say why a simulator cannot lay a valid road; empty if it can."""
    from frenetic.errors import RoadError
    from frenetic.simulators.capabilities import check_road

    try:
        check_road(tester.simulator, tester.driver, road)
    except RoadError as error:
        return str(error)
    return ""


def _who(spec: Spec, recorded: object, document: Mapping[str, Any]) -> Iterator[str]:
    """Yield which driver drove, and the recorded driver if it differs."""
    from frenetic.parts.versions import other_version
    from frenetic.spec.part_text import part_text

    driver = document["driver"]
    now = part_text(driver, recorded, word=spec.driver)
    yield f"{now} in {part_text(document['simulator'], word=spec.simulator)}"
    if isinstance(recorded, dict):
        before = part_text(recorded, driver)
        if before != part_text(driver, recorded):
            yield f"recorded with {before}"
        yield from filter(None, [other_version("driver", recorded, driver)])


def _print(
    spec: Spec, tester: RoadTester, asked: Asked, result: Result, document: Mapping[str, Any]
) -> None:
    differs = document.get("differs")
    words = f"differs from the campaign: {differs}" if differs else "as in the campaign"
    echo(f"{result.outcome}  {result.reason}")
    print_facts(
        [
            ("road", f"{asked.road.length:.1f} m, {asked.name}"),
            ("driver", "; ".join(_who(spec, asked.recorded, document))),
            ("limit", limit_text(tester.setting, asked.road, asked.conditions)),
            ("conditions", as_text({**spec.amounts, **asked.conditions})),
            *facts_of_drive(
                result,
                result.duration if result.outcome.is_driven else None,
                asked.road.lane_width,
            ),
            ("result", "" if differs is None else words),
            ("picture", document.get("plot", "")),
        ]
    )
