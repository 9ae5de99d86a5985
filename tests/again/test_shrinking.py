from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.again.shrinking import Answer, Improvement, Shape, Shrinker, decimals, rounded_away

ENOUGH = 20_000

some = settings(max_examples=80)

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
    ask: Callable[[Shape], Answer],
    *,
    max_trials: int,
    neighbours: Callable[[Shape], Iterable[Shape]] = lambda shape: (),
    place: float | None = None,
) -> Shrunk:
    """Answers a shrinker until it ends or so many trials are spent."""
    shrinker, is_minimal = Shrinker(start, neighbours, place=place), False
    run = shrinker.run()
    try:
        shape = next(run)
        while shrinker.trials < max_trials:
            shape = run.send(ask(shape))
    except StopIteration:
        is_minimal = True
    found = tuple(shrinker.improvements)
    return Shrunk(shrinker.best, found, shrinker.trials, is_minimal, shrinker.is_guarded)


def when(holds: Callable[[Shape], bool]) -> Callable[[Shape], Answer]:
    return lambda shape: Answer.YES if holds(shape) else Answer.NO


def at_random(seed: int, *, refusing: bool = False) -> Callable[[Shape], Answer]:
    """Answers that follow no rule, but always the same to the same shape."""

    def ask(shape: Shape) -> Answer:
        number = zlib.crc32(repr((seed, shape.values, shape.step)).encode())
        if refusing and number % 5 == 0:
            return Answer.REFUSED
        return Answer.YES if number % 3 == 0 else Answer.NO

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
def test_shorter_comes_first_then_plainer(smaller: Shape, larger: Shape) -> None:
    assert smaller.rank < larger.rank


@given(shapes, shapes)
def test_the_order_is_total(one: Shape, other: Shape) -> None:
    assert (one.rank < other.rank) + (other.rank < one.rank) == (one != other)


def test_shapes_that_are_equal_look_alike() -> None:
    plain, signed = Shape((0.0, 0.05), 10.0), Shape((-0.0, np.float64(0.05)), 10.0)
    assert plain == signed
    assert hash(plain) == hash(signed)
    assert repr(plain) == repr(signed)


def test_curves_are_counted_by_the_way_they_turn() -> None:
    assert Shape((0.0, 0.0), 10.0).curves == 0
    assert Shape((0.02, 0.05, -0.01, -0.02), 10.0).curves == 2
    assert Shape((0.0, 0.02, 0.0, 0.03, 0.0), 10.0).curves == 2


@pytest.mark.parametrize(
    ("value", "digits"), [(0.0, 0), (1.0, 0), (-0.05, 2), (0.055, 3), (1.0 / 30.0, 16)]
)
def test_decimals_are_those_that_it_takes_to_write_the_value(value: float, digits: int) -> None:
    assert decimals(value) == digits


@given(values, st.integers(2, 4))
def test_rounding_away_never_gets_closer_to_0(value: float, digits: int) -> None:
    away = rounded_away(value, digits)
    assert decimals(away) <= digits
    assert abs(value) <= abs(away) <= abs(value) + 10.0**-digits
    assert away * value >= 0.0


# What is promised, whatever the property


@some
@given(shapes, st.integers(0, 2**32), st.booleans(), st.integers(0, 300))
def test_nothing_is_asked_twice_and_no_trial_too_many(
    start: Shape, seed: int, refusing: bool, max_trials: int
) -> None:
    ask = at_random(seed, refusing=refusing)
    asked: Counter[Shape] = Counter()
    trials = 0

    def counting(shape: Shape) -> Answer:
        nonlocal trials
        asked[shape] += 1
        trials += ask(shape) is not Answer.REFUSED
        return ask(shape)

    shrunk = shrink(start, counting, max_trials=max_trials)
    assert set(asked.values()) <= {1}
    assert start not in asked
    assert shrunk.trials == trials <= max_trials
    assert shrunk.is_minimal or trials == max_trials
    assert shrunk.shape == start or ask(shrunk.shape) is Answer.YES


@some
@given(shapes, st.integers(0, 2**32))
def test_it_improves_step_by_step_until_nothing_can_be_left_out(start: Shape, seed: int) -> None:
    ask = at_random(seed)
    shrunk = shrink(start, ask, max_trials=ENOUGH)
    assert shrunk == shrink(start, ask, max_trials=ENOUGH)
    found = [improvement.shape for improvement in shrunk.improvements]
    ranks = [shape.rank for shape in (start, *found)]
    assert all(after < before for before, after in pairwise(ranks))
    assert all(ask(shape) is Answer.YES for shape in found)
    trials = [improvement.trials for improvement in shrunk.improvements]
    assert trials == sorted(trials)
    assert shrunk.is_minimal
    best = shrunk.shape
    assert best == (start, *found)[-1]
    for i in range(len(best)):
        shorter = best.replaced(i, i + 1, ())
        assert len(shorter) < 2 or shorter == start or ask(shorter) is Answer.NO
        straighter = best.replaced(i, i + 1, [0.0])
        assert straighter.rank >= best.rank or ask(straighter) is Answer.NO
    # Fewer trials get a part of the way.
    for number in (0, 10, 50):
        part = shrink(start, ask, max_trials=number).improvements
        assert part == shrunk.improvements[: len(part)]


