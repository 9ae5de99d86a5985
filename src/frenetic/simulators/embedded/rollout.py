"""The embedded simulator's compiled loop: observe, decide, move, judge; for many cars side by side.

Each car has a road of its own. The cars are observed and asked one after the other, and moved side
by side. A car that has ended its drive is replaced by the car of the next road. A car drives alone
as it drives beside others, bit for bit.

The loop for drivers in Python (`frenetic.simulators.drive_loop`) calls the same kernels in the same
order, so a built-in driver drives alike in both loops, bit for bit.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import wrapped
from frenetic.drivers.laws import decide, rows_read
from frenetic.drivers.sensor_errors import BoolArray, misread, move_view
from frenetic.drivers.steering_errors import carried_out
from frenetic.drivers.wrappers import disturb
from frenetic.oracle.assessment import RECORD_TIME, RUNNING, assess_record
from frenetic.oracle.drive_assessment import DISTANCE, OFFSET, OOB_SHARE
from frenetic.simulators.embedded.single_track import (
    ASKED,
    BRAKE,
    HEADING,
    INPUT_SIZE,
    MOST_CARS,
    SPEED,
    STATE_SIZE,
    THROTTLE,
    YAW_RATE,
    X,
    Y,
    advance,
)
from frenetic.simulators.embedded.slopes import on_slopes
from frenetic.simulators.embedded.weather import distance_of, grip_at, in_gust
from frenetic.simulators.observer import look_ahead, write_curvatures_ahead, write_limits_ahead

STEP: Final = 0.01
"""Step of the RK4 integration, in s: 100 Hz."""
STEPS_PER_PERIOD: Final = 5
"""RK4 steps between two decisions and records: 20 Hz."""
PERIOD: Final = STEP * STEPS_PER_PERIOD
"""Time between two decisions and records, in s."""

# Columns of the records, in the order of the columns of a `Trajectory`: the time, the state in its
# order, and the controls that the driver chose.
_STATE: Final = 1
INPUTS: Final = _STATE + STATE_SIZE
RECORD_SIZE: Final = INPUTS + INPUT_SIZE


Fields: TypeAlias = tuple[Any, ...]
"""The fields of a named tuple below as a plain tuple. Numba's cache would name the class of a named
tuple, and could not be read any more once the class has moved."""


class Roads(NamedTuple):
    """The n roads of a rollout, in the order of their drives, and what belongs to each."""

    tables: FloatArray
    """Tables of the roads one after the other, (m, 6) or (m, 7), see `frenetic.road.geometry`."""
    first_rows: IntArray
    """First row of each road's table, and the number of rows, (n + 1,)."""
    sub_steps: FloatArray
    """Distance between two rows of each table, (n,) in m."""
    lane_widths: FloatArray
    """Width of each ego lane, (n,) in m."""
    rules: FloatArray
    """Rules of each drive, (n, 5), see `frenetic.oracle.assessment.rules_array`."""
    limits: FloatArray
    """Limits of the roads one after the other, (m, 2): station in m, and the speed limit in m/s to
    which the driver keeps from there on."""
    first_limits: IntArray
    """First limit of each road, and the number of limits, (n + 1,)."""


class Slopes(NamedTuple):
    """The slopes of n roads."""

    slopes: FloatArray
    """`Road.slopes` of the roads one after the other, (m, 2)."""
    first_rows: IntArray
    """First row of each road's slopes, and the number of rows, (n + 1,)."""


class Drivers(NamedTuple):
    """The built-in drivers of a rollout, all of one law, with their wrappers."""

    law: int
    """Number of the law, see `frenetic.drivers.laws`."""
    parameters: FloatArray
    """Parameters of the law, (n, p)."""
    setups: FloatArray
    """Setups of the drives, (n, 9), see `frenetic.drivers.laws.setup_array`."""
    rows: IntArray
    """Number of points of each driver's view, (n,)."""
    delays: IntArray
    """Number of periods that the controls of each driver take to arrive, (n,)."""
    errors: FloatArray
    """Errors of each driver in each record, (n, m, 2): of its offset in m, of its heading in rad;
    (n, 0, 2) if no driver makes any."""


class Interfaces(NamedTuple):
    """The sensors and the steering of the n drivers of a rollout, which err."""

    biases: FloatArray
    """Constant errors of each driver's signals, (n, 4), see `frenetic.drivers.sensor_errors`."""
    dropped: BoolArray
    """Whether each signal stays at its last reading in each record, (n, m, 4)."""
    memories: FloatArray
    """Memories of the sensors, (n, 3, 4), which the kernel changes."""
    steering: FloatArray
    """Amounts of the errors of each steering, (n, 5), see `frenetic.drivers.steering_errors`."""
    steering_states: FloatArray
    """States of the steering, (n, 2), which the kernel changes."""


