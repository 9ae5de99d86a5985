"""Values of a road: poses, the bounds of what a `Road` can represent, and their checks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError

if TYPE_CHECKING:
    import numpy.typing as npt

# Bounds; all are our choice.
MAX_SAMPLES = 10_000
"""Largest number of curvature samples of a road."""
MAX_LENGTH = 50_000.0
"""Length of the longest road, in m."""
MAX_CURVATURE = 10.0
"""Largest curvature, in 1/m; valid roads of the competition stay below 0.07."""
MAX_COORDINATE = 1e7
"""Largest coordinate of a point, in m."""
MIN_DISTANCE = 1e-6
"""Least distance of two consecutive points, in m."""
MIN_STEP = 1e-7
"""Shortest step, in m: below the step of any road through points that are `MIN_DISTANCE` apart."""
MIN_LANE_WIDTH = 0.1
"""Width of the narrowest lane, in m."""
MAX_LANE_WIDTH = 100.0
"""Width of the widest lane, in m."""
MAX_HEADING = 1e6
"""Largest heading of a pose in either direction, in rad."""
MAX_SUPERELEVATION = 1.0
"""Steepest slope across a road in either direction, in m/m; a race track may have 0.6."""
MAX_GRADE = 0.5
"""Steepest slope along a road in either direction, in m/m."""
MAX_WIDENING = 100.0
"""Largest widening of a lane, in m."""
MIN_SPEED_LIMIT = 1.0
"""Lowest speed limit, in km/h."""
MAX_SPEED_LIMIT = 500.0
"""Highest speed limit, in km/h."""


class Pose(NamedTuple):
    """A position and a heading in the plane."""

    x: float
    """Coordinate in m."""
    y: float
    """Coordinate in m."""
    heading: float
    """Heading in rad, counter-clockwise from +x."""


USUAL_CHANGE = 0.05
"""Largest change of the curvature over 10 m of usual test roads, in 1/m: the paper's Section
I-B."""
START = Pose(0.0, 0.0, math.pi / 2)
"""Default pose of a road's first sample: at (0, 0), in the direction of +y."""


def checked_lane_width(value: float) -> float:
    """Return the width of a lane, in m.

    Raises:
        RoadError: the width is no number from 0.1 to 100 m.
    """
    return checked_length(value, "lane_width", MIN_LANE_WIDTH, MAX_LANE_WIDTH)


def checked_curvatures(curvatures: npt.ArrayLike) -> FloatArray:
    """Return curvatures as a read-only (N,) array.

    Raises:
        RoadError: the curvatures are no flat list of numbers, too few or too many, or a curvature
            is too large.
    """
    try:
        values = np.array(curvatures, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RoadError("curvatures are not a list of numbers") from None
    if values.ndim != 1:
        raise RoadError(f"curvatures have shape {values.shape}: a flat list (N,) is needed")
    if not 2 <= len(values) <= MAX_SAMPLES:
        raise RoadError(
            f"a road of {len(values)} curvature samples: 2 to {MAX_SAMPLES} are allowed"
        )
    is_usual = np.abs(values) <= MAX_CURVATURE
    if not is_usual.all():
        bad = int(np.argmin(is_usual))
        raise RoadError(
            f"curvature {bad} is {values[bad]:g} 1/m: every curvature must be a finite"
            f" number, at most {MAX_CURVATURE:g} in either direction"
        )
    values.setflags(write=False)
    return values


def checked_pose(pose: tuple[float, float, float]) -> Pose:
    """Return a pose of three floats.

    Raises:
        RoadError: the pose is not x, y and heading, or a number is too large.
    """
    try:
        x, y, heading = map(float, pose)
    except (TypeError, ValueError, OverflowError):
        raise RoadError(f"pose {pose!r:.40}: x, y and heading are needed") from None
    if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE and abs(heading) <= MAX_HEADING):
        raise RoadError(
            f"pose ({x:g}, {y:g}, {heading:g}): x and y of at most {MAX_COORDINATE:g} m and a"
            f" heading of at most {MAX_HEADING:g} rad in either direction are needed"
        )
    return Pose(x, y, heading)


def checked_length(value: float, name: str, least: float, most: float) -> float:
    """Return a length in m as a float.

    Args:
        value: the length.
        name: name of the length, for the message.
        least: least length that is allowed.
        most: largest length that is allowed.

    Raises:
        RoadError: the value is no number from ``least`` to ``most``.
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number, text = math.nan, f"{value!r:.40}"
    else:
        text = f"{number:g}"
    if not least <= number <= most:
        raise RoadError(f"{name} is {text}: {least:g} to {most:g} m are allowed")
    return number
