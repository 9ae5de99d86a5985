"""The fit: CMA-ES proposes values of the parameters, the twin drives, the loss judges.

Then, what the data leave open: the values of each parameter that explain the drives as well.

A candidate explains them as well as the best one if its loss is larger by no more than `LIMIT`
standard errors of that difference, over runs (over roads where there are few runs). Candidates are
all that the last fit drove, which differ in several parameters at once, the best ones of the folds,
and the best one with one parameter moved alone. The values of a parameter among those that are as
good, and those that the folds found, are its interval, widened to the next value that, moved alone,
is worse: what lies between was not driven. A parameter is determined if that interval is less than
half as wide as its bounds and ends at neither of them: beyond a bound, values may be as good.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from cmaes import CMA

from frenetic._support.arrays import FloatArray
from frenetic.twin.calibration.driving import IntArray, TwinDriver
from frenetic.twin.calibration.loss import Loss
from frenetic.twin.calibration.parameters import Parameter
from frenetic.twin.profile import Fitted

LIMIT: Final = 1.96
"""Standard errors."""
WIDE: Final = 0.5
"""Share of the bounds' distance from which on a parameter is not determined."""
_STEPS: Final = np.array([0.01, 0.03, 0.1, 0.3])
"""Steps by which each parameter is moved alone, as shares of the bounds' distance."""
_PLACES: Final = 2 * len(_STEPS) + 2
"""Number of places at which each parameter is moved alone: by each step, and its bounds."""
_EDGE: Final = 0.02
"""Least distance from the bounds of a fit's first mean, and of what is not at them."""
_SIGMA: Final = 0.25
"""First step size, as a share of the bounds' distance."""
_NEAR_SIGMA: Final = 0.1
"""The same around a good candidate."""
_CONVERGED: Final = 1e-3
"""Range of a generation, as a share of the bounds' distance, at which a fit begins again."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A candidate with its loss."""

    places: FloatArray
    """(parameters,) 0..1 between the bounds."""
    contributions: FloatArray
    """(drives,) shares of the drives in the loss."""

    @property
    def loss(self) -> float:
        """The loss, the mean of the contributions."""
        return float(self.contributions.mean())


def evaluate(
    twins: TwinDriver, batch: FloatArray, indices: IntArray, loss: Loss
) -> list[Evaluated]:
    """Candidates, (candidates, parameters) places, with their losses on some drives."""
    rows = twins.rows(batch, indices)
    return [Evaluated(one, loss.contributions(own)) for one, own in zip(batch, rows, strict=True)]


def fit(
    twins: TwinDriver,
    indices: IntArray,
    loss: Loss,
    *,
    seed: int,
    evaluations: int,
    start: FloatArray | None = None,
) -> list[Evaluated]:
    """All candidates of a fit, in the order of driving; the first is the model as it was.

    The search is CMA-ES within the bounds (`cmaes`), from the model's own values. When it has
    converged, it begins again from the middle with twice as many candidates at once.

    Args:
        twins: drive the candidates.
        indices: of the recorded drives.
        loss: on them.
        seed: of the search.
        evaluations: number of candidates, at least 1; the last generation is driven whole.
        start: (parameters,) places of a good candidate to begin around; by default the model's.
    """
    own = twins.start
    p = len(own)
    sigma = _SIGMA if start is None else _NEAR_SIGMA
    found = evaluate(twins, own[None, :], indices, loss)
    size = 4 + math.floor(3.0 * math.log(p + 1))
    generator = np.random.default_rng(seed)
    mean = np.clip(own if start is None else start, _EDGE, 1.0 - _EDGE)
    while len(found) < evaluations:
        search = _search(mean, sigma, size, int(generator.integers(2**31)))
        width = 1.0
        while len(found) < evaluations and width > _CONVERGED and not search.should_stop():
            asked = np.stack([search.ask() for _ in range(search.population_size)])
            driven = evaluate(twins, asked[:, :p], indices, loss)
            # One parameter alone has a second, idle place that costs nothing.
            told = [(x, one.loss) for x, one in zip(asked, driven, strict=True)]
            search.tell(told)
            found += driven
            width = float(np.ptp(asked[:, :p], axis=0).max())
        size *= 2
        sigma = _SIGMA
        mean = np.full(p, 0.5)
    return found


def _search(mean: FloatArray, sigma: float, size: int, seed: int) -> CMA:
    padded = np.concatenate((mean, np.full(max(0, 2 - len(mean)), 0.5)))
    bounds = np.tile([0.0, 1.0], (len(padded), 1))
    return CMA(mean=padded, sigma=sigma, bounds=bounds, seed=seed, population_size=size)


def best(candidates: list[Evaluated]) -> Evaluated:
    """The candidate of least loss, the first of equal ones."""
    return min(candidates, key=lambda one: one.loss)


# What the data leave open


def moved_alone(best: FloatArray) -> FloatArray:
    """(parameters * _PLACES, parameters) places: the best ones with one parameter moved each."""
    found = np.repeat(best[None, :], len(best) * _PLACES, axis=0)
    for k, place in enumerate(best):
        steps = np.concatenate(([0.0, 1.0], place - _STEPS, place + _STEPS))
        found[k * _PLACES : (k + 1) * _PLACES, k] = np.sort(np.clip(steps, 0.0, 1.0))
    return found


def difference(one: FloatArray, best: FloatArray, labels: IntArray) -> tuple[float, float]:
    """The difference of two losses and its standard error.

    Args:
        one: (n,) contributions of a candidate.
        best: those of the best one.
        labels: (n,) numbers of the independent groups.
    """
    d = one - best
    mean = float(d.mean())
    groups = np.bincount(labels, weights=d - mean)
    count = int(labels.max()) + 1
    factor = count / max(count - 1, 1)
    return mean, float(np.sqrt(factor * (groups**2).sum()) / len(d))


def intervals(
    parameters: Sequence[Parameter],
    best: Evaluated,
    others: Sequence[Evaluated],
    folds: Sequence[Evaluated],
    alone: Sequence[Evaluated],
    labels: IntArray,
) -> list[Fitted]:
    """What the data say about each parameter.

    Args:
        parameters: all that were fitted.
        best: the candidate of least loss.
        others: candidates on the same drives.
        folds: the best ones of the folds, on the same drives.
        alone: those of `moved_alone`, in its order.
        labels: (n,) numbers of the independent groups of drives.
    """

    def is_as_good(one: Evaluated) -> bool:
        mean, error = difference(one.contributions, best.contributions, labels)
        return mean <= LIMIT * error

    apart = [is_as_good(one) for one in alone]
    good = [best, *filter(is_as_good, others), *folds]
    good += [one for one, fine in zip(alone, apart, strict=True) if fine]
    found = []
    for k, parameter in enumerate(parameters):
        low, high = (float(end(one.places[k] for one in good)) for end in (min, max))
        own = range(k * _PLACES, (k + 1) * _PLACES)
        worse = [float(alone[i].places[k]) for i in own if not apart[i]]
        low = max((place for place in worse if place < low), default=low)
        high = min((place for place in worse if place > high), default=high)
        at_bound = (low < _EDGE) != (1.0 - high < _EDGE)
        found.append(
            Fitted(
                name=str(parameter),
                value=parameter.at(float(best.places[k])),
                low=parameter.low,
                high=parameter.high,
                from_=parameter.at(low),
                to=parameter.at(high),
                is_determined=high - low < WIDE and not at_bound,
                at_bound=at_bound,
            )
        )
    return found
