"""The assessment of a drive: where each record lies on the road, and whether the drive ends there.

The kernel `assess_record` holds the rules for ending a drive. Simulators call it after every record
to know when to stop, and `assess` calls it for each record of a trajectory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.oracle.lane_share import share_outside
from frenetic.road.geometry import X, Y, heading_at, project_global, project_near, reach_of
from frenetic.road.profile import value_at

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive, Rules
    from frenetic.road import Road

RUNNING, REACHED, LEFT_LANE, STUCK, TIMED_OUT = range(5)
"""States of a drive at a record: it continues, or how it ended."""

_DISTANCE, _OFFSET, _OOB_SHARE = range(3)
"""Columns of the rows that `_assess` returns, one row per record."""
_TIME_ROUNDING: Final = 1e-9
"""Time by which a rounded time may miss `Rules.stuck_time`, in s; our choice."""
_LENGTH_ROUNDING: Final = 1e-9
"""Distance by which the car may be short of the road's end and has reached it, in m; our choice."""


@njit()
def assess_record(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    heading: float,
    i: int,
    s_before: float,
    least: float,
) -> tuple[int, float, float, float, float]:
    """Return the assessment of record ``i``.

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        lane_width: width of a lane outside bends, in m.
        rules: rules, (5,), see `rules_array`.
        car: the car's box, (3,), see `CarBody.to_array`.
        times, xs, ys: columns of the trajectory, filled up to ``i``.
        heading: heading of the car at record ``i``, in rad.
        s_before: distance along the road at record ``i - 1``, in m; not used for record 0.
        least: the kernel may return 0 for an oob share below ``least``, to save time; at most the
            tolerance of the rules.

    Returns:
        State of the drive (`RUNNING` or how it ended), distance ``s`` along the road and lateral
        offset ``d`` from the centre line in m, heading of the road in rad, and oob share.
    """
    x, y = xs[i], ys[i]
    if i == 0:
        s, d = project_global(table, ds, x, y)
    else:
        moved = math.hypot(x - xs[i - 1], y - ys[i - 1])
        s, d = project_near(table, ds, x, y, s_before, reach_of(moved))
    road_heading = heading_at(table, ds, s)
    share = share_outside(
        table,
        ds,
        0.0,
        -lane_width,
        s,
        d,
        road_heading,
        x,
        y,
        heading,
        car[0],
        car[1],
        car[2],
        least,
    )
    tolerance, goal, stuck_distance = rules[0], rules[1], rules[2]
    stuck_time, timeout = rules[3], rules[4]
    last = len(table) - 1
    end = RUNNING
    if share > tolerance:
        end = LEFT_LANE
    elif (
        # Near the end of the centre line; or beyond it, on a lane so wide that the car is not near.
        math.hypot(x - table[last, X], y - table[last, Y]) <= goal and s >= last * ds - 2.0 * goal
    ) or (s >= last * ds - _LENGTH_ROUNDING and -lane_width <= d <= 0.0):
        end = REACHED
    elif _is_stuck(times, xs, ys, i, stuck_distance, stuck_time):
        end = STUCK
    elif times[i] > timeout:
        end = TIMED_OUT
    return end, s, d, road_heading, share


@njit()
def _is_stuck(
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    i: int,
    stuck_distance: float,
    stuck_time: float,
) -> bool:
    """Return whether a car at record ``i`` is too near to where it was ``stuck_time`` s before."""
    # Find the latest record j that is at least stuck_time old. The first guess assumes records at
    # equal intervals; the loops correct it.
    interval = times[i] - times[i - 1] if i > 0 else 0.0
    j = max(0, i - int(stuck_time / interval)) if interval > 0.0 else i
    while j < i and times[i] - times[j + 1] >= stuck_time - _TIME_ROUNDING:
        j += 1
    while j > 0 and times[i] - times[j] < stuck_time - _TIME_ROUNDING:
        j -= 1
    return bool(
        times[i] - times[j] >= stuck_time - _TIME_ROUNDING
        and math.hypot(xs[i] - xs[j], ys[i] - ys[j]) < stuck_distance
    )


@njit()
def _assess(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    headings: FloatArray,
    least: float,
) -> tuple[int, FloatArray]:
    """Return the state of the drive, and distance, lateral offset and oob share, (n, 3).

    The rows end with the record that ended the drive.
    """
    n = len(times)
    rows = np.empty((n, 3))
    s = 0.0
    for i in range(n):
        end, s, d, _, share = assess_record(
            table, ds, lane_width, rules, car, times, xs, ys, headings[i], i, s, least
        )
        rows[i, _DISTANCE] = s
        rows[i, _OFFSET] = d
        rows[i, _OOB_SHARE] = share
        if end != RUNNING:
            return end, rows[: i + 1]
    return RUNNING, rows


def rules_array(rules: Rules, road_length: float) -> FloatArray:
    """Return the rules for `assess_record`, (5,).

    Tolerated oob share, goal distance in m, stuck distance in m, stuck time and timeout in s.
    """
    return np.array(
        [
            rules.oob_tolerance,
            rules.goal_distance,
            rules.stuck_distance,
            rules.stuck_time,
            rules.timeout(road_length),
        ]
    )


@dataclass(frozen=True)
class Assessment:
    """Position on the road and oob share at each record of a drive, up to its last record."""

    end: int
    """How the drive ended: REACHED, LEFT_LANE, STUCK or TIMED_OUT; RUNNING if no rule ended it."""
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    oob_distance: FloatArray
    """Oob distance, (n,) in m: how far the centre of mass is inside its lane, negative outside."""
    oob_share: FloatArray
    """Share of the car's box outside the ego lane, (n,), 0..1."""


def assess(road: Road, drive: Drive, *, has_shares: bool = True) -> Assessment:
    """Return the assessment of a drive, by `assess_record`.

    Args:
        road: the road that was driven.
        drive: the drive along that road.
        has_shares: whether every oob share is computed; otherwise shares below the tolerance may be
            0, which saves time.
    """
    t = drive.trajectory
    end, rows = _assess(
        road.table,
        road.sub_step,
        road.lane_width,
        rules_array(drive.rules, road.length),
        drive.car.to_array(),
        # Copies are writable, like the arrays for which the rollout has compiled the kernel; for
        # read-only arrays it would be compiled again.
        np.array(t.time),
        np.array(t.x),
        np.array(t.y),
        np.array(t.heading),
        0.0 if has_shares else drive.rules.oob_tolerance,
    )
    distance = rows[:, _DISTANCE]
    half_width = 0.5 * road.lane_width
    # From the ego lane's centre line, which is half a lane to the right of the road's.
    offset = rows[:, _OFFSET] + half_width
    oob_distance = half_width - np.abs(offset)
    if len(road.widening):
        to_right_edge = half_width + offset + value_at(road.widening, distance)
        oob_distance = np.minimum(half_width - offset, to_right_edge)
    return Assessment(end, distance, offset, oob_distance, rows[:, _OOB_SHARE])
