"""Steady parts of a road (arcs and straights), and the stations between which it is linear."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road.conforming import NO_CHANGE

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.road.road import Road

_ROUNDING: Final = 1e-9  # [m] by which the last station may lie beyond a road; our choice


def indices_of(values: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices at which values, (n,), are true."""
    return np.flatnonzero(values).tolist()


def knots(road: Road, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the stations between which curvature and a profile are linear, and the curvatures.

    Args:
        road: the road.
        pairs: a profile of the road, (k, 2), see `frenetic.road.profile`.

    Returns:
        Stations on the road, (n,) in m, and the curvatures there, (n,) in 1/m.
    """
    samples = road.stations
    stations = np.unique(np.concatenate([samples, pairs[:, 0]]))
    stations = stations[(stations >= 0.0) & (stations <= road.length + _ROUNDING)]
    return stations, road.curvature_at(stations)


class SteadyPart(NamedTuple):
    """Samples with the same curvature between two clothoids, or a sample where clothoids meet."""

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


def steady_parts(curvatures: FloatArray) -> list[SteadyPart]:
    """Return the steady parts of a road with these curvatures, (n,) in 1/m.

    The parts at both ends are left out: they may continue beyond the road, so their length is
    unknown.
    """
    # Neighbouring changes of the same sign belong to one clothoid, and changes of 0 to one part.
    changes = np.diff(curvatures)
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
    steady = [float(curvatures[first]) for first, _ in spans]
    return [
        SteadyPart(*spans[k], steady[k], steady[k - 1], steady[k + 1])
        for k in range(1, len(spans) - 1)
    ]
