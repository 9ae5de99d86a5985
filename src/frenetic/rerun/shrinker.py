"""Shrinking: from a road with a property to the shortest and plainest road that still has it.

The caller decides which shapes have the property; nothing here knows a simulator. `Shrinker.run` is
a generator: it yields shapes that are smaller by `Shape.rank`, is sent back whether each has the
property, and keeps each shape that has it. A pass offers changes of a single kind, the boldest
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

MAX_DECIMALS: Final = 16
"""Number of decimals of a value that is not round, as 1/3; a float has about as many."""
_COARSE_STEPS: Final = (10.0, 5.0, 2.0, 1.0)
"""Distances between samples, in m, that are tried for a road with a smaller step; our choice."""
_ROUND_DECIMALS: Final = (2, 3, 4)
"""Decimals of rounded curvatures in 1/m: 0.01 1/m is a radius of 100 m; our choice."""
_SHARPENING: Final = 1.25
"""Factor on all curvatures when a sample is dropped; our choice."""
_EXTRA_BEND: Final = 0.03
"""Change of another sample's curvature when the first sample is dropped, in 1/m; our choice."""
_EXTRA_SAMPLES: Final = (0, 1, 2, 4, 8)
"""Numbers of samples after the failure that are left when the road after it is cut; our choice."""
_SAMPLE_TOLERANCE: Final = 1e-9
"""Share of a step by which a rounding error may move a sample."""
_LIMIT: Final = NAMES.index(LIMITS)
"""Index of the speed limit in each of `Shape.slopes`."""
CUT_BEHIND: Final = "cut behind"
"""Name of the first pass, which runs once: it cuts the road after the failure."""


class TrialResult(StrEnum):
    """Result of a trial: whether a shape has the property."""

    YES = "yes"
    NO = "no"
    REFUSED = "refused"
    """The shape cannot be tried, as an invalid road; this does not count as a trial."""


@dataclass(frozen=True)
class Shape:
    """A road without its pose on the map: samples of curvature and of the profiles."""

    values: Values
    """Curvatures, (N,) in 1/m, positive to the left."""
    step: float
    """Distance between two samples, in m."""
    slopes: tuple[Values, ...] = ()
    """Values of the profiles at each sample, in the order of `frenetic.road.profile.NAMES`: slope
    across the road, slope along it, widening and speed limit. Empty for a flat road without
    limits."""

    def __post_init__(self) -> None:
        # Equal shapes shall look and hash alike: adding 0.0 makes 0.0 of -0.0.
        object.__setattr__(self, "values", tuple(float(value) + 0.0 for value in self.values))
        slopes = tuple(tuple(float(value) + 0.0 for value in sample) for sample in self.slopes)
        object.__setattr__(self, "slopes", slopes if any(map(any, slopes)) else ())

    def __len__(self) -> int:
        return len(self.values)

    @property
    def length(self) -> float:
        """Length of the centre line, in m."""
        return (len(self.values) - 1) * self.step

    @property
    def curves(self) -> int:
        """Number of curves: stretches whose samples all turn to the same side."""
        signs = [int(np.sign(value)) for value in self.values]
        return sum(sign != 0 and sign != before for before, sign in pairwise([0, *signs]))

    @cached_property
    def rank(self) -> tuple[float | Values, ...]:
        """Sort key of a total order of all shapes, the shortest and plainest first.

        In this order: length in m, numbers of samples, curves, samples on a slope, changes from one
        sample to the next, samples that are not 0, and decimals of all values together; sum of the
        changes and sum of the absolute values, both in 1/m. The values decide between shapes that
        are alike in all of these.
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

        Fewer new values than replaced samples shorten the road. A new value has the slopes of the
        sample that it replaces.
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
    """The smaller shape."""
    pass_name: str
    """Name of the pass that found the shape."""
    trials: int
    """Number of trials until the shape was found."""


Trials: TypeAlias = Generator[Shape, TrialResult, T]
"""Generator that yields a shape to try, is sent the result, and returns a value at its end."""


class Shrinker:
    """Search for the smallest shape with a property.

    Args:
        start: shape that has the property.
        neighbours: function that returns shapes close to a shape. A shape is guarded if none of its
            neighbours lacks the property. From the first guarded shape on, `best` is guarded.
        failure_distance: distance along the start at which it shows the property, in m; the road
            after it is cut first. None if that is unknown.
    """

    def __init__(
        self,
        start: Shape,
        neighbours: Callable[[Shape], Iterable[Shape]],
        failure_distance: float | None,
    ) -> None:
        self.best = start
        """Smallest shape with the property so far."""
        self.improvements: list[Improvement] = []
        """Improvements in order; the last one's shape is `best`."""
        self.is_guarded = False
        """Whether no neighbour of `best` lacks the property."""
        self.pass_name = CUT_BEHIND
        """Name of the present pass."""
        self.trials = 0
        """Number of trials; a REFUSED shape does not count."""
        self._neighbours = neighbours
        self._failure_distance = failure_distance
        self._results = {start: TrialResult.YES}

    def run(self) -> Trials[None]:
        """Cut the road after the failure, then run the passes in turn until none improves it.

        No shape is tried twice, and the same results give the same shapes.
        """
        self.is_guarded = yield from self._passes_guard(self.best)
        if self._failure_distance is not None:
            yield from _cut_behind(self, self._failure_distance)
        before = None
        while self.best != before:
            before = self.best
            for name, run_pass in PASSES.items():
                self.pass_name = name
                yield from run_pass(self)

    def offer(self, shape: Shape) -> Trials[bool]:
        """Make a shape the best if it is smaller and has the property.

        Returns:
            Whether the shape is the best now.
        """
        if len(shape) < 2 or not shape.rank < self.best.rank:
            return False
        if (yield from self._result(shape)) is not TrialResult.YES:
            return False
        is_guarded = yield from self._passes_guard(shape)
        if self.is_guarded and not is_guarded:
            return False
        self.is_guarded = is_guarded
        self.best = shape
        self.improvements.append(Improvement(shape, self.pass_name, self.trials))
        return True

    def _passes_guard(self, shape: Shape) -> Trials[bool]:
        """Return whether no neighbour of a shape lacks the property."""
        for near in self._neighbours(shape):
            if (yield from self._result(near)) is TrialResult.NO:
                return False
        return True

    def _result(self, shape: Shape) -> Trials[TrialResult]:
        """Return the result of a shape, which is tried unless the result is known."""
        if shape not in self._results:
            result = yield shape
            self._results[shape] = result
            self.trials += result is not TrialResult.REFUSED
        return self._results[shape]


