"""Shrinking: from a road with a property to the shortest and plainest that still has it.

The property is the caller's; nothing here knows a simulator. `Shrinker.run` is a generator: it
yields ever smaller shapes, in the order of `Shape.rank`, takes the results whether they have the
property, and keeps each shape that has it. A pass offers a single kind of change, the boldest
first; the passes take turns until none of them finds a smaller shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, partial
from itertools import pairwise
from typing import Final, TypeAlias, TypeVar

import numpy as np

from frenetic.road.profile import LIMITS, NAMES

T = TypeVar("T")
Values: TypeAlias = tuple[float, ...]

MOST_DECIMALS: Final = 16
"""Number of decimals assumed for a value that is not round."""
_STEPS: Final = (10.0, 5.0, 2.0, 1.0)
"""Distances between samples, in m, that are tried for a road with a smaller step; ours."""
_DECIMALS: Final = (2, 3, 4)
"""Decimals of rounded curvatures in 1/m; 0.01 1/m is a radius of 100 m. Ours."""
_SHARPER: Final = 1.25
"""Factor on all curvatures when a sample is dropped; ours."""
_BEND: Final = 0.03
"""Change of another sample's curvature when the first sample is dropped, in 1/m; ours."""
_LIMIT: Final = NAMES.index(LIMITS)
"""Index of the speed limit in each of `Shape.slopes`."""
CUT_BEHIND: Final = "cut behind"
"""Name of the work before the passes."""


class TrialResult(StrEnum):
    """Whether a tried shape has the property."""

    YES = "yes"
    NO = "no"
    REFUSED = "refused"
    """The shape cannot be tried; this does not count as a trial."""


@dataclass(frozen=True)
class Shape:
    """A road without a place: curvature samples, their step, and its profiles' values at them."""

    values: Values
    """Values, (N,) in 1/m, positive turns left."""
    step: float
    """Distance between two samples, in m."""
    slopes: tuple[Values, ...] = ()
    """Profiles at each sample, in the order of `frenetic.road.profile.NAMES`: slope across the
    road, slope along it, widening and speed limit; () for a flat road without limits."""

    def __post_init__(self) -> None:
        # Plain floats without a negative zero, so that equal shapes look and hash alike.
        object.__setattr__(self, "values", tuple(float(value) + 0.0 for value in self.values))
        slopes = tuple(tuple(float(value) + 0.0 for value in pair) for pair in self.slopes)
        object.__setattr__(self, "slopes", slopes if any(map(any, slopes)) else ())

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
        """Sort key of the total order of all shapes, shortest and plainest first.

        In this order: length in m, samples, curves, samples on a slope, changes from one sample to
        the next, samples that are not 0, decimals of all values together, sum of the changes, sum
        of the absolute values, both in 1/m; and so that no two are alike, the values.
        """
        changes = [abs(after - before) for before, after in pairwise(self.values)]
        return (
            self.length,
            len(self),
            self.curves,
            sum(map(any, self.slopes)),
            sum(change > 0.0 for change in changes),
            sum(value != 0.0 for value in self.values),
            sum(decimals(value) for value in self.values),
            # Rounded, so that no rounding error decides.
            round(math.fsum(changes), 12),
            round(math.fsum(map(abs, self.values)), 12),
            self.values,
            *self.slopes,
        )

    def replaced(self, begin: int, end: int, values: Iterable[float]) -> Shape:
        """Return the shape with other values for the samples ``begin`` to ``end - 1``.

        A new value takes over the slopes of the sample it replaces; there are at most as many new
        values as replaced samples.
        """
        new = tuple(values)
        slopes = self.slopes[: begin + len(new)] + self.slopes[end:]
        return Shape((*self.values[:begin], *new, *self.values[end:]), self.step, slopes)

    def scaled(self, factor: float) -> Shape:
        """Return the shape with all curvatures multiplied by a factor."""
        return replace(self, values=tuple(factor * value for value in self.values))


@dataclass(frozen=True)
class Improvement:
    """Smaller shape that has the property."""

    shape: Shape
    by: str
    """Name of the pass that found the shape."""
    trials: int
    """Number of trials until then."""


Trials: TypeAlias = Generator[Shape, TrialResult, T]
"""Generator that yields shapes to be tried, takes the results, and returns a value in the end."""