class CarArrays(NamedTuple):
    """The n cars of a rollout. The kernel changes all but the first two."""

    bodies: FloatArray
    """The cars' boxes, (n, 3), see `CarBody.to_array`."""
    vehicles: FloatArray
    """`Vehicle.to_array` of each car, (n, 32)."""
    states: FloatArray
    """State of each car, (n, 7): at the start, then at the end of the drive."""
    records: FloatArray
    """Records of each trajectory, (n, m, 11)."""
    assessments: FloatArray
    """Assessment of each record, (n, m, 3): distance along the road and lateral offset from the
    centre line in m, and oob share, which may be 0 unless it is a drive's largest so far."""
    largest_shares: FloatArray
    """Largest oob share of each drive, (n,); 0 at the start."""
    counts: IntArray
    """Number of records of each drive, (n,); 0 at the start."""
    ends: IntArray
    """How each drive ended, (n,), see `frenetic.oracle.assessment`."""


@njit(interpret_first=0.1)
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


@njit(error_model="numpy", force_inline=True)
def write_record(
    records: FloatArray, i: int, states: FloatArray, inputs: FloatArray, k: int
) -> None:
    """Write record ``i`` of car ``k``: the state, and the controls that the driver chose there."""
    records[i, RECORD_TIME] = i * PERIOD
    for v in range(STATE_SIZE):
        records[i, _STATE + v] = states[k, v]
    for v in range(INPUT_SIZE):
        records[i, INPUTS + v] = inputs[k, v]


@njit(error_model="numpy", interpret_first=0.1)
def ground_under(
    vehicle: FloatArray,
    table: FloatArray,
    ds: float,
    slopes: FloatArray | None,
    weather: FloatArray | None,
    state: FloatArray,
    s: float,
    seconds: float,
) -> tuple[FloatArray, float]:
    """Return a car's parameters on the ground under it, and its distance along the road in m.

    Args:
        vehicle: `Vehicle.to_array()`.
        table, ds: the road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`; None on flat roads.
        weather: see `frenetic.simulators.embedded.weather`; None without.
        state: (7,) state of the car.
        s: distance of the car along the road at most a few periods ago, in m.
        seconds: time for which the parameters hold, in s.
    """
    ground = vehicle
    if weather is not None:
        s = distance_of(table, ds, state, s)
        ground = grip_at(weather, vehicle, s)
    if slopes is not None:
        ground, s = on_slopes(ground, table, ds, slopes, state, s, seconds)
    if weather is not None:
        ground = in_gust(weather, ground, state, s)
    return ground, s


@njit(error_model="numpy")
def _slopes_of(slopes: Fields, k: int) -> FloatArray:
    """Return the slopes of road ``k``, see `Slopes`."""
    rows, first_rows = slopes
    part: FloatArray = rows[first_rows[k] : first_rows[k + 1]]
    return part


@njit(error_model="numpy")
def _readings(
    interfaces: Fields,
    k: int,
    i: int,
    offset: float,
    heading_error: float,
    yaw_rate: float,
    speed: float,
) -> tuple[float, float, float, float]:
    """Return what driver ``k`` reads of four true values in record ``i``, see `misread`."""
    biases, dropped, memories, _, _ = interfaces
    return misread(offset, heading_error, yaw_rate, speed, memories[k], biases[k], dropped[k, i])


@njit(error_model="numpy")
def _move_view(interfaces: Fields, k: int, ahead: FloatArray, first: int, stop: int) -> None:
    """Move the view of driver ``k`` by the errors of its last readings, see `move_view`."""
    biases, _, memories, _, _ = interfaces
    move_view(ahead, first, stop, memories[k], biases[k])


@njit(error_model="numpy")
def _carried_out(interfaces: Fields, k: int, steering: float) -> float:
    """Return the steering angle that a command of driver ``k`` becomes, see `carried_out`."""
    _, _, _, amounts, states = interfaces
    return carried_out(steering, amounts[k], states[k], PERIOD)


