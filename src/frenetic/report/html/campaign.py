"""The HTML report of a campaign, as a file."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from msgspec.json import encode

from frenetic._support.entry_points import imported, installed
from frenetic._support.files import open_file
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.words import (
    capitalised,
    counted,
    format_duration,
    oob_words,
    rate_words,
    signed,
)
from frenetic.analysis.axes import varied_axes
from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import COMPARED, Clusters, distinct_among, nearest_misses
from frenetic.analysis.coverage import domain_coverage
from frenetic.analysis.criteria import criteria_text
from frenetic.analysis.failures import Failure
from frenetic.analysis.features import Features, features_of
from frenetic.analysis.segments import Segment, segment_of_test
from frenetic.campaign.advice import resume_command
from frenetic.campaign.configuration import OWNER, SPEC, earlier_of
from frenetic.campaign.counts import Counts
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.campaign.objective_values import objective_text
from frenetic.campaign.record import Test
from frenetic.campaign.second_drive import not_repeatable
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import facts_text
from frenetic.campaign.warm_start import still_failing
from frenetic.conditions.condition import as_text
from frenetic.errors import CampaignError
from frenetic.export.tables import Place, opened
from frenetic.oracle.outcome import Outcome
from frenetic.parts.versions import innermost, short_version
from frenetic.report.failures import MOST_FILES
from frenetic.report.html.domain import domain_section
from frenetic.report.html.feature_map import choose_mapped, map_section
from frenetic.report.html.gallery import gallery_section
from frenetic.report.html.page import (
    DataBlock,
    Facts,
    Paragraph,
    Report,
    Section,
    command,
    percent,
    write_page,
)
from frenetic.report.html.tests import (
    COLUMNS,
    Film,
    TestSummary,
    drive_data,
    files_of,
    table_of,
)
from frenetic.report.html.timeline import timeline_section
from frenetic.rerun.estimate import FailureRate
from frenetic.rerun.rerun import in_other_simulators, own_repeats, read_reruns
from frenetic.search.records import Candidate
from frenetic.spec import FILE
from frenetic.spec.part_text import recorded_part
from frenetic.spec.parts import PARTS

FILMS: Final = "frenetic.films"
"""Group of entry points. Each is a function of a campaign's configuration that returns a function
of a test, which returns the test's `Film` or None."""
DRIVES_SIZE: Final = 3_500_000
"""Most bytes of JSON for all drives of a page."""
FILMS_SIZE: Final = 3_000_000
"""Most bytes of all pictures of a page."""
REPORT: Final = "report.html"
"""Name of the report in a campaign's folder."""
_BEGINNING: Final = 1024
"""Bytes of a report among which is the end of its campaign; ours."""

_LATE: Final = 0.8
"""Share of the tests after which failures are late; many late failures mean that more drives find
more."""


@dataclass(frozen=True)
class Reading:
    """A campaign's tests at one moment, each of which is read once."""

    tests: Sequence[TestSummary]
    counts: Counts
    clusters: Clusters
    """The distinct failures."""
    misses: Clusters | None
    """The nearest misses; None if a test failed."""
    mapped: Mapping[int, tuple[Features, Candidate]]
    """The tests in the feature map, with their features."""
    failures: Mapping[int, tuple[Test, Segment | None]]
    """The most severe failures, each with its segment, if it has records."""
    finished_at: str = ""
    """When the campaign ended; empty if it had not ended when its tests were read."""

    @classmethod
    def of(cls, store: CampaignStore) -> Reading:
        """Read the tests of a campaign.

        Raises:
            CampaignError: the campaign is damaged.
        """
        finished_at = _finished_at(store.facts)  # first: a campaign that goes on ends anew
        rows = store.rows(
            "SELECT id, outcome, moobd FROM test WHERE result_number IS NOT NULL"
            " ORDER BY result_number"
        )
        repeats = store.repeats()
        first_tests = [
            (int(id), str(outcome), moobd)
            for id, outcome, moobd in rows  # noqa: A001
            if id not in repeats
        ]
        failed = [row for row in first_tests if row[1] == Outcome.FAIL]
        failed.sort(key=lambda row: math.inf if row[2] is None else row[2])
        chosen = choose_mapped(first_tests)
        compared, in_files = ({row[0] for row in failed[:most]} for most in (COMPARED, MOST_FILES))
        counts, tests = Counts(), []
        failures: list[Failure] = []
        mapped, severe = {}, {}
        for record in store.tests(with_trajectory=chosen | compared):
            tests.append(TestSummary.of(record, is_repeat=record.id in repeats))
            counts.add(record.candidate, record.outcome, record.moobd)
            segment = segment_of_test(record)
            if record.id in compared:
                failures += filter(None, [Failure.of_segment(segment, record.result, record.id)])
            if record.id in chosen and segment is not None:
                mapped[record.id] = features_of(segment), record.candidate
            if record.id in in_files:
                severe[record.id] = record, segment
        clusters = distinct_among(store, failures)
        misses = None if counts.failed else nearest_misses(store)
        return cls(tests, counts, clusters, misses, mapped, severe, finished_at)


