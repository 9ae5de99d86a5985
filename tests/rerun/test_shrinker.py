"""The shrinker: smallest shapes with a property, whatever the property is."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.rerun.shrinker import (
    Improvement,
    Shape,
    Shrinker,
    TrialResult,
    decimals,
    rounded_away,
)

ENOUGH_TRIALS = 20_000

some_examples = settings(max_examples=80)

values = st.floats(-0.07, 0.07, allow_nan=False)
shapes = st.builds(Shape, st.lists(values, min_size=2, max_size=20).map(tuple), st.just(10.0))


@dataclass(frozen=True)
class Shrunk:
    shape: Shape
    improvements: tuple[Improvement, ...]
    trials: int
    is_minimal: bool
    is_guarded: bool


def shrink(
    start: Shape,
    ask: Callable[[Shape], TrialResult],
    *,
    max_trials: int,
    neighbours: Callable[[Shape], Iterable[Shape]] = lambda shape: (),
    place: float | None = None,
) -> Shrunk:
    """Answer a shrinker until it ends or has made ``max_trials`` trials."""
    shrinker, is_minimal = Shrinker(start, neighbours, failure_distance=place), False
    run = shrinker.run()
    try:
        shape = next(run)
        while shrinker.trials < max_trials:
            shape = run.send(ask(shape))
    except StopIteration:
        is_minimal = True
    improvements = tuple(shrinker.improvements)
    return Shrunk(shrinker.best, improvements, shrinker.trials, is_minimal, shrinker.is_guarded)


def when(holds: Callable[[Shape], bool]) -> Callable[[Shape], TrialResult]:
    return lambda shape: TrialResult.YES if holds(shape) else TrialResult.NO


def at_random(seed: int, *, refusing: bool = False) -> Callable[[Shape], TrialResult]:
    """Return a property that follows no rule but is the same for the same shape."""

    def ask(shape: Shape) -> TrialResult:
        number = zlib.crc32(repr((seed, shape.values, shape.step)).encode())
        if refusing and number % 5 == 0:
            return TrialResult.REFUSED
        return TrialResult.YES if number % 3 == 0 else TrialResult.NO

    return ask


def sharp(least: float) -> Callable[[Shape], bool]:
    return lambda shape: any(abs(value) >= least for value in shape.values)


# The order


@pytest.mark.parametrize(
    ("smaller", "larger"),
    [
        (Shape((0.05, -0.05), 10.0), Shape((0.0, 0.0, 0.0), 10.0)),  # shorter
        (Shape((0.05, 0.05), 10.0), Shape((0.0, 0.0, 0.0), 5.0)),  # fewer samples
        (Shape((0.05, 0.02, 0.05), 10.0), Shape((0.01, 0.0, 0.01), 10.0)),  # fewer curves
        (Shape((0.05, 0.05, 0.05), 10.0), Shape((0.0, 0.0, 0.01), 10.0)),  # fewer changes
        (Shape((0.0, 0.0, 0.05), 10.0), Shape((0.01, 0.01, 0.02), 10.0)),  # more of it straight
        (Shape((0.0, 0.0, 0.05), 10.0), Shape((0.0, 0.0, 0.015), 10.0)),  # rounder
        (Shape((0.02, 0.04, 0.04), 10.0), Shape((0.01, 0.04, 0.04), 10.0)),  # smaller changes
        (Shape((0.02, 0.01, 0.02), 10.0), Shape((0.02, 0.03, 0.02), 10.0)),  # gentler
        (Shape((0.0, 0.05), 10.0), Shape((0.05, 0.0), 10.0)),  # no two are alike
    ],
)
def test_shapes_are_ordered_by_length_then_by_simplicity(smaller: Shape, larger: Shape) -> None:
    assert smaller.rank < larger.rank


def test_slopes_stay_with_their_samples_until_a_pass_removes_them() -> None:
    hill = ((0.0, 0.06), (0.0, 0.06), (-0.04, 0.0), (-0.04, -0.06), (0.0, -0.06))
    start = Shape((0.0, 0.0, 0.03, 0.03, 0.0), 10.0, hill)
    assert start.replaced(1, 2, ()).slopes == (hill[0], *hill[2:])
    assert start.replaced(0, 2, (0.01, 0.01)).slopes == hill
    assert Shape(start.values, 10.0, ((0.0, -0.0),) * 5) == Shape(start.values, 10.0)
    assert Shape(start.values, 10.0).rank < start.rank

    def leans_in_a_bend(shape: Shape) -> bool:
        pairs = zip(shape.values, shape.slopes, strict=False)
        return any(value > 0.0 and slopes[0] < 0.0 for value, slopes in pairs)

    shrunk = shrink(start, when(leans_in_a_bend), max_trials=500)
    assert shrunk.shape == Shape((0.01, 0.01), 10.0, ((0.0, 0.0), (-0.04, 0.0)))
    assert not shrink(start, when(sharp(0.01)), max_trials=500).shape.slopes


@given(shapes, shapes)
def test_the_order_is_total(first: Shape, second: Shape) -> None:
    assert (first.rank < second.rank) + (second.rank < first.rank) == (first != second)
    signed = Shape(tuple(np.float64(v) if v else -0.0 for v in first.values), first.step)
    assert (signed, hash(signed), repr(signed)) == (first, hash(first), repr(first))


def test_a_curve_ends_where_the_side_changes() -> None:
    for curves, *curvatures in (
        (0, 0.0, 0.0),
        (2, 0.1, 0.2, -0.1, -0.2),
        (2, 0.0, 0.1, 0.0, 0.2, 0.0),
    ):
        assert Shape(tuple(curvatures), 10.0).curves == curves


@given(values, st.integers(2, 4))
def test_rounding_away_never_gets_closer_to_0(value: float, digits: int) -> None:
    assert [decimals(v) for v in (0.0, 1.0, -0.05, 0.055, 1.0 / 30.0)] == [0, 0, 2, 3, 16]
    away = rounded_away(value, digits)
    assert decimals(away) <= digits
    assert abs(value) <= abs(away) <= abs(value) + 10.0**-digits
    assert away * value >= 0.0


@some_examples
@given(shapes, st.integers(0, 2**32), st.booleans(), st.integers(0, 100))
def test_any_property_is_shrunk_until_no_change_improves_the_shape(
    start: Shape, seed: int, refusing: bool, few: int
) -> None:
    """No shape is tried twice, no trial is too many, and results repeat."""
    ask = at_random(seed, refusing=refusing)
    tried: list[Shape] = []

    def counting(shape: Shape) -> TrialResult:
        tried.append(shape)
        return ask(shape)

    shrunk = shrink(start, counting, max_trials=ENOUGH_TRIALS)
    assert len({start, *tried}) == 1 + len(tried)
    assert shrunk.trials == sum(ask(shape) is not TrialResult.REFUSED for shape in tried)
    assert shrunk.is_minimal
    shapes = [improvement.shape for improvement in shrunk.improvements]
    ranks = [shape.rank for shape in (start, *shapes)]
    assert all(after < before for before, after in pairwise(ranks))
    assert all(ask(shape) is TrialResult.YES for shape in shapes)
    trials = [improvement.trials for improvement in shrunk.improvements]
    assert trials == sorted(trials)
    best = shrunk.shape
    assert best == (start, *shapes)[-1]
    for i in range(len(best)):
        shorter = best.replaced(i, i + 1, ())
        assert len(shorter) < 2 or shorter == start or ask(shorter) is not TrialResult.YES
        straighter = best.replaced(i, i + 1, [0.0])
        assert straighter.rank >= best.rank or ask(straighter) is not TrialResult.YES
    part = shrink(start, ask, max_trials=few)  # fewer trials get a part of the way
    assert part.improvements == shrunk.improvements[: len(part.improvements)]
    assert part.trials == few or part == shrunk


# Properties with a known smallest shape


LEFT = [0.03] * 3
EITHER_WAY = [[0.05, 0.05], [-0.05, -0.05]]
SMALLEST_SHAPES: list[tuple[Callable[[Shape], bool], Callable[[Shape], bool]]] = [
    # The smallest shape has two samples and a constant, round curvature.
    (sharp(0.05), lambda best: list(best.values) in EITHER_WAY),
    (sharp(0.0432), lambda best: list(best.values) in EITHER_WAY),
    (lambda shape: len(shape) >= 7, lambda best: set(best.values) == {0.0} and len(best) == 7),
    (
        lambda shape: sum(value >= 0.03 for value in shape.values) >= 3,
        lambda best: list(best.values) == LEFT,
    ),
    (  # a left and a right curve, or two equal curves with a straight sample in between
        lambda shape: shape.curves >= 2,
        lambda best: (len(best), max(map(abs, best.values))) in {(2, 0.01), (3, 0.01)},
    ),
]
"""A property, and a function that says whether a shape is the smallest with this property."""


@some_examples
@given(st.data(), st.sampled_from(SMALLEST_SHAPES))
def test_the_smallest_shape_is_found(
    data: st.DataObject, case: tuple[Callable[[Shape], bool], Callable[[Shape], bool]]
) -> None:
    has_property, is_smallest = case
    start = data.draw(shapes.filter(has_property))
    assert is_smallest(shrink(start, when(has_property), max_trials=ENOUGH_TRIALS).shape)


def test_shortening_takes_few_trials() -> None:
    rough = tuple(float(v) for v in np.random.default_rng(1).uniform(-0.07, 0.07, 25))
    start = Shape((*rough, 0.08, *rough), 10.0)
    shrunk = shrink(start, when(sharp(0.075)), max_trials=10)
    assert not shrunk.is_minimal
    assert shrunk.shape.length <= 50.0


# Options


def test_samples_denser_than_10_m_are_thinned_out_first() -> None:
    places = np.linspace(0.0, 120.0, 241)
    start = Shape(tuple(np.interp(places, [0.0, 60.0, 120.0], [0.0, 0.06, 0.0])), 0.5)
    shrunk = shrink(start, when(sharp(0.055)), max_trials=1)
    assert (shrunk.shape.step, len(shrunk.shape)) == (10.0, 13)
    assert shrunk.improvements[0].pass_name == "coarsen"
    dense = when(lambda shape: sharp(0.05)(shape) and shape.length >= 15.0)
    for place, trials, step in (
        (7, 3, 1.0),
        (5, 2, 5.0),
    ):  # steps of 10, 5 and 2 m, or of 10 m, skip the spike
        spike = Shape((0.0,) * place + (0.06,) + (0.0,) * (20 - place), 1.0)
        assert shrink(spike, dense, max_trials=trials).shape.step == step


def test_a_road_that_is_thinned_out_keeps_its_speed_limits() -> None:
    limits = [50.0] * 4 + [30.0] * 7  # from 12 m on the lower one
    start = Shape((0.0,) * 11, 3.0, tuple((0.0, 0.0, 0.0, limit) for limit in limits))
    shape = shrink(start, when(lambda shape: shape.length == 30.0), max_trials=1).shape
    assert (shape.step, [limit for *_, limit in shape.slopes]) == (10.0, [50.0, 50.0, 30.0, 30.0])


def test_neighbours_must_have_the_property_too() -> None:
    def ask(shape: Shape) -> TrialResult:
        most = max(map(abs, shape.values))
        return (
            TrialResult.REFUSED
            if most > 0.06
            else TrialResult.YES
            if most >= 0.03
            else TrialResult.NO
        )

    def neighbours(shape: Shape) -> list[Shape]:
        return [shape.scaled(0.9), shape.scaled(1.1)]

    start = Shape((0.058, 0.06, 0.01), 10.0)
    alone = shrink(start, ask, max_trials=ENOUGH_TRIALS).shape
    guarded = shrink(start, ask, max_trials=ENOUGH_TRIALS, neighbours=neighbours).shape
    assert (alone.values, guarded.values) == ((0.03, 0.03), (0.04, 0.04))
    # A refused neighbour does not count.
    sharpest = shrink(Shape((0.0, 0.0, 0.06), 10.0), ask, max_trials=5, neighbours=neighbours)
    assert sharpest.shape.length == 10.0


def test_neighbours_count_once_they_have_had_the_property() -> None:
    start = Shape((0.0, 0.05, 0.0, 0.02), 10.0)
    ask = when(lambda shape: 0.05 in shape.values or len(shape) == 2)
    for neighbours, is_guarded in (
        (lambda shape: [shape.scaled(0.9)], True),
        (lambda _: [start.scaled(0.9)], False),  # this neighbour never has the property
    ):
        shrunk = shrink(start, ask, max_trials=ENOUGH_TRIALS, neighbours=neighbours)
        assert (shrunk.shape.length, shrunk.is_guarded) == (10.0, is_guarded)


def test_the_road_behind_the_place_is_cut_first() -> None:
    start = Shape((0.01, 0.02, 0.05, *[0.01] * 17), 10.0)
    has_bend = when(lambda shape: 0.05 in shape.values)
    (improvement,) = shrink(start, has_bend, max_trials=1, place=18.0).improvements
    assert improvement.shape.values == (0.01, 0.02, 0.05)