@njit(error_model="numpy", nogil=True, interpret_first=9.0)
def rollout(
    roads: Fields,
    slopes: Fields | None,
    weather: FloatArray | None,
    drivers: Fields,
    interfaces: Fields | None,
    memories: FloatArray | None,
    cars: Fields,
) -> None:
    """Let built-in drivers drive along their roads until the drives end.

    Args:
        roads: fields of `Roads`.
        slopes: fields of `Slopes`; None if all roads are flat.
        weather: weather of each drive, (n, m), see `frenetic.simulators.embedded.weather`; None
            without.
        drivers: fields of `Drivers`.
        interfaces: fields of `Interfaces`; None if nothing between drivers and cars errs.
        memories: states of the drivers, see `frenetic.drivers.laws.new_memory`.
        cars: fields of `CarArrays`, which the kernel changes.
    """
    tables, first_rows, sub_steps, lane_widths, rules, limits, first_limits = roads
    law, parameters, setups, rows, delays, errors = drivers
    bodies, vehicles, states, records, assessments, largest_shares, counts, ends = cars
    count, most_records, most_rows = len(sub_steps), records.shape[1], rows.max()

    ahead = np.empty((most_rows, 2))
    curvature_ahead = np.empty(most_rows)
    limit_ahead = np.empty(most_rows if len(limits) > count else 1)
    inputs = np.zeros((count, INPUT_SIZE))  # what each driver has decided and its car obeys
    # A ring of what each car will obey.
    waiting = np.zeros((count, delays.max() + 1, INPUT_SIZE))
    grounds = vehicles.copy()  # the cars on the ground under them

    driving = np.arange(min(MOST_CARS, count))
    following = active = len(driving)
    while active:
        n = 0
        while n < active:
            # Record and assess the car.
            k = driving[n]
            i = counts[k]
            table, ds, lane_width = (
                tables[first_rows[k] : first_rows[k + 1]],
                sub_steps[k],
                lane_widths[k],
            )
            car_records = records[k]
            write_record(car_records, i, states, inputs, k)
            before = assessments[k, i - 1, DISTANCE] if i else 0.0
            end, s, d, road_heading, share = assess_record(
                table,
                ds,
                lane_width,
                rules[k],
                bodies[k],
                car_records,
                i,
                before,
                largest_shares[k],
            )
            assessments[k, i, DISTANCE] = s
            assessments[k, i, OFFSET] = d
            assessments[k, i, OOB_SHARE] = share
            largest_shares[k] = max(largest_shares[k], share)
            counts[k], ends[k] = i + 1, end
            if end != RUNNING or i + 1 == most_records:
                if following < count:  # the car of the next road takes its place
                    driving[n] = following
                    following += 1
                else:
                    active -= 1
                    driving[n] = driving[active]
                continue

            # Let its driver see the road, and decide.
            speed, yaw_rate, heading = states[k, SPEED], states[k, YAW_RATE], states[k, HEADING]
            offset, heading_error = d + 0.5 * lane_width, wrapped(heading - road_heading)
            if errors.shape[1]:
                offset += errors[k, i, 0]
                heading_error += errors[k, i, 1]
            if interfaces is not None:
                offset, heading_error, yaw_rate, speed = _readings(
                    interfaces, k, i, offset, heading_error, yaw_rate, speed
                )
            first, stop = rows_read(law, speed, rows[k], parameters[k])
            pose = states[k, X], states[k, Y], heading
            look_ahead(table, ds, lane_width, pose, s, first, stop, ahead)
            write_curvatures_ahead(table, ds, lane_width, s, rows[k], curvature_ahead)
            if len(limit_ahead) == 1:
                limit_ahead[0] = limits[k, 1]
            else:
                own_limits = limits[first_limits[k] : first_limits[k + 1]]
                write_limits_ahead(own_limits, s, most_rows, limit_ahead)
            if errors.shape[1]:
                disturb(ahead, first, stop, errors[k, i, 0], errors[k, i, 1])
            if interfaces is not None:
                _move_view(interfaces, k, ahead, first, stop)
            steering, throttle, brake = decide(
                law,
                speed,
                yaw_rate,
                s,
                offset,
                heading_error,
                ahead,
                curvature_ahead,
                limit_ahead,
                rows[k],
                parameters[k],
                setups[k],
                None if memories is None else memories[k],
            )
            if interfaces is not None:
                steering = _carried_out(interfaces, k, steering)
            slot = i % (delays[k] + 1)
            waiting[k, slot, ASKED] = steering
            waiting[k, slot, THROTTLE] = throttle
            waiting[k, slot, BRAKE] = brake
            slot = (i + 1) % (delays[k] + 1)  # of the oldest controls, which arrive now
            for v in range(INPUT_SIZE):
                inputs[k, v] = records[k, i, INPUTS + v] = waiting[k, slot, v]
            n += 1

        # Move the cars.
        if slopes is not None or weather is not None:
            for n in range(active):
                k = driving[n]
                grounds[k], _ = ground_under(
                    vehicles[k],
                    tables[first_rows[k] : first_rows[k + 1]],
                    sub_steps[k],
                    None if slopes is None else _slopes_of(slopes, k),
                    None if weather is None else weather[k],
                    states[k],
                    assessments[k, counts[k] - 1, DISTANCE],
                    PERIOD,
                )
        advance(states, inputs, grounds, driving[:active], STEP, STEPS_PER_PERIOD)