def write_report(
    campaign: Place,
    path: Path | str | None = None,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Write the report of a campaign: one self-contained HTML file.

    Args:
        campaign: an open campaign, or a campaign's folder.
        path: path of the file, which is replaced; by default ``report.html`` in that folder.
        reading: the campaign's tests, if they are read already.
        sections: sections to add after the campaign's sections.

    Returns:
        The file.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
        FreneticError: the file cannot be written.
    """
    with opened(campaign) as store:
        path = store.folder / REPORT if path is None else Path(path)
        report = campaign_report(store, reading=reading, sections=sections)
    return write_page(report, path)


def has_report(store: CampaignStore) -> bool:
    """Return whether a campaign has ended and its folder holds the report of this end.

    A report that was written before the campaign was resumed does not count.
    """
    finished_at = _finished_at(store.facts)
    try:
        with open_file(store.folder / REPORT) as file:
            beginning = file.read(_BEGINNING).decode("utf-8", "replace")
    except OSError:
        return False
    return bool(finished_at) and Report("", (), finished_at=finished_at).finished_tag in beginning


def campaign_report(
    store: CampaignStore,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Report:
    """Return the report of a campaign.

    Raises:
        CampaignError: the campaign is damaged.
    """
    reading = Reading.of(store) if reading is None else reading
    tests, counts, clusters = reading.tests, reading.counts, reading.clusters
    shown_clusters, config = reading.misses or clusters, store.config
    try:
        reruns, trouble = read_reruns(store.folder), ""
    except CampaignError as error:
        reruns, trouble = [], str(error)
    elsewhere_reruns = in_other_simulators(reruns, config)
    shown = _to_show(
        tests, shown_clusters, [test.id for rerun in elsewhere_reruns for test in rerun.tests]
    )
    coverage = domain_coverage(store.setting, store.tests())
    driven = [test.conditions for test in tests if test.outcome.is_driven]
    axes = varied_axes(driven) if coverage is None else coverage.axes
    drives = _drives(store, reading, shown)
    order = [i for i in dict.fromkeys([*shown, *reading.mapped]) if i in reading.mapped]
    mapped = {i: reading.mapped[i] for i in order}
    cells = {axis: [axis.find(candidate) for _, candidate in mapped.values()] for axis in axes}
    title = _title(clusters, counts)
    return Report(
        title=title,
        sections=(
            Section("summary", title, (headline(store, clusters, counts, trouble),)),
            gallery_section(
                shown_clusters, tests, drives, counts, own_repeats(reruns), elsewhere_reruns, config
            ),
            timeline_section(tests, clusters),
            *([] if coverage is None else [domain_section(coverage)]),
            map_section({i: features for i, (features, _) in mapped.items()}, tests, cells),
            Section("tests", "All tests", (DataBlock("tests", {}),)),
            configuration(store.folder, config, store.facts),
            *sections,
        ),
        data={
            "campaign": _shell(store.folder),
            "is_named": isinstance(config.get(SPEC), Mapping),
            "lane_width": store.setting.lane_width,
            "tests": table_of(tests),
            "resolutions": COLUMNS,
            "drives": drives,
        },
        finished_at=reading.finished_at,
    )


def _finished_at(facts: Mapping[str, Any]) -> str:
    """Return when a campaign with these facts ended; empty if it has not ended."""
    return str(facts.get("finished_at", ""))


def _drives(store: CampaignStore, reading: Reading, shown: Sequence[int]) -> list[dict[str, Any]]:
    """Return the drives of the first tests to show, as many as there is room for."""
    drives: list[dict[str, Any]] = []
    room, room_for_pictures = DRIVES_SIZE, FILMS_SIZE
    films: list[Callable[[Test], Film | None]] = [
        imported(entry.target)(store.config) for entry in installed(FILMS)
    ]
    for test_id in shown:
        if room <= 0:
            break
        if test_id in reading.failures:
            record, segment = reading.failures[test_id]
        else:
            record = store.test(test_id)
            segment = segment_of_test(record)
        if segment is None:
            continue
        data = drive_data(test_id, record.result, segment, record.candidate.origin)
        data |= files_of(test_id, store)
        if conditions := as_text(record.candidate.conditions):
            data["reason"] += f"; {conditions}"
        drives.append(data)
        room -= len(encode(data))
        candidates = (film_of(record) for film_of in films if room_for_pictures > 0)
        film = next((film for film in candidates if film is not None), None)
        drives[-1]["film"] = film
        room_for_pictures -= 0 if film is None else len(film.pictures)
    return drives


def _to_show(
    tests: Sequence[TestSummary], clusters: Clusters, elsewhere: Sequence[int]
) -> list[int]:
    """Return ids of the tests to show, the most important first.

    An example of each cause, each cluster's most severe and typical failure, then the failures that
    were driven in another simulator, then the most severe failures.
    """
    examples = [cause.example for cause in clusters.causes]
    heads = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL and not test.is_repeat),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    return list(dict.fromkeys([*examples, *heads, *elsewhere, *(test.id for test in failed)]))


def _shell(path: Path) -> str:
    """Return a path for pasting into a shell."""
    text = str(path).encode("utf-8", "replace").decode()  # it may hold what no page can
    return f'"{text}"' if sys.platform == "win32" else shlex.quote(text)


# The headline


def _title(clusters: Clusters, counts: Counts) -> str:
    if counts.errors and not counts.failed:
        return capitalised(counts.broken)
    text = "No failure"
    if counts.failed:
        distinct = counted(len(clusters), "distinct failure")
        least = "at least " if clusters.failures < counts.failures else ""
        text = f"{counted(len(clusters.causes), 'cause')} of {least}{distinct}"
    broken = f"; {counts.broken}" if counts.errors else ""
    return f"{text} in {counted(counts.simulations, 'simulation')}{broken}"


def headline(
    store: CampaignStore, clusters: Clusters, counts: Counts, trouble: str = ""
) -> DataBlock:
    """Return the search and its results at a glance.

    Args:
        store: the campaign.
        clusters: the distinct failures.
        counts: counts of the tests.
        trouble: a warning for the reader.
    """
    config, facts = store.config, store.facts
    strategy, driver, simulator = (recorded_part(config, kind) for kind in PARTS)
    criteria, seed = criteria_text(store), config.get("seed")
    warnings = [not_repeatable(facts), str(facts.get("notice", "")), caution(store)]
    if facts.get("interrupted"):
        warnings.insert(
            0, f"interrupted before its budget was spent; go on: {resume_command(store)}"
        )
    elif "finished_at" not in facts:
        killed = f"if it was killed, go on: {resume_command(store)}"
        warnings.insert(0, f"not finished: the campaign was still running, or was killed; {killed}")
    road_class, domain = store.setting.road_class, store.setting.domain
    estimate = None if domain is None else FailureRate.read(store.folder)
    version = short_version(innermost(config.get("driver")))
    facts_shown = {
        "campaign": str(store.folder),
        "roads": "" if road_class is None else road_class.as_text(),
        "domain": "" if domain is None else domain.as_text(),
        "conditions": as_text(store.setting.conditions),
        "how often it fails": "" if estimate is None else estimate.as_text(),
        "criteria": criteria,
        "objective": objective_text(store),
        "starts from": "; ".join(map(str, earlier_of(config))),
        "known before": still_failing(store),
        "search": facts_text(facts.get(SEARCH_FACTS)),
        "driver": f"{driver}, {version}" if version else "",
        "finished": _when(facts.get("finished_at")),
    }
    return DataBlock(
        "headline",
        {
            "lead": f"{strategy} searched for roads on which {driver} leaves its lane"
            f"{' or exceeds another criterion' if criteria else ''} in {simulator},"
            f" seed {'unknown' if seed is None else seed}.",
            "warning": " ".join(
                [*(f"{capitalised(warning)}." for warning in warnings if warning), trouble]
            ),
            "tiles": list(_tiles(store, clusters, counts)),
            "facts": {name: value for name, value in facts_shown.items() if value},
        },
    )


def _tiles(
    store: CampaignStore, clusters: Clusters, counts: Counts
) -> Iterator[tuple[str, str, str, str]]:
    """Yield headline numbers: name, value, note, and the meaning of the colour, if there is one."""
    failures, tests, least = counts.failures, counts.tests, counts.min_moobd
    seconds: Any = store.facts.get("seconds", store.elapsed())
    rate = rate_words(tests / seconds) if tests and seconds > 0.0 else ""
    yield "simulations", str(counts.simulations), rate, ""
    note = f"{percent(failures / counts.simulations)} of simulations" if failures else ""
    if counts.failing_repeats:
        note += f", and {counted(counts.failing_repeats, 'repeat')}"
    yield "failures", str(failures), note, "fail" if failures else ""
    notes = [f"{clusters.known} known before"] if earlier_of(store.config) else []
    if len(clusters):
        late = sum(cluster.ids[0] > _LATE * tests for cluster in clusters)
        notes.append(f"{late} of them first seen in the last fifth")
    if clusters.failures < failures:
        notes.append(f"among the {clusters.failures} most severe")
    role = "fail" if len(clusters) else ""
    yield "distinct failures", str(len(clusters)), ", ".join(notes), role
    yield "causes", str(len(clusters.causes)), "", role
    if least is not None:
        where = "furthest outside" if least < 0.0 else "nearest to the lane's edge"
        inside = oob_words(least, store.lane_width)
        yield where, f"{-least:.2f} m" if least < 0.0 else inside, f"MOOBD {signed(least)} m", ""
    if counts.invalid:
        yield (
            "invalid roads",
            str(counts.invalid),
            f"{percent(counts.invalid / tests)} of tests",
            "",
        )
    if counts.errors:
        yield "errors", str(counts.errors), "", "error"
    if counts.dropped:
        yield "dropped", str(counts.dropped), "before they were driven", ""
    yield "wall time", format_duration(seconds), "min:s" if seconds < 3600.0 else "h:min:s", ""


def _when(value: object) -> str:
    try:
        return f"{datetime.fromisoformat(str(value)):%Y-%m-%d %H:%M} UTC"
    except ValueError:
        return ""


# The configuration


def configuration(
    folder: Path, config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]
) -> Section:
    """Return the configuration of a campaign in a folder, and the command that repeats it."""
    known = {**config, "budget": facts.get("budget", config.get("budget"))}
    named = {name: value for name, value in known.items() if isinstance(value, Mapping)}
    others = {name: value for name, value in known.items() if name not in named}
    repeatability = Paragraph(_repeatability(known))
    repeating = command(f"frenetic run {_shell(folder / FILE)}", "Repeats it, in a new folder:")
    is_named = isinstance(config.get(SPEC), Mapping) and config.get(OWNER) is None
    return Section(
        "configuration",
        "Configuration",
        (
            *([repeating] if is_named else []),
            repeatability,
            *(
                Facts(dict(_flat(value)), capitalised(name), folded=True)
                for name, value in [*named.items(), ("others", others)]
            ),
        ),
    )


def _repeatability(config: Mapping[str, Any]) -> str:
    """Say whether a campaign repeats exactly, and if not, why."""
    text = "The same seed gives the same campaign, on the same machine with the same versions."
    budget = config["budget"]
    if isinstance(budget, Mapping) and budget.get("time") is not None:
        text += " Its budget is wall time, so the number of tests depends on the machine's speed."
    if not isinstance(config.get(SPEC), Mapping):
        text += " It was started from Python, so there is no command that repeats it."
    return text


def _flat(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path and the value of each entry in nested objects."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif value not in (None, "", [], {}):
        text = value if isinstance(value, str) else json.dumps(value, default=plain)
        yield name.removeprefix("options."), text
