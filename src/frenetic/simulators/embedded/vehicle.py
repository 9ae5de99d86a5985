"""The car: a dynamic single-track model with Pacejka tyres, in compiled code.

The two wheels of an axle are taken as one in its middle. The car yaws and slides in the plane; roll
and pitch appear only as the load that driving and braking shift between the axles. Lateral tyre
forces follow the Magic Formula, limited by a friction circle that cornering shares with driving and
braking.

The plane is the road's under the car. Where it is not flat, `frenetic.simulators.embedded.slopes`
says how gravity pulls in it and loads the tyres.

A state is a float64 vector (7,), in SI units, positive to the left; place and heading are those on
the map, all else is in the plane:

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

The inputs are held over a control period: the angle asked of the front wheels [rad], throttle and
brake [0..1]; all three are clipped to their range. There is no reverse gear: ``SPEED`` is negative
only while a car that has spun round slides backwards, or one that nothing holds rolls down a slope.

Sources: M. Althoff, G. Würsching, "CommonRoad: Vehicle Models", 2020 (the parameters of vehicle 2
and of its tyres, and the single-track model); H. B. Pacejka, "Tire and Vehicle Dynamics" (Magic
Formula). What differs from the CommonRoad single-track model: the tyres saturate, the steering
lags, the engine is a family car's, no wheel locks or spins, air and rolling drag act, and low
speeds need no kinematic substitute (see ``Vehicle.crawl_speed``).

With one kind of tyre all round, whose forces grow in proportion to the load, the car is neutral: it
understeers only by what load transfer and drive forces make of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, check
from frenetic._support.compiled import njit
from frenetic.drivers.driver import DRAG_FADE_SPEED, DriveSetup
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import Road

GRAVITY: Final = 9.81
"""m/s²."""
AIR_DENSITY: Final = 1.2
"""kg/m³, at 20 °C."""
STEP_RATE: Final = 100.0
"""RK4 step rate for which a vehicle's parameters are checked to be stable, in Hz."""

# The state vector.
X: Final = 0
Y: Final = 1
HEADING: Final = 2
SPEED: Final = 3
LATERAL_SPEED: Final = 4
YAW_RATE: Final = 5
STEERING: Final = 6
STATE_SIZE: Final = 7

# The parameter vector of the kernels, made by `Vehicle.to_array`.
MASS: Final = 0  # kg
YAW_INERTIA: Final = 1  # kg m²
FRONT: Final = 2  # m, centre of mass to front axle
REAR: Final = 3  # m, centre of mass to rear axle
HEIGHT: Final = 4  # m, of the centre of mass
GRIP: Final = 5  # μ, peak of an axle's force per load
TYRE_B: Final = 6  # 1/rad, such that B C μ is the cornering stiffness per load
TYRE_C: Final = 7
CRAWL_SPEED: Final = 8  # m/s
SLIP_CONTROL: Final = 9  # share of the grip open to driving and braking
STEERING_LIMIT: Final = 10  # rad
STEERING_RATE: Final = 11  # rad/s
STEERING_LAG: Final = 12  # s
ENGINE_FORCE: Final = 13  # N
SWITCH_SPEED: Final = 14  # m/s
BRAKE_FORCE: Final = 15  # N
BRAKE_FRONT_SHARE: Final = 16
AIR_DRAG: Final = 17  # N per (m/s)²
ROLLING_DRAG: Final = 18  # N
LEAST_ACCELERATION: Final = 19  # m/s², negative: all that the tyres can brake
MOST_ACCELERATION: Final = 20  # m/s², all that the rear axle can drive
FRONT_TYRE_B: Final = 21  # 1/rad, TYRE_B of the front axle
ACROSS: Final = 22  # m/s², load on the tyres per mass: gravity's, on flat ground
# The rest are of tilted ground alone.
IS_TILTED: Final = 23  # 1, or 0
PULL_AHEAD: Final = 24  # m/s², gravity's part along the car
PULL_LEFT: Final = 25  # m/s², and across it
# The velocity on the map is AHEAD v_x - SKEW v_y ahead and LEFT v_y to the left; there the car
# turns by TURN r + TWIST.
AHEAD: Final = 26
SKEW: Final = 27
LEFT: Final = 28
TURN: Final = 29
TWIST: Final = 30  # rad/s
PARAMETER_COUNT: Final = 31

_PositiveShare: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]
_STABLE_STEP: Final = 2.0
"""Largest decay rate times step length that is accepted; RK4 is stable up to 2.78."""


