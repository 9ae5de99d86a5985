"""The motion of a car: a dynamic single-track model with Pacejka tyres, in compiled code.

The two wheels of an axle are taken as one wheel in the axle's middle. The car yaws and slides in
the plane; roll and pitch appear only as the load that driving and braking shift between the axles.
Lateral tyre forces follow the Magic Formula, limited by a friction circle that cornering shares
with driving and braking.

The plane is the one of the road under the car. On slopes, `frenetic.simulators.embedded.slopes`
gives the pull of gravity in the plane and the load on the tyres.

A state is a float64 vector (7,), in SI units, positive to the left. Position and heading are on the
map, all other values in the plane:

    ===== ================= ==================================================
    index constant          meaning
    ===== ================= ==================================================
    0     ``X``             m, centre of mass
    1     ``Y``             m, centre of mass
    2     ``HEADING``       rad, counter-clockwise from +x, unwrapped
    3     ``SPEED``         m/s, along the car (v_x)
    4     ``LATERAL_SPEED`` m/s, across the car (v_y)
    5     ``YAW_RATE``      rad/s (r)
    6     ``STEERING``      rad, angle of the front wheels (δ)
    ===== ================= ==================================================

The inputs are the angle asked of the front wheels [rad], throttle and brake [0..1]. They are
constant over a control period, and clipped to their ranges. There is no reverse gear: ``SPEED`` is
negative only while a car that has spun round slides backwards, or while a car rolls down a slope
backwards.

Sources: M. Althoff, G. Würsching, "CommonRoad: Vehicle Models", 2020 (the single-track model);
H. B. Pacejka, "Tire and Vehicle Dynamics" (Magic Formula). What differs from the CommonRoad
single-track model: the tyres saturate, the steering lags, the engine is a family car's, no wheel
locks or spins, air and rolling drag act, and low speeds need no kinematic substitute (see
``Vehicle.crawl_speed``).

With equal tyres on both axles, whose forces are proportional to the load, the car is neutral: only
load transfer and drive forces make it understeer or oversteer.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import arctangent, cosine_within_turn, sine_within_turn, wrapped
from frenetic.drivers.driver import DRAG_FADE_SPEED
from frenetic.simulators.embedded.vehicle import (
    ACROSS,
    AHEAD,
    AIR_DRAG,
    ALONG_WEIGHT,
    BRAKE_FORCE,
    BRAKE_FRONT_SHARE,
    CRAWL_SPEED,
    DRIVE_FRONT_SHARE,
    ENGINE_FORCE,
    FRONT,
    FRONT_TYRE_B,
    GRIP,
    HEIGHT,
    LEAST_ACCELERATION,
    LEFT,
    MASS,
    MOST_ACCELERATION,
    PARAMETER_COUNT,
    PULL_AHEAD,
    PULL_LEFT,
    REAR,
    ROLLING_DRAG,
    SKEW,
    SLIP_CONTROL,
    STEERING_LAG,
    STEERING_LIMIT,
    STEERING_RATE,
    SWITCH_SPEED,
    TURN,
    TWIST,
    TYRE_B,
    TYRE_C,
    YAW_INERTIA,
)

# Indices of the state vector.
X: Final = 0
Y: Final = 1
HEADING: Final = 2
SPEED: Final = 3
LATERAL_SPEED: Final = 4
YAW_RATE: Final = 5
STEERING: Final = 6
STATE_SIZE: Final = 7
# Indices of the inputs.
ASKED: Final = 0
THROTTLE: Final = 1
BRAKE: Final = 2
INPUT_SIZE: Final = 3
_INPUT: Final = STATE_SIZE
_GROUND: Final = _INPUT + INPUT_SIZE
"""First values of the inputs and of the parameters in the array of `advance`."""

MOST_CARS: Final = 32
"""Largest number of cars that `advance` moves side by side; our choice: more are not faster."""

_GROUP: Final = 8
"""Number of cars that the widest vector instructions move at once; it divides `MOST_CARS`."""
_LEAST_BRAKING: Final = 1e-9
"""Deceleration below which nobody brakes, in m/s²: it keeps a quotient finite."""
_Parameters: TypeAlias = tuple[float, ...] | FloatArray
"""A car's parameters by their indices in `frenetic.simulators.embedded.vehicle`."""


