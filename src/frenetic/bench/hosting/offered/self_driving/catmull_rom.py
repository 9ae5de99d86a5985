"""A smooth line through points, as generators made for BeamNG.tech use it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frenetic.errors import RoadError

Place = tuple[float, float]
Node = tuple[float, float, float, float]


def catmull_rom(points: Sequence[Sequence[float]], num_spline_points: int = 20) -> list[Node]:
    """Return the line from the second node to the second last, as nodes.

    Args:
        points: nodes x, y, height and width in m, four or more; of height and width the first
            node's are taken.
        num_spline_points: of each piece of the line, both ends included.

    Raises:
        RoadError: There are fewer than four nodes, or two consecutive ones are at the same place.

    """
    line = catmull_rom_2d(points, num_spline_points)
    height, width = float(points[0][2]), float(points[0][3])
    return [(x, y, height, width) for x, y in line]


def catmull_rom_2d(points: Sequence[Sequence[float]], num_points: int = 20) -> list[Place]:
    """Return the line from the second point to the second last.

    It is the centripetal Catmull-Rom spline: the parameter grows by the square root of the distance
    between two points.

    Args:
        points: of each x and y in m are used; four or more.
        num_points: of each piece of the line, both ends included.

    Raises:
        RoadError: There are fewer than four points, or two consecutive ones are the same.

    """
    if len(points) < 4:
        raise RoadError(f"a line needs at least 4 points, but there are {len(points)}")
    places = np.array([(point[0], point[1]) for point in points], dtype=np.float64)
    moves = np.diff(places, axis=0)
    gaps = np.sqrt(np.hypot(moves[:, 0], moves[:, 1]))[:, None]
    if not (gaps > 0.0).all():
        raise RoadError("two consecutive points are the same; a line moves on at every point")
    # At an inner point: the derivative of the parabola through it and its two neighbours.
    secants = moves / gaps
    slopes = (secants[:-1] * gaps[1:] + secants[1:] * gaps[:-1]) / (gaps[:-1] + gaps[1:])
    share = np.linspace(0.0, 1.0, num_points)[:, None]
    line = []
    for i in range(len(places) - 3):
        start, end, gap, move = places[i + 1], places[i + 2], gaps[i + 1], moves[i + 1]
        leaving, arriving = gap * slopes[i] - move, gap * slopes[i + 1] - move
        bend = share * (1.0 - share) * ((1.0 - share) * leaving - share * arriving)
        piece = start + share * move + bend
        piece[-1:] = end
        line += piece[1 if i else 0 :].tolist()
    return [(x, y) for x, y in line]
