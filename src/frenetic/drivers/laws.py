"""The built-in drivers' laws as kernels, which the compiled rollout and the drivers' `act` call.

A law computes steering angle, throttle and brake from an observation. Its number chooses it, see
`decide`. All laws share these arguments; all values are in SI units:

===================  ===============================================================
``ahead``            points of the view, (n, 2), see `Observation.ahead`
``curvature_ahead``  curvatures there, (n,), see `Observation.curvature_ahead`
``limit_ahead``      speed limits there, (n,), see `Observation.speed_limit_ahead`
``rows``             number of points in view, n
``parameters``       the law's parameters, from the classes in `frenetic.drivers.builtin`
``setup``            array that `setup_array` makes of the `DriveSetup`
===================  ===============================================================
"""

from __future__ import annotations

import math

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import arctangent, sine
from frenetic.drivers.driver import AHEAD_SPACING, DriveSetup
from frenetic.drivers.elastic_band import MEMORY, drive_along_band

PLANNER, STANLEY, BEAMNG_AI = range(3)
"""Numbers of the laws."""

# Indices of ``setup``.
(
    SPEED_LIMIT,
    FRONT_AXLE,
    REAR_AXLE,
    MAX_STEERING,
    MAX_ACCELERATION,
    MAX_DECELERATION,
    LANE_WIDTH,
    CAR_WIDTH,
    PERIOD,
) = range(9)
# Indices of ``parameters``. The parameters of the speed plan come first, for `planner` and
# `stanley` alike.
LATERAL, BRAKING, SPEED_GAIN, SMOOTHING = range(4)
# Further parameters of `planner`.
LOOKAHEAD_TIME, LOOKAHEAD_MIN = 4, 5
# Further parameters of `stanley`.
OFFSET_GAIN, SOFTENING, YAW_DAMPING = 4, 5, 6

_LEAST_BEND = 1e-12
"""Sum of curvatures below which a road counts as straight, in 1/m: it keeps a quotient finite."""
SPACING = AHEAD_SPACING
"""Distance along the road between two points of the view, in m."""


def setup_array(setup: DriveSetup) -> FloatArray:
    """Return the values of a `DriveSetup` that the laws need, (9,)."""
    return np.array(
        [
            setup.speed_limit,
            setup.front_axle,
            setup.rear_axle,
            setup.max_steering,
            setup.max_acceleration,
            setup.max_deceleration,
            setup.lane_width,
            setup.car_width,
            setup.period,
        ]
    )


def new_memory(law: int, count: int) -> FloatArray | None:
    """Return the states of ``count`` drivers at the start of a drive, (count, m); None without."""
    return np.zeros((count, MEMORY)) if law == BEAMNG_AI else None


@njit(error_model="numpy", inline="always", interpret_first=0.3)
def planned_speed(
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    lateral: float,
    braking: float,
    smoothing: int,
) -> float:
    """Return the largest speed, in m/s, from which the car can keep every limit and curve in view.

    A curve allows the speed sqrt(lateral / |kappa|), where kappa is the mean curvature over a
    window of ``smoothing`` rows on each side. With steady braking, the car may now have a speed v
    with v^2 = v_curve^2 + 2 braking distance; a lower speed limit ahead counts in the same way. The
    road beyond the view does not count.

    Args:
        curvature_ahead, rows: see the module's text.
        limit_ahead: speed limits at the points of the view, (n,), or one limit for all, (1,).
        lateral: largest lateral acceleration in curves, in m/s^2.
        braking: deceleration before curves and lower limits, in m/s^2.
        smoothing: number of rows on each side of a row in its window.
    """
    # The sum over the window is updated from row to row: the cost does not depend on its size.
    total = 0.0
    for j in range(min(smoothing, rows)):
        total += curvature_ahead[j]
    square = limit_ahead[0] * limit_ahead[0]  # of the speed
    for i in range(1, min(rows, len(limit_ahead))):
        square = min(square, limit_ahead[i] * limit_ahead[i] + 2.0 * braking * i * SPACING)
    for i in range(rows):
        if i + smoothing < rows:
            total += curvature_ahead[i + smoothing]
        if i - smoothing - 1 >= 0:
            total -= curvature_ahead[i - smoothing - 1]
        count = min(i + smoothing, rows - 1) - max(i - smoothing, 0) + 1
        bend = max(abs(total), _LEAST_BEND)
        square = min(square, lateral * count / bend + 2.0 * braking * i * SPACING)
    return math.sqrt(square)


@njit(error_model="numpy", inline="always", interpret_first=0.3)
def planned_pedals(
    speed: float,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
) -> tuple[float, float]:
    """Return throttle and brake that lead from this speed to the planned speed."""
    wanted = planned_speed(
        curvature_ahead,
        limit_ahead,
        rows,
        parameters[LATERAL],
        parameters[BRAKING],
        int(parameters[SMOOTHING]),
    )
    acceleration = parameters[SPEED_GAIN] * (wanted - speed)
    if acceleration >= 0.0:
        return min(acceleration / setup[MAX_ACCELERATION], 1.0), 0.0
    return 0.0, min(-acceleration / setup[MAX_DECELERATION], 1.0)


