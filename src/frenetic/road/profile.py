"""Profiles: slopes, widening and speed limits of a road, as functions of the distance along it.

A profile is an array (k, 2): ascending stations, which are distances along the road in m, and the
values there. It is linear between stations and constant beyond them. A profile without stations is
0 everywhere.

The speed limits, `LIMITS`, are *steps* instead: each value holds from its station to the next, and
0 means no limit. `values_of`, `plainer` and `piece_of` take a profile or steps, and choose by its
name.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError

if TYPE_CHECKING:
    import numpy.typing as npt

SHAPES: Final = ("superelevation", "grade", "widening")
"""Names of the profiles that shape a road; they are attributes of `Road`."""
LIMITS: Final = "speed_limits"
"""Name of the profile of a road's speed limits."""
NAMES: Final = (*SHAPES, LIMITS)
"""Names of all profiles of a road."""
NOTHING: Final = np.empty((0, 2))
"""The profile that is 0 everywhere."""
NOTHING.setflags(write=False)
MOST_STATIONS: Final = 10_000
"""Largest number of stations of a profile; our choice."""
_LAST_STATION: Final = 1e6  # [m] largest station in either direction; our choice
_STRAIGHT: Final = 1e-15  # value by which a station may be off a straight line; our choice


def checked(profile: npt.ArrayLike, name: str, most: float) -> FloatArray:
    """Return a profile as a read-only (k, 2) array.

    Args:
        profile: pairs of a station in m and a value, or a number for a constant profile.
        name: name of the profile, for messages.
        most: largest value in either direction.

    Raises:
        RoadError: the profile is no list of pairs, has too many stations or stations that do not
            ascend, or a value is not finite or too large.
    """
    if profile is NOTHING or (isinstance(profile, tuple) and not profile):
        return NOTHING
    try:
        pairs = np.array(profile, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RoadError(f"{name} is not a list of pairs of numbers") from None
    if pairs.shape == ():
        pairs = np.array([[0.0, float(pairs)]])
    elif pairs.shape == (0,):
        return NOTHING
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise RoadError(
            f"{name} has shape {pairs.shape}: pairs of a station in m and a value there, (k, 2),"
            " are needed"
        )
    if len(pairs) > MOST_STATIONS:
        raise RoadError(f"{name} has {len(pairs)} stations: at most {MOST_STATIONS} are allowed")
    stations, values = pairs.T
    if not (np.abs(stations) <= _LAST_STATION).all() or not (np.diff(stations) > 0.0).all():
        raise RoadError(f"the stations of {name} are not numbers of metres that ascend")
    bad = np.flatnonzero(~(np.abs(values) <= most))
    if len(bad):
        raise RoadError(
            f"{name} is {values[bad[0]]:g} at {stations[bad[0]]:g} m: a finite number of at most"
            f" {most:g} in either direction is needed"
        )
    if not values.any():
        return NOTHING
    pairs.setflags(write=False)
    return pairs


def value_at(profile: FloatArray, distances: npt.ArrayLike) -> FloatArray:
    """Return the values of a profile at ``distances`` (any shape) in m."""
    stations = np.asarray(distances, dtype=np.float64)
    if not len(profile):
        return np.zeros_like(stations)
    values: FloatArray = np.interp(stations, profile[:, 0], profile[:, 1])
    return values


def integral_at(profile: FloatArray, distances: npt.ArrayLike) -> FloatArray:
    """Return the exact integral of a profile from 0 m to each of ``distances`` (any shape) in m."""
    ends = np.asarray(distances, dtype=np.float64)
    if not len(profile):
        return np.zeros_like(ends)
    low = min(float(profile[0, 0]), 0.0, float(ends.min(initial=0.0)))
    high = max(float(profile[-1, 0]), float(ends.max(initial=0.0)))
    # Between two knots the profile is linear, so the trapezoidal rule is exact.
    knots = np.unique(np.concatenate([[low, 0.0, high], profile[:, 0]]))
    values = value_at(profile, knots)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(knots) * (values[1:] + values[:-1]))])
    k = np.clip(np.searchsorted(knots, ends, side="right") - 1, 0, len(knots) - 1)
    since_knot = 0.5 * (ends - knots[k]) * (value_at(profile, ends) + values[k])
    integrals: FloatArray = sums[k] + since_knot - sums[np.searchsorted(knots, 0.0)]
    return integrals