# Properties of which the smallest shape is known


LEFT = [0.03] * 3
EITHER_WAY = [[0.05, 0.05], [-0.05, -0.05]]
KNOWN: list[tuple[Callable[[Shape], bool], Callable[[Shape], bool]]] = [
    # Two samples are the least, a constant curvature is the plainest, and as round as can be.
    (sharp(0.05), lambda best: list(best.values) in EITHER_WAY),
    (sharp(0.0432), lambda best: list(best.values) in EITHER_WAY),
    (lambda shape: len(shape) >= 7, lambda best: set(best.values) == {0.0} and len(best) == 7),
    (
        lambda shape: sum(value >= 0.03 for value in shape.values) >= 3,
        lambda best: list(best.values) == LEFT,
    ),
    (  # a left and a right one, or two that turn alike with a straight sample in between
        lambda shape: shape.curves >= 2,
        lambda best: (len(best), max(map(abs, best.values))) in {(2, 0.01), (3, 0.01)},
    ),
]
"""A property, and whether a shape is the smallest one that has it."""


@some
@given(st.data(), st.sampled_from(KNOWN))
def test_the_smallest_shape_is_found(
    data: st.DataObject, known: tuple[Callable[[Shape], bool], Callable[[Shape], bool]]
) -> None:
    has_it, is_smallest = known
    start = data.draw(shapes.filter(has_it))
    assert is_smallest(shrink(start, when(has_it), max_trials=ENOUGH).shape)


def test_few_trials_are_spent_on_what_shortens() -> None:
    rough = tuple(float(v) for v in np.random.default_rng(1).uniform(-0.07, 0.07, 25))
    start = Shape((*rough, 0.08, *rough), 10.0)
    shrunk = shrink(start, when(sharp(0.075)), max_trials=10)
    assert not shrunk.is_minimal
    assert shrunk.shape.length <= 50.0


# Options


def test_samples_that_are_denser_than_10_m_are_thinned_out_first() -> None:
    places = np.linspace(0.0, 120.0, 241)
    start = Shape(tuple(np.interp(places, [0.0, 60.0, 120.0], [0.0, 0.06, 0.0])), 0.5)
    shrunk = shrink(start, when(sharp(0.055)), max_trials=1)
    assert shrunk.shape.step == 10.0
    assert len(shrunk.shape) == 13
    assert shrunk.improvements[0].by == "coarsen"


def test_steps_are_as_long_as_they_can_be() -> None:
    start = Shape((0.0,) * 7 + (0.06,) + (0.0,) * 13, 1.0)  # a spike after 7 m
    dense = when(lambda shape: sharp(0.05)(shape) and shape.length >= 15.0)
    shrunk = shrink(start, dense, max_trials=3)  # 10, 5 and 2 m skip it
    assert shrunk.shape == start
    start = Shape((0.0,) * 5 + (0.06,) + (0.0,) * 15, 1.0)
    assert shrink(start, dense, max_trials=2).shape.step == 5.0


def test_neighbours_have_to_have_the_property_too() -> None:
    def ask(shape: Shape) -> Answer:
        most = max(map(abs, shape.values))
        return Answer.REFUSED if most > 0.06 else Answer.YES if most >= 0.03 else Answer.NO

    def neighbours(shape: Shape) -> list[Shape]:
        return [shape.scaled(0.9), shape.scaled(1.1)]

    start = Shape((0.058, 0.06, 0.01), 10.0)
    alone = shrink(start, ask, max_trials=ENOUGH).shape
    guarded = shrink(start, ask, max_trials=ENOUGH, neighbours=neighbours).shape
    assert alone.values == (0.03, 0.03)
    assert guarded.values == (0.04, 0.04)
    # A neighbour that is refused says nothing.
    sharpest = shrink(Shape((0.0, 0.0, 0.06), 10.0), ask, max_trials=5, neighbours=neighbours)
    assert sharpest.shape.length == 10.0


def test_neighbours_need_not_have_the_property_until_they_do() -> None:
    def ask(shape: Shape) -> Answer:
        return Answer.YES if 0.05 in shape.values or len(shape) == 2 else Answer.NO

    start = Shape((0.0, 0.05, 0.0, 0.02), 10.0)
    shrunk = shrink(start, ask, max_trials=ENOUGH, neighbours=lambda one: [one.scaled(0.9)])
    assert (shrunk.shape.length, shrunk.is_guarded) == (10.0, True)
    never = shrink(start, ask, max_trials=ENOUGH, neighbours=lambda _: [start.scaled(0.9)])
    assert (never.shape.length, never.is_guarded) == (10.0, False)


def test_what_lies_behind_the_place_is_cut_first() -> None:
    def has_bend(shape: Shape) -> Answer:
        return Answer.YES if 0.05 in shape.values else Answer.NO

    start = Shape((0.01, 0.02, 0.05, *[0.01] * 17), 10.0)
    shrunk = shrink(start, has_bend, max_trials=1, place=18.0)
    (found,) = shrunk.improvements
    assert found.shape.values == (0.01, 0.02, 0.05)
