"""Metrics of a campaign for comparisons: their meaning and measurement.

The competition's measures are computed as its published code does it, mistakes included, and named
so; beside them stand forms with published bounds. research/measures.md gives the reasons.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, evenly
from frenetic.analysis.competition import (
    CompetitionFeatures,
    competition_features,
    competition_segment,
)
from frenetic.analysis.expectation import RandomRoads
from frenetic.analysis.failures import Failure, cluster_failures
from frenetic.analysis.features import FEATURES, Feature, features_of
from frenetic.analysis.segments import Segment, segments_of
from frenetic.analysis.sparseness import competition_sparseness, diversity
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.outcome import Outcome
from frenetic.search.random_search import RANDOM

Cell: TypeAlias = tuple[int, ...]
"""Cell of a feature map: a bin of each of its features."""
IntArray: TypeAlias = npt.NDArray[np.int64]
Curve: TypeAlias = Literal["distinct_after", "failures_after", "cells_after"]
"""Name of a curve of `CampaignMeasures`."""

MAP_AXES: Final = ("direction_coverage", "max_curvature", "std_steering", "mean_offset")
"""Features that span the map with the counted cells: those of the competition of 2023."""
COMPETITION_AXES: Final = (
    Feature("dir_cov", "DIR_COV", "", 0.0, 0.5, 10),
    Feature("std_sa", "STD_SA", "degrees of the front wheels", 0.0, 20.0, 10),
    Feature("max_curv", "MAX_CURV", "1/m", 0.0, 0.07, 10),
    Feature("mean_lp", "MEAN_LP", "m", 0.0, 2.0, 10),
)
"""The competition's own form of these features, see `CompetitionFeatures`.

