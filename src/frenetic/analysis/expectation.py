"""Random expectation: what a search would have found if all its roads were random.

Its own random roads, those of its first phase, say so. The number of *failures* grows with the
roads: the share that failed goes on. That of *distinct* failures grows more and more slowly, as
new ones become rare. Up to as many roads as there are random ones it is the mean over all
selections of them (rarefaction); beyond, it is extrapolated by how many distinct failures these
roads found once and twice. Both, and the bootstrap behind the interval, are those of Chao et al.,
"Rarefaction and extrapolation with Hill numbers", Ecological Monographs 84 (2014), for incidences:
species are distinct failures, sampling units are roads. It is reliable up to two or three times the
random roads; beyond, it is rather too low, and the interval too narrow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.analysis.failures import Cluster
from frenetic.analysis.statistics import proportion_interval

SAMPLES: Final = 200
"""Number of bootstrap samples."""
_Z: Final = 1.96  # for 95 %


@dataclass(frozen=True, eq=False)
class Curve:
    """An expected number, with the ends of its 95 % interval, for each of some numbers of roads."""

    value: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class RandomRoads:
    """The random roads of a campaign, and what they found."""

    roads: int
    """Number of roads, at least 1."""
    failures: int
    found: tuple[int, ...]
    """Number of these roads that found each distinct failure, each at least 1."""

    @classmethod
    def of(cls, roads: int, failing: Iterable[int], clusters: Iterable[Cluster]) -> RandomRoads:
        """What random roads found.

        Args:
            roads: their number.
            failing: ids of those that failed.
            clusters: the distinct failures of the campaign.
        """
        ids = frozenset(failing)
        found = (len(ids.intersection(cluster.ids)) for cluster in clusters)
        return cls(roads, len(ids), tuple(number for number in found if number))

    def failures_after(self, roads: npt.ArrayLike) -> Curve:
        """Expected failures of so many random roads; the interval is that of Wilson."""
        numbers = np.asarray(roads, dtype=np.float64)
        low, high = proportion_interval(self.failures, self.roads)
        return Curve(self.failures / self.roads * numbers, low * numbers, high * numbers)

    def distinct_after(self, roads: npt.ArrayLike) -> Curve:
        """Expected distinct failures of so many random roads; at most as many as failures."""
        numbers = np.asarray(roads, dtype=np.float64)
        most = self.failures_after(numbers).high
        if not self.found:
            return Curve(np.zeros_like(most), np.zeros_like(most), most)
        found, samples = np.array(self.found, dtype=np.int64), self._samples()
        terms = _terms(np.unique(np.concatenate([found, *samples])), self.roads, numbers)
        value = _accumulated(found, self.roads, numbers, terms)
        others = [_accumulated(sample, self.roads, numbers, terms) for sample in samples]
        half = _Z * np.std(others, axis=0)
        return Curve(value, np.maximum(value - half, 0.0), np.minimum(value + half, most))

    def _samples(self) -> list[npt.NDArray[np.int64]]:
        """Bootstrapped numbers of roads per distinct failure, those that nobody saw included."""
        found, roads = np.array(self.found, dtype=np.float64), self.roads
        total, once, twice = found.sum(), int((found == 1).sum()), int((found == 2).sum())
        unseen = _unseen(found, roads)
        # Share of the failures of the next road that belong to known ones.
        if twice:
            coverage = 1.0 - once / total * (roads - 1) * once / ((roads - 1) * once + 2 * twice)
        elif once:
            rest = (roads - 1) * (once - 1)
            coverage = 1.0 - once / total * rest / (rest + 2)
        else:
            coverage = 1.0
        chances = found / roads
        missed = chances * (1.0 - chances) ** roads
        unknown = total / roads * (1.0 - coverage)
        if missed.sum() > 0.0:
            chances = chances * (1.0 - unknown / missed.sum() * (1.0 - chances) ** roads)
        others = math.ceil(unseen)
        if others:
            chances = np.concatenate([chances, np.full(others, unknown / others)])
        rng = np.random.default_rng(0)
        drawn = rng.binomial(roads, np.clip(chances, 0.0, 1.0), (SAMPLES, len(chances)))
        return [sample[sample > 0] for sample in drawn]


def _unseen(found: npt.NDArray[np.generic], roads: int) -> float:
    """Distinct failures that no road found: the lower bound of Chao."""
    once, twice = int((found == 1).sum()), int((found == 2).sum())
    pairs = once * once / (2.0 * twice) if twice else once * (once - 1) / 2.0
    return (roads - 1) / roads * pairs


def _terms(found: npt.NDArray[np.int64], roads: int, numbers: FloatArray) -> dict[int, FloatArray]:
    """Chance that some of the roads found a failure, by how many of all roads did."""
    from scipy.special import gammaln  # takes its time

    few = np.minimum(numbers, roads)
    terms = {}
    for count in found.tolist():
        rest = np.maximum(roads - count - few, 0.0)
        chance = np.exp(
            gammaln(roads - count + 1)
            - gammaln(rest + 1)
            + gammaln(roads - few + 1)
            - gammaln(roads + 1)
        )
        terms[count] = np.where(roads - count < few, 1.0, 1.0 - chance)
    return terms


def _accumulated(
    found: npt.NDArray[np.int64], roads: int, numbers: FloatArray, terms: dict[int, FloatArray]
) -> FloatArray:
    total = np.zeros_like(numbers)
    counts, times = np.unique(found, return_counts=True)
    for count, often in zip(counts.tolist(), times.tolist(), strict=True):
        total += often * terms[count]
    once, unseen = int((found == 1).sum()), _unseen(found, roads)
    if unseen > 0.0:
        fade = 1.0 - once / (roads * unseen + once)
        total += unseen * (1.0 - fade ** np.maximum(numbers - roads, 0.0))
    return total