@njit(error_model="numpy", force_inline=True)
def _clip(value: float, low: float, high: float) -> float:
    """Return the value, or the end of the range that it is beyond."""
    return low if value < low else high if value > high else value


@njit(error_model="numpy", force_inline=True)
def _lateral_grip_used(rolling: float, sliding: float, b: float, p: _Parameters) -> float:
    """Return the lateral force of an axle's tyres per peak force, -1..1, positive to the left.

    This is the Magic Formula sin(C atan(B α)) with two simplifications, each of which changes the
    force by at most 0.05 % of its peak up to 0.1 rad: the tangent of the slip angle stands for
    α, as Pacejka has it for large slip, and the fourth coefficient, E (p_ey1 = -0.0075), is left
    out.

    Args:
        rolling: speed of the tyres along the wheels, in m/s.
        sliding: speed of the tyres across the wheels in m/s, positive to the left.
        b: TYRE_B of the axle.
        p: `Vehicle.to_array()`.
    """
    slip = -sliding / max(abs(rolling), p[CRAWL_SPEED])
    return sine_within_turn(p[TYRE_C] * arctangent(b * slip))


@njit(error_model="numpy", force_inline=True)
def axle_forces(
    v_x: float,
    v_y: float,
    r: float,
    cos_d: float,
    sin_d: float,
    throttle: float,
    brake: float,
    p: _Parameters,
) -> tuple[float, float, float, float, float, float]:
    """Return F_x, F_y and F_z on the front axle, then on the rear axle, in newtons.

    F_x points along the axle's wheels (the front ones are turned by the steering angle), F_y across
    them to the left, and F_z is the load. F_x² + F_y² <= (μ F_z)² on either axle.

    Args:
        v_x, v_y, r: speed, lateral speed and yaw rate of the state.
        cos_d, sin_d: cosine and sine of the steering angle.
        throttle, brake: 0..1.
        p: `Vehicle.to_array()`.

    """
    # Velocities of the axles along (rolling) and across (sliding) their wheels.
    front_v_y = v_y + p[FRONT] * r
    front_rolling = v_x * cos_d + front_v_y * sin_d
    front_sliding = front_v_y * cos_d - v_x * sin_d
    rear_rolling = v_x
    rear_sliding = v_y - p[REAR] * r

    # Forces that the pedals ask for. Brakes oppose the rolling, and fade out at walking pace.
    engine = throttle * p[ENGINE_FORCE]
    engine *= p[SWITCH_SPEED] / max(v_x, p[SWITCH_SPEED])
    braking = brake * p[BRAKE_FORCE]
    front_fade = _clip(front_rolling / DRAG_FADE_SPEED, -1.0, 1.0)
    rear_fade = _clip(rear_rolling / DRAG_FADE_SPEED, -1.0, 1.0)

    # Load on the axles: the acceleration that the pedals ask for and the tyres allow shifts it.
    acceleration = _clip(
        (engine - braking * rear_fade) / p[MASS], p[LEAST_ACCELERATION], p[MOST_ACCELERATION]
    )
    weight = p[MASS] * p[ACROSS]
    front_share = (p[REAR] - acceleration / p[ACROSS] * p[HEIGHT]) / (p[FRONT] + p[REAR])
    front_z = weight * front_share
    rear_z = weight - front_z

    # Forces along the wheels: the pedals' forces, within the share of the grip open to them.
    front_peak = p[GRIP] * front_z
    rear_peak = p[GRIP] * rear_z
    front_limit = p[SLIP_CONTROL] * front_peak
    rear_limit = p[SLIP_CONTROL] * rear_peak
    front_braking = braking * max(p[BRAKE_FRONT_SHARE], front_share)
    rear_braking = braking - front_braking
    front_engine = p[DRIVE_FRONT_SHARE] * engine
    front_x = _clip(front_engine - front_braking * front_fade, -front_limit, front_limit)
    rear_x = _clip(engine - front_engine - rear_braking * rear_fade, -rear_limit, rear_limit)

    # Forces across the wheels: the limit of the tyres leaves at most this much.
    front_along, rear_along = p[ALONG_WEIGHT] * front_x, p[ALONG_WEIGHT] * rear_x
    front_left = math.sqrt(front_peak * front_peak - front_along * front_along)
    rear_left = math.sqrt(rear_peak * rear_peak - rear_along * rear_along)
    front_y = front_left * _lateral_grip_used(front_rolling, front_sliding, p[FRONT_TYRE_B], p)
    rear_y = rear_left * _lateral_grip_used(rear_rolling, rear_sliding, p[TYRE_B], p)
    return front_x, front_y, front_z, rear_x, rear_y, rear_z


