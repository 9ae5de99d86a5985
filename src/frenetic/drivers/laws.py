"""The built-in drivers' laws as kernels: the same code runs in the compiled rollout and in `act`.

A rollout chooses a law by its number (`decide`). ``parameters`` is the law's own array, see the
classes in `frenetic.drivers.builtin`; ``setup`` is the array made by `setup_array`; all is in SI
units.
"""

from __future__ import annotations

import math

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.driver import AHEAD_SPACING, DriveSetup
from frenetic.drivers.elastic_band import drive_along_band

PLANNER, STANLEY, BEAMNG_AI = range(3)

# Indices of the setup.
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
# Indices of the parameters of the speed plan, the first of every law.
LATERAL, BRAKING, SPEED_GAIN, SMOOTHING = range(4)
# Indices of the parameters of pure pursuit.
LOOKAHEAD_TIME, LOOKAHEAD_MIN = 4, 5
# Indices of the parameters of Stanley's law.
OFFSET_GAIN, SOFTENING, YAW_DAMPING = 4, 5, 6

SPACING = AHEAD_SPACING


def setup_array(setup: DriveSetup) -> FloatArray:
    """Return a `DriveSetup` as the laws take it."""
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


@njit()
def planned_speed(
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    lateral: float,
    braking: float,
    smoothing: int,
) -> float:
    """Return the speed, in m/s, that keeps every limit and curve in view within the budgets.

    Each curve allows sqrt(lateral / |kappa|), where kappa is the mean curvature over a window of
    ``smoothing`` rows on each side; braking steadily from here, v^2 = v_curve^2 + 2 braking
    distance. So does a lower limit ahead. Beyond the view, the road is assumed to go on unchanged.
    ``limit_ahead`` has a row for each point of the view, or one row for all points.
    """
    # The sums slide along, so that the cost does not depend on the window.
    total = 0.0
    for j in range(min(smoothing, rows)):
        total += curvature_ahead[j]
    best = limit_ahead[0] * limit_ahead[0]
    for i in range(1, min(rows, len(limit_ahead))):
        best = min(best, limit_ahead[i] * limit_ahead[i] + 2.0 * braking * i * SPACING)
    for i in range(rows):
        if i + smoothing < rows:
            total += curvature_ahead[i + smoothing]
        if i - smoothing - 1 >= 0:
            total -= curvature_ahead[i - smoothing - 1]
        count = min(i + smoothing, rows - 1) - max(i - smoothing, 0) + 1
        kappa = abs(total) / count
        if kappa * best > lateral:
            best = min(best, lateral / kappa + 2.0 * braking * i * SPACING)
    return math.sqrt(best)


@njit()
def planned_pedals(
    speed: float,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
) -> tuple[float, float]:
    """Return throttle and brake that bring the speed to the planned speed at the law's gain."""
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


@njit()
def planner(
    speed: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    setup: FloatArray,
) -> tuple[float, float, float]:
    """Return steering, throttle and brake: speed from the road ahead, pure-pursuit steering.

    Pure pursuit (R. C. Coulter, CMU-RI-TR-92-01): the front wheels take the arc that leads the
    rear axle through the lane's centre one lookahead distance away.
    """
    throttle, brake = planned_pedals(speed, curvature_ahead, limit_ahead, rows, parameters, setup)
    lookahead = parameters[LOOKAHEAD_MIN] + parameters[LOOKAHEAD_TIME] * speed
    place = min(lookahead / SPACING, rows - 1.0)
    i = max(min(int(place), rows - 2), 0)
    t = place - i
    j = min(i + 1, rows - 1)
    x = ahead[i, 0] + t * (ahead[j, 0] - ahead[i, 0]) + setup[REAR_AXLE]
    y = ahead[i, 1] + t * (ahead[j, 1] - ahead[i, 1])
    square = max(x * x + y * y, 1.0)
    wheelbase = setup[FRONT_AXLE] + setup[REAR_AXLE]
    steering = math.atan(2.0 * wheelbase * y / square)
    bound = setup[MAX_STEERING]
    return min(max(steering, -bound), bound), throttle, brake


@njit()
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
    """Return steering, throttle and brake: `planner`'s speed plan, Stanley's steering law.

    Hoffmann et al., "Autonomous Automobile Trajectory Tracking for Off-Road Driving", ACC 2007:
    heading error plus the angle that takes the front axle back to the line, the lane's own
    curvature fed forward, and the yaw rate damped.
    """
    throttle, brake = planned_pedals(speed, curvature_ahead, limit_ahead, rows, parameters, setup)
    wheelbase = setup[FRONT_AXLE] + setup[REAR_AXLE]
    offset = lateral_offset + setup[FRONT_AXLE] * math.sin(heading_error)
    kappa = curvature_ahead[0]
    steering = (
        math.atan(wheelbase * kappa)
        - heading_error
        - math.atan(parameters[OFFSET_GAIN] * offset / (parameters[SOFTENING] + speed))
        - parameters[YAW_DAMPING] * (yaw_rate - speed * kappa)
    )
    bound = setup[MAX_STEERING]
    return min(max(steering, -bound), bound), throttle, brake


@njit()
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
    memory: FloatArray,
) -> tuple[float, float, float]:
    """Return steering, throttle and brake by the law with a number.

    ``memory``, (`elastic_band.MEMORY`,), is a law's state from call to call within a drive; it
    starts as zeros.
    """
    if law == PLANNER:
        return planner(speed, ahead, curvature_ahead, limit_ahead, rows, parameters, setup)
    if law == STANLEY:
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
