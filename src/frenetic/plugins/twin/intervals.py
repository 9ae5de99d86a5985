"""The uncertainty of a twin's fitted parameters: intervals of values that the drives allow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.plugins.twin.fitting import FitPoint, Fitter, joined, normal_matrix
from frenetic.plugins.twin.profile import Fitted
from frenetic.plugins.twin.recorded_drive import RecordedDrive, group_labels, thinned

_DRIVES: Final = 100  # on which values are compared with the best ones, as `thinned` takes it; ours
_MAX_ERRORS: Final = 1.96  # standard errors by which an equally good loss may be larger: 95 %
_MAX_WIDTH: Final = 0.5  # of a determined parameter's interval, in unit values; our choice
_TRIED_STEPS: Final = np.array([0.01, 0.03, 0.1, 0.3])  # [unit values] either way; our choice
_SLOPE_WIDTH: Final = 0.02  # [unit values]; our choice
_BOUND_DISTANCE: Final = 0.02  # [unit values] below which an end is at the bound; our choice


def fitted_parameters(
    fitter: Fitter,
    best: FloatArray,
    drives: Sequence[RecordedDrive],
    other_fits: Sequence[FloatArray],
) -> list[Fitted]:
    """Return each parameter with its fitted value and its interval.

    The interval holds the fitted value, the values of other fits, and each tried value that
    explains the drives as well as the fitted one. It is widened to the next tried value that is
    worse, since no value between them was tried.

    A value explains the drives as well if the loss with it is larger by at most 1.96 standard
    errors of the difference. It is tried alone, and with the other parameters moved so that they
    make up for it as far as the slopes say.

    A parameter is determined if its interval is less than half as wide as its bounds, and does not
    end at one of them: values beyond a bound may be as good.

    Args:
        fitter: fitter of the model.
        best: unit values that were fitted to the drives.
        drives: the recorded drives.
        other_fits: unit values that were fitted to parts of the drives.
    """
    search = _IntervalSearch(fitter, best, drives)
    fitted = []
    for k, parameter in enumerate(fitter.model.parameters):
        low, high = search.ends(k, [float(values[k]) for values in other_fits])
        # An interval that ends at both bounds is only too wide: no single bound decides.
        at_bound = (low < _BOUND_DISTANCE) != (1.0 - high < _BOUND_DISTANCE)
        fitted.append(
            Fitted(
                name=str(parameter),
                value=parameter.value_at(float(best[k])),
                low=parameter.low,
                high=parameter.high,
                from_=parameter.value_at(low),
                to=parameter.value_at(high),
                is_determined=high - low < _MAX_WIDTH and not at_bound,
                at_bound=at_bound,
            )
        )
    return fitted


class _IntervalSearch:
    """The search for values of one parameter that explain the drives as well as the best value."""

    def __init__(self, fitter: Fitter, best: FloatArray, drives: Sequence[RecordedDrive]) -> None:
        self._fitter = fitter
        self._best = best
        self._drives = thinned(drives, _DRIVES)
        self._labels = group_labels(self._drives)
        residuals = fitter.residuals_by_drive(best, self._drives)
        self._best_losses = _losses(residuals)
        point = FitPoint(best, joined(residuals))
        self._normal = normal_matrix(fitter.slopes(point, self._drives, _SLOPE_WIDTH))

    def ends(self, k: int, other_fitted: Sequence[float]) -> tuple[float, float]:
        """Return both ends of parameter k's interval, in unit values.

        Args:
            k: number of the parameter.
            other_fitted: unit values of the parameter in other fits, which count as equally good.
        """
        best = float(self._best[k])
        good = [best, *other_fitted]
        worse: list[float] = []
        direction = self._compensation(k)
        tried = np.clip([0.0, 1.0, *(best - _TRIED_STEPS), *(best + _TRIED_STEPS)], 0.0, 1.0)
        for value in tried.tolist():
            alone = self._best.copy()
            compensated = np.clip(self._best + (value - best) * direction, 0.0, 1.0)
            alone[k] = compensated[k] = value
            is_good = self._is_as_good(alone) or self._is_as_good(compensated)
            (good if is_good else worse).append(value)
        low, high = min(good), max(good)
        low = max((value for value in worse if value < low), default=low)
        high = min((value for value in worse if value > high), default=high)
        return low, high

    def _compensation(self, k: int) -> FloatArray:
        """Return by how much all parameters move per unit of parameter k, (p,).

        The other parameters move so that the loss stays least, as far as the slopes say.
        """
        others = np.arange(len(self._best)) != k
        direction = np.zeros(len(self._best))
        direction[k] = 1.0
        direction[others] = -np.linalg.solve(
            self._normal[np.ix_(others, others)], self._normal[others, k]
        )
        return direction

    def _is_as_good(self, unit_values: FloatArray) -> bool:
        """Return whether the loss with these unit values may be the best one but for chance."""
        residuals = self._fitter.try_residuals(unit_values, self._drives)
        if residuals is None:
            return False
        mean, error = mean_difference(_losses(residuals), self._best_losses, self._labels)
        return mean <= _MAX_ERRORS * error


def _losses(residuals_by_drive: Sequence[FloatArray]) -> FloatArray:
    """Return the loss of each drive, (n,)."""
    return np.array([float(residuals @ residuals) for residuals in residuals_by_drive])


def mean_difference(
    losses: FloatArray, other_losses: FloatArray, labels: IntArray
) -> tuple[float, float]:
    """Return the mean of paired differences of losses, and its standard error.

    The standard error is cluster-robust: differences within a group may depend on each other.

    Args:
        losses: loss of each drive, (n,).
        other_losses: loss of each drive that is subtracted, (n,).
        labels: number of each drive's independent group, (n,).
    """
    differences = losses - other_losses
    mean = float(differences.mean())
    group_sums = np.bincount(labels, weights=differences - mean)
    correction = len(group_sums) / max(len(group_sums) - 1, 1)
    variance = correction * (group_sums**2).sum()
    return mean, float(np.sqrt(variance) / len(differences))
