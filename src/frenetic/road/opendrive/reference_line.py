"""Reference line of a road: its geometries, traced and joined.

Coordinates and headings in files are rounded, so geometries do not quite meet. Headings are
corrected by what their rounding allows, and small gaps are closed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import geometry
from frenetic.road.opendrive.traced_line import (
    DISTANCE,
    GAP,
    HEADING,
    ROUNDING,
    TOLERANCE,
    X,
    close_gaps,
)
from frenetic.road.opendrive.xml_elements import coefficients_of, number_of
from frenetic.road.road_values import MAX_CURVATURE, MAX_HEADING, MAX_LENGTH, MIN_DISTANCE

STEP_ASIDE: Final = 2.0 * TOLERANCE
"""Largest gap sideways between two geometries, in m: the middle of the gap is `TOLERANCE` from both
ends."""
KINK: Final = 0.01
"""Largest change of heading from the end of a geometry to the start of the next, in rad; our
choice."""
ROUNDED: Final = range(2, 5)
"""Numbers of decimals for which headings count as rounded; our choice. Headings with fewer decimals
are exact, and with more decimals the error does not matter."""
SPACING: Final = 0.1
"""Largest distance between the points of a traced line, in m; our choice."""


def reference_line(road: Element) -> FloatArray:
    """Return a road's reference line: the first six columns of a traced line, (n, 6).

    Raises:
        RoadError: two geometries have too large a gap or kink between them, or a geometry cannot
            be read.
    """
    parts, headings = [], []
    total = 0.0
    for element in road.findall("planView/geometry"):
        length = number_of(element, "length", most=math.inf)
        if length < 0.0:
            raise RoadError(f"a <geometry> has length {length:g}: a positive number is needed")
        total += length
        if total > MAX_LENGTH:
            raise RoadError(f"it is longer than the {MAX_LENGTH:.0f} m that can be read")
        if length > MIN_DISTANCE:
            parts.append(_traced(element, length))
            headings.append(element.get("hdg", "").strip())
    if not parts:
        raise RoadError("it has no geometry")
    heading_error = _heading_error(headings)
    if heading_error:
        parts = _turned_to_meet(parts, heading_error)
    line, rows, gaps = _concatenated(parts, KINK + 2.0 * heading_error)
    return np.column_stack([line, close_gaps(line, rows, gaps)])


def _heading_error(headings: Sequence[str]) -> float:
    """Return the largest rounding error of headings, in rad; 0 if they do not count as rounded.

    Args:
        headings: texts of the headings, in rad.
    """
    decimals = max(len(heading.partition(".")[2]) for heading in headings)
    return 0.5 * 0.1**decimals if decimals in ROUNDED else 0.0


def _turned_to_meet(parts: Sequence[FloatArray], most: float) -> list[FloatArray]:
    """Return lines turned about their starts, so that each ends in the direction of the next start.

    The last line is turned to the heading at which the line before ends.

    Args:
        parts: the lines, (n, 4) each.
        most: largest turn of a line, in rad.
    """
    turned: list[FloatArray] = []
    for i, part in enumerate(parts):
        if i + 1 < len(parts):
            (x, y), (next_x, next_y) = (
                end - part[0, X:HEADING]
                for end in (part[-1, X:HEADING], parts[i + 1][0, X:HEADING])
            )
            angle = math.atan2(x * next_y - y * next_x, x * next_x + y * next_y)
        else:
            last_heading = turned[-1][-1, HEADING] if turned else part[0, HEADING]
            angle = math.remainder(last_heading - part[0, HEADING], math.tau)
        angle = min(max(angle, -most), most)
        c, s = math.cos(angle), math.sin(angle)
        x, y = (part[:, X:HEADING] - part[0, X:HEADING]).T
        points = part[0, X:HEADING] + np.column_stack([c * x - s * y, s * x + c * y])
        turned.append(np.column_stack([part[:, DISTANCE], points, part[:, HEADING] + angle]))
    return turned


def _traced(element: Element, length: float) -> FloatArray:
    """Return the line (n, 4) of a ``geometry`` element.

    Args:
        element: the element.
        length: its length, in m.

    Raises:
        RoadError: the geometry is no line, arc, spiral or paramPoly3, or a number is missing.
    """
    x, y = number_of(element, "x"), number_of(element, "y")
    heading = number_of(element, "hdg", most=MAX_HEADING)
    shape = next(iter(element), element)
    if shape.tag == "paramPoly3":
        return _polynomial(shape, length, x, y, heading)
    end_names = {
        "line": (),
        "arc": ("curvature", "curvature"),
        "spiral": ("curvStart", "curvEnd"),
    }.get(shape.tag)
    if end_names is None:
        raise RoadError(
            f"a <geometry> holds {'nothing' if shape is element else shape.tag[:40]}: line, arc,"
            " spiral and paramPoly3 are read"
        )
    ends = [number_of(shape, name, most=MAX_CURVATURE) for name in end_names]
    curvatures = np.array(ends or [0.0, 0.0])
    pieces = max(geometry.sub_steps(curvatures, length), math.ceil(length / SPACING))
    table = geometry.build_table(curvatures, length, x, y, heading, pieces)
    return np.column_stack([np.linspace(0.0, length, pieces + 1), table[:, :3]])


def _polynomial(shape: Element, length: float, x: float, y: float, heading: float) -> FloatArray:
    """Return the line (n, 4) of a ``paramPoly3``: cubic polynomials of a parameter.

    Args:
        shape: the element.
        length: length of the geometry, in m.
        x, y, heading: pose of its start, in m, m and rad.

    Raises:
        RoadError: the polynomial has another length than ``length``, or a cusp.
    """
    last = length if shape.get("pRange") == "arcLength" else 1.0
    # In the frame of the start, u points ahead and v to the left.
    u, v = (np.polynomial.Polynomial(coefficients_of(shape, axis)) for axis in "UV")
    p = np.linspace(0.0, last, max(8, math.ceil(length / SPACING)) + 1)
    middle = 0.5 * (p[1:] + p[:-1])
    # Length of line per parameter, and the distances by Simpson's rule between two parameters.
    rate, middle_rate = (np.hypot(u.deriv()(at), v.deriv()(at)) for at in (p, middle))
    pieces = (rate[1:] + 4.0 * middle_rate + rate[:-1]) * np.diff(p) / 6.0
    distance = np.concatenate([[0.0], np.cumsum(pieces)])
    if not abs(float(distance[-1]) - length) <= 0.1 + 0.01 * length:
        raise RoadError(
            f"a polynomial geometry is {distance[-1]:.4g} m long, not {length:g} m as its 'length'"
            " says"
        )
    if rate.min() < 1e-3 * rate.max():
        raise RoadError("a polynomial geometry has a cusp, which no road can follow")
    c, s = math.cos(heading), math.sin(heading)
    direction = heading + np.unwrap(np.arctan2(v.deriv()(p), u.deriv()(p)))
    return np.column_stack([distance, x + u(p) * c - v(p) * s, y + u(p) * s + v(p) * c, direction])


def _concatenated(
    parts: Sequence[FloatArray], kink: float
) -> tuple[FloatArray, list[int], list[tuple[float, float]]]:
    """Return lines joined into one line, whose distances and headings continue.

    Args:
        parts: the lines, (n, 4) each.
        kink: largest change of heading from a line to the next, in rad.

    Returns:
        The joined line (n, 4), the row after each gap, and each gap (x, y) in m.

    Raises:
        RoadError: a line begins too far from the end of the line before, or in another direction.
    """
    parts = [parts[0], *(part.copy() for part in parts[1:])]
    row = len(parts[0])
    rows, gaps = [], []
    for before, part in pairwise(parts):
        end, place = before[-1], f"{before[-1, DISTANCE]:.2f} m along the road"
        dx, dy = (part[0, X:HEADING] - end[X:HEADING]).tolist()
        turn = math.remainder(part[0, HEADING] - end[HEADING], math.tau)
        c, s = math.cos(end[HEADING] + 0.5 * turn), math.sin(end[HEADING] + 0.5 * turn)
        along, aside = dx * c + dy * s, dy * c - dx * s
        if abs(along) > GAP + ROUNDING:
            raise RoadError(
                f"the reference line jumps by {abs(along):.3f} m {place}: at most {GAP:g} m along"
                " it is mended"
            )
        if abs(aside) > STEP_ASIDE + ROUNDING:
            raise RoadError(
                f"the reference line jumps sideways by {abs(aside):.3f} m {place}: at most"
                f" {STEP_ASIDE:g} m is mended"
            )
        if abs(turn) > kink + ROUNDING:
            raise RoadError(
                f"the reference line has a kink of {math.degrees(turn):.1f} degrees {place}: a"
                " road has none"
            )
        if math.hypot(dx, dy) > MIN_DISTANCE:
            rows.append(row)
            gaps.append((dx, dy))
        row += len(part) - 1
        part[:, DISTANCE] += end[DISTANCE]
        part[:, HEADING] += turn - (part[0, HEADING] - end[HEADING])
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])]), rows, gaps