@njit(error_model="numpy", force_inline=True)
def _pull(v_x: float, v_y: float, brake: float, p: _Parameters) -> tuple[float, float]:
    """Return the pull of gravity ahead and to the left in m/s², without the part that is held.

    Near standstill the forces of brakes, drag and sliding tyres fade out. By the share by which
    they have faded out, the car is held against the pull, with at most the forces that they have at
    speed. So a car that stands on a slope does not begin to move.
    """
    asked = brake * p[BRAKE_FORCE] / p[MASS]
    brakes = min(asked, -p[LEAST_ACCELERATION])
    rolling = abs(v_x) / DRAG_FADE_SPEED
    rolling *= max(asked, brakes, _LEAST_BRAKING) / max(brakes, _LEAST_BRAKING)
    sliding = abs(v_y) * p[TYRE_B] * p[TYRE_C] / p[CRAWL_SPEED]
    still = (1.0 - min(rolling, 1.0)) * (1.0 - min(sliding, 1.0))
    ahead = brakes + p[ROLLING_DRAG] / p[MASS]
    left = p[GRIP] * p[ACROSS]
    return (
        p[PULL_AHEAD] - still * _clip(p[PULL_AHEAD], -ahead, ahead),
        p[PULL_LEFT] - still * _clip(p[PULL_LEFT], -left, left),
    )


@njit(error_model="numpy", force_inline=True)
def motion(
    v_x: float,
    v_y: float,
    r: float,
    delta: float,
    steering: float,
    throttle: float,
    brake: float,
    p: _Parameters,
) -> tuple[float, float, float, float]:
    """Return the time derivatives of v_x, v_y, r and δ, which do not depend on the pose.

    m (dv_x/dt - v_y r - pull_x) = F_xr + F_xf cos δ - F_yf sin δ - drag
    m (dv_y/dt + v_x r - pull_y) = F_yr + F_xf sin δ + F_yf cos δ
    I_z dr/dt                    = l_f (F_xf sin δ + F_yf cos δ) - l_r F_yr

    See `_pull` for the pull of gravity on slopes and of a gust.
    """
    cos_d = cosine_within_turn(delta)
    sin_d = sine_within_turn(delta)
    front_x, front_y, _, rear_x, rear_y, _ = axle_forces(
        v_x, v_y, r, cos_d, sin_d, throttle, brake, p
    )
    front_ahead = front_x * cos_d - front_y * sin_d
    front_left = front_x * sin_d + front_y * cos_d
    rolling_drag = p[ROLLING_DRAG] * _clip(v_x / DRAG_FADE_SPEED, -1.0, 1.0)
    drag = p[AIR_DRAG] * v_x * abs(v_x) + rolling_drag
    wanted = _clip(steering, -p[STEERING_LIMIT], p[STEERING_LIMIT])
    a_x = (rear_x + front_ahead - drag) / p[MASS] + v_y * r
    a_y = (rear_y + front_left) / p[MASS] - v_x * r
    pull_ahead, pull_left = _pull(v_x, v_y, brake, p)
    a_x += pull_ahead
    a_y += pull_left
    return (
        a_x,
        a_y,
        (p[FRONT] * front_left - p[REAR] * rear_y) / p[YAW_INERTIA],
        _clip((wanted - delta) / p[STEERING_LAG], -p[STEERING_RATE], p[STEERING_RATE]),
    )


