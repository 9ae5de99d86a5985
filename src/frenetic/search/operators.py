"""Operators that draw, mutate and cross roads: functions on curvature values.

They are the operators of Section I-B in Castellano et al., "Frenetic at the SBST 2021 Tool
Competition". The numbers in the docstrings are the paper's; `MutationOptions` can change them.

Roads are (N,) float64 arrays of curvatures κ in 1/m with N >= 2. No argument is modified except the
generator `rng`, and no result shares memory with an argument.

The results may be invalid roads. P6 may leave the bound within which new values are drawn. The
neighbours of removed, replaced or joined values may differ by more than `max_change`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road.road_values import USUAL_CHANGE

if TYPE_CHECKING:
    from typing import TypeAlias

CURVATURE_BOUND = 0.07  # [1/m], the paper's Section I-B
MAX_CHANGE = USUAL_CHANGE  # [1/m] from one value to the next, the paper's Section I-B
MIN_VALUES = 2  # least number of values of a road, as of `frenetic.road.Road`: its two ends


@dataclass(frozen=True)
class MutationOptions:
    """Options of the mutations P1 to P6; the defaults are from the paper's Section I-B."""

    bound: float = CURVATURE_BOUND
    """Largest absolute value of new values, in 1/m."""
    max_change: float = MAX_CHANGE
    """Largest difference of a new value from the value before it, in 1/m."""
    min_changed: int = 1
    """Least number of values that P1 to P5 add, remove or replace."""
    max_changed: int = 5
    """Largest number of values that P1 to P5 add, remove or replace."""
    min_scale: float = 1.1
    """Least factor of P6."""
    max_scale: float = 1.2
    """Largest factor of P6."""


PAPER_OPTIONS = MutationOptions()
"""The options of the paper's Section I-B."""


def next_curvature(previous: float, u: float, *, bound: float, max_change: float) -> float:
    """Return the value that follows `previous`, where `u` in [0, 1) is a uniform random number.

    The value is uniform in the intersection of [-bound, bound] and
    [previous - max_change, previous + max_change]. If `previous` lies more than `max_change`
    outside [-bound, bound], the intersection is empty, and the value is the nearest end of
    [-bound, bound].
    """
    low = min(max(previous - max_change, -bound), bound)
    high = max(min(previous + max_change, bound), -bound)
    return low + u * (high - low)


def random_curvatures(
    rng: np.random.Generator,
    n: int,
    *,
    bound: float = CURVATURE_BOUND,
    max_change: float = MAX_CHANGE,
) -> FloatArray:
    """Return the (n,) values, 1/m, of a random road, each drawn by `next_curvature`.

    The value before the first counts as 0, as in the paper's published code; the paper does not
    say.
    """
    return _continued(rng, 0.0, n, bound, max_change)


