"""What the data leave open: the values of each parameter that explain the drives as well.

A candidate explains them as well as the best one if its loss is larger by no more than `LIMIT`
standard errors of that difference, over runs (over roads where there are few runs). Candidates are
all that the last fit drove, which differ in several parameters at once, the best ones of the folds,
and the best one with one parameter moved alone. The values of a parameter among those that are as
good, and those that the folds found, are its interval, widened to the next value that, moved alone,
is worse: what lies between was not driven. A parameter is determined if that interval is less than
half as wide as its bounds and ends at neither of them: beyond a bound, values may be as good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.twin.calibration.driving import IntArray
from frenetic.twin.calibration.fitting import Evaluated
from frenetic.twin.calibration.parameters import Parameter

LIMIT: Final = 1.96
"""Standard errors."""
WIDE: Final = 0.5
"""Share of the bounds' distance from which on a parameter is not determined."""
_STEPS: Final = np.array([0.01, 0.03, 0.1, 0.3])
"""Steps by which each parameter is moved alone, as shares of the bounds' distance."""
PLACES: Final = 2 * len(_STEPS) + 2
"""Number of places at which each parameter is moved alone: by each step, and its bounds."""
_EDGE: Final = 0.02
_TRADED: Final = 0.8
_ENOUGH: Final = 8


@dataclass(frozen=True, eq=False)
class Interval:
    """What the data say about a parameter."""

    parameter: Parameter
    value: float
    low: float
    """Lower end of the interval of the values with which a twin explains the drives as well."""
    high: float
    is_determined: bool
    at_bound: bool
    """Whether the interval ends at one of its bounds, so that the bound decides."""
    traded_with: tuple[str, ...]
    """Parameters that move along with it among the candidates that are as good."""
    curve: tuple[tuple[float, float, float], ...]
    """(value, loss, standard error of its difference from the least), ascending, where it is moved
    alone, and of the best one."""

    def __str__(self) -> str:
        text = "the data determine it" if self.is_determined else "the data do not determine it"
        if self.at_bound:
            text += "; its interval ends at a bound"
        if self.traded_with:
            text += f"; moves with {', '.join(self.traded_with)}"
        return text


def moved_alone(best: FloatArray) -> FloatArray:
    """(parameters * PLACES, parameters) places: the best ones with one parameter moved each."""
    found = np.repeat(best[None, :], len(best) * PLACES, axis=0)
    for k, place in enumerate(best):
        steps = np.concatenate(([0.0, 1.0], place - _STEPS, place + _STEPS))
        found[k * PLACES : (k + 1) * PLACES, k] = np.sort(np.clip(steps, 0.0, 1.0))
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
    candidates: Sequence[Evaluated],
    folds: Sequence[Evaluated],
    alone: Sequence[Evaluated],
    labels: IntArray,
) -> list[Interval]:
    """What the data say about each parameter.

    Args:
        parameters: all that were fitted.
        best: the candidate of least loss.
        candidates: others, on the same drives.
        folds: the best ones of the folds, on the same drives.
        alone: those of `moved_alone`, in its order.
        labels: (n,) numbers of the independent groups of drives.
    """

    def is_as_good(one: Evaluated) -> bool:
        mean, error = difference(one.contributions, best.contributions, labels)
        return mean <= LIMIT * error

    joint = np.stack([best.places, *(c.places for c in candidates if is_as_good(c))])
    apart = [is_as_good(c) for c in alone]
    good = np.stack(
        [
            *joint,
            *(c.places for c, fine in zip(alone, apart, strict=True) if fine),
            *(c.places for c in folds),
        ]
    )
    found = []
    for k, parameter in enumerate(parameters):
        low, high = float(good[:, k].min()), float(good[:, k].max())
        own = range(k * PLACES, (k + 1) * PLACES)
        worse = [float(alone[i].places[k]) for i in own if not apart[i]]
        low = max((place for place in worse if place < low), default=low)
        high = min((place for place in worse if place > high), default=high)
        curve = [(parameter.at(float(best.places[k])), best.loss, 0.0)]
        for one in alone[k * PLACES : (k + 1) * PLACES]:
            _, error = difference(one.contributions, best.contributions, labels)
            curve.append((parameter.at(float(one.places[k])), one.loss, error))
        at_bound = (low < _EDGE) != (1.0 - high < _EDGE)
        found.append(
            Interval(
                parameter,
                parameter.at(float(best.places[k])),
                parameter.at(low),
                parameter.at(high),
                is_determined=high - low < WIDE and not at_bound,
                at_bound=at_bound,
                traded_with=_traded(joint, k, parameters),
                curve=tuple(sorted(curve)),
            )
        )
    return found


def _traded(joint: FloatArray, k: int, parameters: Sequence[Parameter]) -> tuple[str, ...]:
    if len(joint) < _ENOUGH or np.ptp(joint[:, k]) < 1e-9:
        return ()
    found = []
    for other, parameter in enumerate(parameters):
        if other == k or np.ptp(joint[:, other]) < 1e-9:
            continue
        if abs(np.corrcoef(joint[:, k], joint[:, other])[0, 1]) >= _TRADED:
            found.append(str(parameter))
    return tuple(found)
