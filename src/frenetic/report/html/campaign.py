"""The HTML report of a campaign, as a file."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from frenetic._support.entry_points import imported, installed
from frenetic._support.json_value import JSONValue
from frenetic.again.rerun import Rerun, elsewhere, own_repeats, read_reruns
from frenetic.analysis.failures import Clusters, distinct_failures, nearest_misses
from frenetic.analysis.segments import Segment, segment_of
from frenetic.campaign.counts import Counts, key_of
from frenetic.campaign.earlier import still_failing
from frenetic.campaign.objective import objectives
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Part, Section
from frenetic.report.html.elsewhere import elsewhere_sections
from frenetic.report.html.feature_map import Measured, choose_mapped, map_section
from frenetic.report.html.gallery import gallery_section, misses_section
from frenetic.report.html.headline import headline
from frenetic.report.html.operators import operators_section
from frenetic.report.html.page import Report, made_by, write_page
from frenetic.report.html.repeating import drive_options, repeat_section
from frenetic.report.html.tests import (
    DRIVES_SIZE,
    DriveData,
    Film,
    TestSummary,
    TestTable,
    drive_data,
)
from frenetic.report.html.timeline import timeline_section
from frenetic.spec import decode_budget

FILMS: Final = "frenetic.films"
"""Group of entry points: functions of a campaign's record that give one of a test, for its `Film`
or None."""
FILMS_SIZE: Final = 3_000_000
"""Approximate bytes of all pictures of a page."""
REPORT: Final = "report.html"
"""Name of the report in a campaign's folder."""