@dataclass(frozen=True)
class Vehicle:
    """Parameters of a car. Defaults are CommonRoad's vehicle 2 (BMW 320i) unless said otherwise.

    Raises:
        ValueError: a parameter is not finite or outside its range, or the parameters together lift
            an axle off the ground or are too stiff for the step rate.

    """

    mass: Positive = 1093.2952334674046
    """kg."""
    yaw_inertia: Positive = 1791.5995300122856
    """Yaw inertia about the vertical axis, in kg m²."""
    front_axle: Positive = 1.1561957064
    """Distance from the centre of mass forward to the front axle, in m."""
    rear_axle: Positive = 1.4227170936
    """Distance from the centre of mass back to the rear axle, in m."""
    cg_height: Positive = 0.61373004
    """Height of the centre of mass above the ground, in m; the sprung mass's, as in CommonRoad."""
    length: Positive = 4.508
    """Length from bumper to bumper, in m."""
    width: Positive = 1.610
    """Width in m, without mirrors."""
    body_shift: NotNegative = 0.0
    """Distance of the body's centre ahead of the middle between the axles, in m; may be 0."""

    tyre_shape: Annotated[float, Meta(gt=0.0, le=2.0)] = 1.3507
    """Magic Formula C (p_cy1), up to 2."""
    tyre_peak: Positive = 1.0489
    """Magic Formula D per load (p_dy1): the friction coefficient at `friction` 1."""
    tyre_stiffness: Positive = 21.92
    """Cornering stiffness per load (-p_ky1) in 1/rad, whatever the `friction`."""
    friction: Positive = 1.0
    """Scale of the peak force: 1 is a dry road, about 0.7 a wet one, about 0.3 snow."""
    crawl_speed: Positive = 2.0
    """Least rolling speed assumed in a tyre's slip, in m/s.

    The tyres' damping of lateral motion is proportional to 1/speed, so their equation is stiff near
    standstill. With this floor their force becomes viscous there instead, which holds the wheels to
    the path they point along, as a kinematic model does, and vanishes at rest.
    """
    slip_control: _PositiveShare = 0.95
    """Share (0..1] of an axle's grip that driving and braking may use.

    Anti-lock brakes and traction control keep the rest for cornering, sqrt(1 - 0.95²) = 0.31 of it.
    """

    steering_limit: Annotated[float, Meta(gt=0.0, lt=math.pi / 2.0)] = 1.066
    """Largest angle of the front wheels, in rad."""
    steering_rate: Positive = 0.4
    """Fastest change of that angle, in rad/s."""
    steering_lag: Positive = 0.1
    """Time constant of the actuator, in s; our choice, typical of electric power steering."""

    engine_acceleration: Positive = 4.5
    """Acceleration on a level road at full throttle below `switch_speed`, in m/s², rear axle.

    Our choice: CommonRoad's 11.5 m/s² (switching at 7.319 m/s) is a racer's. 4.5 m/s² up to 15 m/s
    are 67.5 W/kg, which take the car from 0 to 100 km/h in 8 s, as a family car does.
    """
    switch_speed: Positive = 15.0
    """Speed above which the engine's power limits the acceleration (to 1/speed), in m/s."""
    brake_deceleration: Positive = 9.0
    """Deceleration at full pedal, in m/s², within the tyres' limit; our choice, a good car's."""
    brake_front_share: _PositiveShare = 0.66
    """Share (0..1] of the brake force at the front axle, at least.

    Where the front axle bears more than this share of the load, it gets its share of the load, as
    electronic brake-force distribution does: the rear axle never locks first.
    """
    drag_area: NotNegative = 0.65
    """Drag coefficient times frontal area, in m² (about 0.3 times 2.2 m²); may be 0."""
    rolling_resistance: NotNegative = 0.012
    """Rolling drag per weight; may be 0."""
    front_stiffness: Positive = 1.0
    """Cornering stiffness of the front tyres per that of the rear tyres; below 1 the car
    understeers."""

    def __post_init__(self) -> None:
        check(vars(self), Vehicle)
        if self.grip * self.cg_height >= min(self.front_axle, self.rear_axle):
            raise ValueError(
                f"tyre_peak * friction is {self.grip:g}: such grip lifts an axle off the ground;"
                f" with cg_height {self.cg_height:g} m it has to be below"
                f" {min(self.front_axle, self.rear_axle) / self.cg_height:.2f}"
            )
        if self.steering_lag * STEP_RATE * _STABLE_STEP < 1.0:
            raise ValueError(
                f"steering_lag is {self.steering_lag} s: at least"
                f" {1.0 / (STEP_RATE * _STABLE_STEP):g} s are needed to integrate at"
                f" {STEP_RATE:g} Hz"
            )
        # At speed v the tyres damp sliding by C/(m v) per second and yawing by l_f l_r C/(I_z v),
        # where C is the cornering stiffness of both axles.
        arm = self.front_axle * self.rear_axle * self.mass / self.yaw_inertia
        decay = self.tyre_stiffness * GRAVITY * max(1.0, arm)
        needed = decay / (STEP_RATE * _STABLE_STEP)
        if self.crawl_speed < needed:
            raise ValueError(
                f"crawl_speed is {self.crawl_speed} m/s: with this tyre_stiffness, mass and"
                f" yaw_inertia, at least {needed:.2f} m/s are needed to integrate at"
                f" {STEP_RATE:g} Hz"
            )

    @classmethod
    def named(cls, name: str) -> Vehicle:
        """Return the car of a name, see `CARS`.

        Raises:
            ValueError: there is no such car.

        """
        if name not in CARS:
            *others, last = CARS
            raise ValueError(f"vehicle is {name!r}: {', '.join(others)} or {last} is needed")
        return cls(**CARS[name])

    @classmethod
    def of(cls, description: Mapping[str, float | str]) -> Vehicle:
        """Return the car of a description: its parameters, beside those of the car in ``name``.

        Raises:
            ValueError: there is no such car or parameter, or a value is out of range.

        """
        given = dict(description)
        car = cls.named(str(given.pop("name", "default")))
        known = [item.name for item in fields(cls)]
        if unknown := given.keys() - known:
            raise ValueError(f"vehicle has no {min(unknown)!r}; it has: {', '.join(known)}")
        return replace(car, **given)  # type: ignore[arg-type]  # checked there

    @property
    def wheelbase(self) -> float:
        """Wheelbase from axle to axle, in m."""
        return self.front_axle + self.rear_axle

    @property
    def grip(self) -> float:
        """The friction coefficient μ between tyres and road."""
        return self.tyre_peak * self.friction

    def loaded(self, load: float) -> Vehicle:
        """Return the car with ``load`` kg spread evenly between its axles.

        Engine and brakes have the same force. The centre of mass stays where it is.
        """
        share = self.mass / (self.mass + load)
        return replace(
            self,
            mass=self.mass + load,
            yaw_inertia=self.yaw_inertia + load * self.wheelbase**2 / 12.0,
            engine_acceleration=share * self.engine_acceleration,
            brake_deceleration=share * self.brake_deceleration,
        )

    def body(self) -> CarBody:
        """Return the rectangle that the car covers."""
        return CarBody(
            length=self.length,
            width=self.width,
            centre_ahead=0.5 * (self.front_axle - self.rear_axle) + self.body_shift,
        )

    def setup(self, rules: Rules, road: Road, period: float) -> DriveSetup:
        """Return the setup of a drive with one decision every ``period`` s, for its driver."""
        stiffness = self.tyre_stiffness * self.mass * GRAVITY / self.wheelbase
        return DriveSetup(
            speed_limit=rules.start_limit_on(road),
            lane_width=road.lane_width,
            period=period,
            front_axle=self.front_axle,
            rear_axle=self.rear_axle,
            car_length=self.length,
            car_width=self.width,
            max_steering=self.steering_limit,
            max_acceleration=self.engine_acceleration,
            max_deceleration=self.brake_deceleration,
            switch_speed=self.switch_speed,
            rolling_drag=self.rolling_resistance * GRAVITY,
            air_drag=0.5 * AIR_DENSITY * self.drag_area / self.mass,
            mass=self.mass,
            yaw_inertia=self.yaw_inertia,
            front_cornering_stiffness=self.front_stiffness * stiffness * self.rear_axle,
            rear_cornering_stiffness=stiffness * self.front_axle,
            steering_rate=self.steering_rate,
            steering_lag=self.steering_lag,
        )

    def to_array(self) -> FloatArray:
        """Return the parameters as the kernels take them: a (PARAMETER_COUNT,) vector."""
        p = np.zeros(PARAMETER_COUNT)
        p[MASS] = self.mass
        p[YAW_INERTIA] = self.yaw_inertia
        p[FRONT] = self.front_axle
        p[REAR] = self.rear_axle
        p[HEIGHT] = self.cg_height
        p[GRIP] = self.grip
        p[TYRE_B] = self.tyre_stiffness / (self.tyre_shape * self.grip)
        p[TYRE_C] = self.tyre_shape
        p[FRONT_TYRE_B] = p[TYRE_B] * self.front_stiffness
        p[CRAWL_SPEED] = self.crawl_speed
        p[SLIP_CONTROL] = self.slip_control
        p[STEERING_LIMIT] = self.steering_limit
        p[STEERING_RATE] = self.steering_rate
        p[STEERING_LAG] = self.steering_lag
        p[ENGINE_FORCE] = self.mass * self.engine_acceleration
        p[SWITCH_SPEED] = self.switch_speed
        p[BRAKE_FORCE] = self.mass * self.brake_deceleration
        p[BRAKE_FRONT_SHARE] = self.brake_front_share
        p[AIR_DRAG] = 0.5 * AIR_DENSITY * self.drag_area
        p[ROLLING_DRAG] = self.rolling_resistance * self.mass * GRAVITY
        usable = self.slip_control * self.grip
        p[ACROSS] = GRAVITY
        p[LEAST_ACCELERATION] = -usable * GRAVITY
        # The rear axle drives with μ F_z, and the acceleration a adds to its load:
        # m a = μ m (g l_f + a h) / l.
        p[MOST_ACCELERATION] = (
            usable * GRAVITY * self.front_axle / (self.wheelbase - usable * self.cg_height)
        )
        return p


