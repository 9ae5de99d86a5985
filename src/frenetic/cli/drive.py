"""The command that drives single roads, from a file or of a campaign: drive."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli.again import file_spec, recorded_spec
from frenetic.cli.console import (
    Log,
    announced_compilation,
    facts_of_drive,
    print_facts,
    print_measures,
)
from frenetic.cli.options import (
    NewFile,
    file_option,
    json_option,
    lane_option,
    road_option,
    source_arguments,
)
from frenetic.cli.parts import (
    criteria_option,
    given_options,
    given_quantities,
    part_options,
    roads_option,
    with_given,
)
from frenetic.quantities import in_words, without
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import Test
    from frenetic.drive import Drive
    from frenetic.drivers import Driver
    from frenetic.oracle import Result
    from frenetic.road import Road, Verdict
    from frenetic.road.opendrive import Stretch
    from frenetic.simulators import Simulator


@dataclass(frozen=True)
class Asked:
    """A road to drive."""

    name: str
    road: Road
    """In its place on the map, if it fits."""
    verdict: Verdict
    test: Test | None = None
    """The campaign's."""
    recorded: object = None
    """Its driver, in a road's file."""
    is_replaced: bool = False
    """Whether the command line gives other parts or conditions than the file's."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """The test's, but for those that the command line says."""
    behind: Callable[[float], Asked | None] | None = None
    """What is left of a map's stretch behind a place in m along it; None if it is no such road."""


