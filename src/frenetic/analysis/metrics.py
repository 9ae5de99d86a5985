"""Measures by which campaigns are compared: their meaning and measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray, evenly
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.failures import Failure
from frenetic.analysis.official_segment import failure_segment
from frenetic.analysis.sparseness import MOST_COMPARED, largest_distances, unlike_lines
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.road import LANE_WIDTH
from frenetic.segments.features import FEATURES

Curve: TypeAlias = Literal["distinct_after", "failures_after"]
"""Name of a curve of `CampaignMeasures`."""

MAP_AXES: Final = ("direction_coverage", "max_curvature", "std_steering", "mean_offset")
"""Features that span the map with the counted cells, as in the competition of 2023."""
ROAD_SPACING: Final = 5.0
"""Distance between the points by which whole roads are compared, in m (our choice)."""
_OVER: Final = "over"
"""End of a run of the bench whose time is over, see `frenetic.plugins.bench`."""


@dataclass(frozen=True, eq=False)
class CampaignMeasures:
    """Measured results of a campaign.

    Curves have a value for each number of simulations, from 0 on. A repeated road, one that was
    driven again in the same conditions, counts once.
    """

    folder: Path
    """Folder of the campaign."""
    seed: object
    """Seed of the strategy; None if it has none."""
    counts: Counts
    """Counts of the tests."""
    failures_after: IntArray
    """Failures up to each number of simulations, (simulations + 1,)."""
    distinct_after: IntArray
    """Distinct failures up to each number of simulations, (simulations + 1,)."""
    is_finished: bool
    """Whether the budget was spent."""
    cells: int = 0
    """Number of cells of the feature map over `MAP_AXES` that hold a failure."""
    unlike_roads: int = 0
    """Number of failing roads that are unlike each other, see `unlike_lines`."""
    competition_sparseness: float = -math.inf
    """Mean of `largest_distances`, in edits; minus infinity for fewer than two failures."""
    lane_width: float = LANE_WIDTH
    """Width of each lane, in m."""

    @property
    def simulations(self) -> int:
        """Number of drives, including those in which the simulator broke."""
        return len(self.failures_after) - 1

    @property
    def failures(self) -> int:
        """Number of failures."""
        return int(self.failures_after[-1])

    @property
    def distinct_failures(self) -> int:
        """Number of distinct failures, see `frenetic.analysis.cluster_failures`."""
        return int(self.distinct_after[-1])

    @property
    def simulations_to_failure(self) -> float:
        """Number of simulations up to the first failure, inclusive; infinite without a failure."""
        return float(np.argmax(self.failures_after > 0)) if self.failures else math.inf

    @property
    def min_moobd(self) -> float | None:
        """Lowest MOOBD, in m; None if nothing was driven."""
        return self.counts.min_moobd

    @property
    def valid_share(self) -> float:
        """Share 0..1 of the tested roads that were valid; 1 without a tested road."""
        invalid = self.counts.invalid - self.counts.invalid_repeats
        valid = self.simulations - (self.counts.repeats - self.counts.invalid_repeats)
        return valid / (valid + invalid) if valid + invalid else 1.0


@dataclass(frozen=True)
class Measure:
    """Measure: a number by which campaigns are compared."""

    name: str
    """Name of the attribute of `CampaignMeasures`."""
    title: str
    """Title for people."""
    definition: str
    """Definition, in a sentence or two."""
    short: str
    """Title for a narrow column."""
    unit: str = ""
    """Unit; empty without a unit."""
    more_is_better: bool = True
    """Whether more is better for a search, rather than less."""
    decimals: int = 0
    """Number of decimal places of values as text."""

    def of(self, campaign: CampaignMeasures) -> float | None:
        """Return the measure's value; None if the campaign lacks it.

        The value is infinite for an event that never happened, which is worse than any number.
        """
        value = getattr(campaign, self.name)
        return None if value is None else float(value)

    def text(self, value: float) -> str:
        """Return a value as text, without the unit; "none" for an infinite value."""
        return "none" if math.isinf(value) else f"{value:.{self.decimals}f}"

    @property
    def heading(self) -> str:
        """Title, with the unit if there is one."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def sign(self) -> float:
        """Factor 1 or -1 that makes larger values better."""
        return 1.0 if self.more_is_better else -1.0

    @property
    def better(self) -> str:
        """Word for better values: more or less."""
        return "more" if self.more_is_better else "less"


HEADLINE: Final = "distinct_failures"
"""Name of the measure that orders groups."""

MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            Measure(
                "distinct_failures",
                "distinct failures",
                "Clusters of failures that are the same problem: side, road and drive before the"
                " departure differ by up to 2 m.",
                "distinct",
            ),
            Measure(
                "failures",
                "failures",
                "FAIL outcomes. A road that was driven again in the same conditions counts once, in"
                " this and every other measure.",
                "failures",
            ),
            Measure(
                "cells",
                "cells of the feature map",
                "Cells that hold a failure, of 10 x 10 x 10 x 10 over direction coverage"
                " 0.05..1.05, largest curvature 0..0.07 1/m, standard deviation of steering"
                " 0..0.3 rad and mean lateral position -1.5..1.5 m, on the failures' segments.",
                "cells",
            ),
            Measure(
                "unlike_roads",
                "failing roads unlike each other",
                "Failing roads, each of which differs from every one counted before it in more than"
                " a fifth of its steps of 5 m: whole roads, whatever happens on them.",
                "roads",
            ),
            Measure(
                "competition_sparseness",
                "competition's sparseness",
                "As the competition of 2021 and 2022, mistakes included: per failure the largest"
                " edit distance to those after it in the order of the tests, mean. One odd road"
                " raises it for all. None for fewer than two failures, which counts as worse than"
                " any number.",
                "sparseness",
                unit="edits",
                decimals=1,
            ),
            Measure(
                "simulations_to_failure",
                "simulations to first failure",
                "Simulations up to and with the first failure; none if there was none, which"
                " counts as later than any.",
                "first failure",
                more_is_better=False,
            ),
            Measure(
                "min_moobd",
                "lowest MOOBD",
                "Lowest minimum oob distance of all drives: how near to failing, or beyond, a"
                " driver was brought. The one measure that tells searches apart where none fails.",
                "lowest MOOBD",
                unit="m",
                more_is_better=False,
                decimals=2,
            ),
            Measure(
                "valid_share",
                "valid share",
                "Valid roads divided by all roads tested, refused ones included.",
                "valid share",
                decimals=3,
            ),
        )
    }
)
"""Name -> measure, in the order in which they are shown."""


def measure_campaign(folder: Path | str) -> CampaignMeasures:
    """Measure a campaign.

    Raises:
        CampaignError: the campaign does not exist or is damaged.
    """
    with CampaignStore.open(folder) as store:
        counts, simulations = Counts(), 0
        failed_after: dict[int, int] = {}  # id of a failure -> simulations up to and with it
        repeats = store.repeats()
        for test in store.tests():
            counts.add(test.candidate, test.outcome, test.moobd)
            simulations += test.outcome.is_simulated
            if test.outcome is Outcome.FAIL and test.id not in repeats:
                failed_after[test.id] = simulations
        diversity = _Diversity()
        for test in store.tests(Outcome.FAIL, with_segments=True):
            # The others are repeats, or newer than the first reading of a running campaign.
            if test.id in failed_after:
                diversity.add(test)
        config, facts, lane_width = store.config, store.facts, store.lane_width
    clusters = cluster_failures(diversity.failures)
    first_failures = (min(failed_after[test_id] for test_id in cluster.ids) for cluster in clusters)
    return CampaignMeasures(
        folder=Path(folder),
        seed=config.get("seed"),
        counts=counts,
        failures_after=_curve(failed_after.values(), simulations),
        distinct_after=_curve(first_failures, simulations),
        is_finished=_is_finished({"budget": config.get("budget"), **facts}, simulations),
        cells=len(diversity.cells),
        unlike_roads=unlike_lines(diversity.roads),
        competition_sparseness=diversity.competition_sparseness(),
        lane_width=lane_width,
    )


class _Diversity:
    """What the measures of diversity need of the failures of a campaign."""

    def __init__(self) -> None:
        self.failures: list[Failure] = []
        """Failures, to be clustered."""
        self.cells: set[tuple[int, ...]] = set()
        """Cells of the feature map over `MAP_AXES`."""
        self.roads: list[FloatArray] = []
        """Points of the whole roads, (n, 2) in m, `ROAD_SPACING` apart."""
        self._official_segments: list[FloatArray] = []

    def add(self, test: Test) -> None:
        """Add a failed test, read with the values of its segment."""
        failure = Failure.of_test(test)
        if failure is not None:
            self.failures.append(failure)
        if test.segment_values is None:
            return
        features = test.segment_values.features
        self.cells.add(tuple(FEATURES[name].bin(features[name]) for name in MAP_AXES))
        self.roads.append(test.road.sample(ROAD_SPACING))
        official_segment = failure_segment(test)
        if official_segment is not None:
            self._official_segments.append(official_segment)

    def competition_sparseness(self) -> float:
        """Return the mean of `largest_distances`; minus infinity for fewer than two failures."""
        compared = evenly(len(self._official_segments), MOST_COMPARED)
        distances = largest_distances([self._official_segments[i] for i in compared])
        return float(distances.mean()) if len(distances) else -math.inf


def curves(campaigns: Sequence[CampaignMeasures], name: Curve) -> IntArray:
    """Return a curve of each campaign, (campaigns, n), cut where the shortest campaign ends.

    Args:
        campaigns: one or more campaigns.
        name: name of the curve.
    """
    rows: list[IntArray] = [getattr(campaign, name) for campaign in campaigns]
    reached = min(map(len, rows))
    return np.array([row[:reached] for row in rows], dtype=np.int64)


def _curve(rises: Iterable[int], simulations: int) -> IntArray:
    """Return a curve, (simulations + 1,), that rises by 1 at each of some simulations."""
    counts = np.bincount(np.fromiter(rises, dtype=np.int64), minlength=simulations + 1)
    return np.cumsum(counts, dtype=np.int64)


def _is_finished(facts: Mapping[str, Any], simulations: int) -> bool:
    """Return whether the budget was spent; a generator of the bench may end before that."""
    if "finished_at" not in facts or facts.get("interrupted"):
        return False
    ended_by_itself = facts.get("bench", {"end": _OVER})["end"] != _OVER
    return not ended_by_itself or simulations >= (facts["budget"].get("simulations") or 0)
