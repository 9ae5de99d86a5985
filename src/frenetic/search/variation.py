"""Operators that vary a road around a critical place.

The *place*, a distance along the road, is where the car failed or came near failing on the parent's
road; the *site* is the index of the road's value just before the place. An operator makes a child's
curvatures, (n,) 1/m, from the parent's and from uniform random numbers, and returns by how many
values the place has moved along the road. New values are drawn as in Section I-B of the paper, each
relative to the value before it. In the end all values are kept within the bound, and each within
the largest change from the value before it. The sizes of the changes are our choice.

============  ====================================================================================
operator      what it changes
============  ====================================================================================
``redraw``    the road after the place, or from up to 2 values before it, is drawn anew
``shift``     1 to 3 values in a row at the place change by the same amount
``jitter``    all values change a little, each by its own amount
``local``     1 to 3 values from 5 before to 3 after the place change, each by its own amount
``prefix``    the road up to 3 to 6 values before the place is drawn anew, with 3 to 15 values
``approach``  3 to 6 values shortly before the place are drawn anew
``scale``     all values are multiplied by one factor
``splice``    the road after the place becomes the mate's road from shortly before the mate's place
``amplify``   the bend at the place, 3 values to either side, is made sharper
``flatten``   the 7 values before that bend are made straighter, so that the car comes faster
``mirror``    left and right change places
``straight``  2 to 5 values of a straight are put in shortly before the place
============  ====================================================================================

A draw takes a row ``u`` of uniform random numbers from 0 to 1. Where a child has room for m values,
the row is:

=====================  =============================================================
numbers                meaning
=====================  =============================================================
`PARAMETERS`           the operator's parameters, such as how many values it changes
m                      one for each drawn value, in their order, and for ``jitter``
m                      one for each value of the child's fresh ends
=====================  =============================================================
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road.conforming import conform
from frenetic.search.elements import draw_elements
from frenetic.search.operators import CURVATURE_BOUND

_OPERATORS_FOR_ALL = (
    "redraw",
    "shift",
    "jitter",
    "local",
    "prefix",
    "approach",
    "scale",
    "splice",
)
_OPERATORS_FOR_NEAR_MISSES = ("amplify", "flatten", "mirror", "straight")
OPERATORS = _OPERATORS_FOR_ALL + _OPERATORS_FOR_NEAR_MISSES
"""Names of the operators. The number of an operator is its index."""
FAILURE_OPERATOR_COUNT = len(_OPERATORS_FOR_ALL)
"""Roads of failures use only so many of `OPERATORS`, the first; near misses use all."""

# Constants, since compiled code cannot look up names.
REDRAW = OPERATORS.index("redraw")
SHIFT = OPERATORS.index("shift")
JITTER = OPERATORS.index("jitter")
LOCAL = OPERATORS.index("local")
PREFIX = OPERATORS.index("prefix")
APPROACH = OPERATORS.index("approach")
SCALE = OPERATORS.index("scale")
SPLICE = OPERATORS.index("splice")
AMPLIFY = OPERATORS.index("amplify")
FLATTEN = OPERATORS.index("flatten")
MIRROR = OPERATORS.index("mirror")
STRAIGHT = OPERATORS.index("straight")

PARAMETERS = 8
"""Number of an operator's parameters: uniform random numbers beside one for each value."""
MIN_REST = 3
"""Least number of values after the site that a road has if they are redrawn (our choice)."""
AFTER_SHARE = 1.0 / 3.0
"""Length of road after the place that a child with a fresh road keeps, as a share of the length
before the place (our choice)."""
_MIN_VALUES = 5  # least number of values of a child (our choice)


class RoadSite(NamedTuple):
    """A road and the index of its value just before a place."""

    curvatures: FloatArray
    """Curvatures, (N,) in 1/m."""
    site: int
    """Index of the value just before the place."""


@njit()
def has_class(limits: FloatArray) -> bool:
    """Return whether limits are a road class's: `RoadClass.limits` has 4, others are 2."""
    return len(limits) > 2


@njit()
def _whole(u: float, low: float, high: float) -> int:
    """Return a whole number from `low` to `high`, both whole, from a uniform random number.

    The bounds are floats, because numba compiles a form for every literal of an int.
    """
    return int(low) + int(u * (high - low + 1.0))


@njit()
def _between(u: float, low: float, high: float) -> float:
    """Return a number from `low` to `high` from a uniform random number."""
    return low + u * (high - low)