@click.command()
@source_arguments
@roads_option
@part_options
@criteria_option
@click.option("--dry", is_flag=True, help="Say whether the road is valid; do not drive it.")
@file_option(
    "--plot", "Draw the drive into this PNG, SVG or PDF file.", type=NewFile(is_picture=True)
)
@lane_option
@road_option
@click.option("--anyway", is_flag=True, help="Drive the road even if it is invalid.")
@json_option
@click.pass_context
def drive(
    context: click.Context,
    /,
    source: Path,
    test_ids: tuple[int, ...],
    dry: bool,
    plot: Path | None,
    anyway: bool,
    lane: int | None,
    map_roads: str | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive the road of a file or of a campaign's tests, and say what happened.

    The tests of a CAMPAIGN are driven as it drove them, and it is said whether they end as they did
    there; the file of a failing road is driven so, too. Options change that. A ROAD is JSON with
    curvatures (1/m) or road_points, a test file of the competition, or OpenDRIVE. A road that lies
    elsewhere is moved into the map; an invalid one is not driven. With --road the roads of a map
    are driven where they lie, valid or not; where the car leaves its lane the drive goes on behind
    that place as another one. The exit code is 1 if a road is INVALID or the simulator broke
    (ERROR).
    """
    if plot is not None and dry:
        raise click.UsageError("--plot draws a drive: leave it out with --dry")
    if plot is not None and len(test_ids) > 1:
        raise click.UsageError("--plot is for one road: leave it out where there are several")
    if source.is_dir():
        if lane is not None or map_roads is not None:
            raise click.UsageError("--lane and --road are for OpenDRIVE, not for a campaign's test")
        spec, roads = _of_campaign(context, source, test_ids, dry=dry)
    elif test_ids:
        raise click.UsageError(f"{source} is no folder: an ID needs that of a campaign")
    elif map_roads is not None:
        spec, roads = _of_map(context, source, map_roads, lane)
        if plot is not None and len(roads) > 1:
            raise click.UsageError("--plot is for one road: leave it out where there are several")
    elif dry:
        _judge({str(source): _verdict_on(context, source, lane)}, as_json=as_json)
        return
    else:
        spec, roads = _of_file(context, source, lane)
    if dry:
        verdicts = {one.name: _with_parts(spec, one.road, one.verdict) for one in roads}
        _judge(verdicts, as_json=as_json)
        return
    is_whole, documents = True, []
    for asked, result, parts in _driven(spec, roads, plot, anyway=anyway):
        is_whole &= result.outcome.is_driven
        if as_json:
            document = {"road": asked.name, "length": asked.road.length, **result.as_json()}
            documents.append(document | parts | ({} if plot is None else {"plot": str(plot)}))
        else:
            facts = [("driver", _who(asked, parts))]
            if text := in_words({**spec.conditions, **asked.conditions}):
                facts.append(("conditions", text))
            _print_drive(result, asked, plot, facts, parts.get("differs"))
            if spec.rules.criteria or (len(roads) == 1 and map_roads is None):
                print_measures(parts.get("measures", []), spec.rules.criteria)
    if as_json:
        several = len(test_ids) > 1 or map_roads is not None
        click.echo(json.dumps(documents if several else documents[0]))
    if not is_whole:
        raise click.exceptions.Exit(1)


def _judge(verdicts: Mapping[str, Verdict], *, as_json: bool) -> None:
    """Says which roads are valid; the exit code is 1 if one is not."""
    documents = [
        {"road": name, "valid": verdict.valid, "message": verdict.message}
        for name, verdict in verdicts.items()
    ]
    if as_json:
        click.echo(json.dumps(documents if len(documents) > 1 else documents[0]))
    else:
        for name, verdict in verdicts.items():
            click.echo(f"{name}: {'valid' if verdict.valid else f'INVALID  {verdict.message}'}")
    if not all(verdict.valid for verdict in verdicts.values()):
        raise click.exceptions.Exit(1)


def _of_campaign(
    context: click.Context, folder: Path, test_ids: tuple[int, ...], *, dry: bool
) -> tuple[Spec, list[Asked]]:
    """The spec of a campaign, and the roads of tests."""
    from frenetic.campaign import CampaignStore

    if not test_ids:
        raise click.UsageError(
            f"{folder} is a folder: say which tests of the campaign, or name a road file"
        )
    with CampaignStore.open(folder) as store:
        tests = [store.test(number) for number in dict.fromkeys(test_ids)]
        is_made = not dry or any(not test.road.is_plain for test in tests)
        given = given_options(context)
        spec = recorded_spec(store, given, checked=is_made)
    instead = given_quantities(spec, given)
    roads = []
    for test in tests:
        fitted, verdict = test.road.placed(spec.map_size, spec.margin, spec.road_class)
        name, conditions = f"{folder} {test.id}", without(test.candidate.conditions, *instead)
        roads.append(Asked(name, fitted or test.road, verdict, test, conditions=conditions))
    return spec, roads


def _of_file(context: click.Context, path: Path, lane: int | None) -> tuple[Spec, list[Asked]]:
    """The same for a road file."""
    from frenetic.road.files import read_road
    from frenetic.spec import DRIVEN

    file = read_road(path, lane=lane)
    spec, loaded = file_spec(context, file), file.road()
    fitted, verdict = loaded.placed(spec.map_size, road_class=spec.road_class)
    recorded = file.entries.get("driver")
    is_replaced = DRIVEN not in file.entries or bool(given_options(context))
    asked = Asked(str(path), fitted or loaded, verdict, None, recorded, is_replaced)
    return spec, [asked]


def _of_map(
    context: click.Context, path: Path, map_roads: str, lane: int | None
) -> tuple[Spec, list[Asked]]:
    """The same for the roads of a map, where they lie."""
    from frenetic.errors import RoadError
    from frenetic.road import Verdict
    from frenetic.road.files import read_stretches
    from frenetic.search.random_search import TO_GO_ON

    spec = with_given(Spec(), given_options(context), has_roads=False)
    road_map, stretches = read_stretches(path, map_roads, lane=lane)

    def asked(stretch: Stretch) -> Asked:
        def behind(place: float) -> Asked | None:
            if stretch.road.length - place < TO_GO_ON * spec.rules.speed_limit / 3.6:
                return None
            try:
                (rest,) = road_map.stretches(stretch.behind(place), lane=lane)
            except RoadError:
                return None
            return asked(rest)

        verdict = Verdict(True, "")
        if spec.road_class is not None:
            verdict = spec.road_class.verdict(stretch.road)
        return Asked(f"{path} --road {stretch.name}", stretch.road, verdict, behind=behind)

    return spec, [asked(stretch) for stretch in stretches]


def _verdict_on(context: click.Context, path: Path, lane: int | None) -> Verdict:
    """The verdict on a file's road: points are judged where they lie, curvatures where they fit.

    Where the road leans, rises or widens, the simulator and driver have a say, too.
    """
    from frenetic.road.files import read_road

    file = read_road(path, lane=lane)
    spec = file_spec(context, file, checked=False)
    verdict = file.check_validity(spec.map_size, spec.road_class)
    if not verdict or file.road().is_plain:
        return verdict
    return _with_parts(file_spec(context, file), file.road(), verdict)


def _with_parts(spec: Spec, road: Road, verdict: Verdict) -> Verdict:
    """The verdict on a road after that of the simulator and driver, if it leans, rises or widens.

    Only then they are made.
    """
    if not verdict or road.is_plain:
        return verdict
    driver, simulator = spec.make_parts(isolate=False)
    reason = _cannot_be_driven(simulator, driver, road)
    return replace(verdict, valid=not reason, message=reason)


def _driven(
    spec: Spec, roads: list[Asked], plot: Path | None, *, anyway: bool
) -> Iterator[tuple[Asked, Result, dict[str, Any]]]:
    """Drives the valid roads; gives each with its result and with what drove it."""
    from frenetic.campaign import RoadTester
    from frenetic.oracle import Result, judge, measures_json
    from frenetic.outcome import Outcome
    from frenetic.simulators.worlds import in_conditions
    from frenetic.spec import describe

    driver, simulator = spec.make_parts(isolate=True)
    with ExitStack() as entered:
        compiled = entered.enter_context(announced_compilation(Log()))
        is_entered = False
        waiting = deque(roads)
        while waiting:
            asked = waiting.popleft()
            parts: dict[str, Any] = {"driver": describe(driver), "simulator": describe(simulator)}
            reason = "" if asked.verdict.valid or anyway else asked.verdict.message
            reason = reason or _cannot_be_driven(simulator, driver, asked.road)
            if reason:
                if plot is not None:
                    _draw_undriven(asked, reason, plot)
                result = Result(Outcome.INVALID, reason)
                yield asked, result, parts | _compared(asked, result, None, simulator)
                continue
            if not is_entered:
                entered.enter_context(simulator)
                compiled()
                is_entered = True
            if asked.conditions:
                parts["conditions"] = dict(asked.conditions)
            with in_conditions(asked.conditions, simulator, driver) as layered:
                the_drive = RoadTester(simulator, layered).drive(asked.road)
            result = judge(asked.road, the_drive)
            if plot is not None:
                from frenetic.report.picture import draw_drive

                title = f"{Path(asked.name).name}: {result.outcome}"
                draw_drive(asked.road, the_drive, plot, title=title)
            if result.outcome.is_driven and len(the_drive.trajectory):
                parts["measures"] = measures_json(asked.road, the_drive)
            yield asked, result, parts | _compared(asked, result, the_drive, simulator)
            if asked.behind is not None and result.departure is not None and plot is None:
                rest = asked.behind(result.departure.distance)
                waiting.extendleft([] if rest is None else [rest])


def _compared(
    asked: Asked, result: Result, drive: Drive | None, simulator: Simulator
) -> dict[str, Any]:
    """What differs from the campaign's own drive, for JSON; nothing of a road's file."""
    from frenetic.campaign.record import Attempt
    from frenetic.campaign.repeat import other_ending, other_moobd

    if asked.test is None:
        return {}
    path = None if drive is None else drive.trajectory
    attempt = Attempt(asked.test.id, result, asked.road.pose, path)
    again = replace(asked.test, attempt=attempt)
    differs = other_ending(asked.test, again) or other_moobd(asked.test, again, simulator)
    return {"differs": differs}


def _cannot_be_driven(simulator: Simulator, driver: Driver, road: Road) -> str:
    """Why a simulator cannot lay a valid road; empty if it can."""
    from frenetic.errors import RoadError
    from frenetic.simulators.capabilities import check_road

    try:
        check_road(simulator, driver, road)
    except RoadError as error:
        return str(error)
    return ""


def _draw_undriven(asked: Asked, reason: str, plot: Path) -> None:
    from frenetic.report.picture import draw_road

    title = f"{Path(asked.name).name}: INVALID"
    draw_road(asked.road, plot, title=title, reason=reason)


def _who(asked: Asked, parts: dict[str, Any]) -> str:
    """Who drove, and with what it is recorded if that is another."""
    from frenetic.spec import part_text
    from frenetic.versions import other_version

    driver, recorded = parts["driver"], asked.recorded
    now = part_text(driver, recorded)
    who = [f"{now} in {part_text(parts['simulator'])}"]
    if isinstance(recorded, dict):
        before = part_text(recorded, driver)
        if asked.is_replaced and before != now:
            who.append(f"recorded with {before}")
        if note := other_version("driver", recorded, driver):
            who.append(note)
    return "; ".join(who)


def _print_drive(
    result: Result,
    asked: Asked,
    plot: Path | None,
    facts: Sequence[tuple[str, str]],
    differs: str | None,
) -> None:
    click.echo(f"{result.outcome}  {result.reason}")
    facts = [("road", f"{asked.road.length:.1f} m, {asked.name}"), *facts]
    facts += facts_of_drive(result, result.duration if result.outcome.is_driven else None)
    if differs is not None:
        words = f"differs from the campaign: {differs}" if differs else "as in the campaign"
        facts.append(("result", words))
    if plot is not None:
        facts.append(("picture", str(plot)))
    print_facts(facts)