class Shrinker:
    """Search for the smallest shape with a property.

    Args:
        start: shape that has the property.
        neighbours: returns shapes close to a shape. A shape is guarded if none of its neighbours
            lacks the property; from the first guarded shape on, `best` is always guarded.
        place: where the start shows the property, in m along it; the road behind is cut first.
    """

    def __init__(
        self,
        start: Shape,
        neighbours: Callable[[Shape], Iterable[Shape]],
        place: float | None,
    ) -> None:
        self.best = start
        """Smallest shape with the property so far."""
        self.improvements: list[Improvement] = []
        """Improvements in order; the last one's shape is `best`."""
        self.is_guarded = False
        """Whether no neighbour of `best` lacks the property."""
        self.work = CUT_BEHIND
        """Name of the present pass."""
        self.trials = 0
        """Number of trials; a REFUSED shape does not count."""
        self._neighbours = neighbours
        self._place = place
        self._results = {start: TrialResult.YES}

    def run(self) -> Trials[None]:
        """Cut behind the place, then run the passes in turn until none improves anything.

        No shape is tried twice, and the same results give the same shapes.
        """
        self.is_guarded = yield from self._has_guard(self.best)
        if self._place is not None:
            yield from _cut_behind(self, self._place)
        before = None
        while self.best != before:
            before = self.best
            for name, work in PASSES.items():
                self.work = name
                yield from work(self)

    def offer(self, shape: Shape) -> Trials[bool]:
        """Make a shape the best if it is smaller and has the property; return whether it is."""
        if len(shape) < 2 or not shape.rank < self.best.rank:
            return False
        if (yield from self._result(shape)) is not TrialResult.YES:
            return False
        has_guard = yield from self._has_guard(shape)
        if self.is_guarded and not has_guard:
            return False
        self.is_guarded = has_guard
        self.best = shape
        self.improvements.append(Improvement(shape, self.work, self.trials))
        return True

    def _has_guard(self, shape: Shape) -> Trials[bool]:
        for near in self._neighbours(shape):
            if (yield from self._result(near)) is TrialResult.NO:
                return False
        return True

    def _result(self, shape: Shape) -> Trials[TrialResult]:
        """Return the result of a shape, which is tried the first time."""
        if shape not in self._results:
            result = yield shape
            self._results[shape] = result
            self.trials += result is not TrialResult.REFUSED
        return self._results[shape]


# --- Passes ------------------------------------------------------------------------------------
#
# `offer` refuses a shape that is not smaller at no cost, so a pass may offer freely.


def _cut_behind(shrinker: Shrinker, place: float) -> Trials[None]:
    """Cut the road behind a place, or else behind 1, 2, 4 or 8 samples more."""
    shape = shrinker.best
    end = math.ceil(place / shape.step) + 1
    for more in (0, 1, 2, 4, 8):
        if (yield from shrinker.offer(shape.replaced(end + more, len(shape), ()))):
            return


def _coarsen(shrinker: Shrinker) -> Trials[None]:
    """Sample the curvature every 10 m, or else every 5, 2 or 1 m, if that gives fewer samples."""
    shape = shrinker.best
    places = shape.step * np.arange(len(shape))
    for step in _STEPS:
        if step > shape.step:
            # A rounding error in the length must not cost the last sample.
            at = step * np.arange(math.floor(shape.length / step + 1e-9) + 1)
            values = tuple(np.interp(at, places, shape.values))
            columns = [np.interp(at, places, column) for column in zip(*shape.slopes, strict=True)]
            if len(columns) > _LIMIT:
                before = np.searchsorted(places, at + 1e-9) - 1
                columns[_LIMIT] = np.array([pair[_LIMIT] for pair in shape.slopes])[before]
            slopes = tuple(zip(*columns, strict=True))
            if (yield from shrinker.offer(Shape(values, step, slopes))):
                return


def _cut_end(shrinker: Shrinker) -> Trials[None]:
    for size in _halvings(len(shrinker.best) - 1):
        while (yield from shrinker.offer(_without_end(shrinker.best, size))):
            pass


def _without_end(shape: Shape, size: int) -> Shape:
    return shape.replaced(max(len(shape) - size, 0), len(shape), ())


def _cut_start(shrinker: Shrinker) -> Trials[None]:
    for size in _halvings(len(shrinker.best) - 1):
        while (yield from shrinker.offer(shrinker.best.replaced(0, size, ()))):
            pass


def _drop(shrinker: Shrinker) -> Trials[None]:
    """Take stretches out of the middle."""
    yield from _over_windows(shrinker, lambda values: ())  # noqa: ARG005


def _sharpen(shrinker: Shrinker) -> Trials[None]:
    """Drop one sample and make all others sharper in return."""
    begin = 0
    while begin < len(shrinker.best):
        rest = shrinker.best.replaced(begin, begin + 1, ()).scaled(_SHARPER)
        sharper = replace(rest, values=tuple(rounded(value, 3) for value in rest.values))
        if not (yield from shrinker.offer(sharper)):
            begin += 1