@njit()
def copy_values(values: FloatArray, first: int, child: FloatArray, start: int, end: int) -> None:
    """Copy values from index `first` on to start..end-1 of a child."""
    # A loop, since numba takes two seconds to compile the assignment of a slice.
    for i in range(start, end):
        child[i] = values[first + i - start]


@njit()
def scale_values(child: FloatArray, first: int, end: int, factor: float) -> None:
    """Multiply values first..end-1 of a child by a factor."""
    for i in range(first, end):
        child[i] *= factor


@njit()
def limit_changes(values: FloatArray, site: int, max_change: float) -> None:
    """Change values so that neighbours differ by at most `max_change`, and the first from 0.

    The value at the site stays, if the start allows it; the others follow from there to both ends.
    """
    n = len(values)
    for i in range(site + 1, n):
        values[i] = min(max(values[i], values[i - 1] - max_change), values[i - 1] + max_change)
    for i in range(site - 1, -1, -1):
        values[i] = min(max(values[i], values[i + 1] - max_change), values[i + 1] + max_change)
    previous = 0.0
    for i in range(n):
        limited = min(max(values[i], previous - max_change), previous + max_change)
        if limited == values[i]:
            break
        values[i] = previous = limited


@njit()
def _draw(
    child: FloatArray,
    first: int,
    end: int,
    previous: float,
    numbers: FloatArray,
    limits: FloatArray,
) -> None:
    """Draw values first..end-1 of a child: in a road class as straights, clothoids and arcs.

    Without a class, they are drawn as `operators.next_curvature` does, which is repeated here to be
    compiled.

    Args:
        child: Values of the child.
        first: Index of the first value to draw.
        end: Index after the last value to draw.
        previous: Value before the first, in 1/m.
        numbers: Uniform random numbers, one for each value.
        limits: See `vary`.
    """
    if has_class(limits):
        draw_elements(child, first, end, previous, numbers, 0, limits)
        return
    bound, max_change = limits[0], limits[1]
    for i in range(first, end):
        low = min(max(previous - max_change, -bound), bound)
        high = max(min(previous + max_change, bound), -bound)
        previous = low + numbers[i - first] * (high - low)
        child[i] = previous


@njit()
def _change_values(
    operator: int, u: FloatArray, parent: RoadSite, limits: FloatArray, child: FloatArray
) -> None:
    """Change values of a child, a copy of its parent, by an operator that keeps their number.

    Changes are in 1/m, for the competition's bound; `size` scales them to another bound. Counts
    and distances are in values; factors of curvatures have no unit. See `vary` for the arguments.
    """
    n, site, numbers = len(child), parent.site, u[PARAMETERS:]
    size = limits[0] / CURVATURE_BOUND  # scale of changes: 1 on the competition's roads
    if operator == SHIFT:  # 1 to 3 values, from just before or just after the place on
        first = min(site + _whole(u[0], 0.0, 1.0), n - 1)
        change = _between(u[1], 0.02, 0.06) * size
        change = change if u[2] < 0.5 else -change
        for i in range(first, min(first + _whole(u[3], 1.0, 3.0), n)):
            child[i] += change
    elif operator == JITTER:
        width = _between(u[0], 0.005, 0.035) * size
        k = 0
        for i in range(n):
            # In a road class an arc changes as a whole.
            in_arc = (
                has_class(limits) and i > 0 and parent.curvatures[i] == parent.curvatures[i - 1]
            )
            k = k if in_arc else i
            child[i] += width * (2.0 * numbers[k] - 1.0)
    elif operator == LOCAL:  # 1 to 3 values around the place
        for k in range(_whole(u[0], 1.0, 3.0)):
            i = min(max(site + _whole(u[1 + 2 * k], -5.0, 3.0), 0), n - 1)
            child[i] += _between(u[2 + 2 * k], -0.05, 0.05) * size
    elif operator == APPROACH:  # 3 to 6 values before the place, drawn anew
        end = max(site - _whole(u[0], 0.0, 2.0), 1)
        start = max(end - _whole(u[1], 3.0, 6.0), 0)
        _draw(child, start, end, child[start - 1] if start > 0 else 0.0, numbers, limits)
    elif operator == SCALE:
        scale_values(child, 0, n, _between(u[0], 0.8, 1.25))
    elif operator == AMPLIFY:  # the bend
        scale_values(child, max(site - 3, 0), min(site + 3, n), _between(u[0], 1.1, 1.6))
    elif operator == FLATTEN:  # the way to the place, on which the car becomes faster
        scale_values(child, max(site - 9, 0), max(site - 2, 0), _between(u[0], 0.2, 0.8))
    elif operator == MIRROR:
        scale_values(child, 0, n, -1.0)


