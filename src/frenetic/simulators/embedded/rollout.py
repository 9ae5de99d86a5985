"""The embedded simulator's loop: observe, decide, move, judge; compiled, or with a Python driver.

Both loops call the same kernels in the same order, so a built-in driver drives bit for bit alike.
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
from frenetic.simulators.embedded.slopes import lay
from frenetic.simulators.embedded.weather import grip_at, in_gust, place_of
from frenetic.simulators.observer import look_for_limits, observe

STEP = 0.01
"""Step of the RK4 integration, in s: 100 Hz."""
STEPS_PER_PERIOD = 5
"""RK4 steps between two decisions and records: 20 Hz."""
PERIOD = STEP * STEPS_PER_PERIOD
"""Time between two decisions and records, in s."""

# Columns of the records, as in Trajectory.
TIME, RX, RY, RHEADING, RSPEED, RLATERAL, RYAW, RSTEERING, RINPUT, RTHROTTLE, RBRAKE = range(11)


@njit()
def start_state(table: FloatArray, lane_width: float, left: float, turned: float) -> FloatArray:
    """Return the state of a car at rest in the ego lane at the road's first point, (7,).

    It stands ``left`` m left of the lane's centre and points ``turned`` rad left of its direction.
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
    """Write record ``i``: the state and the controls chosen at it."""
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
    """Move the car on by one period, or another number of steps, in place.

    Args:
        state, steering, throttle, brake: see `advance`.
        vehicle: `Vehicle.to_array()`.
        table, ds: the road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        s: m, a place of the car at most a few periods ago, which matters on slopes and in weather.
        weather: see `frenetic.simulators.embedded.weather`.
        steps: Number of integration steps.

    Returns:
        m, the car's place before it moved, on slopes and in weather; `s` otherwise.
    """
    ground = vehicle
    if len(weather):
        s = place_of(table, ds, state, s)
        ground = grip_at(weather, vehicle, s)
    if len(slopes):
        ground, s = lay(ground, table, ds, slopes, state, s, steps * STEP)
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
    """Drive a built-in driver until the drive ends; return the number of records written.

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        lane_width: m.
        rules, car: see `frenetic.oracle.assessment.assess_record`.
        vehicle: `Vehicle.to_array()`.
        law, parameters, setup: see `frenetic.drivers.laws`.
        rows: Number of points of the driver's view.
        delay: Number of periods that controls take to arrive.
        errors: (m, 2) m and rad by which the driver errs, m >= the records' number, or (0, 2).
        state: (7,) state at the start; it becomes the state at the end.
        records: (11, m), room for the columns of a `Trajectory`.
        weather: see `frenetic.simulators.embedded.weather`.
        limits: (k, 2) m and m/s, the speed limits as the driver takes them, each from its station
            on.
    """
    ahead = np.empty((rows, 2))
    curvature_ahead = np.empty(rows)
    limit_ahead = np.empty(rows if len(limits) > 1 else 1)
    look_for_limits(limits, 0.0, len(limit_ahead), limit_ahead)
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
            look_for_limits(limits, s, rows, limit_ahead)
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
            slot = i % (delay + 1)
            waiting[slot, 0], waiting[slot, 1], waiting[slot, 2] = steering, throttle, brake
            slot = (i + 1) % (delay + 1)
            steering, throttle, brake = waiting[slot, 0], waiting[slot, 1], waiting[slot, 2]
        write_record(records, i, state, steering, throttle, brake)
        advance_period(state, steering, throttle, brake, vehicle, table, ds, slopes, s, weather)
    return int(most)
