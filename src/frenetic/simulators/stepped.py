"""Base of simulators in Python that only say where their car starts and how it moves on."""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

from frenetic._support.bounds import Positive, check
from frenetic.drivers.driver import Driver, DriveSetup
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.road import Pose, Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.drive_loop import RECORD_PERIOD, follow
from frenetic.simulators.embedded.rollout import start_state
from frenetic.simulators.observer import wrap
from frenetic.simulators.simulator import Ready, StartingPlace


class Motion(NamedTuple):
    """Place and motion of a car."""

    x: float
    """Coordinate of the centre of mass, in m."""
    y: float
    """Coordinate of the centre of mass, in m."""
    heading: float
    """Heading in rad, counter-clockwise from +x; whole turns do not matter."""
    speed: float = 0.0
    """Speed along the car, in m/s."""
    lateral_speed: float = 0.0
    """Speed across the car, in m/s, positive to the left."""
    yaw_rate: float = 0.0
    """Yaw rate in rad/s, positive to the left."""
    steering: float = 0.0
    """Angle of the front wheels in rad, positive to the left."""


class SteppedSimulator(StartingPlace, Ready):
    """Base of simulators that say where their car starts and how it moves on: `start` and `step`.

    It asks the driver, records, ends drives by the rules, and blames whose code broke. Override
    `__enter__` and `__exit__` to start and end parts, and what is said of the car if it has other
    sizes and limits.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        wall_limit: s of wall time that a drive may take; then it is an ERROR.
        start_offset: m to the left of the ego lane's centre at which the car starts, -2 to 2.
        start_heading: rad to the left of the road's direction in which it points there, within an
            eighth of a turn.

    `rules`, `start_offset` and `start_heading` may be set between two drives.
    """

    car: CarBody = CarBody()
    """The box that the car covers."""
    front_axle: ClassVar[float] = 1.16
    """Distance from the centre of mass to the front axle, in m."""
    rear_axle: ClassVar[float] = 1.42
    """Distance from the centre of mass to the rear axle, in m."""
    max_steering: ClassVar[float] = 0.6
    """Largest angle of the front wheels, in rad."""
    max_acceleration: ClassVar[float] = 4.0
    """Acceleration at full throttle and low speed, in m/s^2."""
    max_deceleration: ClassVar[float] = 9.0
    """Deceleration at full brake, in m/s^2."""
    period_step: ClassVar[float] = RECORD_PERIOD
    """Least time that `step` can be asked for, in s: whole milliseconds."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        wall_limit: Positive = 60.0,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        check({"wall_limit": wall_limit}, SteppedSimulator.__init__)
        self.rules = rules or Rules()
        self.wall_limit = wall_limit
        self.start_offset = start_offset
        self.start_heading = start_heading

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:
        """Put the car at rest on the road.

        Args:
            road: Road under the car; the last drive is over.
            pose: Pose of the car's centre of mass.
            setup: Setup that the driver gets.

        Returns:
            Motion of the car, ``Motion(*pose)`` if it stands there.
        """
        raise NotImplementedError

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Move the car on.

        Args:
            steering: rad, asked of the front wheels, within `max_steering`.
            throttle: 0..1.
            brake: 0..1.
            seconds: s of simulated time.

        Returns:
            Motion of the car afterwards.
        """
        raise NotImplementedError

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road, for its driver."""
        body = _body(self)
        return DriveSetup(
            speed_limit=self.rules.start_limit_on(road),
            lane_width=road.lane_width,
            period=RECORD_PERIOD,
            front_axle=self.front_axle,
            rear_axle=self.rear_axle,
            car_length=body.length,
            car_width=body.width,
            max_steering=self.max_steering,
            max_acceleration=self.max_acceleration,
            max_deceleration=self.max_deceleration,
        )

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Drive along the road.

        Raises:
            RoadError: The road leans, rises or widens, and the simulator lays only flat roads.
            ArithmeticError: The car's motion is no longer finite.
            TypeError: `car` is not a `CarBody`.
        """
        check_road(self, driver, road)
        setup = self.setup(road)
        place = start_state(road.table, road.lane_width, self.start_offset, self.start_heading)
        pose = Pose(*place[:3].tolist())
        car = _SteppedCar(
            self, self.start(road, pose, setup), road.pose.heading, setup.max_steering
        )
        return follow(
            car,
            road,
            self.rules,
            _body(self),
            setup,
            driver,
            self.wall_limit,
            period_step=self.period_step,
        )


def _body(simulator: SteppedSimulator) -> CarBody:
    body: object = simulator.car
    if not isinstance(body, CarBody):
        raise TypeError(
            f"{type(simulator).__name__}.car is the box that the car covers, a CarBody: "
            f"keep the {type(body).__name__} under another name"
        )
    return body


class _SteppedCar:
    """The car of one drive."""

    def __init__(
        self, simulator: SteppedSimulator, motion: Motion, heading: float, max_steering: float
    ) -> None:
        self._simulator = simulator
        self._heading = heading
        self._max_steering = max_steering
        self._take(motion)

    def _take(self, motion: Motion) -> None:
        motion = Motion(*map(float, motion))
        if not all(map(math.isfinite, motion)):
            raise ArithmeticError(f"the physics broke: the car's motion is {tuple(motion)}")
        self._heading += wrap(motion.heading - self._heading)
        self._motion = motion._replace(heading=self._heading)

    def motion(self) -> Motion:
        """Return the car's motion, with the heading unwrapped."""
        return self._motion

    def picture(self) -> None:
        """Return None: the simulator draws nothing."""

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car on."""
        steering = min(max(steering, -self._max_steering), self._max_steering)
        self._take(self._simulator.step(steering, throttle, brake, seconds))
