"""The line of lanes in an OpenDRIVE file, and the road that follows it.

A file's geometries have any lengths, and its curvature may jump between them; a road has one step
and a curvature that is linear in between. A file with such a curvature gives exactly that road. Any
other line is traced every few centimetres and followed by a road with a sample every half metre or
denser, which is refused if it is more than `TOLERANCE` away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.geometry import HEADING, build_table, sub_steps
from frenetic.road.opendrive.writing import hardly_differ
from frenetic.road.recovery import CORRECTION, follow_line
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_LENGTH,
    MAX_SAMPLES,
    Pose,
    Road,
)

TOLERANCE: Final = 0.01
"""Largest distance of a road from the line in its file, and largest gap in that line, in m."""
KINK: Final = 0.01
"""Largest change of heading from the end of one geometry to the start of the next, in rad."""
STEPS: Final = (0.5, 0.25, 0.1)
"""Steps of a road that follows a line, in m; the first within `TOLERANCE` is taken."""

_SPACING: Final = 0.1  # m between the points of a trace
_EQUAL_CURVATURE: Final = 1e-9  # 1/m
_SAME_PLACE: Final = 1e-5  # m and rad
_PARTS: Final = 10  # of the shortest geometry, tried as a file's step

Cubic: TypeAlias = tuple[float, float, float, float]
"""Coefficients a, b, c, d of a + b p + c p^2 + d p^3."""

# Columns of a trace, one row per point.
DISTANCE, X, Y, DIRECTION = range(4)


@dataclass(frozen=True)
class Clothoid:
    """A ``line``, ``arc`` or ``spiral``: a geometry of linear curvature."""

    pose: Pose
    length: float
    """m."""
    start: float
    """Curvature, in 1/m."""
    end: float
    """1/m."""

    def trace(self) -> FloatArray:
        """(n, 4) points: m along, x, y, heading."""
        curvatures = np.array([self.start, self.end])
        parts = max(sub_steps(curvatures, self.length), math.ceil(self.length / _SPACING))
        table = build_table(curvatures, self.length, *self.pose, parts)
        distance = np.linspace(0.0, self.length, parts + 1)
        return np.column_stack([distance, table[:, : HEADING + 1]])


@dataclass(frozen=True)
class Polynomial:
    """A ``poly3`` or ``paramPoly3``: a geometry whose places are cubic polynomials."""

    pose: Pose
    length: float
    """m."""
    ahead: Cubic
    """Distance along the heading at its start, in m, by the parameter."""
    left: Cubic
    """Distance across it, in m."""
    last: float | None
    """The parameter at its end; None where that is where its length is reached."""

    def trace(self) -> FloatArray:
        """(n, 4) points: m along, x, y, heading.

        Raises:
            RoadError: the polynomials are not as long as the file says, or have a cusp.
        """
        parts = max(8, math.ceil(self.length / _SPACING))
        last = self.length if self.last is None else self.last
        with np.errstate(all="ignore"):
            distance = self._distances(np.linspace(0.0, last, parts + 1))
            if self.last is None:
                last = float(np.interp(self.length, distance, np.linspace(0.0, last, parts + 1)))
                distance = self._distances(np.linspace(0.0, last, parts + 1))
            p = np.linspace(0.0, last, parts + 1)
            u, v, du, dv = self._at(p)
            speed = np.hypot(du, dv)
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

    def _distances(self, p: FloatArray) -> FloatArray:
        """Distances at the parameters ``p`` (n,), (n,) in m, by Simpson's rule between them."""
        (_, _, du, dv), (_, _, mu, mv) = self._at(p), self._at(0.5 * (p[1:] + p[:-1]))
        speed, middle = np.hypot(du, dv), np.hypot(mu, mv)
        pieces = (speed[1:] + 4.0 * middle + speed[:-1]) * np.diff(p) / 6.0
        return np.concatenate([[0.0], np.cumsum(pieces)])

    def _at(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """u, v and their derivatives at the parameters ``p`` (n,)."""
        u, v = np.polynomial.Polynomial(self.ahead), np.polynomial.Polynomial(self.left)
        return u(p), v(p), u.deriv()(p), v.deriv()(p)


Geometry: TypeAlias = Clothoid | Polynomial


@dataclass(frozen=True)
class Offset:
    """A ``laneOffset``: how far left of the reference line the lanes' centre line lies."""

    distance: float
    """Distance along the road at which it begins to hold, in m."""
    shift: Cubic
    """Shift in m, by the distance from there."""


def exact_road(
    geometries: Sequence[Geometry], step: float | None, lane_width: float
) -> Road | None:
    """The road with exactly these geometries, or None if there is none.

    They have to be clothoids without gaps and with continuous curvature whose lengths are multiples
    of one step.

    Args:
        geometries: from the road's start to its end.
        step: m, None to find it.
        lane_width: m.
    """
    clothoids = [piece for piece in geometries if isinstance(piece, Clothoid)]
    if len(clothoids) < len(geometries):
        return None
    jumps = (abs(a.end - b.start) for a, b in pairwise(clothoids))
    if any(jump > _EQUAL_CURVATURE for jump in jumps):
        return None
    shortest, total = (f(piece.length for piece in clothoids) for f in (min, sum))
    candidates = [shortest / parts for parts in range(1, _PARTS + 1)]
    for candidate in candidates if step is None else [step, *candidates]:
        if candidate * (MAX_SAMPLES - 1) < total:
            continue
        counts = [round(piece.length / candidate) for piece in clothoids]
        fits = all(
            count > 0 and abs(piece.length - count * candidate) <= 1e-9 * piece.length
            for piece, count in zip(clothoids, counts, strict=True)
        )
        if fits:
            break
    else:
        return None
    curvatures = np.empty(sum(counts) + 1)
    ends = np.cumsum([0, *counts])
    # A line or an arc may stand for nearly equal curvatures; a spiral is exact, so it decides on
    # the samples that they share.
    for piece, (first, last) in sorted(
        zip(clothoids, pairwise(ends), strict=True), key=lambda item: item[0].start != item[0].end
    ):
        curvatures[first : last + 1] = np.linspace(piece.start, piece.end, last - first + 1)
    road = Road(curvatures, candidate, clothoids[0].pose, lane_width=lane_width)
    starts = np.array([piece.pose for piece in clothoids])
    away = np.hypot(*(road.points[ends[:-1]] - starts[:, :2]).T)
    turn = np.remainder(road.headings[ends[:-1]] - starts[:, 2] + math.pi, math.tau) - math.pi
    meets = away.max() <= TOLERANCE and np.abs(turn).max() <= KINK
    return road if meets else None


def are_of_road(geometries: Sequence[Geometry], road: Road) -> bool:
    """Whether geometries are those that `to_opendrive` writes for a road: clothoids along it."""
    distance = 0.0
    for piece in geometries:
        if not isinstance(piece, Clothoid):
            return False
        pose = road.pose_at(distance)
        gap = math.hypot(piece.pose.x - pose.x, piece.pose.y - pose.y)
        turn = math.remainder(piece.pose.heading - pose.heading, math.tau)
        last = min(distance + piece.length, road.length)
        start, end = road.curvature_at([distance, last])
        same = all(
            here == there or hardly_differ(here, there)
            for here, there in ((piece.start, float(start)), (piece.end, float(end)))
        )
        if not (same and gap <= _SAME_PLACE and abs(turn) <= _SAME_PLACE):
            return False
        distance += piece.length
    return abs(distance - road.length) <= _SAME_PLACE


def trace(geometries: Sequence[Geometry], offsets: Sequence[Offset]) -> FloatArray:
    """(n, 4) points of the lanes' centre line: m along, x, y, heading.

    Raises:
        RoadError: there is a gap or a kink between two geometries, or a polynomial one is not what
            it says.
    """
    traced: list[FloatArray] = []
    distance = 0.0
    for geometry in geometries:
        part = geometry.trace()
        if not (np.isfinite(part).all() and np.abs(part).max() <= MAX_COORDINATE + MAX_LENGTH):
            raise RoadError("a geometry leaves every map: its numbers are too large")
        part[:, DISTANCE] += distance
        if traced:
            _join(traced[-1][-1], part)
            part = part[1:]
        traced.append(part)
        distance = float(part[-1, DISTANCE])
    line = np.concatenate(traced)
    return _shifted(line, offsets) if offsets else line


def joined(lines: Sequence[FloatArray]) -> FloatArray:
    """One line (n, 4) of several that follow each other.

    Raises:
        RoadError: there is a gap or a kink between two.
    """
    parts: list[FloatArray] = []
    for line in lines:
        part = line.copy()
        if parts:
            part[:, DISTANCE] += parts[-1][-1, DISTANCE]
            _join(parts[-1][-1], part)
            part = part[1:]
        parts.append(part)
    return np.concatenate(parts)


def backwards(line: FloatArray) -> FloatArray:
    """A line (n, 4) from its end to its start."""
    turned = line[::-1].copy()
    turned[:, DISTANCE] = line[-1, DISTANCE] - turned[:, DISTANCE]
    turned[:, DIRECTION] += math.pi
    return turned


def stacked(layers: Sequence[Sequence[Offset]]) -> list[Offset]:
    """The offsets that are the sums of several layers of them."""
    ordered = [sorted(layer, key=lambda offset: offset.distance) for layer in layers]
    places = sorted({offset.distance for layer in ordered for offset in layer})
    total = []
    for place in places:
        shift = np.zeros(4)
        for layer in ordered:
            held = [offset for offset in layer if offset.distance <= place]
            if held:
                a, b, c, d = held[-1].shift
                p = place - held[-1].distance
                shift += (
                    a + p * (b + p * (c + p * d)),
                    b + p * (2.0 * c + p * 3.0 * d),
                    c + p * 3.0 * d,
                    d,
                )
        total.append(Offset(place, (float(shift[0]), *map(float, shift[1:]))))  # type: ignore[arg-type]
    return total


def _join(end: FloatArray, part: FloatArray) -> None:
    """Continues a part's heading where the one before ended, if they meet."""
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
    part[:, DIRECTION] += kink - turn


def _shifted(line: FloatArray, offsets: Sequence[Offset]) -> FloatArray:
    """A line moved to its left by the offsets, its distances measured anew."""
    distance, heading = line[:, DISTANCE], line[:, DIRECTION]
    ordered = sorted(offsets, key=lambda offset: offset.distance)
    starts = np.array([-math.inf, *(offset.distance for offset in ordered)])
    shifts = np.array([(0.0, 0.0, 0.0, 0.0), *(offset.shift for offset in ordered)])
    rows = np.searchsorted(starts, distance, side="right") - 1
    p = np.where(rows > 0, distance - np.maximum(starts[rows], 0.0), 0.0)
    a, b, c, d = shifts[rows].T
    shift = a + p * (b + p * (c + p * d))
    slope = b + p * (2.0 * c + p * 3.0 * d)
    moved = line.copy()
    moved[:, X] -= shift * np.sin(heading)
    moved[:, Y] += shift * np.cos(heading)
    ahead = 1.0 - shift * np.gradient(heading, distance)
    if ahead.min() <= 0.0:
        raise RoadError("the lanes are shifted beyond the centre of a bend, where no road can be")
    moved[:, DIRECTION] += np.arctan2(slope, ahead)
    chords = np.hypot(np.diff(moved[:, X]), np.diff(moved[:, Y]))
    moved[1:, DISTANCE] = np.cumsum(chords)
    return moved


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