def _flatten(shrinker: Shrinker) -> Trials[None]:
    """Remove slopes and widening, or else all of these but one; speed limits stay."""
    for columns in ((), (0,), (1,), (2,)):
        slopes = (
            tuple(value if k in (*columns, _LIMIT) else 0.0 for k, value in enumerate(pair))
            for pair in shrinker.best.slopes
        )
        yield from shrinker.offer(replace(shrinker.best, slopes=tuple(slopes)))


def _straighten(shrinker: Shrinker) -> Trials[None]:
    yield from _over_windows(shrinker, lambda values: [0.0] * len(values))


def _level(shrinker: Shrinker) -> Trials[None]:
    """Make the curvature constant over a stretch: its mean, or else its sharpest value."""
    yield from _over_windows(
        shrinker, lambda values: [rounded(math.fsum(values) / len(values), 2)] * len(values)
    )
    yield from _over_windows(shrinker, lambda values: [max(values, key=abs)] * len(values))


def _round(shrinker: Shrinker) -> Trials[None]:
    """Round to the nearest, or else away from 0: a road that failed by sharpness stays sharp."""
    for digits in _DECIMALS:
        yield from _over_windows(shrinker, partial(_all_rounded, rounded, digits))
        yield from _over_windows(shrinker, partial(_all_rounded, rounded_away, digits))


def _all_rounded(
    rounding: Callable[[float, int], float], digits: int, values: Values
) -> list[float]:
    return [rounding(value, digits) for value in values]


def _lower(shrinker: Shrinker) -> Trials[None]:
    """Move equal neighbours together towards 0, then single samples, as far as possible."""
    begin = 0
    while begin < len(shrinker.best):
        values = shrinker.best.values
        end = begin + 1
        while end < len(values) and values[end] == values[begin]:
            end += 1
        yield from _lower_window(shrinker, begin, end)
        begin = end
    for begin in range(len(shrinker.best)):
        yield from _lower_window(shrinker, begin, begin + 1)


def _lower_window(shrinker: Shrinker, begin: int, end: int) -> Trials[None]:
    """Move samples of equal value towards 0, in units of the value's last decimal."""
    value = shrinker.best.values[begin]
    digits = min(max(decimals(value), _DECIMALS[0]), _DECIMALS[-1])
    units = round(abs(value) * 10**digits)
    for size in _halvings(units):
        while units >= size:
            lower = rounded(math.copysign((units - size) / 10**digits, value), digits)
            lowered = shrinker.best.replaced(begin, end, [lower] * (end - begin))
            if not (yield from shrinker.offer(lowered)):
                break
            units -= size


def _exchange(shrinker: Shrinker) -> Trials[None]:
    """Drop the first sample and bend another sample more to either side in return."""
    while (yield from _exchange_once(shrinker)):
        pass


def _exchange_once(shrinker: Shrinker) -> Trials[bool]:
    best = shrinker.best
    for bend in (_BEND, -_BEND):
        for i, value in enumerate(best.values[1:], start=1):
            bent = best.replaced(i, i + 1, [rounded(value + bend, 4)]).replaced(0, 1, ())
            if (yield from shrinker.offer(bent)):
                return True
    return False


def _over_windows(shrinker: Shrinker, change: Callable[[Values], Sequence[float]]) -> Trials[None]:
    """Offer a change of each stretch of samples: the whole road first, then shorter stretches."""
    for size in _halvings(len(shrinker.best)):
        begin = 0
        while begin < len(shrinker.best):
            end = min(begin + size, len(shrinker.best))
            changed = change(shrinker.best.values[begin:end])
            if not (yield from shrinker.offer(shrinker.best.replaced(begin, end, changed))):
                begin += size


PASSES: Final[dict[str, Callable[[Shrinker], Trials[None]]]] = {
    "coarsen": _coarsen,
    "cut the end": _cut_end,
    "cut the start": _cut_start,
    "drop": _drop,
    "sharpen": _sharpen,
    "flatten": _flatten,
    "straighten": _straighten,
    "level": _level,
    "round": _round,
    "lower": _lower,
    "exchange": _exchange,
}
"""Passes by name, in their order: first those that shorten a road in few trials."""


def _halvings(size: int) -> Iterator[int]:
    """Yield the size, half of it, and so on down to 1."""
    while size >= 1:
        yield size
        size //= 2


def decimals(value: float) -> int:
    """Return the number of decimals of a value: 0 for 0.0, 2 for 0.05; at most 16."""
    return next((n for n in range(MOST_DECIMALS) if round(value, n) == value), MOST_DECIMALS)


def rounded(value: float, digits: int) -> float:
    """Return the nearest number with so many decimals."""
    return round(value, digits)


def rounded_away(value: float, digits: int) -> float:
    """Return the nearest number with so many decimals that is no closer to 0."""
    nearest = round(value, digits)
    if abs(nearest) >= abs(value):
        return nearest
    return round(nearest + math.copysign(10.0**-digits, value), digits)
