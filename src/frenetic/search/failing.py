"""How likely a child will fail: a logistic model, learnt from the campaign's children.

Its features are the approach with which the child is expected to fail (see `approach`), mirrored
where needed so that the failure is to the left, the operator, and the parent's fitness.
"""

from __future__ import annotations

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.search.approach import ROAD_SIZE, STATE_SCALE, STATES
from frenetic.search.archive import RIGHT

# The values are our choice.
_MEMORY = 2048  # most recent children from which the model learns
_BATCH_SIZE = 64  # children in a step of training
_STEPS = 10  # steps of training after each child
_LEARNING_RATE = 0.1  # learning rate of Adagrad
_FIRST_SQUARES = 1e-6  # sum of squared gradients with which Adagrad begins
_MIN_CHILDREN = 30  # children before the first use
_USUAL_SPEED, _SPEED_SPREAD = 14.0, 4.0  # [m/s] offset and scale of speeds as features
_MAX_FITNESS = 2.0  # bound of the parent's fitness as a feature, in either direction
_MAX_LOGIT = 30.0  # bound that keeps the exponential finite


class FailureModel:
    """A logistic regression of a child's chance to fail, trained by Adagrad after each child.

    Args:
        rng: Generator that draws the children of each training step.
        operators: Number of operators.
    """

    def __init__(self, rng: np.random.Generator, operators: int) -> None:
        self._rng = rng
        self._operators = operators
        self._weights = np.zeros(ROAD_SIZE // 2 + 2 * STATES + 4 + operators)
        self._squares = np.full_like(self._weights, _FIRST_SQUARES)
        # Features and failures of the last children, in a ring.
        self._rows = np.empty((_MEMORY, len(self._weights)))
        self._failed = np.empty(_MEMORY)
        self._count = 0  # number of all children so far

    def features(
        self, vector: FloatArray, side: int, operator: int | None, fitness: float
    ) -> FloatArray:
        """Return the features of a child, (n,).

        Args:
            vector: (64,) m, the approach with which the child is expected to fail.
            side: Side of the lane on which it is expected to fail, as in `archive.SIDES`.
            operator: Number of the operator that made the child; None in other conditions.
            fitness: Fitness of the parent.
        """
        mirror = -1.0 if side == RIGHT else 1.0
        # y of the road's points, then the states before the place.
        aside = mirror * vector[1:ROAD_SIZE:2]
        offsets = mirror * vector[ROAD_SIZE : ROAD_SIZE + STATES] / STATE_SCALE
        speeds = (vector[ROAD_SIZE + STATES :] / STATE_SCALE - _USUAL_SPEED) / _SPEED_SPREAD
        # The bend around the place: y of the last point, and of a point 15 m before the place.
        bend = aside[-1] + aside[len(aside) // 3]
        is_operator = np.zeros(self._operators)
        if operator is not None:
            is_operator[operator] = 1.0
        bounded_fitness = min(max(fitness, -_MAX_FITNESS), _MAX_FITNESS)
        constant = 1.0
        others = (constant, bounded_fitness, bend * speeds[-1], bend * bend)
        return np.concatenate((aside, offsets, speeds, others, is_operator))

    @property
    def is_ready(self) -> bool:
        """Whether the model has learnt enough to be of use."""
        return self._count >= _MIN_CHILDREN

    def chance(self, features: FloatArray) -> float:
        """Return the chance of a failure, 0 to 1."""
        logit = np.clip(self._weights @ features, -_MAX_LOGIT, _MAX_LOGIT)
        return float(1.0 / (1.0 + np.exp(-logit)))

    def learn(self, features: FloatArray, *, has_failed: bool) -> None:
        """Learn from a driven child."""
        row = self._count % _MEMORY
        self._rows[row], self._failed[row] = features, has_failed
        self._count += 1
        remembered = min(self._count, _MEMORY)
        for batch in self._rng.integers(0, remembered, (_STEPS, _BATCH_SIZE)):
            x = self._rows[batch]
            chances = 1.0 / (1.0 + np.exp(-np.clip(x @ self._weights, -_MAX_LOGIT, _MAX_LOGIT)))
            gradient = x.T @ (chances - self._failed[batch]) / _BATCH_SIZE
            self._squares += gradient * gradient
            self._weights -= _LEARNING_RATE * gradient / np.sqrt(self._squares)
