"""Operators that vary a road around a critical place, and the kernel that tries them.

The place is where the car failed or came near failing on the parent's road; the *site* is the index
of the parent's value just before it. An operator makes a child's curvatures, (n,) 1/m, from the
parent's and from uniform random numbers, and returns by how many values the place has moved along
the road. New values are drawn as in Section I-B of the paper, each relative to the value before it.
Changed values are kept within the bound. The sizes of the changes are our choice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road.conforming import conform
from frenetic.search.approach import (
    AHEAD,
    BEHIND,
    POINTS_BEHIND,
    ROAD_SIZE,
    SPACING,
    STATE_SCALE,
    STATES,
    points_along,
    set_points,
    set_road,
    squared_difference,
    table_around,
)
from frenetic.search.elements import draw_elements
from frenetic.search.known_failures import Known, near_failure
from frenetic.search.operators import CURVATURE_BOUND
from frenetic.search.speed_model import predict

if TYPE_CHECKING:
    from typing import TypeAlias

    import numpy.typing as npt

    IntArray: TypeAlias = npt.NDArray[np.int64]

(
    REDRAW,
    SHIFT,
    JITTER,
    LOCAL,
    PREFIX,
    APPROACH,
    SCALE,
    SPLICE,
    AMPLIFY,
    FLATTEN,
    MIRROR,
    STRAIGHT,
) = range(12)

OPERATORS = (
    "redraw",
    "shift",
    "jitter",
    "local",
    "prefix",
    "approach",
    "scale",
    "splice",
    "amplify",
    "flatten",
    "mirror",
    "straight",
)
"""Names of the operators, in the order of their numbers."""
OPERATORS_FOR_FAILURES = SPLICE + 1
"""Number of operators for the roads of failures: the first of `OPERATORS`. Near misses have all."""

PARAMETERS = 8
"""Number of uniform random numbers that an operator takes beside one for each new value."""
MIN_REST = 3
"""Least number of values after the site that a road has if they are redrawn (our choice)."""
AFTER = 1.0 / 3.0
"""Length of road after the place that a child with a fresh road keeps, as a share of the length
before the place (our choice)."""
FAILURE_DISTANCES = (0.0, -5.0, 5.0, 10.0, 15.0)
"""Distances from the parent's place to the places where a child may fail, in m, the likeliest first
(our choice)."""
_FAILURE_POINTS = tuple(
    POINTS_BEHIND + round((distance - min(FAILURE_DISTANCES)) / SPACING)
    for distance in FAILURE_DISTANCES
)
"""Indices of the points at these places, among the points from `BEHIND` m before the first place
on."""
_POINTS = max(_FAILURE_POINTS) + round(AHEAD / SPACING) + 1
"""Number of these points, up to `AHEAD` m after the last place."""
_RECENT_FAILURES = 8
"""Failures that refused siblings of a child and are compared with the child first (our choice)."""
_MIN_VALUES = 5  # least number of values of a child (our choice)


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
def _copy(values: FloatArray, first: int, child: FloatArray, at: int, end: int) -> None:
    """Copy values from index `first` on to at..end-1 of a child."""
    # A loop, since numba takes two seconds to compile the assignment of a slice.
    for i in range(at, end):
        child[i] = values[first + i - at]


@njit()
def _scale(child: FloatArray, first: int, end: int, by: float) -> None:
    """Multiply values first..end-1 of a child."""
    for i in range(first, end):
        child[i] *= by


@njit()
def _draw(
    child: FloatArray, first: int, end: int, previous: float, u: FloatArray, limits: FloatArray
) -> None:
    """Draw values first..end-1 of a child by `operators.next_curvature`; in a class as elements.

    Args:
        child: Values of the child.
        first: Index of the first value to draw.
        end: Index after the last value to draw.
        previous: Value before the first, in 1/m.
        u: Uniform random numbers, from index `PARAMETERS` on one for each value.
        limits: See `vary`.
    """
    if len(limits) > 2:
        draw_elements(child, first, end, previous, u, PARAMETERS, limits)
        return
    bound, change = limits[0], limits[1]
    for i in range(first, end):
        low = min(max(previous - change, -bound), bound)
        high = max(min(previous + change, bound), -bound)
        previous = low + u[PARAMETERS + i - first] * (high - low)
        child[i] = previous


@njit()
def _change_values(
    operator: int,
    u: FloatArray,
    parent: FloatArray,
    site: int,
    limits: FloatArray,
    child: FloatArray,
) -> None:
    """Change values of a child, a copy of its parent, by an operator that keeps their number.

    See `vary` for the arguments.
    """
    n = len(child)
    size = limits[0] / CURVATURE_BOUND  # scale of changes: 1 on the competition's roads
    if operator == SHIFT:  # 1 to 3 values just after the place
        first = min(site + _whole(u[0], 0.0, 1.0), n - 1)
        by = _between(u[1], 0.02, 0.06) * size
        by = by if u[2] < 0.5 else -by
        for i in range(first, min(first + _whole(u[3], 1.0, 3.0), n)):
            child[i] += by
    elif operator == JITTER:
        width = _between(u[0], 0.005, 0.035) * size
        k = 0
        for i in range(n):
            # In a class an arc changes as a whole.
            k = k if len(limits) > 2 and i > 0 and parent[i] == parent[i - 1] else i
            child[i] += width * (2.0 * u[PARAMETERS + k] - 1.0)
    elif operator == LOCAL:  # 1 to 3 values around the place
        for k in range(_whole(u[0], 1.0, 3.0)):
            i = min(max(site + _whole(u[1 + 2 * k], -5.0, 3.0), 0), n - 1)
            child[i] += _between(u[2 + 2 * k], -0.05, 0.05) * size
    elif operator == APPROACH:  # 3 to 6 values before the place
        end = max(site - _whole(u[0], 0.0, 2.0), 1)
        start = max(end - _whole(u[1], 3.0, 6.0), 0)
        _draw(child, start, end, child[start - 1] if start > 0 else 0.0, u, limits)
    elif operator == SCALE:
        _scale(child, 0, n, _between(u[0], 0.8, 1.25))
    elif operator == AMPLIFY:  # the bend
        _scale(child, max(site - 3, 0), min(site + 3, n), _between(u[0], 1.1, 1.6))
    elif operator == FLATTEN:  # the way to the place, on which the car becomes faster
        _scale(child, max(site - 9, 0), max(site - 2, 0), _between(u[0], 0.2, 0.8))
    elif operator == MIRROR:
        _scale(child, 0, n, -1.0)


@njit()
def vary(
    operator: int,
    u: FloatArray,
    parent: FloatArray,
    site: int,
    other: FloatArray,
    other_site: int,
    length: int,
    limits: FloatArray,
    child: FloatArray,
) -> tuple[int, int]:
    """Make a child; return its number of values and by how many values the place has moved.

    The number of values is 0 if the child would have too few or too many.

    Args:
        operator: Number of the operator.
        u: Uniform random numbers: `PARAMETERS`, then one for each value of `child`.
        parent: (N,) 1/m.
        site: Index of the value before the place.
        other: (M,) 1/m, another road of the archive.
        other_site: Index of the value before the other road's place.
        length: Usual number of values of a road, for a child with a new end.
        limits: Bound and largest change of new values, both in 1/m; or a road class's `limits`,
            whose rules the child then keeps.
        child: Room for the child's values.

    """
    most = len(child)
    n, moved = len(parent), 0
    bound = limits[0]
    if operator == REDRAW:  # the road after the place, or from shortly before it
        keep = max(site + 1 - _whole(u[0], 0.0, 2.0), 2)
        n = max(length, keep + MIN_REST)
        if n <= most:
            _copy(parent, 0, child, 0, keep)
            _draw(child, keep, n, child[keep - 1], u, limits)
    elif operator == PREFIX:  # another way to the place
        start = max(site - _whole(u[0], 3.0, 6.0), 0)
        new = _whole(u[1], 3.0, 15.0)
        moved = new - start
        n = min(len(parent) + moved, max(length, site + moved + MIN_REST))
        if n <= most:
            _draw(child, 0, new, 0.0, u, limits)
            _copy(parent, start, child, new, n)
    elif operator == SPLICE:  # the other's road from its place on
        keep = max(site + 1 - _whole(u[0], 0.0, 2.0), 2)
        start = max(other_site - _whole(u[1], 2.0, 6.0), 0)
        n = min(keep + len(other) - start, max(length, keep + MIN_REST))
        if n <= most:
            _copy(parent, 0, child, 0, keep)
            _copy(other, start, child, keep, n)
    elif operator == STRAIGHT:  # a straight before the place
        start = max(site - _whole(u[0], 1.0, 3.0), 0)
        moved = _whole(u[1], 2.0, 5.0)
        n = min(len(parent) + moved, max(length, site + moved + MIN_REST))
        if n <= most:
            _copy(parent, 0, child, 0, start)
            for i in range(start, start + moved):
                child[i] = 0.0
            _copy(parent, start, child, start + moved, n)
    elif n <= most:
        _copy(parent, 0, child, 0, n)
        _change_values(operator, u, parent, site, limits, child[:n])
    if not _MIN_VALUES <= n <= most:
        return 0, 0
    for i in range(n):
        child[i] = min(max(child[i], -bound), bound)
    if len(limits) > 2:
        conform(child[:n], limits, np.empty(n))
    return n, moved


@njit()
def _draw_fresh_ends(
    child: FloatArray,
    step: float,
    place: float,
    run_up: float,
    u: FloatArray,
    limits: FloatArray,
) -> None:
    """Draw a child's values anew, except around the place.

    Kept are `run_up` m before the place and `AFTER` times as much after it. See `draw_child` for
    the arguments.
    """
    n = len(child)
    first = max(int((place - run_up) / step), 0)
    end = min(int((place + AFTER * run_up) / step) + 1, n)
    _draw(child, 0, first, 0.0, u, limits)
    _draw(child, end, n, child[end - 1], u[first:], limits)
    if len(limits) > 2:
        conform(child, limits, np.empty(n))


@njit()
def _refusing_failure(
    failures: Known,
    expected: FloatArray,
    square: float,
    table: FloatArray,
    ds: float,
    place: float,
    recent: IntArray,
) -> int:
    """Return the row of a known failure that refuses a child; -1 if there is none.

    Args:
        failures: Known failures.
        expected: Approach with which the child is expected to fail, (64,) in m; its road is
            overwritten.
        square: Squared difference below which a failure refuses the child, in m².
        table: Table of the child's road, see `table_around`.
        ds: Distance between two rows of the table, in m.
        place: Distance along the table's road to the place, in m. The child may fail at any of the
            `FAILURE_DISTANCES` from there.
        recent: Rows of failures that are compared first.
    """
    points = points_along(table, ds, place + min(FAILURE_DISTANCES) - BEHIND, _POINTS)
    for point in _FAILURE_POINTS:
        set_points(expected, points, point)
        for row in recent:
            if squared_difference(failures.vectors[row], expected, square) < square:
                return int(row)
    for point in _FAILURE_POINTS:
        set_points(expected, points, point)
        near: int = near_failure(failures, expected, square)
        if near >= 0:
            return near
    return -1


@njit()
def draw_child(
    operators: IntArray,
    u: FloatArray,
    parent: FloatArray,
    step: float,
    place: float,
    vector: FloatArray,
    others: FloatArray,
    other_sizes: IntArray,
    other_sites: IntArray,
    lengths: IntArray,
    limits: FloatArray,
    known: Known,
    opposite: Known,
    least: float,
    run_ups: FloatArray,
    weights: FloatArray,
    child: FloatArray,
    expected: FloatArray,
) -> tuple[int, int, int]:
    """Draw children until one is expected to fail as no known failure did.

    A child is expected to fail at one of the `FAILURE_DISTANCES` from the parent's place, with the
    parent's offsets, and with the parent's speeds plus the change that the model predicts.

    Args:
        operators: (k,) numbers of the operators, one for each draw.
        u: (k, m) uniform random numbers for each draw: see `vary`, then as many as the child has
            room for.
        parent: Curvatures of the parent, (N,) in 1/m.
        step: Distance between two curvatures, in m.
        place: Distance along the parent's road to the critical place, in m.
        vector: The parent's approach to the place, (64,) in m.
        others: Curvatures of another road of the archive for each draw, (k, room) in 1/m.
        other_sizes: (k,) numbers of values of the other roads.
        other_sites: (k,) indices of the values before the places of the other roads.
        lengths: (k,) usual numbers of values of a road, see `vary`.
        limits: See `vary`.
        known: Known failures on the parent's side.
        opposite: Known failures on the other side, for a mirrored child.
        least: Least difference from these failures, in m.
        run_ups: (k,) lengths in m. A child keeps its parent's road so far before the place, and
            `AFTER` times as far after it; the rest is drawn anew. 0: the child keeps all of it.
        weights: See `SpeedModel.weights`; empty if no speeds are predicted.
        child: Room for the child's curvatures, in 1/m.
        expected: Room for the approach with which the child is expected to fail, (64,) in m.

    Returns:
        The index of the child's draw, the number of its values, and by how many values the place
        has moved. The index is -1 if all draws are refused.

    """
    # Predicted speeds on the parent's road and on the child's, and the room for values.
    before, after, most = np.empty(STATES), np.empty(STATES), len(child)
    road = parent.copy()  # writable like `child`: kernels are compiled for writable arrays alone
    if len(weights):
        predict(weights, road, step, place - BEHIND, before)
    site = min(int(place / step), len(parent) - 1)
    # A failure that refused a sibling is likely to refuse the next child.
    recent, refusals = np.empty(_RECENT_FAILURES, np.int64), 0
    for k in range(len(operators)):
        n, moved = vary(
            operators[k],
            u[k],
            road,
            site,
            others[k, : other_sizes[k]],
            other_sites[k],
            lengths[k],
            limits,
            child,
        )
        if n == 0:
            continue
        _copy(vector, 0, expected, 0, len(vector))
        there = place + moved * step
        if run_ups[k] > 0.0:
            _draw_fresh_ends(child[:n], step, there, run_ups[k], u[k][most:], limits)
        failures = known
        if operators[k] == MIRROR:
            _scale(expected, ROAD_SIZE, ROAD_SIZE + STATES, -1.0)
            failures = opposite
        elif len(weights):
            predict(weights, child[:n], step, there - BEHIND, after)
            for i in range(STATES):
                expected[ROAD_SIZE + STATES + i] += (after[i] - before[i]) * STATE_SCALE
        table, ds, start = table_around(
            child[:n], step, there + min(FAILURE_DISTANCES), there + max(FAILURE_DISTANCES)
        )
        there -= start
        first = recent[: 0 if operators[k] == MIRROR else min(refusals, _RECENT_FAILURES)]
        row = _refusing_failure(failures, expected, least * least, table, ds, there, first)
        if row < 0:
            set_road(expected, table, ds, there)
            return k, n, moved
        if operators[k] != MIRROR:
            recent[refusals % _RECENT_FAILURES] = row
            refusals += 1
    return -1, 0, 0
