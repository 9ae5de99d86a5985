"""Spaces in which failures are compared, and that no search uses: `SPACES`.

In a space a failure is a vector, such that the distance between two vectors is the difference of
the failures: the root mean square, over places along the road or moments of the drive, of what
differs there. The place of a failure is where the car left its lane, or where another finding was
made, see `frenetic.segments.segment`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.road.geometry import frame_at, sample_line

# All sizes and scales are our choice: about what tells two failures clearly apart.
_MOMENTS: Final = np.arange(-3.0, 0.125, 0.25)  # [s] from the place
_SPEED_SCALE: Final = 3.0  # [m/s]
_ACCELERATION_SCALE: Final = 3.0  # [m/s²]
_STEERING_SCALE: Final = 0.15  # [rad]
_BEND_PLACES: Final = np.arange(-50.0, 16.25, 2.5)  # [m] from the place
_CURVATURE_SCALE: Final = 0.02  # [1/m]
_ROAD_PLACES: Final = np.arange(-200.0, -2.0, 4.0)  # [m] from the place, which itself is left out
_ROAD_SCALE: Final = 10.0  # [m]


@dataclass(frozen=True)
class Space:
    """A space in which failures are compared."""

    name: str
    """Name, a word."""
    title: str
    """Title for people, after "unlike in"."""
    definition: str
    """Definition of the difference, in a sentence."""
    vector: Callable[[Test], FloatArray | None]
    """Function that returns the vector of a failed test, read with its trajectory and the values of
    its segment; None if the drive has no records, or a value is no number."""


def _behaviour(test: Test) -> FloatArray | None:
    """Return speed, lateral acceleration and steering over the 3 s before the place, (39,)."""
    segment, finding = test.segment, test.result.finding
    if segment is None or not len(segment.signals.path):
        return None
    located = segment.signals
    path = located.path
    if finding is None:
        time = float(path.time[np.argmin(np.abs(located.distance - segment.place))])
    else:
        time = finding.time
    with np.errstate(all="ignore"):  # of an odd drive, whose values are no numbers
        signals = (
            path.speed / _SPEED_SCALE,
            path.lateral_acceleration / _ACCELERATION_SCALE,
            path.steering / _STEERING_SCALE,
        )
    moments = time + _MOMENTS  # before the drive's start the first values hold
    rows = [np.interp(moments, path.time, values) for values in signals]
    return _finite(np.concatenate(rows) / math.sqrt(len(_MOMENTS)))


def _bend(test: Test) -> FloatArray | None:
    """Return the road's curvature around the place, (27,)."""
    values = test.segment_values
    if values is None:
        return None
    curvatures = test.road.curvature_at(values.place + _BEND_PLACES)
    return _finite(curvatures / (_CURVATURE_SCALE * math.sqrt(len(_BEND_PLACES))))


def _road(test: Test) -> FloatArray | None:
    """Return the points of the driven road, seen from the place, (100,)."""
    values = test.segment_values
    if values is None:
        return None
    table, sub_step = test.road.table, test.road.sub_step
    x, y, cosine, sine, _ = frame_at(table, sub_step, values.place)
    # Before its start the road goes straight on.
    points = sample_line(table, sub_step, values.place + _ROAD_PLACES, 0.0) - (x, y)
    turned = points @ np.array([[cosine, -sine], [sine, cosine]])
    return _finite(turned.ravel() / (_ROAD_SCALE * math.sqrt(len(_ROAD_PLACES))))


def _finite(vector: FloatArray) -> FloatArray | None:
    """Return a vector of finite numbers; None for another vector."""
    return vector if np.isfinite(vector).all() else None


SPACES: Final[Mapping[str, Space]] = MappingProxyType(
    {
        space.name: space
        for space in (
            Space(
                "behaviour",
                "behaviour",
                "speed / 3 m/s, lateral acceleration / 3 m/s² and steering / 0.15 rad over the last"
                " 3 s before the place, every 0.25 s",
                _behaviour,
            ),
            Space(
                "bend",
                "bend",
                "curvature / 0.02 1/m of the road from 50 m before the place to 15 m after it,"
                " every 2.5 m, 0 beyond the road's ends",
                _bend,
            ),
            Space(
                "road",
                "driven road",
                "points / 10 m of the road over the 200 m before the place, every 4 m, laid over"
                " each other at the place; a shorter road is continued straight backwards",
                _road,
            ),
        )
    }
)
"""Name -> space, in the order in which they are shown."""