# --- Passes ------------------------------------------------------------------------------------
#
# `offer` refuses a shape that is not smaller without a trial, so a pass may offer such shapes.


def _cut_behind(shrinker: Shrinker, failure_distance: float) -> Trials[None]:
    """Cut the road after the failure, or after as few samples behind it as possible."""
    shape = shrinker.best
    end = math.ceil(failure_distance / shape.step) + 1
    for extra in _EXTRA_SAMPLES:
        if (yield from shrinker.offer(shape.replaced(end + extra, len(shape), ()))):
            return


def _coarsen(shrinker: Shrinker) -> Trials[None]:
    """Sample the road in the largest of `_COARSE_STEPS` that gives fewer samples."""
    for step in _COARSE_STEPS:
        if step > shrinker.best.step and (
            yield from shrinker.offer(_resampled(shrinker.best, step))
        ):
            return


def _resampled(shape: Shape, step: float) -> Shape:
    """Return a shape sampled at another step, in m: values in between are linear, limits hold."""
    stations = shape.step * np.arange(len(shape))
    # A rounding error in the length must not cost the last sample.
    new_stations = step * np.arange(math.floor(shape.length / step + _SAMPLE_TOLERANCE) + 1)
    values = tuple(np.interp(new_stations, stations, shape.values))
    columns = [
        np.interp(new_stations, stations, column) for column in zip(*shape.slopes, strict=True)
    ]
    if len(columns) > _LIMIT:
        before = np.searchsorted(stations, new_stations + _SAMPLE_TOLERANCE) - 1
        columns[_LIMIT] = np.array([sample[_LIMIT] for sample in shape.slopes])[before]
    return Shape(values, step, tuple(zip(*columns, strict=True)))


def _cut_end(shrinker: Shrinker) -> Trials[None]:
    """Cut samples off the end, half of the road first."""
    for size in _halvings(len(shrinker.best) - 1):
        while (yield from shrinker.offer(_without_end(shrinker.best, size))):
            pass


def _without_end(shape: Shape, size: int) -> Shape:
    """Return a shape without its last samples, as many as ``size``."""
    return shape.replaced(max(len(shape) - size, 0), len(shape), ())


def _cut_start(shrinker: Shrinker) -> Trials[None]:
    """Cut samples off the start, half of the road first."""
    for size in _halvings(len(shrinker.best) - 1):
        while (yield from shrinker.offer(shrinker.best.replaced(0, size, ()))):
            pass


