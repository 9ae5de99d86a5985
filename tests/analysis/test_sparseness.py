"""The competition's edit distance and sparseness, and unlike lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.analysis.sparseness import largest_distances, unlike_lines

Steps = Sequence[tuple[float, float]]


def line(steps: Steps, heading: float = 0.0) -> FloatArray:
    """Return points of a line; each step has a turn in degrees and a length in m."""
    points = [(0.0, 0.0)]
    for turn, length in steps:
        heading += turn
        x, y = points[-1]
        way = math.radians(heading)
        points.append((x + length * math.cos(way), y + length * math.sin(way)))
    return np.array(points)


def ahead(number: int) -> list[tuple[float, float]]:
    return [(0.0, 1.0)] * number


def edit_distance(first: FloatArray, second: FloatArray) -> float:
    """Return the edit distance of two lines."""
    return float(largest_distances([first, second])[0])


def reference(first: FloatArray, second: FloatArray) -> float:
    """Return the edit distance by its definition."""

    def word(points: FloatArray) -> list[tuple[float, float]]:
        steps = np.diff(points, axis=0)
        angles = [math.degrees(math.atan2(y, x)) for x, y in steps]
        turns = [0.0] + [b - a for a, b in pairwise(angles)]
        return list(zip(turns, map(math.hypot, *steps.T), strict=True))

    def replacing(u: tuple[float, float], v: tuple[float, float]) -> float:
        angle = abs((abs(u[0] - v[0]) + 180.0) % 360.0 - 180.0)
        length = abs(u[1] - v[1])
        if angle < 0.3 and length < 0.2:
            return 0.0
        return (angle / (1.0 + angle) + length / (1.0 + length)) / 2.0

    s, t = word(first), word(second)
    costs = np.zeros((len(s) + 1, len(t) + 1))
    costs[:, 0] = range(len(s) + 1)
    costs[0, :] = range(len(t) + 1)
    for i in range(len(s)):
        for j in range(len(t)):
            costs[i + 1, j + 1] = min(
                costs[i, j + 1] + 1.0,
                costs[i + 1, j] + 1.0,
                costs[i, j] + replacing(s[i], t[j]),
            )
    return float(costs[-1, -1])


LINES = st.lists(
    st.tuples(st.floats(-30.0, 30.0), st.floats(0.5, 1.5)), min_size=1, max_size=12
).map(line)


@pytest.mark.parametrize(
    ("first", "second", "edits"),
    [
        (ahead(2), ahead(2), 0.0),
        # The second step turns by 90 degrees: replacing it costs (90/91 + 0) / 2.
        (ahead(2), [(0.0, 1.0), (90.0, 1.0)], 45.0 / 91.0),
        # The second step is 3 m instead of 1 m long: (0 + 2/3) / 2.
        (ahead(2), [(0.0, 1.0), (0.0, 3.0)], 1.0 / 3.0),
        # Both at once: (90/91 + 2/3) / 2.
        (ahead(2), [(0.0, 1.0), (90.0, 3.0)], (90.0 / 91.0 + 2.0 / 3.0) / 2.0),
        # Three steps more: three insertions.
        (ahead(2), ahead(5), 3.0),
        # Small differences cost nothing: 0.2 degrees and 0.1 m.
        (ahead(2), [(0.0, 1.0), (0.2, 1.1)], 0.0),
        # A small difference costs if the other is large: (0.2/1.2 + 0.25/1.25) / 2.
        (ahead(2), [(0.0, 1.0), (0.2, 1.25)], (0.2 / 1.2 + 0.25 / 1.25) / 2.0),
        # 170 degrees to the left and to the right differ by 20: (20/21) / 2.
        ([(0.0, 1.0), (170.0, 1.0)], [(0.0, 1.0), (-170.0, 1.0)], 10.0 / 21.0),
        # A turn one step later: replacing both costs 45/91 each, less than to delete and insert.
        ([*ahead(1), (90.0, 1.0), *ahead(1)], [*ahead(2), (90.0, 1.0)], 90.0 / 91.0),
        # Three turns one step later: to delete a step and insert one costs 2, replacing 3 * 20/21.
        (
            [*ahead(1), *[(20.0, 1.0), (-20.0, 1.0)] * 3, *ahead(1)],
            [*ahead(2), *[(20.0, 1.0), (-20.0, 1.0)] * 3],
            2.0,
        ),
    ],
)
def test_edit_distance_worked_out_by_hand(first: Steps, second: Steps, edits: float) -> None:
    assert edit_distance(line(first), line(second)) == pytest.approx(edits, abs=1e-9)
    # The first turn is 0, in whichever direction a line begins.
    assert edit_distance(line(first, 33.0), line(second, -170.0)) == pytest.approx(edits, abs=1e-9)


@settings(max_examples=80)
@given(LINES, LINES)
def test_edit_distance_follows_the_definition(first: FloatArray, second: FloatArray) -> None:
    assert edit_distance(first, second) == pytest.approx(reference(first, second), abs=1e-6)


# A straight line of two steps, a line that turns, a straight line of four steps.
A, B, C = line(ahead(2)), line([(0.0, 1.0), (90.0, 1.0)]), line(ahead(4))
AB, AC, BC = 45.0 / 91.0, 2.0, 2.0 + 45.0 / 91.0


def test_the_largest_distance_is_to_a_later_line() -> None:
    assert largest_distances([A, B, C]) == pytest.approx((max(AB, AC), BC))
    assert largest_distances([C, B, A]) == pytest.approx((max(BC, AC), AB))
    assert len(largest_distances([A])) == len(largest_distances([])) == 0


@given(st.lists(LINES, min_size=2, max_size=12))
@settings(max_examples=50)
def test_the_largest_distance_misses_no_pair(lines: list[FloatArray]) -> None:
    expected = [
        max(edit_distance(first, second) for second in lines[i + 1 :])
        for i, first in enumerate(lines[:-1])
    ]
    assert largest_distances(lines).tolist() == expected


def test_lines_are_unlike_if_more_than_a_fifth_of_the_steps_needs_edits() -> None:
    straight = ahead(10)
    turning = [*straight[:5], (90.0, 1.0), *straight[6:]]  # 45/91 of an edit
    longer, much_longer = ahead(12), ahead(13)  # 2 of 12 steps, 3 of 13
    assert unlike_lines([line(steps) for steps in (straight, straight, turning, longer)]) == 1
    assert unlike_lines([line(steps) for steps in (straight, much_longer, longer)]) == 2
    assert unlike_lines([]) == 0


@settings(max_examples=50)
@given(st.lists(LINES, max_size=8))
def test_unlike_lines_follow_the_definition(lines: list[FloatArray]) -> None:
    counted: list[FloatArray] = []
    for new in lines:
        shares = [edit_distance(new, old) / (max(len(new), len(old)) - 1) for old in counted]
        if all(share > 0.2 for share in shares):
            counted.append(new)
    assert unlike_lines(lines) == len(counted)


@pytest.mark.parametrize("points", [[(0.0, 0.0)], [], [1.0, 2.0, 3.0]])
def test_a_line_needs_two_points(points: object) -> None:
    with pytest.raises(ValueError, match="two or more points"):
        largest_distances([points, A])  # type: ignore[list-item]
