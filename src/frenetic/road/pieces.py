"""Roads of straights, clothoids and arcs, as curvature samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray

_STEPS_ROUNDING: Final = 1e-9
"""Number of steps by which a computed length may exceed a whole number of steps; our choice."""


class RoadPiece(NamedTuple):
    """A piece of a road with linear curvature: a straight, an arc or a clothoid."""

    length: float
    """Length, in m."""
    first: float
    """Curvature where the piece begins, in 1/m, positive turns left."""
    last: float
    """Curvature where the piece ends, in 1/m."""


def single_bend(
    curvature: float, *, run_up: float, transition: float, arc: float, run_out: float
) -> list[RoadPiece]:
    """Return the pieces of a straight, a bend between two clothoids, and a straight.

    Args:
        curvature: curvature of the bend's arc, in 1/m, positive turns left.
        run_up: length of the first straight, in m.
        transition: length of each clothoid, in m.
        arc: length of the arc, in m.
        run_out: length of the last straight, in m.
    """
    return [
        RoadPiece(run_up, 0.0, 0.0),
        RoadPiece(transition, 0.0, curvature),
        RoadPiece(arc, curvature, curvature),
        RoadPiece(transition, curvature, 0.0),
        RoadPiece(run_out, 0.0, 0.0),
    ]


def sampled_curvatures(pieces: Sequence[RoadPiece], step: float) -> FloatArray:
    """Return the curvatures of joined pieces every ``step`` m, (N,) in 1/m.

    The last piece goes on with its last curvature to the next whole step. An edge between two
    pieces that lies between two samples is rounded off.
    """
    ends = np.cumsum([piece.length for piece in pieces])
    starts = ends - [piece.length for piece in pieces]
    edges = np.column_stack([starts, ends]).ravel()
    values = np.array([(piece.first, piece.last) for piece in pieces]).ravel()
    steps = math.ceil(float(ends[-1]) / step - _STEPS_ROUNDING)
    return np.asarray(np.interp(step * np.arange(steps + 1), edges, values))
