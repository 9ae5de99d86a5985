"""How likely a child will fail: a logistic model, learnt from the campaign's children.

It looks at the approach with which the child is expected to fail (see `approach`), turned so that
the failure is to the left, at the operator, and at how the parent fared.
"""

from __future__ import annotations

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.search.approach import ROAD_SIZE, STATE_SCALE, STATES
from frenetic.search.archive import RIGHT

_ROOM = 2048  # children that are learnt from, the last ones
_BATCH = 64
_STEPS = 10  # a child
_RATE = 0.1  # of Adagrad
_FIRST = 30  # children before the first use
_USUAL, _SPREAD = 14.0, 4.0  # [m/s] of speed
_MOST = 2.0  # of the parent's severity


class FailureModel:
    """The model of the chance to fail.

    Args:
        rng: draws what is learnt from.
        operators: number of operators.
    """

    def __init__(self, rng: np.random.Generator, operators: int) -> None:
        self._rng = rng
        self._operators = operators
        self._weights = np.zeros(ROAD_SIZE // 2 + 2 * STATES + 4 + operators)
        self._squares = np.full_like(self._weights, 1e-6)
        self._rows = np.empty((_ROOM, len(self._weights)))
        self._failed = np.empty(_ROOM)
        self._count = 0

    def features(
        self, vector: FloatArray, side: int, operator: int | None, severity: float
    ) -> FloatArray:
        """What the model looks at, (n,).

        Args:
            vector: (64,) m, the approach with which the child is expected to fail.
            side: of the lane on which it is.
            operator: that made it; None for none.
            severity: of the parent.
        """
        turned = -1.0 if side == RIGHT else 1.0
        aside = turned * vector[1:ROAD_SIZE:2]
        offsets = turned * vector[ROAD_SIZE : ROAD_SIZE + STATES] / STATE_SCALE
        speeds = (vector[ROAD_SIZE + STATES :] / STATE_SCALE - _USUAL) / _SPREAD
        bend = aside[-1] + aside[len(aside) // 3]
        kind = np.zeros(self._operators)
        if operator is not None:
            kind[operator] = 1.0
        fared = min(max(severity, -_MOST), _MOST)
        more = (1.0, fared, bend * speeds[-1], bend * bend)
        return np.concatenate((aside, offsets, speeds, more, kind))

    @property
    def is_ready(self) -> bool:
        """Whether it has learnt enough to be of use."""
        return self._count >= _FIRST

    def chance(self, features: FloatArray) -> float:
        """The chance of a failure, 0 to 1."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self._weights @ features, -30.0, 30.0))))

    def learn(self, features: FloatArray, *, has_failed: bool) -> None:
        """Learn from a child."""
        row = self._count % _ROOM
        self._rows[row], self._failed[row] = features, has_failed
        self._count += 1
        kept = min(self._count, _ROOM)
        for batch in self._rng.integers(0, kept, (_STEPS, _BATCH)):
            x = self._rows[batch]
            p = 1.0 / (1.0 + np.exp(-np.clip(x @ self._weights, -30.0, 30.0)))
            slope = x.T @ (p - self._failed[batch]) / _BATCH
            self._squares += slope * slope
            self._weights -= _RATE * slope / np.sqrt(self._squares)
