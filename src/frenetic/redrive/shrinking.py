"""Shrinking: from a road with a property to the shortest and plainest that still has it.

The property is the caller's; nothing here knows a simulator. `shrink` takes a road's `Shape` and a
function that answers whether a shape has the property. It offers the function ever smaller shapes,
in the order of `Shape.rank`, and keeps each one that has the property. A pass offers one kind of
change, the boldest first; the passes take turns until none of them finds anything smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

Values: TypeAlias = tuple[float, ...]

MOST_DECIMALS: Final = 16
"""Number of decimals assumed for a value that is not round."""
_STEPS: Final = (10.0, 5.0, 2.0, 1.0)
"""Steps that a road of more samples is given in m, if they will do."""
_DECIMALS: Final = (2, 3, 4)
"""Grid of rounded curvatures, in 1/m: 0.01 is a plain number there, a radius of 100 m."""
_SHARPER: Final = 1.25
"""Factor on all curvatures when a sample is dropped."""
_BEND: Final = 0.03
"""Bend on one curvature when the first sample is dropped, in 1/m."""
CUT_BEHIND: Final = "cut behind"
"""Name of what comes before the passes."""


class Answer(StrEnum):
    """Whether a shape has the property."""

    YES = "yes"
    NO = "no"
    REFUSED = "refused"
    """The shape cannot be tried. Finding that out is no trial."""


class Ending(StrEnum):
    """Reason for the end of shrinking."""

    MINIMAL = "minimal"
    """No pass finds anything smaller."""
    SPENT = "spent"
    """The allowed trials are spent."""
    STOPPED = "stopped"
    """The caller stopped it."""


@dataclass(frozen=True)
class Shape:
    """A road without a place: curvature samples and their step."""

    values: Values
    """Values, (N,) in 1/m, positive turns left."""
    step: float
    """Distance between two samples, in m."""

    def __post_init__(self) -> None:
        # Plain floats without a negative zero, so that equal shapes look and hash alike.
        object.__setattr__(self, "values", tuple(float(value) + 0.0 for value in self.values))

    def __len__(self) -> int:
        return len(self.values)

    @property
    def length(self) -> float:
        """Length of the centre line, in m."""
        return (len(self.values) - 1) * self.step

    @property
    def curves(self) -> int:
        """Number of curves: stretches of samples that all turn the same way."""
        signs = [int(np.sign(value)) for value in self.values]
        return sum(sign != 0 and sign != before for before, sign in pairwise([0, *signs]))

    @cached_property
    def rank(self) -> tuple[float | Values, ...]:
        """Its place in the order of all shapes, shortest and plainest first: a total order.

        In this order: length in m, samples, curves, changes from one sample to the next, samples
        that are not 0, decimals of all values together, sum of the changes, sum of the absolute
        values, both in 1/m; and so that no two are alike, the values.
        """
        changes = [abs(after - before) for before, after in pairwise(self.values)]
        return (
            self.length,
            len(self),
            self.curves,
            sum(change > 0.0 for change in changes),
            sum(value != 0.0 for value in self.values),
            sum(decimals(value) for value in self.values),
            # Rounded, so that no rounding error decides.
            round(math.fsum(changes), 12),
            round(math.fsum(map(abs, self.values)), 12),
            self.values,
        )

    def replaced(self, begin: int, end: int, values: Iterable[float]) -> Shape:
        """The shape with other values in place of those from ``begin`` up to before ``end``."""
        return Shape((*self.values[:begin], *values, *self.values[end:]), self.step)

    def scaled(self, factor: float) -> Shape:
        """The shape with all curvatures multiplied."""
        return Shape(tuple(factor * value for value in self.values), self.step)


@dataclass(frozen=True)
class Improvement:
    """A smaller shape that has the property."""

    shape: Shape
    by: str
    """The pass that found it."""
    trials: int
    """Trials spent until then."""


@dataclass(frozen=True)
class Shrunk:
    """The result of shrinking a shape."""

    shape: Shape
    """The smallest shape found with the property; the first one if there was none."""
    improvements: tuple[Improvement, ...]
    """Its improvements, in order; the last one's shape is `shape`."""
    trials: int
    ending: Ending
    is_guarded: bool
    """Whether its neighbours were found to have the property, too."""


