"""The car's parameters, and named cars.

The kernels of `frenetic.simulators.embedded.single_track` take the parameters as the vector that
`Vehicle.to_array` returns; the constants below are its indices.

Source: M. Althoff, G. Würsching, "CommonRoad: Vehicle Models", 2020 (the parameters of vehicle 2
and of its tyres).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, Share, check
from frenetic.drivers.driver import DriveSetup
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import Road
from frenetic.road.classes import GRAVITY

AIR_DENSITY: Final = 1.2
"""Density of air at 20 °C, in kg/m³."""
STEP_RATE: Final = 100.0
"""RK4 step rate for which a vehicle's parameters are checked to be stable, in Hz."""

# Indices of the parameter vector, with units.
MASS: Final = 0  # kg
YAW_INERTIA: Final = 1  # kg m²
FRONT: Final = 2  # m, centre of mass to front axle
REAR: Final = 3  # m, centre of mass to rear axle
HEIGHT: Final = 4  # m, of the centre of mass
GRIP: Final = 5  # μ, peak of an axle's force per load
TYRE_B: Final = 6  # 1/rad, such that B C μ is the cornering stiffness per load
TYRE_C: Final = 7  # Magic Formula C
CRAWL_SPEED: Final = 8  # m/s, see `Vehicle.crawl_speed`
SLIP_CONTROL: Final = 9  # share of the grip open to driving and braking
STEERING_LIMIT: Final = 10  # rad
STEERING_RATE: Final = 11  # rad/s
STEERING_LAG: Final = 12  # s
ENGINE_FORCE: Final = 13  # N
SWITCH_SPEED: Final = 14  # m/s
BRAKE_FORCE: Final = 15  # N
BRAKE_FRONT_SHARE: Final = 16  # share of the brake force at the front axle, at least
AIR_DRAG: Final = 17  # N per (m/s)²
ROLLING_DRAG: Final = 18  # N
LEAST_ACCELERATION: Final = 19  # m/s², negative: the hardest braking that the tyres allow
MOST_ACCELERATION: Final = 20  # m/s², the largest that the driven tyres allow
FRONT_TYRE_B: Final = 21  # 1/rad, TYRE_B of the front axle
ACROSS: Final = 22  # m/s², load on the tyres per mass: gravity's acceleration on flat ground
# The tilt of the ground and the push of a gust: neutral on flat ground without a gust.
PULL_AHEAD: Final = 23  # m/s², pull of gravity ahead
PULL_LEFT: Final = 24  # m/s², pull of gravity and gust to the left
# The velocity on the map is AHEAD v_x - SKEW v_y ahead and LEFT v_y to the left, and the heading on
# the map changes by TURN r + TWIST.
AHEAD: Final = 25
SKEW: Final = 26
LEFT: Final = 27
TURN: Final = 28
TWIST: Final = 29  # rad/s
DRIVE_FRONT_SHARE: Final = 30  # share of the engine's force at the front axle
ALONG_WEIGHT: Final = 31  # weight of the force along a wheel in the tyres' limit
PARAMETER_COUNT: Final = 32

_PositiveShare: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]
_STABLE_STEP: Final = 2.0
"""Largest decay rate times step length that is accepted; our choice, since RK4 is stable up to
2.78."""


@dataclass(frozen=True)
class Vehicle:
    """Parameters of a car. Defaults are CommonRoad's vehicle 2 (BMW 320i) unless said otherwise.

    Raises:
        ValueError: A parameter is not finite or outside its range, or the parameters together lift
            an axle off the ground or are too stiff for the step rate.

    """

    mass: Positive = 1093.2952334674046
    """Mass, in kg."""
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
    """Fastest change of the front wheels' angle, in rad/s."""
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
    """Cornering stiffness of the front tyres, as a multiple of the rear tyres'; below 1 the car
    understeers."""
    drive_front_share: Share = 0.0
    """Share (0..1) of the engine's force at the front axle: 0 for rear-wheel drive."""
    along_weight: Share = 1.0
    """Weight (0..1) of the force along a wheel in the limit that it shares with the force across:
    1 for the friction circle."""

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
        # At speed v the tyres damp sliding at the rate C/(m v) and yawing at l_f l_r C/(I_z v), in
        # 1/s, where C is the cornering stiffness of both axles in N/rad.
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
        """Return the car with a name in `CARS`.

        Raises:
            ValueError: There is no such car.

        """
        if name not in CARS:
            *others, last = CARS
            raise ValueError(f"vehicle is {name!r}: {', '.join(others)} or {last} is needed")
        return cls(**CARS[name])

    @classmethod
    def of(cls, description: Mapping[str, float | str]) -> Vehicle:
        """Return a named car, or the default one, with some parameters replaced.

        Args:
            description: Parameter -> value; ``name`` is the name of the car.

        Raises:
            ValueError: There is no such car or parameter, or a value is out of range.

        """
        parameters = dict(description)
        car = cls.named(str(parameters.pop("name", "default")))
        known = [item.name for item in fields(cls)]
        if unknown := parameters.keys() - known:
            raise ValueError(f"vehicle has no {min(unknown)!r}; it has: {', '.join(known)}")
        return replace(car, **parameters)  # type: ignore[arg-type]  # checked on construction

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

        The forces of engine and brakes and the centre of mass do not change.
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
        """Return the setup that the driver of a drive gets.

        Args:
            rules: Rules of the drive.
            road: Road of the drive.
            period: Time between two decisions, in s.
        """
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
        p[AHEAD] = p[LEFT] = p[TURN] = 1.0
        p[LEAST_ACCELERATION] = -usable * GRAVITY
        p[DRIVE_FRONT_SHARE] = self.drive_front_share
        p[ALONG_WEIGHT] = self.along_weight
        p[MOST_ACCELERATION] = self._most_acceleration(usable)
        return p

    def _most_acceleration(self, usable: float) -> float:
        """Return the largest acceleration that the driven tyres allow, in m/s².

        Args:
            usable: the share of the friction coefficient μ that driving may use.
        """
        if 0.0 < self.drive_front_share < 1.0:
            return usable * GRAVITY
        # The acceleration a takes load from the front axle and adds it to the rear one. A driven
        # rear axle has m a = μ m (g l_f + a h) / l, a front one m a = μ m (g l_r - a h) / l.
        shift = usable * self.cg_height
        if self.drive_front_share == 0.0:
            return usable * GRAVITY * self.front_axle / (self.wheelbase - shift)
        return usable * GRAVITY * self.rear_axle / (self.wheelbase + shift)


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
steering, engine and brakes come from MetaDrive 0.4.3's default car with constant parameters. Its
wheels do not slide before the friction limit and hold it beyond, so the tyres are as stiff as the
step rate allows and their force has no peak; they steer at once; nothing but the engine's limit of
80 km/h holds the car back under throttle. It brakes by 8 m/s², beyond which MetaDrive's rear tyres
begin to slide. MetaDrive drives all wheels, and its friction limit counts forces along a wheel
half; this car has neither. To leave as much grip for cornering, half of it is open to driving and
braking, so this car starts with 2.1 instead of 2.9 m/s² and brakes by 4.4 m/s².

``etk800`` is the car that BeamNG.AI drives in the competition, as far as this model allows;
`docs/beamng-ai.md` says what is known of it and what is fitted to recorded drives.
"""