@njit(error_model="numpy", force_inline=True)
def _turned(v_x: float, v_y: float, angle: float) -> tuple[float, float]:
    """Return a velocity turned by a small angle, with a relative error of 1e-9 up to 0.1 rad."""
    square = angle * angle
    cos_a = 1.0 - square * (0.5 - square / 24.0)
    sin_a = angle * (1.0 - square * (1.0 / 6.0 - square / 120.0))
    return v_x * cos_a - v_y * sin_a, v_x * sin_a + v_y * cos_a


@njit(error_model="numpy", force_inline=True)
def on_map(v_x: float, v_y: float, r: float, p: _Parameters) -> tuple[float, float, float]:
    """Return the velocities ahead and to the left on the map, and the heading's rate of change."""
    return p[AHEAD] * v_x - p[SKEW] * v_y, p[LEFT] * v_y, p[TURN] * r + p[TWIST]


@njit(error_model="numpy", force_inline=True)
def _parameters_of(side: FloatArray, i: int) -> _Parameters:
    """Return the parameters of car ``i`` of the array in `advance`."""
    q, n = _GROUND * MOST_CARS + i, MOST_CARS
    return (
        *(side[q + 0 * n], side[q + 1 * n], side[q + 2 * n], side[q + 3 * n]),
        *(side[q + 4 * n], side[q + 5 * n], side[q + 6 * n], side[q + 7 * n]),
        *(side[q + 8 * n], side[q + 9 * n], side[q + 10 * n], side[q + 11 * n]),
        *(side[q + 12 * n], side[q + 13 * n], side[q + 14 * n], side[q + 15 * n]),
        *(side[q + 16 * n], side[q + 17 * n], side[q + 18 * n], side[q + 19 * n]),
        *(side[q + 20 * n], side[q + 21 * n], side[q + 22 * n], side[q + 23 * n]),
        *(side[q + 24 * n], side[q + 25 * n], side[q + 26 * n], side[q + 27 * n]),
        *(side[q + 28 * n], side[q + 29 * n], side[q + 30 * n], side[q + 31 * n]),
    )


@njit(error_model="numpy", force_inline=True)
def _step(
    state: tuple[float, float, float, float],
    steering: float,
    throttle: float,
    brake: float,
    p: _Parameters,
    dt: float,
) -> tuple[float, float, float, float, float, float, float]:
    """Return how a car moves in a step of the classical Runge-Kutta method (RK4).

    Args:
        state: v_x, v_y, r and δ at the start of the step.
        steering, throttle, brake: see `motion`.
        p: the car's parameters.
        dt: length of the step in s, at most 0.01.

    Returns:
        Displacement ahead and to the left, in the frame of the step's start, where the heading
        stays small; changes of heading, v_x, v_y, r and δ.
    """
    v_x, v_y, r, delta = state
    half = 0.5 * dt

    # Each stage: its velocities, the derivatives there, and the heading relative to the start.
    a_x1, a_y1, a_r1, rate1 = motion(v_x, v_y, r, delta, steering, throttle, brake, p)
    east1, north1, turn1 = on_map(v_x, v_y, r, p)

    v_x2, v_y2, r2 = v_x + half * a_x1, v_y + half * a_y1, r + half * a_r1
    ahead2, left2, turn2 = on_map(v_x2, v_y2, r2, p)
    east2, north2 = _turned(ahead2, left2, half * turn1)
    a_x2, a_y2, a_r2, rate2 = motion(
        v_x2, v_y2, r2, delta + half * rate1, steering, throttle, brake, p
    )

    v_x3, v_y3, r3 = v_x + half * a_x2, v_y + half * a_y2, r + half * a_r2
    ahead3, left3, turn3 = on_map(v_x3, v_y3, r3, p)
    east3, north3 = _turned(ahead3, left3, half * turn2)
    a_x3, a_y3, a_r3, rate3 = motion(
        v_x3, v_y3, r3, delta + half * rate2, steering, throttle, brake, p
    )

    v_x4, v_y4, r4 = v_x + dt * a_x3, v_y + dt * a_y3, r + dt * a_r3
    ahead4, left4, turn4 = on_map(v_x4, v_y4, r4, p)
    east4, north4 = _turned(ahead4, left4, dt * turn3)
    a_x4, a_y4, a_r4, rate4 = motion(
        v_x4, v_y4, r4, delta + dt * rate3, steering, throttle, brake, p
    )

    sixth = dt / 6.0
    return (
        sixth * (east1 + 2.0 * (east2 + east3) + east4),
        sixth * (north1 + 2.0 * (north2 + north3) + north4),
        sixth * (turn1 + 2.0 * (turn2 + turn3) + turn4),
        sixth * (a_x1 + 2.0 * (a_x2 + a_x3) + a_x4),
        sixth * (a_y1 + 2.0 * (a_y2 + a_y3) + a_y4),
        sixth * (a_r1 + 2.0 * (a_r2 + a_r3) + a_r4),
        sixth * (rate1 + 2.0 * (rate2 + rate3) + rate4),
    )