CARS: Final[Mapping[str, Mapping[str, float]]] = {
    "default": {},
    "metadrive": {
        "mass": 1100.0,
        "yaw_inertia": 2183.05,
        "front_axle": 1.05234,
        "rear_axle": 1.4166,
        "cg_height": 0.6,
        "length": 4.515,
        "width": 1.852,
        "body_shift": 0.18213,
        "tyre_shape": 1.0,
        "tyre_peak": 0.9,
        "tyre_stiffness": 40.0,
        "slip_control": 0.5,
        "steering_limit": math.radians(40.0),
        "steering_rate": 20.0,
        "steering_lag": 0.01,
        "engine_acceleration": 4.0 * 800.0 / 1100.0,
        "switch_speed": 80.0 / 3.6,
        "brake_deceleration": 8.0,
        "brake_front_share": 0.5,
        "drag_area": 0.0,
        "rolling_resistance": 0.0,
    },
    "etk800": {
        "mass": 1500.0,
        "yaw_inertia": 2000.0,
        "front_axle": 1.45,
        "rear_axle": 1.45,
        "cg_height": 0.5,
        "length": 4.7,
        "width": 1.91,
        "tyre_shape": 1.5,
        "tyre_peak": 1.03,
        "tyre_stiffness": 26.5,
        "front_stiffness": 0.43,
        "crawl_speed": 3.0,
        "steering_limit": 0.6,
        "steering_rate": 2.4,
        "steering_lag": 0.05,
        "engine_acceleration": 4.2,
        "switch_speed": 12.0,
        "brake_deceleration": 8.0,
    },
}
"""Name of a car -> the parameters in which it differs from the default.

``metadrive`` is the car of `frenetic.plugins.metadrive`, as far as this model allows. Sizes, mass,
steering, engine and brakes are those of MetaDrive 0.4.3's default car with constant parameters. Its
wheels do not slide before the friction limit and hold it beyond, so the tyres are as stiff as the
step rate allows and their force has no peak; they steer at once; nothing but the engine's limit of
80 km/h holds the car back under throttle. It brakes by 8 m/s², beyond which MetaDrive's rear tyres
begin to slide. MetaDrive drives all wheels, and its friction limit counts forces along a wheel
half, which this model cannot. To leave as much grip for cornering, half of it is open to driving
and braking, so this car starts with 2.1 instead of 2.9 m/s² and brakes by 4.4 m/s².

``etk800`` is the car that BeamNG.AI drives in the competition, as far as this model allows;
`docs/beamng-ai.md` says what is known of it and what is fitted to recorded drives.
"""