def shrink(
    start: Shape,
    ask: Callable[[Shape], Answer | None],
    *,
    max_trials: int,
    neighbours: Callable[[Shape], Iterable[Shape]] = lambda shape: (),  # noqa: ARG005
    place: float | None = None,
    on_trial: Callable[[str, int, Shape], None] | None = None,
    on_better: Callable[[Improvement], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Shrunk:
    """The smallest shape with the property that the passes lead to.

    No shape is tried twice, and the same answers give the same result.

    Args:
        start: has the property.
        ask: whether a shape has it; YES and NO count as a trial each, None stops.
        max_trials: most trials to spend.
        neighbours: shapes close to a given one, which have the property as well unless they are
            REFUSED. A shape without such neighbours is kept only while none with them is known.
        place: where the start shows the property, in m along it; what lies behind is cut first.
        on_trial: called after every trial with the current pass, the trials spent and the smallest
            shape so far.
        on_better: called with every improvement.
        should_stop: asked before every trial.

    Raises:
        ValueError: ``max_trials`` is negative.
    """
    if max_trials < 0:
        raise ValueError(f"max_trials is {max_trials}: at least 0 is needed")
    shrinker = _Shrinker(start, ask, max_trials, neighbours, on_trial, on_better, should_stop)
    ending = Ending.MINIMAL
    try:
        shrinker.run(place)
    except _End as end:
        ending = end.ending
    return Shrunk(
        shrinker.best,
        tuple(shrinker.improvements),
        shrinker.trials,
        ending,
        shrinker.is_guarded,
    )


class _End(Exception):  # noqa: N818  # nothing went wrong
    def __init__(self, ending: Ending) -> None:
        self.ending = ending


class _Shrinker:
    """The smallest shape so far, and the answers on others."""

    def __init__(
        self,
        start: Shape,
        ask: Callable[[Shape], Answer | None],
        max_trials: int,
        neighbours: Callable[[Shape], Iterable[Shape]],
        on_trial: Callable[[str, int, Shape], None] | None,
        on_better: Callable[[Improvement], None] | None,
        should_stop: Callable[[], bool] | None,
    ) -> None:
        self.best = start
        self.is_guarded = False
        self.trials = 0
        self.improvements: list[Improvement] = []
        self._ask = ask
        self._max_trials = max_trials
        self._neighbours = neighbours
        self._on_trial = on_trial
        self._on_better = on_better
        self._should_stop = should_stop
        self._answers = {start: Answer.YES}
        self._pass = ""

    def run(self, place: float | None) -> None:
        """Cuts behind the place, then runs the passes in turn until none improves anything."""
        self._pass = CUT_BEHIND
        self.is_guarded = self._has_guard(self.best)
        if place is not None:
            _cut_behind(self, place)
        before = None
        while self.best != before:
            before = self.best
            for name, work in PASSES.items():
                self._pass = name
                work(self)

    def offer(self, shape: Shape) -> bool:
        """Whether a shape is smaller than the best and has the property; it becomes the best."""
        if len(shape) < 2 or not shape.rank < self.best.rank:
            return False
        if self._answer(shape) is not Answer.YES:
            return False
        has_guard = self._has_guard(shape)
        if self.is_guarded and not has_guard:
            return False
        self.is_guarded = has_guard
        self.best = shape
        self.improvements.append(Improvement(shape, self._pass, self.trials))
        if self._on_better is not None:
            self._on_better(self.improvements[-1])
        return True

    def _has_guard(self, shape: Shape) -> bool:
        return all(self._answer(near) is not Answer.NO for near in self._neighbours(shape))

    def _answer(self, shape: Shape) -> Answer:
        if shape not in self._answers:
            if self._should_stop is not None and self._should_stop():
                raise _End(Ending.STOPPED)
            if self.trials >= self._max_trials:
                raise _End(Ending.SPENT)
            answer = self._ask(shape)
            if answer is None:
                raise _End(Ending.STOPPED)
            self._answers[shape] = answer
            if answer is not Answer.REFUSED:
                self.trials += 1
                if self._on_trial is not None:
                    self._on_trial(self._pass, self.trials, self.best)
        return self._answers[shape]


# --- Passes ------------------------------------------------------------------------------------
#
# `offer` refuses a shape that is not smaller at no cost, so a pass may offer freely.


def _cut_behind(shrinker: _Shrinker, place: float) -> None:
    """Cuts what lies behind a place, or else behind 1, 2, 4 or 8 samples more."""
    shape = shrinker.best
    end = math.ceil(place / shape.step) + 1
    for more in (0, 1, 2, 4, 8):
        if shrinker.offer(shape.replaced(end + more, len(shape), ())):
            return


def _coarsen(shrinker: _Shrinker) -> None:
    """Takes the curvature every 10 m, or else every 5, 2 or 1 m, where there are more samples."""
    shape = shrinker.best
    places = shape.step * np.arange(len(shape))
    for step in _STEPS:
        if step > shape.step:
            # A length of a whole number of steps, up to rounding, keeps its last one.
            at = step * np.arange(math.floor(shape.length / step + 1e-9) + 1)
            if shrinker.offer(Shape(tuple(np.interp(at, places, shape.values)), step)):
                return


def _cut_end(shrinker: _Shrinker) -> None:
    for size in _halvings(len(shrinker.best) - 1):
        while shrinker.offer(
            shrinker.best.replaced(max(len(shrinker.best) - size, 0), len(shrinker.best), ())
        ):
            pass


def _cut_start(shrinker: _Shrinker) -> None:
    for size in _halvings(len(shrinker.best) - 1):
        while shrinker.offer(shrinker.best.replaced(0, size, ())):
            pass


def _drop(shrinker: _Shrinker) -> None:
    """Takes stretches out of the middle."""
    _over_windows(shrinker, lambda values: ())  # noqa: ARG005


def _sharpen(shrinker: _Shrinker) -> None:
    """Drops one sample and makes all others sharper in return."""
    begin = 0
    while begin < len(shrinker.best):
        rest = shrinker.best.replaced(begin, begin + 1, ()).scaled(_SHARPER)
        if not shrinker.offer(Shape(tuple(rounded(value, 3) for value in rest.values), rest.step)):
            begin += 1


def _straighten(shrinker: _Shrinker) -> None:
    _over_windows(shrinker, lambda values: [0.0] * len(values))


def _level(shrinker: _Shrinker) -> None:
    """Makes the curvature constant over a stretch: its mean, or else its sharpest value."""
    _over_windows(
        shrinker, lambda values: [rounded(math.fsum(values) / len(values), 2)] * len(values)
    )
    _over_windows(shrinker, lambda values: [max(values, key=abs)] * len(values))


def _round(shrinker: _Shrinker) -> None:
    """Rounds to the nearest, or else away from 0: a road that failed by sharpness stays sharp."""
    for digits in _DECIMALS:
        _over_windows(shrinker, partial(_all_rounded, rounded, digits))
        _over_windows(shrinker, partial(_all_rounded, rounded_away, digits))


def _all_rounded(how: Callable[[float, int], float], digits: int, values: Values) -> list[float]:
    return [how(value, digits) for value in values]


def _lower(shrinker: _Shrinker) -> None:
    """Moves equal neighbours together towards 0, then single samples, as far as possible."""
    begin = 0
    while begin < len(shrinker.best):
        values = shrinker.best.values
        end = begin + 1
        while end < len(values) and values[end] == values[begin]:
            end += 1
        _lower_window(shrinker, begin, end)
        begin = end
    for begin in range(len(shrinker.best)):
        _lower_window(shrinker, begin, begin + 1)


def _lower_window(shrinker: _Shrinker, begin: int, end: int) -> None:
    """Moves samples that have one value in common towards 0, in units of its last decimal."""
    value = shrinker.best.values[begin]
    digits = min(max(decimals(value), _DECIMALS[0]), _DECIMALS[-1])
    units = round(abs(value) * 10**digits)
    for size in _halvings(units):
        while units >= size:
            lower = rounded(math.copysign((units - size) / 10**digits, value), digits)
            if not shrinker.offer(shrinker.best.replaced(begin, end, [lower] * (end - begin))):
                break
            units -= size


def _exchange(shrinker: _Shrinker) -> None:
    """Drops the first sample and bends one other sample more to either side in return."""
    bends = (_BEND, -_BEND)
    while any(
        shrinker.offer(
            shrinker.best.replaced(i, i + 1, [rounded(value + bend, 4)]).replaced(0, 1, ())
        )
        for bend in bends
        for i, value in enumerate(shrinker.best.values[1:], start=1)
    ):
        pass


def _over_windows(shrinker: _Shrinker, change: Callable[[Values], Sequence[float]]) -> None:
    """Offers a change of each stretch of samples, first of all of them, then of ever fewer."""
    for size in _halvings(len(shrinker.best)):
        begin = 0
        while begin < len(shrinker.best):
            end = min(begin + size, len(shrinker.best))
            changed = change(shrinker.best.values[begin:end])
            if not shrinker.offer(shrinker.best.replaced(begin, end, changed)):
                begin += size


PASSES: Final[dict[str, Callable[[_Shrinker], None]]] = {
    "coarsen": _coarsen,
    "cut the end": _cut_end,
    "cut the start": _cut_start,
    "drop": _drop,
    "sharpen": _sharpen,
    "straighten": _straighten,
    "level": _level,
    "round": _round,
    "lower": _lower,
    "exchange": _exchange,
}
"""The passes by name, in their order: those first that shorten a road by few trials."""


def _halvings(size: int) -> Iterator[int]:
    """The size, half of it, and so on down to 1."""
    while size >= 1:
        yield size
        size //= 2


def decimals(value: float) -> int:
    """Number of decimals of a value: 0 for 0.0, 2 for 0.05; at most 16."""
    return next((n for n in range(MOST_DECIMALS) if round(value, n) == value), MOST_DECIMALS)


def rounded(value: float, digits: int) -> float:
    """The nearest number with so many decimals."""
    return round(value, digits)


def rounded_away(value: float, digits: int) -> float:
    """The nearest number with so many decimals that is no closer to 0."""
    nearest = round(value, digits)
    if abs(nearest) >= abs(value):
        return nearest
    return round(nearest + math.copysign(10.0**-digits, value), digits)
