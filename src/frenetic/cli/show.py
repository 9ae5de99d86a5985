"""The command `show`: a campaign, a list of its tests, or a test in full."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted, oob_unit, rounded_seconds
from frenetic.cli import echo
from frenetic.cli.console import print_facts, print_table, shell, two_digits
from frenetic.cli.drive_facts import facts_of_drive, limit_of_search, limit_text
from frenetic.cli.failure_tables import (
    causes_json,
    clusters_json,
    first_error,
    print_causes,
    print_failures,
)
from frenetic.cli.option_types import NamedRange, range_type
from frenetic.cli.options import as_usage_error, campaign_argument, count_option, json_option
from frenetic.conditions.condition import as_text as conditions_text
from frenetic.conditions.condition import condition_named
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.records import innermost, short_version
from frenetic.spec.part_text import recorded_part
from frenetic.spec.parts import PARTS

if TYPE_CHECKING:
    from frenetic.analysis.bend_map import SweepMap
    from frenetic.analysis.coverage import DomainCoverage
    from frenetic.campaign import CampaignStore, Test
    from frenetic.campaign.counts import Counts
    from frenetic.segments.passing import PassingDrives

MAX_GAPS: Final = 3
"""Largest number of printed cells without a drive (our choice); the JSON has all."""
MAX_TESTS: Final = 20
"""Largest number of tests listed without --limit (our choice); the JSON has all."""


@click.command()
@campaign_argument
@click.argument("test_id", type=int, required=False, metavar="[ID]")
@click.option(
    "--outcome",
    "outcomes",
    type=click.Choice([str(outcome) for outcome in Outcome], case_sensitive=False),
    multiple=True,
    help="List the tests with this outcome; may be repeated.",
)
@click.option(
    "--feature",
    "features",
    type=range_type("max_curvature=0.05:0.07", allows_value=False),
    multiple=True,
    help="List the tests with a feature or condition in a range, as in max_curvature=0.05:0.07 or"
    " friction=0.3:0.5, or show its values: friction; may be repeated.",
)
@click.option(
    "--sort",
    metavar="ORDER",
    help="List the tests by severity (lowest MOOBD first), tested (as their results came),"
    " duration, or a feature or condition (largest first). [default: severity]",
)
@count_option("--limit", f"List N tests at most. [default: {MAX_TESTS}; with --json all]")
@click.option(
    "--follow",
    is_flag=True,
    help="Show the progress of the campaign until it ends; with --json, print its present state.",
)
@json_option
def show(
    campaign: Path,
    test_id: int | None,
    outcomes: tuple[str, ...],
    features: tuple[NamedRange, ...],
    sort: str | None,
    limit: int | None,
    follow: bool,
    as_json: bool,
) -> None:
    """Say what a CAMPAIGN folder holds, list its tests, or show a test in full, with a picture.

    --outcome, --feature, --sort and --limit list tests. Features describe the road and the drive
    within 30 m of the place where the car left its lane, or else was nearest to its edge: length,
    max_curvature, direction_coverage, bends, mean_speed, std_speed, std_steering, mean_offset,
    extreme_offset. --feature and --sort take the name of a condition, too ('frenetic list
    conditions').

    --follow shows the progress of a campaign that runs on this machine, each second. Ctrl-C ends
    the view; the campaign continues. The exit code is 0 when the campaign has finished, 1 when it
    was interrupted, gave up or was killed.
    """
    from frenetic.campaign import CampaignStore

    is_list = bool(outcomes or features or sort is not None or limit is not None)
    if is_list and test_id is not None:
        raise click.UsageError(
            "the ID of a test shows this test alone: leave it out to list tests with --outcome,"
            " --feature, --sort or --limit"
        )
    if follow:
        if is_list or test_id is not None:
            raise click.UsageError("--follow shows the whole campaign: leave out what shows tests")
        from frenetic.cli.follow import follow as follow_campaign
        from frenetic.cli.follow import print_state

        if as_json:
            print_state(campaign)
        else:
            follow_campaign(campaign)
        return
    with CampaignStore.open(campaign) as store:
        if is_list:
            limit = MAX_TESTS if limit is None and not as_json else limit
            _list_tests(store, outcomes, features, sort or "severity", limit, as_json)
        elif test_id is None:
            _show_campaign(store, as_json)
        else:
            _show_test(store, test_id, as_json)


def _list_tests(
    store: CampaignStore,
    outcomes: tuple[str, ...],
    features: tuple[NamedRange, ...],
    sort: str,
    limit: int | None,
    as_json: bool,
) -> None:
    """Print the tests that match the options, or their first `limit`."""
    from frenetic.analysis.listing import ORDERS, list_tests

    anything = (-math.inf, math.inf)
    ranges = {feature.name: feature.limits or anything for feature in features}
    with as_usage_error():
        tests = list_tests(store, outcomes=outcomes, within=ranges, sort=sort)
    listed = tests[:limit]
    names = list(ranges)  # features and conditions with a column
    if sort not in ORDERS and sort not in names:  # sorted by another feature or condition
        names.append(sort)
    rows: list[dict[str, Any]] = [
        {
            "id": test.id,
            "result_number": test.result_number,
            "outcome": str(test.outcome),
            "moobd": test.moobd,
            "duration": rounded_seconds(test.result.duration),
            "operator": test.candidate.origin.operator,
            "reason": test.reason,
            "features": {name: _json_value(values.get(name)) for name in names},
        }
        for test, values in listed
    ]
    if as_json:
        document = {"folder": str(store.folder), "matching": len(tests), "listed": rows}
        echo(json.dumps(document))
        return
    _print_tests(rows, names, oob_unit(store.lane_width))
    remark = f"; the first {len(listed)} are listed" if len(listed) < len(tests) else ""
    verb = "matches" if len(tests) == 1 else "match"
    results = sum(store.by_outcome().values())
    echo(f"{len(tests)} of {counted(results, 'result')} {verb}{remark}")


def _print_tests(rows: Sequence[Mapping[str, Any]], names: Sequence[str], moobd_unit: str) -> None:
    """Print a table of tests.

    Args:
        rows: the tests, as `_list_tests` prints them in JSON.
        names: features and conditions that have a column.
        moobd_unit: unit of the MOOBD, for the heading.
    """
    from frenetic.segments.features import FEATURES

    units = [(FEATURES[name] if name in FEATURES else condition_named(name)).unit for name in names]
    headings = [
        f">{name}{f' ({unit})' if unit else ''}" for name, unit in zip(names, units, strict=True)
    ]
    print_table(
        (
            ">test",
            "outcome",
            f">MOOBD ({moobd_unit})",
            ">time (s)",
            *headings,
            "why",
        ),
        [
            (
                row["id"],
                row["outcome"],
                two_digits(row["moobd"]),
                two_digits(row["duration"]),
                *(None if value is None else f"{value:.3g}" for value in row["features"].values()),
                row["reason"],
            )
            for row in rows
        ],
    )


def _json_value(value: float | None) -> float | None:
    """Return a value for JSON: None for infinity, the amount of an unlimited view."""
    return None if value == math.inf else value


def _show_campaign(store: CampaignStore, as_json: bool) -> None:
    """Print what a campaign holds: its facts, failures and coverage."""
    from frenetic.analysis.bend_map import sweep_map
    from frenetic.analysis.clusters import LISTED, distinct_failures, nearest_misses
    from frenetic.analysis.coverage import domain_coverage
    from frenetic.analysis.explained import explained_causes
    from frenetic.rerun.minimised_roads import minimised_drives

    counts, setting = store.counts(), store.setting
    clusters = distinct_failures(store)
    listed_clusters = clusters if counts.failed else nearest_misses(store)
    minimised = minimised_drives(store, [cause.example for cause in clusters.causes])
    causes = explained_causes(store, clusters)
    coverage = domain_coverage(setting, store.tests())
    swept = sweep_map(store.tests())
    if as_json:
        document = {
            "folder": str(store.folder),
            **counts.counts_json(),
            "causes": causes_json(causes, minimised),
            "distinct_failures": clusters_json(clusters),
            "near_misses": [] if counts.failed else clusters_json(listed_clusters),
            "coverage": None if coverage is None else coverage.as_json(),
            "sweep": None if swept is None else swept.as_json(),
            "facts": dict(store.facts),
            "config": dict(store.config),
        }
        echo(json.dumps(document))
        return
    print_facts(_facts_of_campaign(store, counts))
    if counts.failed:
        print_causes(causes, clusters, counts, minimised)
        echo()
    print_failures(listed_clusters, counts, min(LISTED, len(listed_clusters)), setting.lane_width)
    if coverage is not None:
        echo(
            f"\nFailures/drives in each cell of {coverage.name}, and the most probable cells that"
            " were never reached"
        )
        print_facts(list(_coverage_facts(coverage)))
    if swept is not None:
        _print_sweep(swept)
    if listed_clusters:
        example = clusters.causes[0].example if counts.failed else listed_clusters[0].most_severe
        echo(f"Example in full: frenetic show {shell(store.folder)} {example}")


def _facts_of_campaign(store: CampaignStore, counts: Counts) -> list[tuple[str, str]]:
    """Return the facts of a campaign as labels and texts; `print_facts` leaves out empty texts."""
    from frenetic.analysis.caution import caution
    from frenetic.analysis.criteria import criteria_text
    from frenetic.analysis.failure_stability import FailureStability
    from frenetic.campaign.configuration import earlier_of
    from frenetic.campaign.guarded_strategy import SEARCH_FACTS
    from frenetic.campaign.objective_values import objective_text
    from frenetic.campaign.second_drive import not_repeatable
    from frenetic.campaign.stored_spec import stored_conditions
    from frenetic.campaign.summary import facts_text
    from frenetic.campaign.warm_start import still_failing
    from frenetic.rerun.estimate import FailureRate

    setting, config, facts = store.setting, store.config, store.facts
    budget, rate = _budget(store), FailureRate.read(store.folder)
    stability = FailureStability.read(facts)
    rules, error = setting.rules, first_error(store)
    strategy = config.get("strategy")
    strategy_options = strategy.get("options") if isinstance(strategy, Mapping) else None
    limit = limit_of_search(setting, config.get("from_roads"), strategy_options)
    return [
        ("campaign", str(store.folder)),
        *((kind, _part_text(config, kind)) for kind in PARTS),
        ("seed", "" if config.get("seed") is None else str(config["seed"])),
        ("conditions", conditions_text(stored_conditions(store))),
        (
            "rules",
            f"speed limit {limit}, {rules.oob_tolerance:g} of the car may be out, map of"
            f" {setting.map_size:g} m",
        ),
        ("criteria", criteria_text(store)),
        ("roads", "" if setting.road_class is None else setting.road_class.as_text()),
        ("domain", "" if setting.domain is None else setting.domain.as_text()),
        ("how often", "" if rate is None else rate.as_text()),
        ("objective", objective_text(store)),
        *(("starts from", str(earlier)) for earlier in earlier_of(config)),
        ("budget", budget),
        ("go on", _next_command(store)),
        ("results", counts.as_text()),
        ("known before", still_failing(store)),
        ("stability", "" if stability is None else stability.as_text()),
        ("search", facts_text(facts.get(SEARCH_FACTS))),
        ("note", not_repeatable(facts)),
        ("note", str(facts.get("notice") or "")),
        ("note", caution(store)),
        ("error", f"the first: {error}" if error else ""),
    ]


def _budget(store: CampaignStore) -> str:
    """Return the budget of a campaign, and whether it was interrupted or has not finished."""
    from frenetic.campaign.stored_spec import stored_budget

    facts = store.facts
    try:
        budget = str(stored_budget(store))
    except CampaignError:
        budget = "unknown"
    if facts.get("interrupted"):
        return f"{budget}, interrupted"
    return budget if "finished_at" in facts else f"{budget}, not finished"


def _next_command(store: CampaignStore) -> str:
    """Return the command that continues a campaign or writes its report; empty if finished."""
    from frenetic.campaign.advice import how_to_resume
    from frenetic.campaign.configuration import OWNER, SPEC
    from frenetic.campaign.status import Status, read_status
    from frenetic.report.html.campaign import has_report

    status, config = read_status(store), store.config
    is_search = config.get(SPEC) is not None and config.get(OWNER) is None
    if status is Status.FINISHED:
        needs_report = is_search and not has_report(store)
        return f"frenetic resume {shell(store.folder)}" if needs_report else ""
    return how_to_resume(store) if status.has_ended else ""


def _coverage_facts(coverage: DomainCoverage) -> Iterator[tuple[str, str]]:
    """Yield the coverage of a domain as labels and texts: axes, pairs, gaps, drives outside."""
    for cells in coverage.singles:
        (axis,) = cells.axes
        texts = (
            f"{axis.text(i)}: {f'{failures}/{drives}' if drives else 'never'}"
            for i, (drives, failures) in enumerate(zip(cells.drives, cells.failures, strict=True))
        )
        yield f"{axis.title}{f' ({axis.unit})' if axis.unit else ''}", ", ".join(texts)
    yield "together", coverage.as_text()
    for i, gap in enumerate(coverage.gaps[:MAX_GAPS]):
        label = "never reached" if i == 0 else ""
        yield label, f"{gap.as_text()}, {gap.likelihood}"
    if coverage.outside:
        yield "outside", f"{counted(coverage.outside, 'drive')}, which count nowhere"


def _print_sweep(swept: SweepMap) -> None:
    """Print failures and drives of each cell of a sweep, with the lowest MOOBD."""
    rows = []
    for i in reversed(range(len(swept.speeds))):
        cells = [
            f"{swept.failures[i, j]}/{swept.drives[i, j]} {swept.moobd[i, j]:5.2f}"
            if swept.drives[i, j]
            else None
            for j in range(len(swept.radii))
        ]
        rows.append((f"{swept.speeds[i]:g} km/h", *cells))
    echo("\nFailures/drives and lowest MOOBD (m) by radius and speed limit")
    print_table(("", *(f">{radius:g} m" for radius in swept.radii)), rows)


def _cause_text(test: Test) -> str:
    """Return what the driver did wrong in a failed test; empty if unknown or in the reason."""
    from frenetic.analysis.failures import Failure
    from frenetic.segments.causes import as_text

    failure = Failure.of_test(test)
    return "" if failure is None or failure.cause is None else as_text(*failure.cause)


def _trials_text(store: CampaignStore, test_id: int) -> str:
    """Return what trials of a test's cause showed; empty without trials."""
    from frenetic.analysis.cause_trials import tried_failures

    tried = tried_failures(store.facts).get(test_id)
    return "" if tried is None else tried.as_text()


def _part_text(config: Mapping[str, Any], kind: str) -> str:
    """Return a part of a campaign's configuration with its options and version."""
    version = short_version(innermost(config.get(kind)))
    return recorded_part(config, kind) + (f" [{version}]" if version else "")


def _draw(store: CampaignStore, test: Test, passing: PassingDrives | None) -> str:
    """Draw a test into the campaign's folder; return the picture's path, or why there is none."""
    from frenetic.campaign.record import file_stem
    from frenetic.report.failures import FAILURES, PICTURES
    from frenetic.report.picture import draw_test

    folder_name = FAILURES if test.outcome is Outcome.FAIL else PICTURES
    picture = store.folder / folder_name / f"{file_stem(test.id)}.png"
    try:
        picture.parent.mkdir(exist_ok=True)
        draw_test(test, picture, f"Test {test.id}: {test.outcome}", passing)
    except (OSError, FreneticError) as error:
        return f"not drawn, {error}"
    return str(picture)


def _origin_text(store: CampaignStore, test: Test) -> str:
    """Return the operator that made a test's road, the tests of its parents, and the generation."""
    from frenetic.campaign.warm_start import driven_again
    from frenetic.search.operator_names import EARLIER, GIVEN

    origin, notes = test.candidate.origin, test.candidate.notes
    text = origin.operator
    if origin.parents:
        text += f" of {', '.join(map(str, origin.parents))}"
    earlier = driven_again(store).get(test.id) if origin.operator == EARLIER else None
    if earlier is not None and (source := earlier.candidate.source) is not None:
        text += f", the road of test {source.test} of {source.campaign}"
    if GIVEN in notes:
        text += f", {notes[GIVEN]}"
    return f"{text}, generation {origin.generation}"


def _minimised_text(store: CampaignStore, test_id: int) -> str:
    """Return the length and file of a test's minimised road; empty if it was not minimised."""
    from frenetic.rerun.minimised_roads import minimised_drives, minimised_road

    minimised = minimised_drives(store, [test_id]).get(test_id)
    if minimised is None:
        return ""
    return f"{minimised.road.length:.1f} m, {minimised_road(store.folder, test_id)}"


def _objective_value_text(store: CampaignStore, test: Test) -> str:
    """Return a test's value of the campaign's objective; empty for the MOOBD or without a drive."""
    from frenetic.campaign.objective_values import value_text

    if test.objective is None:
        return ""
    return value_text(str(store.config.get("objective")), test.objective)


def _show_test(store: CampaignStore, test_id: int, as_json: bool) -> None:
    """Draw a test, and print everything that is known about it."""
    from frenetic.analysis.passing import passing_drives
    from frenetic.campaign.stored_spec import signed_driving, stored_conditions
    from frenetic.report.failures import road_document
    from frenetic.segments.evidence import evidence_of_result

    test = store.test(test_id)
    result_number, own_conditions = test.result_number, test.candidate.conditions
    passing = passing_drives(store) if test.outcome is Outcome.FAIL else None
    evidence = evidence_of_result(test.segment, test.result, passing)
    picture = _draw(store, test, passing)
    if as_json:
        document = road_document(test, store.config, signed_driving(store))
        further = {
            "picture": picture,
            "result_number": result_number,
            "evidence": None if evidence is None else evidence.as_json(),
        }
        echo(json.dumps(document | further))
        return
    number_text = "" if result_number == test_id else f", result {result_number}"
    print_facts(
        [
            ("test", f"{test_id}{number_text}"),
            ("outcome", f"{test.outcome}  {test.reason}"),
            ("origin", _origin_text(store, test)),
            ("cause", _cause_text(test)),
            ("mistake", "" if evidence is None else evidence.text),
            ("trials", _trials_text(store, test_id)),
            ("conditions", conditions_text({**stored_conditions(store), **own_conditions})),
            ("road", test.road.as_text()),
            ("limit", limit_text(store.setting, test.road, own_conditions)),
            ("minimised", _minimised_text(store, test_id)),
            ("driver", _part_text(store.config, "driver")),
            *facts_of_drive(test.result, test.result.duration, test.road.lane_width),
            ("objective", _objective_value_text(store, test)),
            ("curvatures", " ".join(f"{value:.4f}" for value in test.road.curvatures)),
            ("picture", picture),
        ]
    )
