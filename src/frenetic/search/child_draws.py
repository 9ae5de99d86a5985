"""Draws of children: a parent's road is varied until a child may fail in a new way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
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
from frenetic.search.known_failures import Known, near_failure
from frenetic.search.speed_model import predict
from frenetic.search.variation import (
    MIRROR,
    PARAMETERS,
    RoadSite,
    copy_values,
    draw_fresh_ends,
    scale_values,
    vary,
)

FAILURE_DISTANCES = (0.0, -5.0, 5.0, 10.0, 15.0)
"""Distances from the parent's place to the places where a child may fail, in m, the likeliest first
(our choice)."""
_FAILURE_POINTS = tuple(
    POINTS_BEHIND + round((distance - min(FAILURE_DISTANCES)) / SPACING)
    for distance in FAILURE_DISTANCES
)
"""Indices of the points at these distances, among points of the road every `SPACING` m. The first
point lies `BEHIND` m before the first place where a child may fail."""
_POINTS = max(_FAILURE_POINTS) + round(AHEAD / SPACING) + 1
"""Number of points of the road, up to `AHEAD` m after the last place where a child may fail."""
_MAX_LIKELY_REFUSERS = 8
"""Largest number of failures that refused siblings of a child, and are compared with the child
first (our choice)."""


class Parent(NamedTuple):
    """A place of the archive whose road is varied."""

    curvatures: FloatArray
    """Curvatures of the road, (N,) in 1/m."""
    step: float
    """Distance between two curvatures, in m."""
    place: float
    """Distance along the road to the critical place, in m."""
    approach: FloatArray
    """Approach to the place, (64,) in m."""


class ChildDraws(NamedTuple):
    """Random choices for k draws of a child, each of which may be refused."""

    operators: IntArray
    """Numbers of the operators, (k,)."""
    u: FloatArray
    """Uniform random numbers, a row for each draw, see `variation`'s table."""
    mates: FloatArray
    """Curvatures of another road of the archive for each draw, (k, room) in 1/m."""
    mate_sizes: IntArray
    """Numbers of values of these roads, (k,)."""
    mate_sites: IntArray
    """Sites of these roads, (k,)."""
    lengths: IntArray
    """Usual numbers of values of a road, for children with a new end, (k,)."""
    run_ups: FloatArray
    """Lengths of road before the place that a child keeps from its parent, (k,) in m. It keeps
    `variation.AFTER_SHARE` times as much after the place, and its ends are drawn anew. 0: the child
    has no fresh ends."""

    def after(self, draw: int) -> ChildDraws:
        """Return the draws after the draw with an index."""
        return ChildDraws._make(values[draw + 1 :] for values in self)


class RefusingFailures(NamedTuple):
    """Known failures that refuse children who are expected to fail as these failures did."""

    same_side: Known
    """Known failures on the parent's side."""
    opposite_side: Known
    """Known failures on the other side, for a mirrored child."""
    least_difference: float
    """Least difference of a child from these failures, in m."""


@njit()
def _refusing_failure(
    failures: Known,
    expected: FloatArray,
    square: float,
    table: FloatArray,
    ds: float,
    place: float,
    likely_refusers: IntArray,
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
        likely_refusers: Rows of failures that are compared first.
    """
    points = points_along(table, ds, place + min(FAILURE_DISTANCES) - BEHIND, _POINTS)
    for point in _FAILURE_POINTS:
        set_points(expected, points, point)
        for row in likely_refusers:
            if squared_difference(failures.vectors[row], expected, square) < square:
                return int(row)
    for point in _FAILURE_POINTS:
        set_points(expected, points, point)
        near: int = near_failure(failures, expected, square)
        if near >= 0:
            return near
    return -1


@njit(interpret_first=6.5)
def draw_child(
    parent: Parent,
    draws: ChildDraws,
    refusing: RefusingFailures,
    limits: FloatArray,
    weights: FloatArray,
    child: FloatArray,
    expected: FloatArray,
) -> tuple[int, int, int]:
    """Draw children until one is expected to fail differently from every known failure.

    A child is expected to fail at one of the `FAILURE_DISTANCES` from the parent's place, with the
    parent's offsets, and with the parent's speeds plus the change that the model predicts.

    Args:
        parent: The parent.
        draws: Random choices, for one child each; they are tried in order.
        refusing: Known failures, and the least difference from them.
        limits: See `variation.vary`.
        weights: See `SpeedModel.weights`; empty if no speeds are predicted.
        child: Room for the child's curvatures, in 1/m.
        expected: Room for the approach with which the child is expected to fail, (64,) in m.

    Returns:
        The index of the child's draw, the number of its values, and by how many values the place
        has moved. The index is -1 if all draws are refused.

    """
    step, room = parent.step, len(child)
    speeds, child_speeds = np.empty(STATES), np.empty(STATES)  # [m/s] predicted before the place
    # A copy is writable like `child`: kernels are compiled for writable arrays alone.
    road = RoadSite(
        parent.curvatures.copy(), min(int(parent.place / step), len(parent.curvatures) - 1)
    )
    if len(weights):
        predict(weights, road.curvatures, step, parent.place - BEHIND, speeds)
    # A failure that refused a sibling is likely to refuse the next child.
    recent_refusers, refusals = np.empty(_MAX_LIKELY_REFUSERS, np.int64), 0
    least_square = refusing.least_difference * refusing.least_difference
    for k in range(len(draws.operators)):
        is_mirrored = draws.operators[k] == MIRROR
        mate = RoadSite(draws.mates[k, : draws.mate_sizes[k]], draws.mate_sites[k])
        n, moved = vary(draws.operators[k], draws.u[k], road, mate, draws.lengths[k], limits, child)
        if n == 0:
            continue
        child_place = parent.place + moved * step
        if draws.run_ups[k] > 0.0:
            fresh_numbers = draws.u[k][PARAMETERS + room :]
            draw_fresh_ends(child[:n], step, child_place, draws.run_ups[k], fresh_numbers, limits)
        copy_values(parent.approach, 0, expected, 0, len(parent.approach))
        if is_mirrored:
            scale_values(expected, ROAD_SIZE, ROAD_SIZE + STATES, -1.0)  # the offsets
        elif len(weights):
            predict(weights, child[:n], step, child_place - BEHIND, child_speeds)
            for i in range(STATES):
                expected[ROAD_SIZE + STATES + i] += (child_speeds[i] - speeds[i]) * STATE_SCALE
        table, ds, table_start = table_around(
            child[:n],
            step,
            child_place + min(FAILURE_DISTANCES),
            child_place + max(FAILURE_DISTANCES),
        )
        table_place = child_place - table_start
        # The refusers lie on the parent's side, so they do not count for a mirrored child.
        failures = refusing.opposite_side if is_mirrored else refusing.same_side
        likely_count = 0 if is_mirrored else min(refusals, _MAX_LIKELY_REFUSERS)
        likely_refusers = recent_refusers[:likely_count]
        refuser = _refusing_failure(
            failures, expected, least_square, table, ds, table_place, likely_refusers
        )
        if refuser < 0:
            set_road(expected, table, ds, table_place)
            return k, n, moved
        if not is_mirrored:
            recent_refusers[refusals % _MAX_LIKELY_REFUSERS] = refuser
            refusals += 1
    return -1, 0, 0
