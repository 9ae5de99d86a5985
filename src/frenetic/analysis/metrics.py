"""The measures by which campaigns are compared: their meaning and measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import evenly
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.failures import Failure
from frenetic.analysis.features import FEATURES, features_of
from frenetic.analysis.official_segment import failure_segment
from frenetic.analysis.segments import segment_of_test
from frenetic.analysis.sparseness import MOST_COMPARED, largest_distances, unlike_lines
from frenetic.campaign.counts import Counts
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome

IntArray: TypeAlias = npt.NDArray[np.int64]
Curve: TypeAlias = Literal["distinct_after", "failures_after"]
"""Name of a curve of `CampaignMeasures`."""

MAP_AXES: Final = ("direction_coverage", "max_curvature", "std_steering", "mean_offset")
"""Features that span the map with the counted cells: those of the competition of 2023."""
ROAD_SPACING: Final = 5.0
"""Distance between the points by which whole roads are compared, in m."""


@dataclass(frozen=True, eq=False)
class CampaignMeasures:
    """Measured results of a campaign.

    Curves have a value for each number of simulations, from 0 on.
    """

    folder: Path
    seed: object
    """Seed of its strategy."""
    counts: Counts
    failures_after: IntArray
    """(simulations + 1,) failures found by each number of simulations, a repeated road once."""
    distinct_after: IntArray
    """(simulations + 1,) distinct failures, each counted from the first of those alike."""
    is_finished: bool
    """Whether its budget was spent."""
    cells: int = 0
    """Cells of the feature map over `MAP_AXES` that hold a failure."""
    unlike_roads: int = 0
    """Failing roads that are unlike each other, see `unlike_lines`."""
    competition_sparseness: float = -math.inf
    """Sparseness in edits, see `largest_distances`; minus infinity below two failures."""
    lane_width: float = 4.0
    """Width of each lane, in m."""

    @property
    def simulations(self) -> int:
        """Drives, also those in which the simulator broke."""
        return len(self.failures_after) - 1

    @property
    def failures(self) -> int:
        """FAIL outcomes; a repeated road counts once."""
        return int(self.failures_after[-1])

    @property
    def distinct_failures(self) -> int:
        """See `frenetic.analysis.cluster_failures`."""
        return int(self.distinct_after[-1])

    @property
    def simulations_to_failure(self) -> float:
        """Simulations up to and with the first failure; infinite if there is none."""
        return float(np.argmax(self.failures_after > 0)) if self.failures else math.inf

    @property
    def min_moobd(self) -> float | None:
        """Lowest MOOBD, in m; None if nothing was driven."""
        return self.counts.min_moobd

    @property
    def valid_share(self) -> float:
        """Share 0..1 of the tested roads that were valid; 1 if none was tested.

        A repeated road counts once.
        """
        invalid = self.counts.invalid - self.counts.invalid_repeats
        valid = self.simulations - (self.counts.repeats - self.counts.invalid_repeats)
        return valid / (valid + invalid) if valid + invalid else 1.0


@dataclass(frozen=True)
class Measure:
    """A number by which campaigns are compared."""

    name: str
    """Name of the attribute of `CampaignMeasures`."""
    title: str
    definition: str
    """Definition, in a sentence or two."""
    short: str
    """A title for a narrow column."""
    unit: str = ""
    """Unit, empty if it has none."""
    more_is_better: bool = True
    """Whether more is better for a search, rather than less."""
    decimals: int = 0

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
    def sign(self) -> float:
        """1 or -1: a value times it is larger where it is better."""
        return 1.0 if self.more_is_better else -1.0

    @property
    def better(self) -> str:
        """The better direction: more or less."""
        return "more" if self.more_is_better else "less"


HEADLINE: Final = "distinct_failures"
"""The measure that orders groups."""

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
    """Measures a campaign.

    Raises:
        CampaignError: there is none, or it is damaged.
    """
    with CampaignStore.open(folder) as store:
        found = [0]
        found_at: dict[int, int] = {}  # id of a failure -> simulations up to and with it
        counts, repeats = Counts(), store.repeats()
        for test in store.tests():
            outcome = test.outcome
            counts.add(test.candidate, outcome, test.moobd)
            if outcome.is_simulated:
                is_new = outcome is Outcome.FAIL and test.id not in repeats
                found.append(found[-1] + is_new)
                if is_new:
                    found_at[test.id] = len(found) - 1
        failures: list[Failure] = []
        cells, roads, cuts = set(), [], []
        for test in store.tests(Outcome.FAIL, with_trajectory=True):
            if test.id not in found_at:
                continue  # a repeat, or of a campaign that goes on
            segment = segment_of_test(test)
            failures += filter(None, [Failure.of_segment(segment, test.result, test.id)])
            if segment is None:
                continue
            features = features_of(segment)
            cells.add(tuple(FEATURES[name].bin(features[name]) for name in MAP_AXES))
            roads.append(test.road.sample(ROAD_SPACING))
            if (cut := failure_segment(test)) is not None:
                cuts.append(cut)
        config, facts, lane_width = store.config, store.facts, store.lane_width
    clusters = cluster_failures(failures)
    distances = largest_distances([cuts[i] for i in evenly(len(cuts), MOST_COMPARED)])
    return CampaignMeasures(
        folder=Path(folder),
        seed=config.get("seed"),
        counts=counts,
        failures_after=np.array(found, dtype=np.int64),
        distinct_after=_curve(
            (min(map(found_at.__getitem__, c.ids)) for c in clusters), len(found)
        ),
        is_finished=_is_finished({"budget": config.get("budget"), **facts}, len(found) - 1),
        cells=len(cells),
        unlike_roads=unlike_lines(roads),
        competition_sparseness=float(distances.mean()) if len(distances) else -math.inf,
        lane_width=lane_width,
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


def _curve(rises: Iterable[int], length: int) -> IntArray:
    """Curve, (length,): how many of the given numbers of simulations each number reached."""
    counts = np.bincount(np.fromiter(rises, dtype=np.int64), minlength=length)
    return np.cumsum(counts, dtype=np.int64)


def _is_finished(facts: Mapping[str, Any], simulations: int) -> bool:
    """Whether a budget was spent: a run of a bench may end by itself before."""
    if "finished_at" not in facts or facts.get("interrupted"):
        return False
    ended_by_itself = facts.get("bench", {"end": "over"})["end"] != "over"
    return not ended_by_itself or simulations >= (facts["budget"].get("simulations") or 0)
