"""Bends of a road, and places described by them."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.segments.bends import (
    AFTER_BEND,
    BEFORE_BEND,
    bends_of,
    find_bends,
    place_text,
)

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


def test_a_radius_above_200_m_makes_no_bend_however_far_it_turns() -> None:
    assert find_bends(np.array([0.0, 400.0]), np.full(2, 0.0049)) == ()


# Places in words


def test_a_place_between_two_bends_is_behind_the_first() -> None:
    # A left-hand bend of 15 m radius ends at 29.3 m; a right-hand bend of 33 m starts at 41.7 m.
    curvatures = np.array([0.0, 0.0, 1 / 15, 0.0, 0.0, -0.03, -0.03, 0.0])
    expected = {
        20.0: "in a left-hand bend of 15 m radius",
        29.0: "at the end of a left-hand bend of 15 m radius",
        39.0: "10 m past a left-hand bend of 15 m radius",
        41.0: "12 m past a left-hand bend of 15 m radius",
        43.0: "entering a right-hand bend of 33 m radius after a left-hand bend",
    }
    assert {place: place_text(curvatures, 10.0, place) for place in expected} == expected


@settings(deadline=None)
@given(
    st.lists(st.floats(-0.07, 0.07), min_size=2, max_size=30),
    st.sampled_from([2.0, 10.0, 25.0]),
    st.floats(0.0, 1.0),
)
def test_a_place_is_described_by_its_bend_or_by_the_last_or_next_bend(
    curvatures: list[float], step: float, share: float
) -> None:
    line, place = np.array(curvatures), share * step * (len(curvatures) - 1)
    text, bends = place_text(line, step, place), bends_of(line, step)
    if around := [bend for bend in bends if bend.start <= place <= bend.end]:
        bend, pattern = around[0], "(entering|in|at the end of) a"
    elif behind := [bend for bend in bends if 0.0 < place - bend.end <= AFTER_BEND]:
        bend, pattern = behind[-1], r"(just|\d+ m) past a"
    elif ahead := [bend for bend in bends if 0.0 < bend.start - place <= BEFORE_BEND]:
        bend, pattern = ahead[0], r"(just|\d+ m) before a"
    else:
        assert text == "on a straight"
        return
    radius = f"{1.0 / bend.sharpest:.0f}"
    assert re.match(rf"{pattern} {bend.side}-hand bend of {radius} m radius", text), text


def test_a_long_bend_is_described_by_its_least_radius() -> None:
    curvatures = np.array([0.0, 0.05, *[0.01] * 20, 0.0])
    text = "in a left-hand bend of 20 m radius"
    assert [place_text(curvatures, 10.0, place) for place in (60.0, 140.0)] == [
        text,
        "at the end of a left-hand bend of 20 m radius",
    ]


def test_the_wide_bends_of_a_motorway_are_no_straights() -> None:
    curvatures = np.array([*[0.0] * 10, *[-0.001] * 20, *[0.0] * 10])
    places = {50.0: "on a straight", 190.0: "in a right-hand bend of 1000 m radius"}
    assert {place: place_text(curvatures, 10.0, place) for place in places} == places
    assert place_text(np.full(40, 5e-5), 10.0, 200.0) == "on a straight"