@njit(error_model="numpy", force_inline=True)
def _lookahead_row(speed: float, rows: int, parameters: FloatArray) -> float:
    """Return the place of the planner's lookahead point in the view, in rows."""
    lookahead: float = parameters[LOOKAHEAD_MIN] + parameters[LOOKAHEAD_TIME] * speed
    return min(lookahead / SPACING, rows - 1.0)


@njit(error_model="numpy", force_inline=True)
def _rows_around(row: float, rows: int) -> tuple[int, int]:
    """Return the first row, and the row after the last, that surround a place in the view."""
    i = max(min(int(row), rows - 2), 0)
    return i, min(i + 2, rows)


@njit(error_model="numpy", force_inline=True)
def rows_read(law: int, speed: float, rows: int, parameters: FloatArray) -> tuple[int, int]:
    """Return which of the points ``ahead`` a law reads: the first one, and the one after the last.

    Args:
        law: see `decide`.
        speed: speed of the car, in m/s.
        rows, parameters: see the module's text.
    """
    if law == PLANNER:
        return _rows_around(_lookahead_row(speed, rows, parameters), rows)
    return 0, 0 if law == STANLEY else rows


@njit(error_model="numpy", inline="always")
def planner(
    speed: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
) -> tuple[float, float, float]:
    """Return steering, throttle and brake by the speed plan and pure pursuit.

    Pure pursuit (R. C. Coulter, CMU-RI-TR-92-01): the front wheels take the arc that leads the
    rear axle through the point of the lane's centre at the lookahead distance.
    """
    throttle, brake = planned_pedals(speed, curvature_ahead, limit_ahead, rows, parameters, setup)
    row = _lookahead_row(speed, rows, parameters)
    i, stop = _rows_around(row, rows)
    j = stop - 1
    t = row - i
    x = ahead[i, 0] + t * (ahead[j, 0] - ahead[i, 0]) + setup[REAR_AXLE]
    y = ahead[i, 1] + t * (ahead[j, 1] - ahead[i, 1])
    square = max(x * x + y * y, 1.0)
    wheelbase = setup[FRONT_AXLE] + setup[REAR_AXLE]
    steering = arctangent(2.0 * wheelbase * y / square)
    bound = setup[MAX_STEERING]
    return min(max(steering, -bound), bound), throttle, brake


@njit(error_model="numpy", inline="always")
def stanley(
    speed: float,
    yaw_rate: float,
    lateral_offset: float,
    heading_error: float,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
) -> tuple[float, float, float]:
    """Return steering, throttle and brake by the speed plan and Stanley's steering law.

    Hoffmann et al., "Autonomous Automobile Trajectory Tracking for Off-Road Driving", ACC 2007. The
    steering angle is the sum of four angles: for the lane's curvature, against the heading error,
    back to the lane's centre, and against the yaw rate in excess of the lane's.
    """
    throttle, brake = planned_pedals(speed, curvature_ahead, limit_ahead, rows, parameters, setup)
    wheelbase = setup[FRONT_AXLE] + setup[REAR_AXLE]
    offset = lateral_offset + setup[FRONT_AXLE] * sine(heading_error)
    kappa = curvature_ahead[0]
    steering = (
        arctangent(wheelbase * kappa)
        - heading_error
        - arctangent(parameters[OFFSET_GAIN] * offset / (parameters[SOFTENING] + speed))
        - parameters[YAW_DAMPING] * (yaw_rate - speed * kappa)
    )
    bound = setup[MAX_STEERING]
    return min(max(steering, -bound), bound), throttle, brake


@njit(error_model="numpy", force_inline=True, interpret_first=1.0)
def decide(
    law: int,
    speed: float,
    yaw_rate: float,
    distance: float,
    lateral_offset: float,
    heading_error: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
    memory: FloatArray | None,
) -> tuple[float, float, float]:
    """Return steering in rad, throttle and brake by the law with a number.

    Args:
        law: `PLANNER`, `STANLEY` or `BEAMNG_AI`.
        speed, yaw_rate, distance, lateral_offset, heading_error: see `Observation`.
        ahead, curvature_ahead, limit_ahead, rows, parameters, setup: see the module's text.
        memory: state of the law between two calls, see `new_memory`.
    """
    if memory is None:  # compiled without the elastic band
        if law == PLANNER:
            return planner(speed, ahead, curvature_ahead, limit_ahead, rows, parameters, setup)
        return stanley(
            speed,
            yaw_rate,
            lateral_offset,
            heading_error,
            curvature_ahead,
            limit_ahead,
            rows,
            parameters,
            setup,
        )
    steering, throttle, brake = drive_along_band(
        speed,
        distance,
        heading_error,
        ahead,
        curvature_ahead,
        limit_ahead,
        rows,
        parameters,
        setup[LANE_WIDTH],
        setup[CAR_WIDTH],
        setup[REAR_AXLE],
        setup[PERIOD],
        memory,
    )
    bound = setup[MAX_STEERING]
    return min(max(steering, -bound), bound), throttle, brake