Neither its code nor its tables publish ranges; these are ours.
"""
MOST_PAIRED: Final = 200
"""Most failures for the pairwise diversity; of more, this many are chosen, evenly spaced."""
MOST_COMPARED: Final = 2000
"""Most failures for the competition's sparseness, whose time grows with the square; of more, this
many are chosen, evenly spaced."""


@dataclass(frozen=True, eq=False)
class CampaignMeasures:
    """Measured results of a campaign.

    Curves have a value for each number of simulations, from 0 on.
    """

    folder: Path
    seed: object
    """Seed of its strategy."""
    invalid: int
    """Roads that were refused."""
    failures_after: IntArray
    """(simulations + 1,) failures found by each number of simulations."""
    distinct_after: IntArray
    """(simulations + 1,) distinct failures, each counted from the first of those alike."""
    cells_after: IntArray
    """(simulations + 1,) cells of the feature map over `MAP_AXES` that hold a failure."""
    seconds_to_failure: float
    """Campaign time up to the first failure, in s; infinite if there is none."""
    is_finished: bool
    """Whether its budget was spent."""
    errors: int = 0
    """Simulations that broke."""
    dropped: int = 0
    """Candidates that were no longer wanted before they were driven."""
    roads: int = 0
    """Different roads among the tests."""
    min_moobd: float | None = None
    """Lowest MOOBD, in m; None if nothing was driven."""
    filled: frozenset[Cell] = frozenset()
    """Cells of the feature map over `MAP_AXES` that hold a failure."""
    competition_filled: frozenset[Cell] = frozenset()
    """Likewise over `COMPETITION_AXES`; without the failures that the competition leaves out."""
    pairwise_diversity: float = -math.inf
    """Diversity 0..1, see `Diversity.pairwise`; minus infinity for fewer than two failures."""
    competition_sparseness: float = -math.inf
    """Sparseness in edits, see `CompetitionSparseness.mean`; minus infinity below two failures."""
    generator_seconds: float | None = None
    """Wall time that the strategy itself took, in s; None if the campaign does not say."""
    seconds_per_test: float | None = None
    """Virtual time that a simulation costs on a bench, in s; None elsewhere."""
    expected_failures: float | None = None
    """Failures if all simulated roads were random, see `frenetic.analysis.expectation`; None if the
    campaign drove no random road."""
    expected_distinct: float | None = None
    """Distinct failures, likewise."""
    unused: int = 0
    """Simulations that a run of a bench had left when it ended by itself; 0 elsewhere.

    They count in figures per simulation: crashing after a failure gains nothing.
    """

    @property
    def simulations(self) -> int:
        """Drives, broken ones included."""
        return len(self.failures_after) - 1

    @property
    def tests(self) -> int:
        """Roads that were tested: driven or refused."""
        return self.simulations + self.invalid

    @property
    def failures(self) -> int:
        """FAIL outcomes."""
        return int(self.failures_after[-1])

    @property
    def counts(self) -> Counts:
        """The counts of the campaign."""
        return Counts(
            invalid=self.invalid,
            passed=self.simulations - self.failures - self.errors,
            failed=self.failures,
            errors=self.errors,
            dropped=self.dropped,
            min_moobd=self.min_moobd,
            roads=self.roads,
        )

    @property
    def distinct_failures(self) -> int:
        """See `frenetic.analysis.cluster_failures`."""
        return int(self.distinct_after[-1])

    @property
    def cells(self) -> int:
        """Cells of the feature map over `MAP_AXES` that hold a failure."""
        return int(self.cells_after[-1])

    @property
    def competition_cells(self) -> int:
        """Likewise over `COMPETITION_AXES`."""
        return len(self.competition_filled)

    @property
    def failures_per_100(self) -> float:
        """Failures per 100 simulations."""
        return self._per_100(self.failures)

    @property
    def distinct_per_100(self) -> float:
        """Distinct failures per 100 simulations."""
        return self._per_100(self.distinct_failures)

    @property
    def simulations_to_failure(self) -> float:
        """Simulations up to and with the first failure; infinite if there is none."""
        return float(np.argmax(self.failures_after > 0)) if self.failures else math.inf

    @property
    def virtual_seconds_to_failure(self) -> float | None:
        """Virtual time up to and with the first failure, in s; infinite without one.

        None where simulations have no virtual cost.
        """
        if self.seconds_per_test is None:
            return None
        return self.simulations_to_failure * self.seconds_per_test

    @property
    def invalid_share(self) -> float:
        """Share 0..1 of the tests that were refused."""
        return self.invalid / self.tests if self.tests else 0.0

    def _per_100(self, number: int) -> float:
        simulations = self.simulations + self.unused
        return 100.0 * number / simulations if simulations else 0.0


class Topic(StrEnum):
    """Kind of a measure."""

    FOUND = "found"
    DIFFERENT = "diversity"
    COMPETITION = "as the competition"
    """A measure computed as the published code of the SBST/SBFT competition does it."""
    SOON = "first failure"
    COST = "cost"
    SPENT = "spent"


@dataclass(frozen=True)
class Measure:
    """A number by which campaigns are compared."""

    name: str
    """Name of the attribute of `CampaignMeasures`."""
    title: str
    definition: str
    """Definition, in a sentence or two."""
    bounds: str
    """Range, as a text."""
    short: str
    """A title for a narrow column."""
    topic: Topic
    unit: str = ""
    """Unit, empty if it has none."""
    more_is_better: bool | None = None
    """Whether more is better for a search; None if neither is."""
    decimals: int = 0
    is_main: bool = True
    """Whether it is shown where space is short."""

    def of(self, campaign: CampaignMeasures) -> float | None:
        """This measure's value; None if the campaign has none.

        An event that never happened is infinitely late or infinitely little: worse than any number.
        """
        value = getattr(campaign, self.name)
        return None if value is None else float(value)

    def text(self, value: float) -> str:
        """A value for people, without its unit."""
        return "none" if math.isinf(value) else f"{value:.{self.decimals}f}"

    @property
    def heading(self) -> str:
        """Its title, with its unit if it has one."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def comparative(self) -> str:
        """What the better of two campaigns does, such as "finds more" than the other."""
        return f"{'finds' if self.topic is Topic.FOUND else 'has'} {self.better}"

    @property
    def better(self) -> str:
        """The better direction: more, less or neither."""
        if self.more_is_better is None:
            return "neither"
        return "more" if self.more_is_better else "less"


HEADLINE: Final = "distinct_per_100"
"""The measure that orders groups."""

MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            Measure(
                "distinct_per_100",
                "distinct failures per 100 simulations",
                "Distinct failures divided by the simulations of valid roads, times 100. A"
                " simulation that ended in an ERROR was spent and counts; a refused road was not"
                " driven and does not. Of a run of a bench that ended before its budget, what was"
                " left of that counts, too.",
                "0..100",
                "distinct per\u00a0100",
                Topic.FOUND,
                more_is_better=True,
                decimals=1,
            ),
            Measure(
                "distinct_failures",
                "distinct failures",
                "Clusters of failures that are the same problem: side, road and drive before the"
                " departure differ by up to 2 m.",
                "0..failures",
                "distinct",
                Topic.FOUND,
                more_is_better=True,
            ),
            Measure(
                "failures",
                "failures",
                "FAIL outcomes.",
                "0..simulations",
                "failures",
                Topic.FOUND,
                more_is_better=True,
            ),
            Measure(
                "expected_distinct",
                "distinct failures if all roads were random",
                "What the campaign's own random roads would find, were there as many as"
                " simulations: beyond their number an estimate by how many distinct failures they"
                " found once and twice (Chao et al. 2014), rather too low beyond two or three times"
                " as many. Without random roads there is none.",
                "0..simulations",
                "distinct if random",
                Topic.FOUND,
                decimals=1,
            ),
            Measure(
                "expected_failures",
                "failures if all roads were random",
                "The share of the campaign's own random roads that failed, times simulations."
                " Without random roads there is none.",
                "0..simulations",
                "failures if random",
                Topic.FOUND,
                decimals=1,
            ),
            Measure(
                "failures_per_100",
                "failures per 100 simulations",
                "FAIL outcomes divided by simulations, ERROR included, times 100.",
                "0..100",
                "failures per\u00a0100",
                Topic.FOUND,
                more_is_better=True,
                decimals=1,
                is_main=False,
            ),
            Measure(
                "cells",
                "cells of the feature map",
                "Cells that hold a failure, of 10 x 10 x 10 x 10 over direction coverage"
                " 0.05..1.05, largest curvature 0..0.07 1/m, standard deviation of steering"
                " 0..0.3 rad and mean lateral position -1.5..1.5 m, on the failures' segments.",
                "0..10000",
                "cells",
                Topic.FOUND,
                more_is_better=True,
            ),
            Measure(
                "pairwise_diversity",
                "diversity of failures",
                "Mean share of its steps that must be edited to make one failure's segment"
                " another's, over all pairs of failures; of more than 200 failures, over those of"
                " 200. Depends on no order. None for fewer than two failures, which counts as"
                " worse than any number.",
                "0..1",
                "pairwise",
                Topic.DIFFERENT,
                more_is_better=True,
                decimals=3,
            ),
            Measure(
                "competition_sparseness",
                "competition's sparseness",
                "As the competition of 2021 and 2022, mistakes included: per failure the largest"
                " edit distance to those after it in the order of the tests, mean. One odd road"
                " raises it for all. None for fewer than two failures, which counts as worse than"
                " any number.",
                "0..about 60",
                "sparseness",
                Topic.COMPETITION,
                unit="edits",
                more_is_better=True,
                decimals=1,
            ),
            Measure(
                "competition_cells",
                "competition's map: cells",
                "As the competition of 2023, mistakes included: cells that hold a failure, of 10"
                " x 10 x 10 x 10 over DIR_COV 0..0.5 (it never exceeds 0.5), STD_SA 0..20 degrees"
                " of the front wheels, MAX_CURV 0..0.07 1/m and MEAN_LP 0..2 m. The competition"
                " published no ranges: these are ours, so its own tables cannot be compared.",
                "0..10000",
                "cells",
                Topic.COMPETITION,
                more_is_better=True,
                is_main=False,
            ),
            Measure(
                "simulations_to_failure",
                "simulations to first failure",
                "Simulations up to and with the first failure; none if there was none, which"
                " counts as later than any.",
                "1..simulations",
                "simulations",
                Topic.SOON,
                more_is_better=False,
            ),
            Measure(
                "virtual_seconds_to_failure",
                "virtual time to first failure",
                "Simulations up to and with the first failure, each at its cost on the bench's"
                " clock, without the generator's own time.",
                "0..budget",
                "virtual time",
                Topic.SOON,
                unit="s",
                more_is_better=False,
                is_main=False,
            ),
            Measure(
                "seconds_to_failure",
                "time to first failure",
                "Wall time of the campaign up to the first failure: depends on the machine.",
                "0..",
                "wall time",
                Topic.SOON,
                unit="s",
                more_is_better=False,
                decimals=2,
                is_main=False,
            ),
            Measure(
                "min_moobd",
                "lowest MOOBD",
                "Lowest minimum oob distance of all drives: how near to failing, or beyond, a"
                " driver was brought. The one measure that tells searches apart where none fails.",
                "-inf..2",
                "lowest MOOBD",
                Topic.SOON,
                unit="m",
                more_is_better=False,
                decimals=2,
                is_main=False,
            ),
            Measure(
                "invalid_share",
                "invalid share",
                "Refused roads divided by all roads tested.",
                "0..1",
                "invalid share",
                Topic.COST,
                more_is_better=False,
                decimals=3,
            ),
            Measure(
                "generator_seconds",
                "generator time",
                "Wall time that the strategy or generator itself took over the whole campaign:"
                " depends on the machine.",
                "0..",
                "generator time",
                Topic.COST,
                unit="s",
                more_is_better=False,
                decimals=2,
            ),
            Measure(
                "tests",
                "tests",
                "Roads handed over to be tested: simulations and refused roads.",
                "0..",
                "tests",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "simulations",
                "simulations",
                "Valid roads that were driven, whether they ended in PASS, FAIL or ERROR.",
                "0..tests",
                "simulations",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "invalid",
                "invalid tests",
                "Roads that were refused and not driven.",
                "0..tests",
                "invalid tests",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "errors",
                "errors",
                "Simulations that broke.",
                "0..simulations",
                "errors",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "dropped",
                "dropped candidates",
                "Candidates that the strategy no longer wanted before they were driven: no tests.",
                "0..",
                "dropped",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "roads",
                "different roads",
                "Different roads among the tests: a repeated one counts once.",
                "0..tests",
                "roads",
                Topic.SPENT,
                is_main=False,
            ),
        )
    }
)
"""Name -> measure, in the order in which they are shown."""