@njit(error_model="numpy")
def _clip(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


@njit(error_model="numpy")
def _lateral_grip_used(rolling: float, sliding: float, b: float, p: FloatArray) -> float:
    """Return the lateral force per peak force, -1..1, of tyres that roll and slide so fast [m/s].

    The Magic Formula sin(C atan(B α)), where the tangent of the slip angle stands for α, as Pacejka
    has it for large slip; up to 0.1 rad, that moves the force by 0.05 % of its peak. So does
    leaving out the fourth coefficient, E (p_ey1 = -0.0075). A tyre that slides to the right is
    pushed to the left.
    """
    slip = -sliding / max(abs(rolling), p[CRAWL_SPEED])
    return math.sin(p[TYRE_C] * math.atan(b * slip))


@njit(error_model="numpy")
def axle_forces(
    v_x: float,
    v_y: float,
    r: float,
    cos_d: float,
    sin_d: float,
    throttle: float,
    brake: float,
    p: FloatArray,
) -> tuple[float, float, float, float, float, float]:
    """Return the forces on the front axle, then on the rear axle, in newtons: F_x, F_y, F_z each.

    F_x points along the axle's wheels (the front ones are turned by the steering angle), F_y across
    them to the left, and F_z is the load. F_x² + F_y² <= (μ F_z)² on either axle.

    Args:
        v_x, v_y, r: speed, lateral speed and yaw rate of the state.
        cos_d, sin_d: of the steering angle.
        throttle, brake: 0..1.
        p: `Vehicle.to_array()`.

    """
    # Velocities of the axles along (rolling) and across (sliding) their wheels.
    front_v_y = v_y + p[FRONT] * r
    front_rolling = v_x * cos_d + front_v_y * sin_d
    front_sliding = front_v_y * cos_d - v_x * sin_d
    rear_rolling = v_x
    rear_sliding = v_y - p[REAR] * r

    # What the pedals ask for. Brakes oppose the rolling and fade with it.
    engine = throttle * p[ENGINE_FORCE]
    if v_x > p[SWITCH_SPEED]:
        engine *= p[SWITCH_SPEED] / v_x
    braking = brake * p[BRAKE_FORCE]
    front_fade = _clip(front_rolling / DRAG_FADE_SPEED, -1.0, 1.0)
    rear_fade = _clip(rear_rolling / DRAG_FADE_SPEED, -1.0, 1.0)

    # Onto the ground: the acceleration asked for, as far as the tyres give it, shifts load.
    acceleration = _clip(
        (engine - braking * rear_fade) / p[MASS], p[LEAST_ACCELERATION], p[MOST_ACCELERATION]
    )
    weight = p[MASS] * p[ACROSS]
    front_share = (p[REAR] - acceleration / p[ACROSS] * p[HEIGHT]) / (p[FRONT] + p[REAR])
    front_z = weight * front_share
    rear_z = weight - front_z

    # Along the wheels: the pedals' forces, held within the share of the grip open to them.
    front_peak = p[GRIP] * front_z
    rear_peak = p[GRIP] * rear_z
    front_limit = p[SLIP_CONTROL] * front_peak
    rear_limit = p[SLIP_CONTROL] * rear_peak
    front_braking = braking * max(p[BRAKE_FRONT_SHARE], front_share)
    rear_braking = braking - front_braking
    front_x = _clip(-front_braking * front_fade, -front_limit, front_limit)
    rear_x = _clip(engine - rear_braking * rear_fade, -rear_limit, rear_limit)

    # Across the wheels: what the friction circle leaves.
    front_left = math.sqrt(front_peak * front_peak - front_x * front_x)
    rear_left = math.sqrt(rear_peak * rear_peak - rear_x * rear_x)
    front_y = front_left * _lateral_grip_used(front_rolling, front_sliding, p[FRONT_TYRE_B], p)
    rear_y = rear_left * _lateral_grip_used(rear_rolling, rear_sliding, p[TYRE_B], p)
    return front_x, front_y, front_z, rear_x, rear_y, rear_z


@njit(error_model="numpy")
def _pull(v_x: float, v_y: float, brake: float, p: FloatArray) -> tuple[float, float]:
    """Return gravity's pull along and across the car in m/s², less what its tyres hold.

    Brakes and drag fade out at walking pace, and so do tyres across that hardly slide. As far as
    they have, they hold against the pull what they give at speed: a car that stands stays.
    """
    asked = brake * p[BRAKE_FORCE] / p[MASS]
    brakes = min(asked, -p[LEAST_ACCELERATION])
    rolling = abs(v_x) / DRAG_FADE_SPEED
    if asked > brakes:
        rolling *= asked / brakes
    sliding = abs(v_y) * p[TYRE_B] * p[TYRE_C] / p[CRAWL_SPEED]
    still = (1.0 - min(rolling, 1.0)) * (1.0 - min(sliding, 1.0))
    ahead = brakes + p[ROLLING_DRAG] / p[MASS]
    left = p[GRIP] * p[ACROSS]
    return (
        p[PULL_AHEAD] - still * _clip(p[PULL_AHEAD], -ahead, ahead),
        p[PULL_LEFT] - still * _clip(p[PULL_LEFT], -left, left),
    )


@njit(error_model="numpy")
def motion(
    v_x: float,
    v_y: float,
    r: float,
    delta: float,
    steering: float,
    throttle: float,
    brake: float,
    p: FloatArray,
) -> tuple[float, float, float, float]:
    """Return the time derivatives of v_x, v_y, r and δ. They depend on neither place nor heading.

    m (dv_x/dt - v_y r) = F_xr + F_xf cos δ - F_yf sin δ - drag
    m (dv_y/dt + v_x r) = F_yr + F_xf sin δ + F_yf cos δ
    I_z dr/dt           = l_f (F_xf sin δ + F_yf cos δ) - l_r F_yr

    On tilted ground gravity's pull comes on top, less what holds a car that stands.
    """
    cos_d = math.cos(delta)
    sin_d = math.sin(delta)
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
    if p[IS_TILTED]:
        pull_ahead, pull_left = _pull(v_x, v_y, brake, p)
        a_x += pull_ahead
        a_y += pull_left
    return (
        a_x,
        a_y,
        (p[FRONT] * front_left - p[REAR] * rear_y) / p[YAW_INERTIA],
        _clip((wanted - delta) / p[STEERING_LAG], -p[STEERING_RATE], p[STEERING_RATE]),
    )


@njit(error_model="numpy")
def _turned(v_x: float, v_y: float, angle: float) -> tuple[float, float]:
    """Return a velocity turned by a small angle, to 1e-9 of itself up to 0.1 rad."""
    square = angle * angle
    cos_a = 1.0 - square * (0.5 - square / 24.0)
    sin_a = angle * (1.0 - square * (1.0 / 6.0 - square / 120.0))
    return v_x * cos_a - v_y * sin_a, v_x * sin_a + v_y * cos_a


@njit(error_model="numpy")
def on_map(v_x: float, v_y: float, r: float, p: FloatArray) -> tuple[float, float, float]:
    """Return the velocities ahead and to the left on the map, and how fast the heading turns."""
    if p[IS_TILTED]:
        return p[AHEAD] * v_x - p[SKEW] * v_y, p[LEFT] * v_y, p[TURN] * r + p[TWIST]
    return v_x, v_y, r


@njit(error_model="numpy")
def advance(
    state: FloatArray, steering: float, throttle: float, brake: float, p: FloatArray, dt: float
) -> None:
    """Move a state on by dt [s] in place: one step of the classical Runge-Kutta method (RK4).

    The way is summed up in the frame of the step's start, in which the heading stays small.

    Args:
        state: (7,), see the module's text.
        steering: rad, asked of the front wheels, positive to the left.
        throttle: 0..1.
        brake: 0..1.
        p: `Vehicle.to_array()`.
        dt: s, at most 0.01.

    """
    throttle = _clip(throttle, 0.0, 1.0)
    brake = _clip(brake, 0.0, 1.0)
    v_x, v_y, r, delta = state[SPEED], state[LATERAL_SPEED], state[YAW_RATE], state[STEERING]
    half = 0.5 * dt

    # Each stage: its velocities, the heading since the start, and the derivatives there.
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
    ahead = sixth * (east1 + 2.0 * (east2 + east3) + east4)
    left = sixth * (north1 + 2.0 * (north2 + north3) + north4)
    cos_h = math.cos(state[HEADING])
    sin_h = math.sin(state[HEADING])
    state[X] += ahead * cos_h - left * sin_h
    state[Y] += ahead * sin_h + left * cos_h
    state[HEADING] += sixth * (turn1 + 2.0 * (turn2 + turn3) + turn4)
    state[SPEED] += sixth * (a_x1 + 2.0 * (a_x2 + a_x3) + a_x4)
    state[LATERAL_SPEED] += sixth * (a_y1 + 2.0 * (a_y2 + a_y3) + a_y4)
    state[YAW_RATE] += sixth * (a_r1 + 2.0 * (a_r2 + a_r3) + a_r4)
    state[STEERING] += sixth * (rate1 + 2.0 * (rate2 + rate3) + rate4)
