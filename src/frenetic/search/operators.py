"""Operators that draw, mutate and cross roads: pure functions on curvature values.

They are the operators of Section I-B in Castellano et al., "Frenetic at the SBST 2021 Tool
Competition". `DOES` lists the names that an `Origin` carries, and what each operator does,
including the operators of `frenetic.search.variation`.

Roads are (N,) float64 arrays of curvatures κ in 1/m with N >= 2; nothing is modified in place, and
no result shares memory with an argument. Whether a road is valid is judged elsewhere: P6 may leave
the bound within which new values are drawn, and the neighbours of removed, replaced or joined
values may differ by more than `max_change`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray

if TYPE_CHECKING:
    from typing import TypeAlias

CURVATURE_BOUND = 0.07  # [1/m], the paper's Section I-B
MAX_CHANGE = 0.05  # [1/m] from one value to the next, the paper's Section I-B
MIN_VALUES = 2  # fewer do not describe a road


@dataclass(frozen=True)
class MutationOptions:
    """Strength of the mutations P1 .. P6; the defaults are from the paper's Section I-B."""

    bound: float = CURVATURE_BOUND
    """1/m; new values lie within ± this."""
    max_change: float = MAX_CHANGE
    """1/m; a new value differs from the one before it by at most this."""
    min_changed: int = 1
    """Least number of values that P1 .. P5 add, remove or replace."""
    max_changed: int = 5
    """Largest number of values that P1 .. P5 add, remove or replace."""
    min_scale: float = 1.1
    """Least factor of P6."""
    max_scale: float = 1.2
    """Largest factor of P6."""


LISTING_1 = MutationOptions()
"""The options of the paper's Section I-B."""


def next_curvature(previous: float, u: float, *, bound: float, max_change: float) -> float:
    """Return the value that follows `previous`, where `u` in [0, 1) is a uniform random number.

    It is uniform in the intersection of [-bound, bound] and
    [previous - max_change, previous + max_change]. Where that is empty, because `previous` lies
    further than `max_change` outside the bound, it is the nearest end of [-bound, bound].
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
    """Return (n,) values, 1/m, each drawn relative to the one before it; the first relative to 0.

    See `next_curvature` for the distribution. The paper does not say what the first one is relative
    to, its published code takes 0.
    """
    return _continued(rng, 0.0, n, bound, max_change)


def append(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray:
    """P1: return the road with 1..5 new values at its end, which continue from its last value."""
    count = _count(rng, options)
    new = _continued(rng, float(curvatures[-1]), count, options.bound, options.max_change)
    return np.concatenate((curvatures, new))


def remove_random(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray | None:
    """P2: return the road without 1..5 values at random positions.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removable(rng, curvatures, options)
    if count == 0:
        return None
    remains = np.ones(len(curvatures), dtype=np.bool_)
    remains[rng.choice(len(curvatures), size=count, replace=False)] = False
    return curvatures[remains]


