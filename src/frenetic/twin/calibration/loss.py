"""The loss of a twin: what its drives say about the recorded ones, 0 all and 1 nothing.

It is a weighted mean of terms, each a mean over drives, so the share of one drive in it is known.
A term counts only where the recording has what it compares:

============ ======================================================================================
term         per drive
============ ======================================================================================
outcome      log loss of the recorded outcome, over that of the share of failures; the chance of a
             failure is a logistic function of the twin's MOOBD, fitted anew each time
oob_share    half the squared difference of the standardised ranks of both largest oob shares: its
             mean is 1 minus Spearman's rank correlation; see `scores` and `with_ties` for the twin
oob_distance the same of the mean oob distance, where there is no trajectory
steering     the same of the standard deviation of steering, likewise
offset       mean absolute error of the lateral offset every 2 m of road, over the mean absolute
             deviation of all recorded ones from their median; 1 where the twin does not come
speed        the same of the speed
============ ======================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import ranks
from frenetic.errors import FreneticError
from frenetic.twin.calibration.driving import (
    COVERED,
    MOOBD,
    OFFSET,
    OOB_DISTANCE,
    SHARE,
    SPEED,
    STEERING,
    IntArray,
)
from frenetic.twin.calibration.recordings import RecordedDrive
from frenetic.twin.profile import Term

_TERMS: Final[Mapping[Term, tuple[float, int, str]]] = MappingProxyType(
    {
        "outcome": (1.0, MOOBD, "failed"),
        "oob_share": (1.0, SHARE, "max_oob_share"),
        "oob_distance": (0.5, OOB_DISTANCE, "mean_oob_distance"),
        "steering": (0.25, STEERING, "std_steering"),
        "offset": (1.0, OFFSET, "offset"),
        "speed": (1.0, SPEED, "speed"),
    }
)
"""Name of a term -> its usual weight, the column of a twin's drive, the field of a recorded one."""
_ALONG: Final[tuple[Term, ...]] = ("offset", "speed")
REFUSED: Final = 10.0
"""Loss of a candidate with which no car can be made, or with which the driver broke."""
_RIDGE: Final = 1e-3
_STEPS: Final = 25
_LEAST: Final = 1e-9
_STEEPEST: Final = 30.0


def chances(score: FloatArray, failed: FloatArray) -> FloatArray:
    """The chances of a failure, (n,): 1 / (1 + exp(-(a + b * score))), the most likely one.

    By Newton's method with a slight ridge; b is at least 0.

    Args:
        score: (n,).
        failed: (n,) 0 or 1, both of them there.
    """
    base = float(failed.mean())
    middle, width = float(score.mean()), float(score.std())
    flat = math.log(base / (1.0 - base))
    if width < _LEAST:
        return _sigmoid(flat + 0.0 * score)
    x = (score - middle) / width
    a, b = flat, 0.0
    for _ in range(_STEPS):
        p = _sigmoid(a + b * x)
        w = p * (1.0 - p) + 1e-9
        g = np.array([(failed - p).mean(), ((failed - p) * x).mean() - _RIDGE * b])
        h = np.array([[w.mean(), (w * x).mean()], [(w * x).mean(), (w * x * x).mean() + _RIDGE]])
        step = np.linalg.solve(h, g)
        a, b = a + float(step[0]), b + float(step[1])
        if abs(step).max() < 1e-8:
            break
    if b <= 0.0:
        return _sigmoid(flat + 0.0 * score)
    return _sigmoid(a - b * middle / width + b / width * score)


def _sigmoid(logit: FloatArray) -> FloatArray:
    found: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(logit, -_STEEPEST, _STEEPEST)))
    return found


def scores(rows: FloatArray) -> FloatArray:
    """The twin's scores of roads, larger is worse: the largest oob share, then the MOOBD.

    Args:
        rows: (..., COLUMNS).
    """
    found: FloatArray = rows[..., SHARE] - 1e-6 * rows[..., MOOBD]
    return found


def with_ties(score: FloatArray, recorded: FloatArray) -> FloatArray:
    """The scores, the lowest of them equal, as many as the recorded values have equal lowest ones.

    A record does not tell apart the drives that never left the lane; the MOOBD of a twin does.
    Without the ties, a twin that drives as recorded would not agree with the record.
    """
    equal = int((recorded == recorded.min()).sum())
    found: FloatArray = np.maximum(score, np.partition(score, equal - 1)[equal - 1])
    return found


