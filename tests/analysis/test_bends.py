from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.analysis import find_bends

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


def test_two_bends_the_same_way_are_parted_by_a_straight() -> None:
    found = find_bends(PLACES, np.array([0.0, -0.05, 0.0, 0.0, -0.05, -0.05, -0.05]))
    assert [bend.side for bend in found] == ["right", "right"]
    assert found[1].end == 60.0  # cut off with the line


@pytest.mark.parametrize(("degrees", "number"), [(9.9, 0), (10.0, 1), (30.0, 1)])
def test_a_bend_turns_ten_degrees_or_more(degrees: float, number: int) -> None:
    kappa = np.full(2, math.radians(degrees) / 20.0)
    assert len(find_bends(np.array([0.0, 20.0]), kappa)) == number


def test_a_gentle_bend_is_none_however_far_it_turns() -> None:
    assert find_bends(np.array([0.0, 400.0]), np.full(2, 0.0049)) == ()


@given(st.lists(st.floats(-0.07, 0.07), min_size=2, max_size=30))
def test_a_mirrored_line_has_mirrored_bends(values: list[float]) -> None:
    places, kappa = 10.0 * np.arange(float(len(values))), np.array(values)
    here, there = find_bends(places, kappa), find_bends(places, -kappa)
    assert len(here) == len(there)
    for one, other in zip(here, there, strict=True):
        assert (one.start, one.end) == pytest.approx((other.start, other.end))
        assert one.turn == pytest.approx(-other.turn)