def append(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray:
    """P1: return the road with 1..5 new values at its end, which continue from its last value."""
    count = _random_count(rng, options)
    new = _continued(rng, float(curvatures[-1]), count, options.bound, options.max_change)
    return np.concatenate((curvatures, new))


def remove_random(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray | None:
    """P2: return the road without 1..5 values at random positions.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removed_count(rng, curvatures, options)
    if count == 0:
        return None
    remains = np.ones(len(curvatures), dtype=np.bool_)
    remains[rng.choice(len(curvatures), size=count, replace=False)] = False
    return curvatures[remains]


def remove_front(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray | None:
    """P3: return the road without its first 1..5 values.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removed_count(rng, curvatures, options)
    return curvatures[count:].copy() if count else None


def remove_end(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray | None:
    """P4: return the road without its last 1..5 values.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removed_count(rng, curvatures, options)
    return curvatures[:-count].copy() if count else None


def replace_random(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray:
    """P5: return the road with new values at 1..5 random positions.

    New values are drawn by `next_curvature` from the first position to the last, each from the
    value before it, which may be new, too; the value before the first counts as 0. A new value may
    differ by any amount from the value after it.
    """
    n = len(curvatures)
    count = min(_random_count(rng, options), n)
    positions = np.sort(rng.choice(n, size=count, replace=False)).tolist()
    mutant = curvatures.copy()
    for i in positions:
        u = rng.random()
        previous = float(mutant[i - 1]) if i > 0 else 0.0
        mutant[i] = next_curvature(previous, u, bound=options.bound, max_change=options.max_change)
    return mutant


def scale(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = PAPER_OPTIONS
) -> FloatArray:
    """P6: return all values times one factor that is uniform in 1.1..1.2.

    The paper does not say whether all values share one factor; in its published code they do.
    """
    return curvatures * rng.uniform(options.min_scale, options.max_scale)


def reverse_road(curvatures: FloatArray) -> FloatArray:
    """F1: return the same road from its other end, so that its other lane is driven.

    A left turn in one direction is a right turn in the other, so the values are reversed and
    negated.
    """
    return -curvatures[::-1]


def reverse_values(curvatures: FloatArray) -> FloatArray:
    """F2: return the values in reverse order: the mirror image of `reverse_road`."""
    return curvatures[::-1].copy()


def swap_halves(curvatures: FloatArray) -> FloatArray:
    """F3: return the second half of the road, then its first half.

    The first half is the first floor(N/2) values. For even N, swapping twice gives the road again.
    """
    half = len(curvatures) // 2
    return np.concatenate((curvatures[half:], curvatures[:half]))


def flip(curvatures: FloatArray) -> FloatArray:
    """F4: return the negated values: the road's mirror image."""
    return -curvatures


def mix(rng: np.random.Generator, first: FloatArray, second: FloatArray) -> FloatArray:
    """C1: return one child of (min(N, M),) values, each with equal chance from either parent."""
    n = min(len(first), len(second))
    return np.where(rng.random(n) < 0.5, first[:n], second[:n])


def splice(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """C2: return two children, the front half of one parent with the back half of the other.

    The front half of N values is the first floor(N/2) of them. So the children of parents with N
    and M values have floor(N/2) + ceil(M/2) and floor(M/2) + ceil(N/2) values.
    """
    i, j = len(first) // 2, len(second) // 2
    return np.concatenate((first[:i], second[j:])), np.concatenate((second[:j], first[i:]))


PassOperator: TypeAlias = Callable[
    [np.random.Generator, FloatArray, MutationOptions], FloatArray | None
]
"""Random mutation of a parent that passed; it returns None if it cannot change the road."""
FailOperator: TypeAlias = Callable[[FloatArray], FloatArray]
"""Mutation of a parent that failed, without randomness."""

PASS_OPERATORS: Mapping[str, PassOperator] = MappingProxyType(
    {
        "P1": append,
        "P2": remove_random,
        "P3": remove_front,
        "P4": remove_end,
        "P5": replace_random,
        "P6": scale,
    }
)
"""Mutations of a parent that passed, in the order in which they are tried."""

FAIL_OPERATORS: Mapping[str, FailOperator] = MappingProxyType(
    {"F1": reverse_road, "F2": reverse_values, "F3": swap_halves, "F4": flip}
)
"""Mutations of a parent that failed, in the order in which they are tried."""


def _continued(
    rng: np.random.Generator, previous: float, n: int, bound: float, max_change: float
) -> FloatArray:
    """Return n values that continue from a previous value, each drawn by `next_curvature`."""
    values = []
    for u in rng.random(n).tolist():
        previous = next_curvature(previous, u, bound=bound, max_change=max_change)
        values.append(previous)
    return np.array(values, dtype=np.float64)


def _random_count(rng: np.random.Generator, options: MutationOptions) -> int:
    """Return a random number of values to change."""
    return int(rng.integers(options.min_changed, options.max_changed, endpoint=True))


def _removed_count(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions
) -> int:
    """Return a random number of values to remove, so that at least `MIN_VALUES` remain."""
    return max(0, min(_random_count(rng, options), len(curvatures) - MIN_VALUES))
