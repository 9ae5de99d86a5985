"""The embedded simulator's compiled loop: observe, decide, move, judge.

The loop for drivers in Python (`frenetic.simulators.drive_loop`) calls the same kernels in the same
order, so a built-in driver drives alike in both loops, bit for bit.
"""

from __future__ import annotations

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.elastic_band import MEMORY
from frenetic.drivers.laws import decide
from frenetic.drivers.wrappers import disturb
from frenetic.oracle.assessment import RUNNING
from frenetic.simulators.embedded.single_track import (
    HEADING,
    LATERAL_SPEED,
    SPEED,
    STEERING,
    YAW_RATE,
    X,
    Y,
    advance,
)
from frenetic.simulators.embedded.slopes import on_slopes
from frenetic.simulators.embedded.weather import distance_of, grip_at, in_gust
from frenetic.simulators.observer import observe, write_limits_ahead

STEP = 0.01
"""Step of the RK4 integration, in s: 100 Hz."""
STEPS_PER_PERIOD = 5
"""RK4 steps between two decisions and records: 20 Hz."""
PERIOD = STEP * STEPS_PER_PERIOD
"""Time between two decisions and records, in s."""

# Rows of the array of records, in the order of the columns of a `Trajectory`. Most begin with R, to
# tell them from the indices of the state.
TIME, RX, RY, RHEADING, RSPEED, RLATERAL, RYAW, RSTEERING, RINPUT, RTHROTTLE, RBRAKE = range(11)


@njit()
def start_state(table: FloatArray, lane_width: float, left: float, turned: float) -> FloatArray:
    """Return the state (7,) of a car at rest in the ego lane at the road's first point.

    Args:
        table: the road, see `frenetic.road.geometry`.
        lane_width: width of the lane, in m.
        left: distance of the car to the left of the lane's centre, in m.
        turned: angle of the car to the left of the lane's direction, in rad.
    """
    state = np.zeros(7)
    offset = left - 0.5 * lane_width
    state[X] = table[0, 0] - offset * table[0, 5]
    state[Y] = table[0, 1] + offset * table[0, 4]
    state[HEADING] = table[0, 2] + turned
    return state


@njit()
def write_record(
    records: FloatArray,
    i: int,
    state: FloatArray,
    steering: float,
    throttle: float,
    brake: float,
) -> None:
    """Write record ``i``: the state, and the controls that the driver chose there."""
    records[TIME, i] = i * PERIOD
    records[RX, i] = state[X]
    records[RY, i] = state[Y]
    records[RHEADING, i] = state[HEADING]
    records[RSPEED, i] = state[SPEED]
    records[RLATERAL, i] = state[LATERAL_SPEED]
    records[RYAW, i] = state[YAW_RATE]
    records[RSTEERING, i] = state[STEERING]
    records[RINPUT, i] = steering
    records[RTHROTTLE, i] = throttle
    records[RBRAKE, i] = brake


@njit()
def advance_period(
    state: FloatArray,
    steering: float,
    throttle: float,
    brake: float,
    vehicle: FloatArray,
    table: FloatArray,
    ds: float,
    slopes: FloatArray,
    s: float,
    weather: FloatArray,
    steps: int = STEPS_PER_PERIOD,
) -> float:
    """Move the car by one period, or by another number of integration steps.

    Args:
        state, steering, throttle, brake: see `advance`; the state is changed in place.
        vehicle: `Vehicle.to_array()`.
        table, ds: the road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        s: distance of the car along the road at most a few periods ago, in m; it is used on slopes
            and in weather only.
        weather: see `frenetic.simulators.embedded.weather`.
        steps: number of integration steps.

    Returns:
        Distance of the car along the road before it moved, in m; ``s`` itself without slopes and
        weather.
    """
    ground = vehicle
    if len(weather):
        s = distance_of(table, ds, state, s)
        ground = grip_at(weather, vehicle, s)
    if len(slopes):
        ground, s = on_slopes(ground, table, ds, slopes, state, s, steps * STEP)
    if len(weather):
        ground = in_gust(weather, ground, state, s)
    for _ in range(steps):
        advance(state, steering, throttle, brake, ground, STEP)
    return s


@njit()
def rollout(
    table: FloatArray,
    ds: float,
    slopes: FloatArray,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    vehicle: FloatArray,
    law: int,
    parameters: FloatArray,
    setup: FloatArray,
    rows: int,
    delay: int,
    errors: FloatArray,
    state: FloatArray,
    records: FloatArray,
    weather: FloatArray,
    limits: FloatArray,
) -> int:
    """Let a built-in driver drive until the drive ends; return the number of records written.

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        lane_width: width of the ego lane, in m.
        rules, car: see `frenetic.oracle.assessment.assess_record`.
        vehicle: `Vehicle.to_array()`.
        law, parameters, setup: see `frenetic.drivers.laws`.
        rows: number of points of the driver's view.
        delay: number of periods that controls take to arrive.
        errors: (n, 2) errors of the driver in each record: of its offset in m, of its heading in
            rad; (0, 2) for a driver without errors.
        state: (7,) state at the start; it becomes the state at the end.
        records: (11, n) array that the columns of a `Trajectory` are written to.
        weather: see `frenetic.simulators.embedded.weather`.
        limits: (k, 2) station in m, and the speed limit in m/s to which the driver keeps from there
            on.
    """
    ahead = np.empty((rows, 2))
    curvature_ahead = np.empty(rows)
    limit_ahead = np.empty(rows if len(limits) > 1 else 1)
    write_limits_ahead(limits, 0.0, len(limit_ahead), limit_ahead)
    waiting = np.zeros((delay + 1, 3))
    memory = np.zeros(MEMORY)
    most = records.shape[1]
    steering = throttle = brake = 0.0
    s = 0.0
    for i in range(most):
        write_record(records, i, state, steering, throttle, brake)
        end, s, offset, heading_error, _ = observe(
            table,
            ds,
            lane_width,
            rules,
            car,
            records,
            i,
            state[HEADING],
            s,
            rules[0],
            ahead,
            curvature_ahead,
        )
        if end != RUNNING:
            return i + 1
        if len(errors):
            disturb(ahead, rows, errors[i, 0], errors[i, 1])
            offset += errors[i, 0]
            heading_error += errors[i, 1]
        if len(limits) > 1:
            write_limits_ahead(limits, s, rows, limit_ahead)
        steering, throttle, brake = decide(
            law,
            state[SPEED],
            state[YAW_RATE],
            s,
            offset,
            heading_error,
            ahead,
            curvature_ahead,
            limit_ahead,
            rows,
            parameters,
            setup,
            memory,
        )
        if delay:
            # A ring of the controls that are on their way: the oldest ones arrive now.
            slot = i % (delay + 1)
            waiting[slot, 0], waiting[slot, 1], waiting[slot, 2] = steering, throttle, brake
            slot = (i + 1) % (delay + 1)
            steering, throttle, brake = waiting[slot, 0], waiting[slot, 1], waiting[slot, 2]
        write_record(records, i, state, steering, throttle, brake)
        advance_period(state, steering, throttle, brake, vehicle, table, ds, slopes, s, weather)
    return int(most)
