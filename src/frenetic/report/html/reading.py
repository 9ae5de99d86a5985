"""What a report says of a campaign's tests, each of which is read once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from frenetic.analysis.failures import (
    COMPARED,
    Clusters,
    Failure,
    distinct_among,
    nearest_misses,
)
from frenetic.analysis.features import Features
from frenetic.analysis.segments import Segment, segment_of_test
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.outcome import Outcome
from frenetic.report.failures import MOST_FILES
from frenetic.report.html.feature_map import choose_mapped, measure
from frenetic.report.html.tests import TestSummary
from frenetic.search.records import Candidate


class _Told(NamedTuple):
    """The verdict on a test, all that decides what is read of it."""

    id: int
    outcome: str
    moobd: float | None


@dataclass(frozen=True)
class Reading:
    """A campaign's tests at one moment."""

    tests: Sequence[TestSummary]
    counts: Counts
    conditions: Sequence[Mapping[str, float]]
    """Of the driven tests."""
    clusters: Clusters
    """The distinct failures."""
    misses: Clusters | None
    """The nearest misses; None if a test failed."""
    features: Mapping[int, Mapping[str, Features]]
    """Of the tests in the feature map, see `measure`."""
    mapped: Mapping[int, Candidate]
    """Those that have features."""
    failures: Mapping[int, tuple[Test, Segment | None]]
    """The most severe failures, each with its segment, if it has records."""

    @classmethod
    def of(cls, store: CampaignStore) -> Reading:
        """The tests of a campaign.

        Raises:
            CampaignError: the campaign is damaged.
        """
        rows = store.rows(
            "SELECT id, outcome, moobd FROM test WHERE told IS NOT NULL ORDER BY told"
        )
        told = [_Told(*row) for row in rows]
        failed = [one for one in told if one.outcome == Outcome.FAIL]
        failed.sort(key=lambda one: (one.moobd is None, one.moobd or 0.0))
        chosen = {one.id for one in choose_mapped(told)}
        compared = {one.id for one in failed[:COMPARED]}
        kept = {one.id for one in failed[:MOST_FILES]}
        counts, tests, conditions = Counts(), [], []
        failures: list[Failure] = []
        features, mapped, severe = {}, {}, {}
        for record in store.tests(with_trajectory=chosen | compared):
            tests.append(TestSummary.of(record))
            counts.add(record.candidate, record.outcome, record.moobd)
            if record.outcome.is_driven:
                conditions.append(record.candidate.conditions)
            segment = segment_of_test(record)
            if record.id in compared:
                failures += filter(None, [Failure.of_segment(segment, record.result, record.id)])
            if record.id in chosen and segment is not None:
                features[record.id], mapped[record.id] = measure(segment), record.candidate
            if record.id in kept:
                severe[record.id] = record, segment
        clusters = distinct_among(store, failures)
        misses = None if counts.failed else nearest_misses(store)
        return cls(tests, counts, conditions, clusters, misses, features, mapped, severe)