def write_report(
    campaign: CampaignStore | Path | str,
    path: Path | str | None = None,
    *,
    clusters: Clusters | None = None,
    misses: Clusters | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Writes the report of a campaign: one self-contained HTML file.

    Args:
        campaign: open, or its folder.
        path: of the file, which is replaced; ``report.html`` in the campaign's folder by default.
        clusters: its distinct failures, if known.
        misses: its nearest misses, if known; they are shown if nothing failed.
        sections: to add after those of the campaign.

    Returns:
        The file.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
        FreneticError: the file cannot be written.
    """
    with ExitStack() as stack:
        store = (
            campaign
            if isinstance(campaign, CampaignStore)
            else stack.enter_context(CampaignStore.open(Path(campaign)))
        )
        path = store.folder / REPORT if path is None else Path(path)
        report = campaign_report(store, clusters=clusters, misses=misses, sections=sections)
    return write_page(report, path)


def campaign_report(
    store: CampaignStore,
    *,
    clusters: Clusters | None = None,
    misses: Clusters | None = None,
    sections: Sequence[Section] = (),
) -> Report:
    """The report of a campaign.

    Raises:
        CampaignError: the campaign is damaged.
    """
    failures = store.by_outcome()[Outcome.FAIL]
    clusters = distinct_failures(store) if clusters is None else clusters
    found = clusters
    if not failures:
        found = nearest_misses(store) if misses is None else misses
    tests, counts = _read(store)  # last: while the campaign runs, it has what was found before
    mapped = [test.id for test in choose_mapped(tests)]
    config, facts = store.config, store.facts
    reruns, trouble = _reruns(store)
    own, there = own_repeats(reruns, config, store.setting.rules), elsewhere(reruns, config)
    driven_there = [test.id for one in there for test in one.tests]
    drives, measured = _look(store, _to_show(tests, found, driven_there), mapped)
    opened = {drive.id for drive in drives}
    moobds = {test.id: test.moobd for test in tests if test.moobd is not None}
    elapsed = store.elapsed()
    top = headline(
        config,
        facts,
        counts,
        clusters,
        folder=str(store.folder),
        elapsed=elapsed,
        is_spent=_budget_spent(config, facts, counts, elapsed) >= 1.0,
        objectives=objectives(store),
        known=still_failing(store),
        trouble=trouble,
    )
    return Report(
        title=top.title,
        sections=(
            Section("summary", top.title, (top,)),
            timeline_section(tests, clusters),
            gallery_section(found, moobds, opened, own, failures)
            if failures
            else misses_section(found, counts, moobds, opened),
            map_section(measured, tests),
            operators_section(tests, clusters),
            *elsewhere_sections(store, there),
            Section("tests", "All tests", (Part("tests", {}),)),
            repeat_section(config, facts),
            *sections,
        ),
        campaign=_shell(store.folder),
        drive_options=drive_options(config),
        made_by=made_by(),
        lane_width=_lane_width(config.get("lane_width")),
        tests=TestTable.of(tests),
        drives=tuple(drives),
    )


def _read(store: CampaignStore) -> tuple[list[TestSummary], Counts]:
    """The tests, and their counts: a campaign that runs may have more by now."""
    tests, roads = [], set()
    for record in store.tests():
        tests.append(TestSummary.of(record))
        if record.outcome is not Outcome.DROPPED:
            roads.add(key_of(record.candidate))
    by_outcome = dict.fromkeys(Outcome, 0) | Counter(test.outcome for test in tests)
    moobds = [test.moobd for test in tests if test.moobd is not None]
    return tests, Counts.of(by_outcome, min(moobds, default=None), len(roads))


def _look(
    store: CampaignStore, shown: Sequence[int], mapped: Sequence[int]
) -> tuple[list[DriveData], dict[int, Measured]]:
    """The drives of as many tests to show as there is room for, and the features of the mapped.

    Each trajectory is read once, and not kept.
    """
    drives: list[DriveData] = []
    measured: dict[int, Measured] = {}
    room, room_for_pictures = DRIVES_SIZE, FILMS_SIZE
    is_mapped, is_shown = set(mapped), set(shown)
    films = [film(store.config) for film in _films()]
    for test_id in dict.fromkeys([*shown, *mapped]):
        is_wanted = room > 0 and test_id in is_shown
        if not is_wanted and test_id not in is_mapped:
            continue
        record = store.test(test_id)
        segment = _segment(record)
        if segment is None:
            continue
        if test_id in is_mapped:
            measured[test_id] = Measured.of(segment)
        if is_wanted:
            drive = drive_data(record, segment)
            if room_for_pictures > 0:
                seen = (film(record) for film in films)
                drive = replace(drive, film=next((one for one in seen if one is not None), None))
            drives.append(drive.with_files(store.folder))
            room -= drive.size
            if drive.film is not None:
                room_for_pictures -= drive.film.size
    return drives, measured


def _films() -> list[Callable[[Mapping[str, JSONValue]], Callable[[Test], Film | None]]]:
    return [imported(entry.target) for entry in installed(FILMS)]


def _segment(record: Test) -> Segment | None:
    """The segment of a test that was read with its trajectory; None if it has no records."""
    drive = record.drive
    if drive is None or not len(drive.trajectory):
        return None
    return segment_of(record.road, drive, record.departure)


def _budget_spent(
    config: Mapping[str, JSONValue],
    facts: Mapping[str, JSONValue],
    counts: Counts,
    elapsed: float,
) -> float:
    """Share of the campaign's last budget that its results have spent, 0..1.

    It is 0 without a usable budget.
    """
    try:
        budget = decode_budget(facts.get("budget", config.get("budget")))
    except ValueError:
        return 0.0
    return budget.spent(counts.simulations, elapsed, counts.failed)


def _to_show(
    tests: Sequence[TestSummary], clusters: Clusters, elsewhere: Sequence[int]
) -> list[int]:
    """Ids of the tests to show, the most important first.

    Each cluster's most severe and typical failure, then those driven in another simulator, and the
    most severe failures.
    """
    heads = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    return list(dict.fromkeys([*heads, *elsewhere, *(test.id for test in failed)]))


def _reruns(store: CampaignStore) -> tuple[list[Rerun], str]:
    """The reruns of a campaign, and trouble with them."""
    try:
        return read_reruns(store.folder), ""
    except CampaignError as error:
        return [], str(error)


def _shell(path: Path) -> str:
    """A path for pasting into a shell."""
    return f'"{path}"' if sys.platform == "win32" else shlex.quote(str(path))


def _lane_width(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 4.0
