"""The tests of a campaign as its report needs them, read once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from frenetic.analysis.clusters import COMPARED, Clusters, distinct_among, nearest_misses
from frenetic.analysis.failures import Failure
from frenetic.analysis.passing import passing_drives
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.report.failures import MOST_FILES
from frenetic.report.html.feature_map import choose_mapped
from frenetic.report.html.tests import TestSummary
from frenetic.search.records import Candidate
from frenetic.segments.features import Features
from frenetic.segments.passing import PassingDrives


@dataclass(frozen=True)
class Reading:
    """A campaign's tests at one moment, each of which is read once."""

    tests: Sequence[TestSummary]
    """Summaries of all tests."""
    counts: Counts
    """Counts of the tests by outcome."""
    clusters: Clusters
    """The distinct failures."""
    misses: Clusters | None
    """The nearest misses; None if a test failed."""
    mapped: Mapping[int, tuple[Features, Candidate]]
    """Id of a test in the feature map -> its features and its candidate."""
    failures: Sequence[Test]
    """The most severe failures, at most `MOST_FILES`, without their trajectories."""
    passing: PassingDrives | None
    """Passing drives with which mistakes are compared; None without a failure or with too few."""
    finished_at: str = ""
    """When the campaign ended; empty if it had not ended when its tests were read."""

    @classmethod
    def of(cls, store: CampaignStore) -> Reading:
        """Read the tests of a campaign.

        Raises:
            CampaignError: the campaign is damaged.
        """
        finished_at = finished_at_of(store.facts)  # before the tests: a resumed campaign ends again
        rows = list(
            store.rows(
                "SELECT id, outcome, moobd FROM test WHERE result_number IS NOT NULL"
                " ORDER BY result_number"
            )
        )
        counts, repeats = store.counts(), store.repeats()
        first_tests = [
            (int(id), str(outcome), moobd)
            for id, outcome, moobd in rows  # noqa: A001
            if id not in repeats
        ]
        all_failed = {int(id) for id, outcome, _ in rows if outcome == Outcome.FAIL}  # noqa: A001
        failed = [row for row in first_tests if row[1] == Outcome.FAIL]
        failed.sort(
            key=lambda row: math.inf if row[2] is None else row[2]
        )  # the lowest MOOBD first
        to_map = choose_mapped(first_tests)
        to_compare = {row[0] for row in failed[:COMPARED]}
        to_write = {row[0] for row in failed[:MOST_FILES]}
        tests = []
        failures: list[Failure] = []
        mapped, severe = {}, []
        for record in store.tests(with_segments=to_map | all_failed):
            if record.result_number > counts.result_count:
                break  # a result that came after the counts
            tests.append(TestSummary.of(record, is_repeat=record.id in repeats))
            if record.id in to_compare:
                failures += filter(None, [Failure.of_test(record)])
            if record.id in to_map and record.segment_values is not None:
                mapped[record.id] = record.segment_values.features, record.candidate
            if record.id in to_write:
                severe.append(record)
        clusters = distinct_among(store, failures)
        misses = None if counts.failed else nearest_misses(store)
        passing = passing_drives(store) if counts.failed else None
        return cls(tests, counts, clusters, misses, mapped, severe, passing, finished_at)


def finished_at_of(facts: Mapping[str, Any]) -> str:
    """Return when a campaign with these facts ended; empty if it has not ended."""
    return str(facts.get("finished_at", ""))
