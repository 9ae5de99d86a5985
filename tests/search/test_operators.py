"""F1, compared with roads reversed as points: by scipy's quadrature, circles and clothoids.

Also: each operator has a description.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import fixed_quad
from scipy.special import fresnel

from frenetic._support.arrays import FloatArray
from frenetic.search.operator_names import (
    CONDITIONS,
    EARLIER,
    GIVEN,
    OPERATOR_DESCRIPTIONS,
    REST,
    SWEEP,
)
from frenetic.search.operators import (
    FAIL_OPERATORS,
    PASS_OPERATORS,
    flip,
    random_curvatures,
    reverse_road,
    reverse_values,
    swap_halves,
)
from frenetic.search.road_families import FAMILIES
from frenetic.search.variation import OPERATORS

SPACING = 0.1  # [m] between two points of a road
LANE_CENTRE = 2.0  # [m] from the centre line


def heading_after(s: FloatArray, heading: float, start: float, slope: float) -> FloatArray:
    """Return headings in rad, s m behind a sample whose curvature ``start`` grows by ``slope``."""
    return heading + start * s + 0.5 * slope * s**2


def eastward(s: FloatArray, *shape: float) -> FloatArray:
    return np.cos(heading_after(s, *shape))


def northward(s: FloatArray, *shape: float) -> FloatArray:
    return np.sin(heading_after(s, *shape))


def points_of(
    curvatures: FloatArray, step: float, start: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return points, (n, 2) m, `SPACING` apart, and headings, (n,) rad, by quadrature."""
    x, y, heading = start
    points, headings = [(x, y)], [heading]
    places = np.linspace(0.0, step, round(step / SPACING) + 1)
    for first, last in pairwise(curvatures.tolist()):
        shape = (headings[-1], first, (last - first) / step)
        for low, high in pairwise(places.tolist()):
            x += fixed_quad(eastward, low, high, shape, 8)[0]
            y += fixed_quad(northward, low, high, shape, 8)[0]
            points.append((x, y))
        headings += heading_after(places[1:], *shape).tolist()
    return np.array(points), np.array(headings)


def curvatures_of(points: FloatArray) -> FloatArray:
    """Return the curvature, (n - 2,) 1/m, of circles through three neighbours; positive left."""
    before, here, after = points[:-2], points[1:-1], points[2:]
    arriving, leaving, chord = here - before, after - here, after - before
    cross = arriving[:, 0] * leaving[:, 1] - arriving[:, 1] * leaving[:, 0]
    lengths = np.hypot(*arriving.T) * np.hypot(*leaving.T) * np.hypot(*chord.T)
    curvature: FloatArray = 2.0 * cross / lengths
    return curvature


def assert_profile(points: FloatArray, curvatures: FloatArray, step: float) -> None:
    """Check that the points have these curvatures, linear in between."""
    along = SPACING * np.arange(1, len(points) - 1)
    expected = np.interp(along, step * np.arange(len(curvatures)), curvatures)
    # A circle through both sides of a sample sees the mean of two slopes.
    is_inside = np.abs(along / step - np.round(along / step)) > 1.5 * SPACING / step
    np.testing.assert_allclose(
        curvatures_of(points)[is_inside], expected[is_inside], rtol=0, atol=2e-6
    )


@given(seed=st.integers(0, 10**6), n=st.integers(2, 12), step=st.sampled_from([2.0, 5.0, 10.0]))
@settings(max_examples=15)
def test_f1_is_the_road_reversed_as_points_and_driven_in_the_other_lane(
    seed: int, n: int, step: float
) -> None:
    rng = np.random.default_rng(seed)
    road = random_curvatures(rng, n)
    start = (*rng.uniform(0.0, 200.0, 2).tolist(), rng.uniform(-math.pi, math.pi))
    points, headings = points_of(road, step, start)

    mutant = reverse_road(road)

    assert_profile(points[::-1], mutant, step)
    back, back_headings = points_of(mutant, step, (*points[-1], headings[-1] + math.pi))
    np.testing.assert_allclose(back, points[::-1], rtol=0, atol=1e-9)  # ends and length, too
    # The mutant's right-hand lane is the road's left-hand lane.
    to_the_right = np.column_stack([np.sin(back_headings), -np.cos(back_headings)])
    to_the_left = np.column_stack([-np.sin(headings), np.cos(headings)])
    np.testing.assert_allclose(
        back + LANE_CENTRE * to_the_right,
        (points + LANE_CENTRE * to_the_left)[::-1],
        rtol=0,
        atol=1e-9,
    )


@pytest.mark.parametrize("curvature", [0.07, 0.02, -0.05])
def test_f1_of_an_arc_turns_the_other_way_round_the_same_centre(curvature: float) -> None:
    length, step, n = 40.0, 10.0, 5
    # A circle around the origin; its first point lies to the right or left of the origin.
    angles = curvature * np.arange(0.0, length + 0.5 * SPACING, SPACING)
    circle = np.column_stack([np.cos(angles), np.sin(angles)]) / curvature

    mutant = reverse_road(np.full(n, curvature))

    assert_profile(circle[::-1], mutant, step)
    heading = math.pi / 2 + angles[-1] + math.pi
    back, _ = points_of(mutant, step, (*circle[-1], heading))
    np.testing.assert_allclose(np.hypot(*back.T), 1.0 / abs(curvature), rtol=0, atol=1e-9)
    np.testing.assert_allclose(back[-1], circle[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("sharpest", [0.06, -0.03])
def test_f1_of_a_clothoid_begins_with_its_sharp_end(sharpest: float) -> None:
    length, step = 60.0, 10.0
    values = np.linspace(0.0, sharpest, 7)
    along = np.arange(0.0, length + 0.5 * SPACING, SPACING)
    size = math.sqrt(math.pi * length / abs(sharpest))  # of the spiral, m
    y, x = (size * values for values in fresnel(along / size))
    clothoid = np.column_stack([x, math.copysign(1.0, sharpest) * y])

    mutant = reverse_road(values)

    assert mutant[0] == -sharpest
    assert mutant[-1] == 0.0
    assert_profile(clothoid[::-1], mutant, step)
    back, _ = points_of(mutant, step, (*clothoid[-1], 0.5 * sharpest * length + math.pi))
    np.testing.assert_allclose(back, clothoid[::-1], rtol=0, atol=1e-9)


@given(seed=st.integers(0, 10**6), n=st.integers(2, 31))
def test_f1_f2_and_f4_undo_themselves_and_f3_does_for_an_even_number_of_values(
    seed: int, n: int
) -> None:
    road = random_curvatures(np.random.default_rng(seed), n)
    for vary in (reverse_road, reverse_values, flip):
        np.testing.assert_array_equal(vary(vary(road)), road)
    assert np.array_equal(swap_halves(swap_halves(road)), road) is (n % 2 == 0)


def test_each_operator_has_a_description() -> None:
    names = {*PASS_OPERATORS, *FAIL_OPERATORS, "C1", "C2", *OPERATORS}
    names |= {*FAMILIES, REST, EARLIER, GIVEN, CONDITIONS, SWEEP}
    assert names == set(OPERATOR_DESCRIPTIONS)