@njit(error_model="numpy", interpret_first=2.0)
def advance(
    states: FloatArray,
    inputs: FloatArray,
    grounds: FloatArray,
    cars: IntArray,
    dt: float,
    steps: int,
) -> None:
    """Advance cars side by side by some steps, in place; each moves as it would alone, bit for bit.

    Args:
        states: (n, 7) states, see the module's text.
        inputs: (n, 3) angles asked of the front wheels in rad, throttle and brake.
        grounds: (n, 32) parameters of each car on the ground under it, see `Vehicle.to_array`.
        cars: numbers of the cars that move, at most `MOST_CARS`.
        dt: length of a step in s, at most 0.01.
        steps: number of steps.
    """
    count = len(cars)
    # Vector instructions move whole groups: the last group is filled up with copies of a car.
    filled = count if count == 1 else -(-count // _GROUP) * _GROUP
    # Value v of car i is at v * MOST_CARS + i: in this order the loop over the cars is compiled to
    # vector instructions.
    side = np.empty((_GROUND + PARAMETER_COUNT) * MOST_CARS)
    for i in range(filled):
        k = cars[min(i, count - 1)]
        for v in range(STATE_SIZE):
            side[v * MOST_CARS + i] = states[k, v]
        side[(_INPUT + ASKED) * MOST_CARS + i] = inputs[k, ASKED]
        side[(_INPUT + THROTTLE) * MOST_CARS + i] = _clip(inputs[k, THROTTLE], 0.0, 1.0)
        side[(_INPUT + BRAKE) * MOST_CARS + i] = _clip(inputs[k, BRAKE], 0.0, 1.0)
        for v in range(PARAMETER_COUNT):
            side[(_GROUND + v) * MOST_CARS + i] = grounds[k, v]
    for _ in range(steps):
        for i in range(filled):
            heading = wrapped(side[HEADING * MOST_CARS + i])
            cos_h, sin_h = cosine_within_turn(heading), sine_within_turn(heading)
            ahead, left, turned, faster, sideways, yawing, steered = _step(
                (
                    side[SPEED * MOST_CARS + i],
                    side[LATERAL_SPEED * MOST_CARS + i],
                    side[YAW_RATE * MOST_CARS + i],
                    side[STEERING * MOST_CARS + i],
                ),
                side[(_INPUT + ASKED) * MOST_CARS + i],
                side[(_INPUT + THROTTLE) * MOST_CARS + i],
                side[(_INPUT + BRAKE) * MOST_CARS + i],
                _parameters_of(side, i),
                dt,
            )
            side[X * MOST_CARS + i] += ahead * cos_h - left * sin_h
            side[Y * MOST_CARS + i] += ahead * sin_h + left * cos_h
            side[HEADING * MOST_CARS + i] += turned
            side[SPEED * MOST_CARS + i] += faster
            side[LATERAL_SPEED * MOST_CARS + i] += sideways
            side[YAW_RATE * MOST_CARS + i] += yawing
            side[STEERING * MOST_CARS + i] += steered
    for i in range(count):
        for v in range(STATE_SIZE):
            states[cars[i], v] = side[v * MOST_CARS + i]
