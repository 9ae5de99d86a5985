"""The line of lanes in an OpenDRIVE file, and the road that follows it.

A file's geometries have any lengths, and its curvature may jump between them; a road has one step
and a curvature that is linear in between. So the line is traced every few centimetres and followed
by a road with a sample every half metre or denser, which is refused if it is more than `TOLERANCE`
away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.geometry import HEADING, build_table, sub_steps
from frenetic.road.opendrive.writing import Clothoid
from frenetic.road.recovery import CORRECTION, follow_line
from frenetic.road.road import MAX_CURVATURE, MAX_SAMPLES, Pose, Road

TOLERANCE: Final = 0.01
"""Largest distance of a road from the line in its file, and largest gap in that line, in m."""
KINK: Final = 0.01
"""Largest change of heading from the end of one geometry to the start of the next, in rad."""
STEPS: Final = (0.5, 0.25, 0.1)
"""Steps of a road that follows a line, in m; the first within `TOLERANCE` is taken."""
SPACING: Final = 0.1
"""Distance between the points of a traced line, in m."""

Cubic: TypeAlias = tuple[float, float, float, float]
"""Coefficients a, b, c, d of a + b p + c p^2 + d p^3."""

# Columns of a trace, one row per point.
DISTANCE, X, Y, DIRECTION = range(4)


@dataclass(frozen=True)
class Polynomial:
    """A ``paramPoly3``: a geometry whose places are cubic polynomials."""

    pose: Pose
    length: float
    """m."""
    ahead: Cubic
    """Distance along the heading at its start, in m, by the parameter."""
    left: Cubic
    """Distance across it, in m."""
    last: float
    """The parameter at its end."""

    def trace(self) -> FloatArray:
        """(n, 4) points: m along, x, y, heading.

        Raises:
            RoadError: the polynomials are not as long as the file says, or have a cusp.
        """
        parts = max(8, math.ceil(self.length / SPACING))
        p = np.linspace(0.0, self.last, parts + 1)
        (u, v, du, dv), (_, _, mu, mv) = self._at(p), self._at(0.5 * (p[1:] + p[:-1]))
        speed, middle = np.hypot(du, dv), np.hypot(mu, mv)
        # Simpson's rule between the parameters.
        pieces = (speed[1:] + 4.0 * middle + speed[:-1]) * np.diff(p) / 6.0
        distance = np.concatenate([[0.0], np.cumsum(pieces)])
        if not abs(float(distance[-1]) - self.length) <= 0.1 + 0.01 * self.length:
            raise RoadError(
                f"a polynomial geometry is {distance[-1]:.4g} m long, not {self.length:g} m as"
                " its 'length' says"
            )
        if speed.min() < 1e-3 * speed.max():
            raise RoadError("a polynomial geometry has a cusp, which no road can follow")
        x, y, heading = self.pose
        c, s = math.cos(heading), math.sin(heading)
        direction = heading + np.unwrap(np.arctan2(dv, du))
        return np.column_stack([distance, x + u * c - v * s, y + u * s + v * c, direction])

    def _at(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """u, v and their derivatives at the parameters ``p`` (n,)."""
        u, v = np.polynomial.Polynomial(self.ahead), np.polynomial.Polynomial(self.left)
        return u(p), v(p), u.deriv()(p), v.deriv()(p)


Geometry: TypeAlias = Clothoid | Polynomial


def trace(geometries: Sequence[Geometry]) -> FloatArray:
    """(n, 4) points of the reference line: m along, x, y, heading.

    Raises:
        RoadError: there is a gap or a kink between two geometries, or a polynomial one is not what
            it says.
    """
    traced: list[FloatArray] = []
    for geometry in geometries:
        if isinstance(geometry, Polynomial):
            part = geometry.trace()
        else:
            x, y, heading, length, start, end = geometry
            curvatures = np.array([start, end])
            parts = max(sub_steps(curvatures, length), math.ceil(length / SPACING))
            table = build_table(curvatures, length, x, y, heading, parts)
            distance = np.linspace(0.0, length, parts + 1)
            part = np.column_stack([distance, table[:, : HEADING + 1]])
        if traced:
            join(traced[-1][-1], part)
            part = part[1:]
        traced.append(part)
    return np.concatenate(traced)


def join(end: FloatArray, part: FloatArray) -> None:
    """Continues a part's distances and headings where the one before ended, if they meet."""
    place = f"{end[DISTANCE]:.2f} m along the road"
    gap = math.hypot(part[0, X] - end[X], part[0, Y] - end[Y])
    if gap > TOLERANCE:
        raise RoadError(
            f"the reference line jumps by {gap:.3f} m {place}: at most {TOLERANCE:g} m is mended"
        )
    turn = part[0, DIRECTION] - end[DIRECTION]
    kink = math.remainder(turn, math.tau)
    if abs(kink) > KINK:
        raise RoadError(
            f"the reference line has a kink of {math.degrees(kink):.1f} degrees {place}: a road"
            " has none"
        )
    part[:, DISTANCE] += end[DISTANCE]
    part[:, DIRECTION] += kink - turn


