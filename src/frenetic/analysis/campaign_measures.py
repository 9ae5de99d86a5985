"""Measured results of a campaign, from which `frenetic.analysis.measures` take their values."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray, evenly
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.diameter import set_diameter
from frenetic.analysis.failure_stability import FailureStability
from frenetic.analysis.failures import Failure
from frenetic.analysis.official_segment import failure_segment
from frenetic.analysis.spaces import SPACES
from frenetic.analysis.sparseness import MOST_COMPARED, largest_distances, unlike_lines
from frenetic.analysis.unlike import MOST_LINKED, UnlikeFailures
from frenetic.campaign.configuration import decode_budget
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.road import LANE_WIDTH
from frenetic.segments.features import FEATURES

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
    unlike: Mapping[str, UnlikeFailures] = field(default_factory=dict)
    """Name of a space of `SPACES` -> numbers of failures unlike each other in it."""
    test_set_diameter: float = -math.inf
    """Diameter of the failing roads, see `set_diameter`; minus infinity for fewer than two."""
    kilometres_to_failure: float = math.inf
    """Length driven up to and with the first failure, in km; infinite without a failure."""
    seconds_to_failure: float = math.inf
    """Simulated time up to and with the first failure, in s; infinite without a failure."""
    strategy_seconds: float | None = None
    """Wall time in which the strategy or generator computed, in s; None if it is not recorded."""
    stability: FailureStability | None = None
    """Stability of the failures; None if it was not studied."""

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
    def mean_failures(self) -> float:
        """Mean number of failures after a simulation: the area under their curve."""
        return _mean_after(self.failures_after)

    @property
    def mean_distinct_failures(self) -> float:
        """Mean number of distinct failures after a simulation: the area under their curve."""
        return _mean_after(self.distinct_after)

    @property
    def invalid_roads(self) -> int:
        """Number of roads that were refused."""
        return self.counts.invalid - self.counts.invalid_repeats

    @property
    def failing_repeats(self) -> int:
        """Number of failures that repeat an earlier failure, see `frenetic.campaign.counts`."""
        return self.counts.failing_repeats

    @property
    def min_moobd(self) -> float | None:
        """Lowest MOOBD, in m; None if nothing was driven."""
        return self.counts.min_moobd

    @property
    def passes_with_more_grip(self) -> float | None:
        """Share 0..1 of the studied failures that pass with more grip.

        It is infinite if no failure could be judged, and None without a study.
        """
        if self.stability is None:
            return None
        share = self.stability.total.passes_with_more_grip.value
        return math.inf if share is None else share

    @property
    def keeps_cause(self) -> float | None:
        """Share 0..1 of the studied failures that keep their cause.

        It is minus infinity if no failure could be judged, and None without a study.
        """
        if self.stability is None:
            return None
        share = self.stability.total.keeps_cause.value
        return -math.inf if share is None else share

    @property
    def valid_share(self) -> float:
        """Share 0..1 of the tested roads that were valid; 1 without a tested road."""
        invalid = self.invalid_roads
        valid = self.simulations - (self.counts.repeats - self.counts.invalid_repeats)
        return valid / (valid + invalid) if valid + invalid else 1.0


def measure_campaign(folder: Path | str) -> CampaignMeasures:
    """Measure a campaign.

    Raises:
        CampaignError: the campaign does not exist or is damaged.
    """
    with CampaignStore.open(folder) as store:
        counts, simulations = Counts(), 0
        kilometres_to_failure = seconds_to_failure = math.inf
        failed_after: dict[int, int] = {}  # id of a failure -> simulations up to and with it
        repeats = store.repeats()
        for test in store.tests():
            counts.add(test.candidate, test.result)
            simulations += test.outcome.is_simulated
            if test.outcome is Outcome.FAIL and test.id not in repeats:
                if not failed_after:
                    kilometres_to_failure = 0.001 * counts.driven_metres
                    seconds_to_failure = counts.simulated_seconds
                failed_after[test.id] = simulations
        diversity = _Diversity(_evenly_chosen(failed_after))
        for test in store.tests(Outcome.FAIL, with_trajectory=diversity.linked, with_segments=True):
            # The others are repeats, or newer than the first reading of a running campaign.
            if test.id in failed_after:
                diversity.add(test)
        config, facts, lane_width = store.config, store.facts, store.lane_width
    clusters = cluster_failures(diversity.failures)
    first_failures = (min(failed_after[test_id] for test_id in cluster.ids) for cluster in clusters)
    strategy_seconds: Any = facts.get("strategy_seconds")
    return CampaignMeasures(
        folder=Path(folder),
        seed=config.get("seed"),
        counts=counts,
        failures_after=_curve(failed_after.values(), simulations),
        distinct_after=_curve(first_failures, simulations),
        is_finished=_is_finished({"budget": config.get("budget"), **facts}, counts),
        cells=len(diversity.cells),
        unlike_roads=unlike_lines(diversity.roads),
        competition_sparseness=diversity.competition_sparseness(),
        lane_width=lane_width,
        unlike=diversity.unlike(),
        test_set_diameter=diversity.set_diameter(),
        kilometres_to_failure=kilometres_to_failure,
        seconds_to_failure=seconds_to_failure,
        strategy_seconds=strategy_seconds,
        stability=FailureStability.read(facts),
    )


def _evenly_chosen(ids: Collection[int]) -> frozenset[int]:
    """Return the ids of the failures that are linked: at most `MOST_LINKED`, evenly spaced."""
    listed = list(ids)
    return frozenset(listed[i] for i in evenly(len(listed), MOST_LINKED))


class _Diversity:
    """What the measures of diversity need of the failures of a campaign."""

    def __init__(self, linked: Collection[int]) -> None:
        self.linked = linked
        """Ids of the failures that are linked in each space."""
        self.failures: list[Failure] = []
        """Failures, to be clustered."""
        self.cells: set[tuple[int, ...]] = set()
        """Cells of the feature map over `MAP_AXES`."""
        self.roads: list[FloatArray] = []
        """Points of the whole roads, (n, 2) in m, `ROAD_SPACING` apart."""
        self._official_segments: list[FloatArray] = []
        self._curvatures: list[FloatArray] = []
        self._vectors: dict[str, list[FloatArray]] = {name: [] for name in SPACES}

    def add(self, test: Test) -> None:
        """Add a failed test, read with the values of its segment.

        A test that is linked is read with its trajectory, too.
        """
        failure = Failure.of_test(test)
        if failure is not None:
            self.failures.append(failure)
        self._curvatures.append(test.candidate.curvatures)
        if test.id in self.linked:
            for name, space in SPACES.items():
                if (vector := space.vector(test)) is not None:
                    self._vectors[name].append(vector)
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

    def unlike(self) -> dict[str, UnlikeFailures]:
        """Return the numbers of failures unlike each other in each space."""
        return {
            name: UnlikeFailures.of(np.array(vectors)) for name, vectors in self._vectors.items()
        }

    def set_diameter(self) -> float:
        """Return the diameter of the failing roads; minus infinity for fewer than two."""
        diameter = set_diameter(self._curvatures)
        return -math.inf if diameter is None else diameter


def _mean_after(curve: IntArray) -> float:
    """Return the mean of a curve after each simulation; 0 without a simulation."""
    return float(curve[1:].mean()) if len(curve) > 1 else 0.0


def _curve(rises: Iterable[int], simulations: int) -> IntArray:
    """Return a curve, (simulations + 1,), that rises by 1 at each of some simulations."""
    counts = np.bincount(np.fromiter(rises, dtype=np.int64), minlength=simulations + 1)
    return np.cumsum(counts, dtype=np.int64)


def _is_finished(facts: Mapping[str, Any], counts: Counts) -> bool:
    """Return whether the budget was spent; a generator of the bench may end before that.

    Args:
        facts: facts of the campaign, with its budget.
        counts: counts of all its tests.
    """
    if "finished_at" not in facts or facts.get("interrupted"):
        return False
    ended_by_itself = facts.get("bench", {"end": _OVER})["end"] != _OVER
    amounts = counts.amounts(facts.get("seconds", 0.0))
    return not ended_by_itself or decode_budget(facts["budget"]).spent(amounts) >= 1.0