class Loss:
    """The loss of a twin on recorded drives.

    Args:
        drives: all recorded drives.
        indices: of those that count.
        weights: name of a term -> its weight, in place of the usual one.

    Raises:
        FreneticError: nothing can be compared.
    """

    def __init__(
        self,
        drives: Sequence[RecordedDrive],
        indices: IntArray,
        weights: Mapping[Term, float] | None = None,
    ) -> None:
        chosen = [drives[i] for i in indices]
        self.n = len(chosen)
        self.failed = np.array([drive.failed for drive in chosen], dtype=np.float64)
        self._has_path = np.array([len(drive.offset) > 0 for drive in chosen])
        self._ranked: dict[Term, tuple[int, FloatArray, FloatArray]] = {}
        self._scale: dict[Term, tuple[int, float]] = {}
        for name, (_, column, field) in _TERMS.items():
            if name in _ALONG:
                paths = [getattr(drive, field) for drive in chosen if len(drive.offset)]
                told = np.concatenate(paths) if paths else np.empty(0)
                told = told[np.isfinite(told)]
                spread = float(np.abs(told - np.median(told)).mean()) if len(told) else 0.0
                if spread > _LEAST:
                    self._scale[name] = column, spread
            # The trajectories say more than mean distance and steering.
            elif name == "oob_share" or (name != "outcome" and not self._has_path.any()):
                told = np.array([getattr(drive, field) for drive in chosen])
                if np.isfinite(told).all() and np.ptp(told) > 0.0:
                    self._ranked[name] = column, told, _standard_ranks(told)
        present: list[Term] = ["outcome"] if 0.0 < self.failed.mean() < 1.0 else []
        present += [*self._ranked, *self._scale]
        wanted = {name: (weights or {}).get(name, _TERMS[name][0]) for name in present}
        self.weights = {name: weight for name, weight in wanted.items() if weight > 0.0}
        """Name of a term that counts -> its weight."""
        if not self.weights:
            raise FreneticError(
                "there is nothing to fit to: the drives neither differ in outcome or oob share nor"
                " have trajectories, or all weights are 0"
            )

    def contributions(self, rows: FloatArray) -> FloatArray:
        """The share of each drive in the loss, (n,), whose mean is the loss.

        Args:
            rows: (n, COLUMNS) of the twin.
        """
        if np.isnan(rows[:, SHARE]).any():
            return np.full(self.n, REFUSED)
        found = np.zeros(self.n)
        for name, values in self.terms(rows).items():
            found += self.weights[name] * values
        return found / sum(self.weights.values())

    def terms(self, rows: FloatArray) -> dict[Term, FloatArray]:
        """Name of a term -> its share in each drive, (n,)."""
        found: dict[Term, FloatArray] = {}
        for name in self.weights:
            if name == "outcome":
                found[name] = self._outcome(rows)
            elif name in self._ranked:
                column, told, theirs = self._ranked[name]
                values = rows[:, column]
                if column == SHARE:
                    values = with_ties(scores(rows), told)
                ours = _standard_ranks(values)
                # One that tells no two drives apart knows nothing.
                found[name] = 0.5 * (theirs - ours) ** 2 if np.ptp(values) > 0.0 else theirs**2
            else:
                found[name] = self._along(name, rows)
        return found

    def _outcome(self, rows: FloatArray) -> FloatArray:
        score = -rows[:, MOOBD]
        chance = np.clip(chances(score, self.failed), 1e-6, 1.0 - 1e-6)
        base = float(self.failed.mean())
        nothing = -(base * math.log(base) + (1.0 - base) * math.log(1.0 - base))
        losses: FloatArray = -np.where(self.failed > 0.5, np.log(chance), np.log1p(-chance))
        return losses / nothing

    def _along(self, name: Term, rows: FloatArray) -> FloatArray:
        column, spread = self._scale[name]
        covered = np.nan_to_num(rows[:, COVERED])
        errors = np.nan_to_num(rows[:, column]) / spread
        found: FloatArray = covered * errors + (1.0 - covered)
        # Drives without a record count as the mean of the others.
        mean = float(found[self._has_path].mean())
        return np.where(self._has_path, found, mean)


def _standard_ranks(values: FloatArray) -> FloatArray:
    """(n,) ranks with mean 0 and variance 1; 0 where all are equal."""
    found = ranks(values)
    centred: FloatArray = found - found.mean()
    width = float(centred.std())
    return centred / width if width > 0.0 else centred