def shifted(line: FloatArray, shift: FloatArray, slope: FloatArray) -> FloatArray:
    """A line (n, 4) moved to its left by a shift (n,) in m, its distances measured anew.

    Raises:
        RoadError: it is moved beyond the centre of a bend.
    """
    heading = line[:, DIRECTION]
    ahead = 1.0 - shift * np.gradient(heading, line[:, DISTANCE])
    if ahead.min() <= 0.0:
        raise RoadError("the lanes are shifted beyond the centre of a bend, where no road can be")
    moved = line.copy()
    moved[:, X] -= shift * np.sin(heading)
    moved[:, Y] += shift * np.cos(heading)
    moved[:, DIRECTION] += np.arctan2(slope, ahead)
    moved[1:, DISTANCE] = np.cumsum(np.hypot(np.diff(moved[:, X]), np.diff(moved[:, Y])))
    return moved


def backwards(line: FloatArray) -> FloatArray:
    """A line (n, 4) from its end to its start."""
    turned = line[::-1].copy()
    turned[:, DISTANCE] = line[-1, DISTANCE] - turned[:, DISTANCE]
    turned[:, DIRECTION] += math.pi
    return turned


def follow(line: FloatArray, lane_width: float) -> Road:
    """The road along a traced line (n, 4).

    Raises:
        RoadError: no road stays within `TOLERANCE` of it.
    """
    length = float(line[-1, DISTANCE])
    start = Pose(*(float(v) for v in line[0, X:]))
    away = math.inf
    for spacing in STEPS:
        samples = min(max(2, math.ceil(length / spacing - 1e-9)), MAX_SAMPLES - 1) + 1
        step = length / (samples - 1)
        at = np.arange(samples) * step
        x, y, heading = (np.interp(at, line[:, DISTANCE], line[:, k]) for k in (X, Y, DIRECTION))
        # The mean curvature around each sample: where the curvature jumps, its value at the sample
        # says little.
        low, high = np.maximum(at - 0.5 * step, 0.0), np.minimum(at + 0.5 * step, length)
        turned = np.interp(high, line[:, DISTANCE], line[:, DIRECTION])
        turned -= np.interp(low, line[:, DISTANCE], line[:, DIRECTION])
        curvatures = follow_line(
            np.column_stack([x, y, heading, turned / (high - low)]),
            step,
            max(CORRECTION, 4.0 * step),
        )
        if np.abs(curvatures).max() > MAX_CURVATURE:
            continue
        road = Road(curvatures, step, start, lane_width=lane_width)
        away = float(np.hypot(road.points[:, 0] - x, road.points[:, 1] - y).max())
        if away <= TOLERANCE:
            return road
    raise RoadError(
        f"no road can follow its line: the nearest is {away:.3g} m away somewhere, and at most"
        f" {TOLERANCE:g} m are allowed"
    )