def remove_front(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray | None:
    """P3: return the road without its first 1..5 values.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removable(rng, curvatures, options)
    return curvatures[count:].copy() if count else None


def remove_end(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray | None:
    """P4: return the road without its last 1..5 values.

    Fewer are removed where fewer than `MIN_VALUES` would remain; None if none can be removed.
    """
    count = _removable(rng, curvatures, options)
    return curvatures[:-count].copy() if count else None


def replace_random(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray:
    """P5: return the road with new values at 1..5 random positions.

    They are drawn from left to right, each relative to the value then before it, the very first
    relative to 0. How they fit the value after them is left to chance.
    """
    n = len(curvatures)
    count = min(_count(rng, options), n)
    positions = np.sort(rng.choice(n, size=count, replace=False)).tolist()
    mutant = curvatures.copy()
    for i in positions:
        u = rng.random()
        previous = float(mutant[i - 1]) if i > 0 else 0.0
        mutant[i] = next_curvature(previous, u, bound=options.bound, max_change=options.max_change)
    return mutant


def scale(
    rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions = LISTING_1
) -> FloatArray:
    """P6: return all values times one factor that is uniform in 1.1..1.2.

    The paper says by how much values grow, not that all have one factor; its published code has.
    """
    return curvatures * rng.uniform(options.min_scale, options.max_scale)


def reverse_road(curvatures: FloatArray) -> FloatArray:
    """F1: return the same road from its other end, which is driven in its other lane.

    What turns left one way turns right the other way, so the values are reversed and negated.
    """
    return -curvatures[::-1]


def reverse_values(curvatures: FloatArray) -> FloatArray:
    """F2: return the values in reverse order: the mirror image of `reverse_road`."""
    return curvatures[::-1].copy()


def swap_halves(curvatures: FloatArray) -> FloatArray:
    """F3: return κ_{floor(N/2)} .. κ_{N-1}, κ_0 .. κ_{floor(N/2)-1}.

    It undoes itself for even N only.
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

    A front half of N values is the first floor(N/2) of them, so the children of parents of N and M
    values have floor(N/2) + ceil(M/2) and floor(M/2) + ceil(N/2) values.
    """
    i, j = len(first) // 2, len(second) // 2
    return np.concatenate((first[:i], second[j:])), np.concatenate((second[:j], first[i:]))


PassOperator: TypeAlias = Callable[
    [np.random.Generator, FloatArray, MutationOptions], "FloatArray | None"
]
FailOperator: TypeAlias = Callable[[FloatArray], FloatArray]

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
"""Mutations of a parent that passed, in the order in which they are tried; None: not applicable."""

FAIL_OPERATORS: Mapping[str, FailOperator] = MappingProxyType(
    {"F1": reverse_road, "F2": reverse_values, "F3": swap_halves, "F4": flip}
)
"""Mutations of a parent that failed, in the order in which they are tried."""

DOES: Mapping[str, str] = MappingProxyType(
    {
        "random": "draws a new road",
        "P1": "adds new values at the end",
        "P2": "removes values anywhere",
        "P3": "removes values from the front",
        "P4": "removes values from the end",
        "P5": "replaces values anywhere",
        "P6": "multiplies all values by one factor",
        "F1": "drives the road from its other end",
        "F2": "reverses the order of the values",
        "F3": "puts the second half first",
        "F4": "mirrors the road: left becomes right",
        "C1": "takes each value from either of two parents",
        "C2": "joins halves of two parents",
        "redraw": "draws the road behind the critical place anew",
        "shift": "bends the road more to one side behind the place",
        "jitter": "changes all values a little",
        "local": "changes values around the place",
        "prefix": "leads another way to the place",
        "approach": "draws the values before the place anew",
        "scale": "multiplies all values by one factor",
        "splice": "goes on behind the place as another road does",
        "amplify": "sharpens the bend",
        "flatten": "straightens the way to the place, for more speed",
        "mirror": "mirrors the road: left becomes right",
        "straight": "puts a straight before the place",
        "rest": "goes on behind the place where the car left its lane",
        "given": "drives a stretch of a real road",
        "earlier": "drives a road of an earlier campaign again",
    }
)
"""Name of an operator -> what it does, in a few words for people."""


def _continued(
    rng: np.random.Generator, previous: float, n: int, bound: float, max_change: float
) -> FloatArray:
    values = []
    for u in rng.random(n).tolist():
        previous = next_curvature(previous, u, bound=bound, max_change=max_change)
        values.append(previous)
    return np.array(values, dtype=np.float64)


def _count(rng: np.random.Generator, options: MutationOptions) -> int:
    return int(rng.integers(options.min_changed, options.max_changed, endpoint=True))


def _removable(rng: np.random.Generator, curvatures: FloatArray, options: MutationOptions) -> int:
    return max(0, min(_count(rng, options), len(curvatures) - MIN_VALUES))