def measure_campaign(folder: Path | str) -> CampaignMeasures:
    """Measures a campaign.

    Raises:
        CampaignError: there is none, or it is damaged.
    """
    with CampaignStore.open(folder) as store:
        found = [0]
        found_at: dict[int, int] = {}  # id of a failure -> simulations up to and with it
        seconds_to_failure = math.inf
        counts = Counts()
        drawn = 0
        failed_by_chance = []
        for record in store.tests():
            outcome = record.outcome
            counts.add(record.candidate, outcome, record.moobd)
            if outcome.is_simulated:
                found.append(found[-1] + (outcome is Outcome.FAIL))
                if record.candidate.origin.operator == RANDOM:
                    drawn += 1
                    if outcome is Outcome.FAIL:
                        failed_by_chance.append(record.id)
                if outcome is Outcome.FAIL:
                    found_at[record.candidate.id] = len(found) - 1
                    if len(found_at) == 1:
                        seconds_to_failure = record.elapsed
        failures = _read_failures(store, found_at)
        facts, seed = store.facts, store.config.get("seed")
    unused = _unused(facts, counts.simulations)
    clusters = cluster_failures(failure.compared for failure in failures)
    expected_failures = expected_distinct = None
    if drawn:
        random = RandomRoads.of(drawn, failed_by_chance, clusters)
        expected_failures = float(random.failures_after(len(found) - 1).value)
        expected_distinct = float(random.mean_distinct_after(len(found) - 1))
    # A curve rises at the first failure in a cell or cluster.
    cells = {failure.cell: found_at[failure.id] for failure in reversed(failures)}
    return CampaignMeasures(
        folder=Path(folder),
        seed=seed,
        invalid=counts.invalid,
        failures_after=np.array(found, dtype=np.int64),
        distinct_after=_curve(
            (min(map(found_at.__getitem__, c.ids)) for c in clusters), len(found)
        ),
        cells_after=_curve(cells.values(), len(found)),
        seconds_to_failure=seconds_to_failure,
        is_finished="finished_at" in facts and not facts.get("interrupted") and not unused,
        errors=counts.errors,
        dropped=counts.dropped,
        roads=counts.roads,
        min_moobd=counts.min_moobd,
        filled=frozenset(cells),
        competition_filled=frozenset(
            failure.competition_cell for failure in failures if failure.competition_cell is not None
        ),
        pairwise_diversity=_diversity([failure.points for failure in failures]),
        competition_sparseness=_sparseness(
            [failure.cut for failure in failures if failure.cut is not None]
        ),
        generator_seconds=_seconds(facts.get("strategy_seconds")),
        seconds_per_test=_seconds(facts.get("seconds_per_test")),
        unused=unused,
        expected_failures=expected_failures,
        expected_distinct=expected_distinct,
    )


