"""The HTML report of a campaign, as a file."""

from __future__ import annotations

import math
import shlex
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from frenetic.analysis.failures import (
    COMPARED,
    Clusters,
    Failure,
    distinct_among,
    nearest_misses,
)
from frenetic.analysis.segments import Segment, segment_of
from frenetic.campaign.counts import Counts, key_of
from frenetic.campaign.earlier import still_failing
from frenetic.campaign.record import TestRecord
from frenetic.campaign.screening import ScreeningSummary
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.robustness import Rerun, read_reruns, telling_reruns
from frenetic.report.html.blocks import Section
from frenetic.report.html.camera import PICTURES_SIZE, DriverCamera
from frenetic.report.html.confirmed import confirmations_of, confirmed_sections
from frenetic.report.html.feature_map import Measured, choose_mapped, map_section
from frenetic.report.html.gallery import family_section, gallery_section, misses_section
from frenetic.report.html.headline import headline
from frenetic.report.html.operators import operators_section
from frenetic.report.html.page import Report, made_by, write_page
from frenetic.report.html.repeating import drive_options, repeat_section
from frenetic.report.html.tests import (
    DRIVES_SIZE,
    DriveData,
    TestSummary,
    TestTable,
    ancestors,
    drive_data,
)
from frenetic.report.html.timeline import timeline_section
from frenetic.spec import decode_budget

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
    return GrowingReport().make(store, clusters=clusters, misses=misses, sections=sections)


