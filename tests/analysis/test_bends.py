from __future__ import annotations

import math

import numpy as np
import pytest

from frenetic.analysis.segments import find_bends

PLACES = np.arange(0.0, 70.0, 10.0)


def test_a_bend_is_where_the_radius_is_below_200_m() -> None:
    # The curvature rises from 0 at 10 m to 0.05 at 20 m and falls to 0 at 30 m, so it is 0.005 at
    # 11 m and at 29 m. The triangle's area is 20 * 0.05 / 2 = 0.5; its two tips, 1 * 0.005 / 2
    # each, do not belong to the bend.
    (bend,) = find_bends(PLACES, np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0]))
    assert bend.start == pytest.approx(11.0)
    assert bend.end == pytest.approx(29.0)
    assert bend.turn == pytest.approx(0.5 - 2 * 0.0025)
    assert bend.sharpest == 0.05
    assert bend.side == "left"


def test_an_s_has_two_bends() -> None:
    # From 0.05 at 20 m to -0.05 at 30 m: 0.005 at 24.5 m, -0.005 at 25.5 m.
    first, second = find_bends(PLACES, np.array([0.0, 0.0, 0.05, -0.05, 0.0, 0.0, 0.0]))
    assert (first.side, second.side) == ("left", "right")
    assert first.end == pytest.approx(24.5)
    assert second.start == pytest.approx(25.5)
    assert first.turn == pytest.approx(-second.turn)


@pytest.mark.parametrize(("degrees", "number"), [(9.9, 0), (10.0, 1), (30.0, 1)])
def test_a_bend_turns_ten_degrees_or_more(degrees: float, number: int) -> None:
    kappa = np.full(2, math.radians(degrees) / 20.0)
    assert len(find_bends(np.array([0.0, 20.0]), kappa)) == number


def test_a_gentle_bend_is_none_however_far_it_turns() -> None:
    assert find_bends(np.array([0.0, 400.0]), np.full(2, 0.0049)) == ()
