"""Parts of a road: arcs and straights of one curvature, and stations where something bends."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road.conforming import NO_CHANGE

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.road.road import Road

_ROUNDING: Final = 1e-9  # [m] by which the last station may lie beyond a road; ours


def indices_of(values: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices of true values."""
    return np.flatnonzero(values).tolist()


def knots(road: Road, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return stations in m where the curvature or a profile bends, and the curvatures there."""
    samples = np.arange(len(road.curvatures)) * road.step
    stations = np.unique(np.concatenate([samples, pairs[:, 0]]))
    stations = stations[(stations >= 0.0) & (stations <= road.length + _ROUNDING)]
    return stations, road.curvature_at(stations)


class SteadyPart(NamedTuple):
    """Samples of one curvature between two clothoids, or the sample at which clothoids meet."""

    first: int
    """Index of the first sample."""
    last: int
    """Index of the last sample."""
    curvature: float
    """Curvature of the part, in 1/m."""
    before: float
    """Curvature at the start of the clothoid that leads to the part, in 1/m."""
    after: float
    """Curvature at the end of the clothoid that leads away, in 1/m."""


def steady_parts(values: FloatArray) -> list[SteadyPart]:
    """Return a road's steady parts, without those at its ends, which may belong to longer ones."""
    changes = np.diff(values)
    signs = np.where(np.abs(changes) > NO_CHANGE, np.sign(changes), 0.0)
    borders = [0, *indices_of(np.diff(signs, prepend=signs[0]) != 0.0), len(signs)]
    spans: list[tuple[int, int]] = []
    for first, last in pairwise(borders):
        if signs[first] == 0.0:
            spans.append((first, last))
        elif not spans or spans[-1][1] != first:
            spans.append((first, first))
    if spans[-1][1] != len(signs):
        spans.append((len(signs), len(signs)))
    curvatures = [float(values[first]) for first, _ in spans]
    return [
        SteadyPart(*spans[k], curvatures[k], curvatures[k - 1], curvatures[k + 1])
        for k in range(1, len(spans) - 1)
    ]
