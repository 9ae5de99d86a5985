"""The assessment of a drive: where each record lies on the road, and whether the drive ends there.

The kernel `assess_record` holds the rules for ending a drive. Simulators call it after every record
to know when to stop, and `assess` calls it for each record of a trajectory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import hypotenuse
from frenetic.oracle.drive_assessment import (
    ASSESSMENT_SIZE,
    DISTANCE,
    OFFSET,
    OOB_SHARE,
    Assessment,
)
from frenetic.oracle.lane_share import share_outside
from frenetic.road.geometry import X, Y, heading_at, project_global, project_near, reach_of

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive, Rules
    from frenetic.road import Road

RUNNING, REACHED, LEFT_LANE, STUCK, TIMED_OUT = range(5)
"""States of a drive at a record: it continues, or how it ended."""

RECORD_TIME, RECORD_X, RECORD_Y, RECORD_HEADING = range(4)
"""Columns of the records from which a drive is assessed; the first of a `Trajectory`."""
RULES_SIZE: Final = 5
"""Number of the values of `rules_array`."""
_TIME_ROUNDING: Final = 1e-9
"""Time by which a rounded time may miss `Rules.stuck_time`, in s; our choice."""
_LENGTH_ROUNDING: Final = 1e-9
"""Distance by which the car may be short of the road's end and has reached it, in m; our choice."""


@njit(error_model="numpy", force_inline=True)
def assess_record(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    records: FloatArray,
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
        records: (n, m) records of the trajectory, filled up to ``i``; the first columns are time in
            s, x and y in m, and heading in rad.
        s_before: distance along the road at record ``i - 1``, in m; not used for record 0.
        least: the kernel may return 0 for an oob share below ``least``, to save time; at most the
            tolerance of the rules.

    Returns:
        State of the drive (`RUNNING` or how it ended), distance ``s`` along the road and lateral
        offset ``d`` from the centre line in m, heading of the road in rad, and oob share.
    """
    x, y, heading = records[i, RECORD_X], records[i, RECORD_Y], records[i, RECORD_HEADING]
    if i == 0:
        s, d = project_global(table, ds, x, y)
    else:
        moved = hypotenuse(x - records[i - 1, RECORD_X], y - records[i - 1, RECORD_Y])
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
        hypotenuse(x - table[last, X], y - table[last, Y]) <= goal and s >= last * ds - 2.0 * goal
    ) or (s >= last * ds - _LENGTH_ROUNDING and -lane_width <= d <= 0.0):
        end = REACHED
    elif _is_stuck(records, i, stuck_distance, stuck_time):
        end = STUCK
    elif records[i, RECORD_TIME] > timeout:
        end = TIMED_OUT
    return end, s, d, road_heading, share


@njit(error_model="numpy", force_inline=True)
def _is_stuck(records: FloatArray, i: int, stuck_distance: float, stuck_time: float) -> bool:
    """Return whether a car at record ``i`` is too near to where it was ``stuck_time`` s before."""
    # Find the latest record j that is at least stuck_time old. The first guess assumes records at
    # equal intervals; the loops correct it.
    now = records[i, RECORD_TIME]
    interval = now - records[i - 1, RECORD_TIME] if i > 0 else 0.0
    j = max(0, i - int(stuck_time / interval)) if interval > 0.0 else i
    while j < i and now - records[j + 1, RECORD_TIME] >= stuck_time - _TIME_ROUNDING:
        j += 1
    while j > 0 and now - records[j, RECORD_TIME] < stuck_time - _TIME_ROUNDING:
        j -= 1
    dx = records[i, RECORD_X] - records[j, RECORD_X]
    dy = records[i, RECORD_Y] - records[j, RECORD_Y]
    is_old = now - records[j, RECORD_TIME] >= stuck_time - _TIME_ROUNDING
    return bool(is_old and hypotenuse(dx, dy) < stuck_distance)


@njit(error_model="numpy", interpret_first=3.0)
def _assess(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    records: FloatArray,
    has_all_shares: bool,
) -> tuple[int, FloatArray]:
    """Return the state of the drive, and distance, lateral offset and oob share, (n, 3).

    The rows end with the record that ended the drive.
    """
    n = len(records)
    rows = np.empty((n, ASSESSMENT_SIZE))
    s = largest = 0.0
    for i in range(n):
        least = 0.0 if has_all_shares else largest
        end, s, d, _, share = assess_record(table, ds, lane_width, rules, car, records, i, s, least)
        largest = max(largest, share)
        rows[i, DISTANCE] = s
        rows[i, OFFSET] = d
        rows[i, OOB_SHARE] = share
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


def assess(road: Road, drive: Drive, *, has_all_shares: bool = True) -> Assessment:
    """Return the assessment of a drive, by `assess_record`.

    Args:
        road: the road that was driven.
        drive: the drive along that road.
        has_all_shares: whether every oob share is computed; otherwise only the largest is exact and
            others may be 0, which saves time.
    """
    if not has_all_shares and drive.assessed is not None:
        parts = road, drive.rules, drive.car, drive.trajectory
        if drive.assessed.holds_for(*parts):
            return drive.assessed.assessment
    end, rows = _assess(
        road.table,
        road.sub_step,
        road.lane_width,
        rules_array(drive.rules, road.length),
        drive.car.to_array(),
        drive.trajectory.block[: RECORD_HEADING + 1].T.copy(),
        has_all_shares,
    )
    return Assessment.of(road, end, rows)