def curves(campaigns: Sequence[CampaignMeasures], what: Curve) -> IntArray:
    """Curves, (campaigns, n), up to the number of simulations that all campaigns reached.

    Args:
        campaigns: one or more.
        what: which of their curves.
    """
    found: list[IntArray] = [getattr(campaign, what) for campaign in campaigns]
    reached = min(map(len, found))
    return np.array([curve[:reached] for curve in found], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class _Failure:
    """Measurements of a failure."""

    id: int
    compared: Failure
    cell: Cell
    competition_cell: Cell | None
    """Cell in the competition's form; None if it leaves the failure out."""
    points: FloatArray
    """The segment, (n, 2) in m."""
    cut: FloatArray | None
    """The segment as the competition cuts it, (n, 2) in m; None if it leaves the failure out."""


def _read_failures(store: CampaignStore, ids: Container[int]) -> list[_Failure]:
    """The failures with these ids and stored drives, in the order of the tests."""
    return [
        _measure_failure(record, segment)
        for record, segment in segments_of(store, Outcome.FAIL)
        if record.candidate.id in ids  # a campaign that goes on may have more by now
    ]


def _measure_failure(record: Test, segment: Segment) -> _Failure:
    points = record.candidate.points
    submitted = segment.road.road_points if points is None else points
    left = record.departure
    cut = None if left is None else competition_segment(submitted, (left.x, left.y))
    features = features_of(segment)
    return _Failure(
        id=record.candidate.id,
        compared=Failure.of(segment, id=record.candidate.id, moobd=record.moobd or 0.0),
        cell=tuple(FEATURES[name].bin_of(features) for name in MAP_AXES),
        competition_cell=_competition_cell(competition_features(segment, submitted)),
        points=segment.points(),
        cut=None if cut is None else cut.points,
    )


def _competition_cell(features: CompetitionFeatures | None) -> Cell | None:
    if features is None:
        return None
    return tuple(axis.bin(float(getattr(features, axis.name))) for axis in COMPETITION_AXES)


def _curve(rises: Iterable[int], length: int) -> IntArray:
    """Curve, (length,): how many of the given numbers of simulations each number reached."""
    counts = np.bincount(np.fromiter(rises, dtype=np.int64), minlength=length)
    return np.cumsum(counts, dtype=np.int64)


def _diversity(segments: Sequence[FloatArray]) -> float:
    pairwise = diversity(_thinned(segments, MOST_PAIRED)).pairwise
    return -math.inf if pairwise is None else pairwise


def _sparseness(cuts: Sequence[FloatArray]) -> float:
    mean = competition_sparseness(_thinned(cuts, MOST_COMPARED)).mean
    return -math.inf if mean is None else mean


def _thinned(segments: Sequence[FloatArray], most: int) -> Sequence[FloatArray]:
    """Evenly spaced segments, the first and the last among them."""
    return [segments[i] for i in evenly(len(segments), most)]


def _unused(facts: Mapping[str, Any], simulations: int) -> int:
    """Simulations left of the budget of a bench's run that ended by itself."""
    ending, budget = facts.get("bench"), facts.get("budget")
    if not isinstance(ending, Mapping) or ending.get("end") == "over":
        return 0
    allowed = budget.get("simulations") if isinstance(budget, Mapping) else None
    return max(0, allowed - simulations) if isinstance(allowed, int) else 0


def _seconds(value: object) -> float | None:
    """A fact as a time; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) and value >= 0.0 else None