class GrowingReport:
    """The report of one campaign, which can be made again while the campaign grows.

    What a test holds never changes, so it is read once.
    """

    def __init__(self) -> None:
        self._tests: list[TestSummary] = []
        self._by_id: dict[int, TestSummary] = {}
        self._roads: set[int] = set()
        self._failures: dict[int, Failure | None] = {}  # None without a drive
        self._drives: dict[int, DriveData | None] = {}
        self._measured: dict[int, Measured | None] = {}
        self._camera: DriverCamera | None = None

    @property
    def told(self) -> int:
        """Number of results that were read."""
        return len(self._tests)

    def make(
        self,
        store: CampaignStore,
        *,
        clusters: Clusters | None = None,
        misses: Clusters | None = None,
        sections: Sequence[Section] = (),
        is_running: bool = False,
    ) -> Report:
        """The report of what the campaign holds now; for its arguments see `write_report`.

        Args:
            store: the campaign, the same each time.
            is_running: whether the campaign is known to run, so that it is no wonder that it is
                unfinished.

        Raises:
            CampaignError: the campaign is damaged.
        """
        self._read_new(store)
        tests, by_id = self._tests, self._by_id
        mapped = [test.id for test in choose_mapped(tests)]
        clusters = self._distinct_failures(store, set(mapped)) if clusters is None else clusters
        counts, config, facts = self._counts(), store.config, store.facts
        failures = counts.by_outcome[Outcome.FAIL]
        found = clusters
        if not failures:
            found = nearest_misses(store) if misses is None else misses
        reruns, trouble = _reruns(store)
        confirmations, damage = confirmations_of(store)
        confirmed = [test.test_id for one in confirmations for test in one.tests]
        drives, measured = self._look(store, _to_show(tests, by_id, found, confirmed), mapped)
        opened = {drive.id for drive in drives}
        spoken_of = measured.keys() | opened | set(ancestors(by_id, opened))
        table = TestTable.of(test for test in tests if test.id in spoken_of)
        moobds = {test.id: test.moobd for test in tests if test.moobd is not None}
        elapsed = store.elapsed()
        screening = ScreeningSummary.of_store(store)
        trouble = " ".join(
            [
                *(f"Changed {one}." for one in store.changes if one.what),
                *([screening.stopped] if screening is not None and screening.stopped else []),
                trouble,
            ]
        )
        top = headline(
            config,
            facts,
            counts,
            clusters,
            folder=str(store.folder),
            elapsed=elapsed,
            is_running=is_running,
            is_spent=_budget_spent(config, facts, counts, elapsed) >= 1.0,
            objectives=store.objectives(),
            known=still_failing(store),
            trouble=trouble,
            screening=screening,
        )
        return Report(
            title=top.title,
            sections=(
                Section("summary", top.title, (top,)),
                timeline_section(tests, clusters),
                gallery_section(found, moobds, opened, reruns, failures)
                if failures
                else misses_section(found, counts, moobds, opened),
                map_section(table.ids, measured, tests),
                family_section(found, opened),
                operators_section(tests, clusters),
                *confirmed_sections(store, confirmations, damage),
                repeat_section(config, facts),
                *sections,
            ),
            campaign=_shell(store.folder),
            drive_options=drive_options(config),
            made_by=made_by(),
            lane_width=_lane_width(config.get("lane_width")),
            tests=table,
            drives=tuple(drives),
        )

    def _read_new(self, store: CampaignStore) -> None:
        for record in store.tests(after=self.told):
            if record.id not in self._by_id:
                self._tests.append(TestSummary.of(record))
                self._by_id[record.id] = self._tests[-1]
                if record.outcome is not Outcome.DROPPED:
                    self._roads.add(key_of(record.candidate))

    def _counts(self) -> Counts:
        """The counts of the tests that were read: a campaign that runs may have more by now."""
        by_outcome = dict.fromkeys(Outcome, 0) | Counter(test.outcome for test in self._tests)
        moobds = [test.moobd for test in self._tests if test.moobd is not None]
        return Counts.of(by_outcome, min(moobds, default=None), len(self._roads))

    def _distinct_failures(self, store: CampaignStore, mapped: Collection[int]) -> Clusters:
        """As `frenetic.analysis.failures.distinct_failures`; features of the mapped are kept."""
        failed = [test for test in self._tests if test.outcome is Outcome.FAIL]
        failed.sort(key=lambda test: math.inf if test.moobd is None else test.moobd)
        known, self._failures = self._failures, {}
        for test in failed[:COMPARED]:
            if test.id in known:
                self._failures[test.id] = known[test.id]
                continue
            record = store.test(test.id)
            segment = _segment(record)
            self._failures[test.id] = (
                None
                if segment is None
                else Failure.of(segment, id=test.id, moobd=record.moobd or 0.0)
            )
            if test.id in mapped:
                self._measured[test.id] = None if segment is None else Measured.of(segment)
        return distinct_among([one for one in self._failures.values() if one], store.earlier())

    def _look(
        self, store: CampaignStore, shown: Sequence[int], mapped: Sequence[int]
    ) -> tuple[list[DriveData], dict[int, Measured]]:
        """The drives of as many tests to show as there is room for, and the features of the mapped.

        Each trajectory is read once, and not kept.
        """
        drives: dict[int, DriveData | None] = {}
        measured: dict[int, Measured | None] = {}
        room, room_for_pictures = DRIVES_SIZE, PICTURES_SIZE
        is_mapped, is_shown = set(mapped), set(shown)
        camera = self._camera = self._camera or DriverCamera(store.config, store.folder)
        for test_id in dict.fromkeys([*shown, *mapped]):
            is_wanted = room > 0 and test_id in is_shown
            lacks_drive = is_wanted and test_id not in self._drives
            lacks_features = test_id in is_mapped and test_id not in self._measured
            record = store.test(test_id) if lacks_drive or lacks_features else None
            segment = None if record is None else _segment(record)
            if test_id in is_mapped:
                measured[test_id] = (
                    (None if segment is None else Measured.of(segment))
                    if lacks_features
                    else self._measured[test_id]
                )
            if is_wanted:
                drive = self._drives.get(test_id)
                if record is not None and segment is not None and lacks_drive:
                    drive = drive_data(record, segment)
                    if room_for_pictures > 0:
                        drive = replace(drive, camera=camera.saw(record))
                drives[test_id] = drive
                room -= 0 if drive is None else drive.size
                if drive is not None and drive.camera is not None:
                    room_for_pictures -= drive.camera.size
        self._drives, self._measured = drives, measured
        return (
            [drive.with_files(store.folder) for drive in drives.values() if drive is not None],
            {test_id: found for test_id, found in measured.items() if found is not None},
        )


def _segment(record: TestRecord) -> Segment | None:
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
    tests: Sequence[TestSummary],
    by_id: dict[int, TestSummary],
    clusters: Clusters,
    confirmed: Sequence[int],
) -> list[int]:
    """Ids of the tests to show, the most important first.

    Each cluster's most severe and typical failure, then those driven in another simulator, those
    that the first descend from, and the most severe failures.
    """
    heads = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    driven = [i for i in ancestors(by_id, heads) if by_id[i].outcome.is_driven]
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    return list(dict.fromkeys([*heads, *confirmed, *driven, *(test.id for test in failed)]))


def _reruns(store: CampaignStore) -> tuple[dict[int, Rerun], str]:
    """Repeats of its tests with the campaign's own parts, and trouble with them."""
    parts = store.parts
    driver, simulator = parts.get("driver"), parts.get("simulator")
    try:
        reruns, rules = read_reruns(store.folder), store.setting.rules
    except CampaignError as error:
        return {}, str(error)
    if not isinstance(driver, dict) or not isinstance(simulator, dict):
        return {}, ""
    return telling_reruns(reruns, driver, simulator, rules), ""


def _shell(path: Path) -> str:
    """A path for pasting into a shell."""
    return f'"{path}"' if sys.platform == "win32" else shlex.quote(str(path))


def _lane_width(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 4.0
