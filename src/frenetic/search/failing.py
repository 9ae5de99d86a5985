"""How likely a child will fail: a logistic model, learnt from the campaign's children.

Its features are the approach with which the child is expected to fail (see `approach`), mirrored
where needed so that the failure is to the left, the operator, and the parent's severity.
"""

from __future__ import annotations

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.search.approach import ROAD_SIZE, STATE_SCALE, STATES
from frenetic.search.archive import RIGHT

# All values are ours.
_ROOM = 2048  # last children that are learnt from
_BATCH = 64  # children in a step
_STEPS = 10  # of training after each child
_RATE = 0.1  # learning rate of Adagrad
_FIRST = 30  # children before the first use
_USUAL_SPEED, _SPEED_SPREAD = 14.0, 4.0  # [m/s], by which speeds are scaled
_MOST_SEVERITY = 2.0  # of the parent, by its absolute value


class FailureModel:
    """A model of a child's chance to fail.

    Args:
        rng: Draws the children that are learnt from.
        operators: Number of operators.
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
        """Return the features of a child, (n,).

        Args:
            vector: (64,) m, the approach with which the child is expected to fail.
            side: Side of the lane on which it is expected to fail.
            operator: Number of the operator that made the child; None in other conditions.
            severity: Severity of the parent.
        """
        turned = -1.0 if side == RIGHT else 1.0
        aside = turned * vector[1:ROAD_SIZE:2]
        offsets = turned * vector[ROAD_SIZE : ROAD_SIZE + STATES] / STATE_SCALE
        speeds = (vector[ROAD_SIZE + STATES :] / STATE_SCALE - _USUAL_SPEED) / _SPEED_SPREAD
        bend = aside[-1] + aside[len(aside) // 3]
        kind = np.zeros(self._operators)
        if operator is not None:
            kind[operator] = 1.0
        bounded = min(max(severity, -_MOST_SEVERITY), _MOST_SEVERITY)
        more = (1.0, bounded, bend * speeds[-1], bend * bend)
        return np.concatenate((aside, offsets, speeds, more, kind))

    @property
    def is_ready(self) -> bool:
        """Whether the model has learnt enough to be of use."""
        return self._count >= _FIRST

    def chance(self, features: FloatArray) -> float:
        """Return the chance of a failure, 0 to 1."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self._weights @ features, -30.0, 30.0))))

    def learn(self, features: FloatArray, *, has_failed: bool) -> None:
        """Learn from a driven child."""
        row = self._count % _ROOM
        self._rows[row], self._failed[row] = features, has_failed
        self._count += 1
        count = min(self._count, _ROOM)
        for batch in self._rng.integers(0, count, (_STEPS, _BATCH)):
            x = self._rows[batch]
            p = 1.0 / (1.0 + np.exp(-np.clip(x @ self._weights, -30.0, 30.0)))
            slope = x.T @ (p - self._failed[batch]) / _BATCH
            self._squares += slope * slope
            self._weights -= _RATE * slope / np.sqrt(self._squares)