def cut(profile: FloatArray, start: float, end: float = math.inf) -> FloatArray:
    """Return the part of a profile from ``start`` to ``end`` m, with stations from ``start`` on."""
    if not len(profile):
        return NOTHING
    stations = profile[:, 0]
    inner = stations[(stations > start) & (stations < end)]
    ends = [start] if math.isinf(end) else [start, end]
    knots = np.unique(np.concatenate([ends, inner]))
    return thinned(np.column_stack([knots - start, value_at(profile, knots)]))


def steps_at(steps: FloatArray, distances: npt.ArrayLike) -> FloatArray:
    """Return the values of steps at ``distances`` (any shape) in m; 0 before the first station."""
    rows = np.searchsorted(steps[:, 0], np.asarray(distances, dtype=np.float64), side="right")
    values: FloatArray = np.concatenate([[0.0], steps[:, 1]])[rows]
    return values


def merged(steps: FloatArray) -> FloatArray:
    """Return steps without the stations at which the value does not change."""
    is_new: npt.NDArray[np.bool_] = np.diff(steps[:, 1], prepend=-1.0) != 0.0
    return steps[is_new]


def values_of(name: str, profile: FloatArray, distances: npt.ArrayLike) -> FloatArray:
    """Return the values of a profile, or of steps, at ``distances`` (any shape) in m.

    Args:
        name: name of the profile, from `NAMES`.
        profile: the profile, (k, 2).
        distances: distances along the road, in m.
    """
    return (steps_at if name == LIMITS else value_at)(profile, distances)


def plainer(name: str, profile: FloatArray) -> FloatArray:
    """Return a profile, or steps, without stations that make no difference.

    Args:
        name: name of the profile, from `NAMES`.
        profile: the profile, (k, 2).
    """
    return (merged if name == LIMITS else thinned)(profile)


def moved_steps(steps: FloatArray, moved: float) -> FloatArray:
    """Return steps whose stations are ``moved`` m further along; steps before 0 m are left out.

    At 0 m is the value that was there before or, if stations move back, comes there.
    """
    first = [[0.0, float(steps_at(steps, max(-moved, 0.0)))]]
    further = steps + np.array([moved, 0.0])
    return merged(np.concatenate([first, further[further[:, 0] > 0.0]]))


def piece_of(name: str, profile: FloatArray, start: float, end: float = math.inf) -> FloatArray:
    """Return the part of a profile, or of steps, from ``start`` to ``end`` m, see `cut`.

    Args:
        name: name of the profile, from `NAMES`.
        profile: the profile, (k, 2).
        start: station at which the part begins, in m.
        end: station at which the part ends, in m.
    """
    if name != LIMITS:
        return cut(profile, start, end)
    if not len(profile):
        return NOTHING
    inner = profile[(profile[:, 0] > start) & (profile[:, 0] < end)]
    first = [[0.0, float(steps_at(profile, start))]]
    return merged(np.concatenate([first, inner - [start, 0.0]]))


def thinned(profile: FloatArray) -> FloatArray:
    """Return a profile without the stations at which it does not bend."""
    if not len(profile):
        return profile
    rows = [0]  # of the stations that remain
    last = len(profile) - 1
    for i in range(1, len(profile)):
        if i == last and profile[i, 1] == profile[rows[-1], 1]:
            continue  # a profile is constant beyond its last station anyway
        if i < last:
            (s0, v0), (s1, v1), (s2, v2) = profile[rows[-1]], profile[i], profile[i + 1]
            straight = v0 + (v2 - v0) * (s1 - s0) / (s2 - s0)
            if abs(straight - v1) <= _STRAIGHT:
                continue
        rows.append(i)
    return profile[rows]


def simplified(profile: FloatArray, error: float) -> FloatArray:
    """Return a profile with fewer stations, within ``error`` of the values at all stations.

    The station farthest from a straight line between two remaining stations is added until no
    station is too far away (Ramer, Douglas and Peucker's algorithm).
    """
    rows = {0, len(profile) - 1}  # of the stations that remain
    spans = [(0, len(profile) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        piece = profile[first : last + 1]
        errors = np.abs(piece[:, 1] - np.interp(piece[:, 0], *piece[[0, -1]].T))
        if errors.max() > error:
            farthest = first + int(np.argmax(errors))
            rows.add(farthest)
            spans += [(first, farthest), (farthest, last)]
    return profile[sorted(rows)]