def _drop(shrinker: Shrinker) -> Trials[None]:
    """Take stretches out of the road."""
    yield from _offer_windows(shrinker, lambda values: ())  # noqa: ARG005


def _sharpen(shrinker: Shrinker) -> Trials[None]:
    """Drop one sample, and make all other samples sharper in return."""
    begin = 0
    while begin < len(shrinker.best):
        rest = shrinker.best.replaced(begin, begin + 1, ()).scaled(_SHARPENING)
        sharper = replace(rest, values=tuple(rounded(value, 3) for value in rest.values))
        if not (yield from shrinker.offer(sharper)):
            begin += 1


def _flatten(shrinker: Shrinker) -> Trials[None]:
    """Remove slopes and widening, or else all of these except one; speed limits stay."""
    for kept_columns in ((), (0,), (1,), (2,)):
        slopes = (
            tuple(value if k in (*kept_columns, _LIMIT) else 0.0 for k, value in enumerate(sample))
            for sample in shrinker.best.slopes
        )
        yield from shrinker.offer(replace(shrinker.best, slopes=tuple(slopes)))


def _straighten(shrinker: Shrinker) -> Trials[None]:
    """Make stretches straight."""
    yield from _offer_windows(shrinker, lambda values: [0.0] * len(values))


def _level(shrinker: Shrinker) -> Trials[None]:
    """Make the curvature of a stretch constant: its rounded mean, or else its sharpest value."""
    yield from _offer_windows(
        shrinker,
        lambda values: [rounded(math.fsum(values) / len(values), digits=2)] * len(values),
    )
    yield from _offer_windows(shrinker, lambda values: [max(values, key=abs)] * len(values))


def _round(shrinker: Shrinker) -> Trials[None]:
    """Round to the nearest, or else away from 0, so that a road stays as sharp as it must be."""
    for digits in _ROUND_DECIMALS:
        yield from _offer_windows(shrinker, partial(_all_rounded, rounded, digits))
        yield from _offer_windows(shrinker, partial(_all_rounded, rounded_away, digits))


def _all_rounded(
    rounding: Callable[[float, int], float], digits: int, values: Values
) -> list[float]:
    """Return the rounded values."""
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
    digits = min(max(decimals(value), _ROUND_DECIMALS[0]), _ROUND_DECIMALS[-1])
    units = round(abs(value) * 10**digits)
    for size in _halvings(units):
        while units >= size:
            lower = rounded(math.copysign((units - size) / 10**digits, value), digits)
            lowered = shrinker.best.replaced(begin, end, [lower] * (end - begin))
            if not (yield from shrinker.offer(lowered)):
                break
            units -= size


def _exchange(shrinker: Shrinker) -> Trials[None]:
    """Drop the first sample, and bend another sample more to one side in return."""
    while (yield from _exchange_once(shrinker)):
        pass


def _exchange_once(shrinker: Shrinker) -> Trials[bool]:
    """Drop the first sample once; return whether a shape was found."""
    best = shrinker.best
    for bend in (_EXTRA_BEND, -_EXTRA_BEND):
        for i, value in enumerate(best.values[1:], start=1):
            bent = best.replaced(i, i + 1, [rounded(value + bend, 4)]).replaced(0, 1, ())
            if (yield from shrinker.offer(bent)):
                return True
    return False


def _offer_windows(shrinker: Shrinker, change: Callable[[Values], Sequence[float]]) -> Trials[None]:
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
"""Name of a pass -> the pass, in their order: first the ones that shorten a road in few trials."""


def _halvings(size: int) -> Iterator[int]:
    """Yield the size, half of it, and so on down to 1."""
    while size >= 1:
        yield size
        size //= 2


def decimals(value: float) -> int:
    """Return the number of decimals of a value, at most `MAX_DECIMALS`: 0 for 0.0, 2 for 0.05."""
    return next((n for n in range(MAX_DECIMALS) if round(value, n) == value), MAX_DECIMALS)


def rounded(value: float, digits: int) -> float:
    """Return the nearest number with ``digits`` decimals."""
    return round(value, digits)


def rounded_away(value: float, digits: int) -> float:
    """Return the nearest number with ``digits`` decimals that is not closer to 0."""
    nearest = round(value, digits)
    if abs(nearest) >= abs(value):
        return nearest
    return round(nearest + math.copysign(10.0**-digits, value), digits)