@njit(interpret_first=2.9)
def vary(
    operator: int,
    u: FloatArray,
    parent: RoadSite,
    mate: RoadSite,
    length: int,
    limits: FloatArray,
    child: FloatArray,
) -> tuple[int, int]:
    """Make a child; return its number of values and by how many values the place has moved.

    The number of values is 0 if the child would have too few or too many. Counts and distances are
    in values.

    Args:
        operator: Number of the operator.
        u: Uniform random numbers, see the module's table; the numbers of fresh ends may be absent.
        parent: The parent's road.
        mate: Another road of the archive, for the operator `SPLICE`.
        length: Usual number of values of a road, for a child with a new end.
        limits: Bound and largest change of values, both in 1/m; or a road class's `limits`, whose
            rules the child then keeps.
        child: Room for the child's values.

    """
    road, site, numbers = parent.curvatures, parent.site, u[PARAMETERS:]
    room, bound = len(child), limits[0]
    n, moved = len(road), 0
    # A road of another length has at most the usual one, but `MIN_REST` values after the site.
    if operator == REDRAW:  # the road after the place, or from shortly before it
        keep = max(site + 1 - _whole(u[0], 0.0, 2.0), 2)
        n = max(length, keep + MIN_REST)
        if n <= room:
            copy_values(road, 0, child, 0, keep)
            _draw(child, keep, n, child[keep - 1], numbers, limits)
    elif operator == PREFIX:  # another way to the place
        start = max(site - _whole(u[0], 3.0, 6.0), 0)
        new = _whole(u[1], 3.0, 15.0)
        moved = new - start
        n = min(len(road) + moved, max(length, site + moved + MIN_REST))
        if n <= room:
            _draw(child, 0, new, 0.0, numbers, limits)
            copy_values(road, start, child, new, n)
    elif operator == SPLICE:  # the mate's road from its place on
        keep = max(site + 1 - _whole(u[0], 0.0, 2.0), 2)
        start = max(mate.site - _whole(u[1], 2.0, 6.0), 0)
        n = min(keep + len(mate.curvatures) - start, max(length, keep + MIN_REST))
        if n <= room:
            copy_values(road, 0, child, 0, keep)
            copy_values(mate.curvatures, start, child, keep, n)
    elif operator == STRAIGHT:  # a straight before the place
        start = max(site - _whole(u[0], 1.0, 3.0), 0)
        moved = _whole(u[1], 2.0, 5.0)
        n = min(len(road) + moved, max(length, site + moved + MIN_REST))
        if n <= room:
            copy_values(road, 0, child, 0, start)
            for i in range(start, start + moved):
                child[i] = 0.0
            copy_values(road, start, child, start + moved, n)
    elif n <= room:
        copy_values(road, 0, child, 0, n)
        _change_values(operator, u, parent, limits, child[:n])
    if not _MIN_VALUES <= n <= room:
        return 0, 0
    for i in range(n):
        child[i] = min(max(child[i], -bound), bound)
    _keep_limits(child[:n], min(site + moved, n - 1), limits)
    return n, moved


@njit()
def _keep_limits(child: FloatArray, site: int, limits: FloatArray) -> None:
    """Change values so that they keep the rules of the road class, or else the largest change."""
    if has_class(limits):
        conform(child, limits, np.empty(len(child)))
    else:
        limit_changes(child, site, limits[1])


@njit()
def draw_fresh_ends(
    child: FloatArray,
    step: float,
    place: float,
    run_up: float,
    numbers: FloatArray,
    limits: FloatArray,
) -> None:
    """Draw a child's values anew, except around the place.

    Args:
        child: Values of the child, (n,) in 1/m.
        step: Distance between two values, in m.
        place: Distance along the child's road to the place, in m.
        run_up: Length of road before the place that stays, in m; after the place, `AFTER_SHARE`
            times as much stays.
        numbers: Uniform random numbers, one for each value.
        limits: See `vary`.
    """
    n = len(child)
    first = max(int((place - run_up) / step), 0)
    end = min(int((place + AFTER_SHARE * run_up) / step) + 1, n)
    _draw(child, 0, first, 0.0, numbers, limits)
    _draw(child, end, n, child[end - 1], numbers[first:], limits)
    _keep_limits(child, min(int(place / step), n - 1), limits)
