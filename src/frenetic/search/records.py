"""Records that a campaign and a search strategy exchange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.outcome import Outcome


@dataclass(frozen=True)
class Origin:
    """Origin of a candidate."""

    operator: str
    """Name of the operator that made it, as in Listing 1: ``random``, ``P1`` .. ``C2``."""
    parents: tuple[int, ...] = ()
    """Ids of its parents."""
    generation: int = 0
    """Generation: 0 for a random road, otherwise one more than its youngest parent's."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A road that a strategy wants judged."""

    id: int
    """Number from 1 in the order of asking."""
    curvatures: FloatArray
    """Curvature samples, (N,) in 1/m, read-only."""
    step: float
    """Distance between two curvature samples, in m."""
    origin: Origin
    points: FloatArray | None = None
    """Points of the road on the map, (N, 2) in m, read-only, if it was proposed as points.

    Then these are judged and driven where they lie, and the curvatures follow from them; there are
    none if no road passes through the points.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvatures", _read_only(self.curvatures))
        if self.points is not None:
            object.__setattr__(self, "points", _read_only(self.points))

    def __reduce__(self) -> tuple[Any, ...]:
        # Made anew, so that the values are read-only again.
        return Candidate, (self.id, self.curvatures, self.step, self.origin, self.points)


def _read_only(values: FloatArray) -> FloatArray:
    copied = np.array(values, dtype=np.float64)
    copied.setflags(write=False)
    return copied


@dataclass(frozen=True)
class Evaluation:
    """Result of a candidate, as a strategy is told it."""

    candidate: Candidate
    outcome: Outcome
    moobd: float | None
    """Minimum oob distance in m, smaller is worse for the driver; None unless PASS or FAIL."""
    budget_spent: float
    """Share of the campaign's budget spent when this was told, 0..1."""
