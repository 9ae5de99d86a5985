"""Base of simulators in Python: override how a car starts and how it moves, the rest is here."""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

from frenetic._support.bounds import Positive, check
from frenetic._support.trigonometry import wrapped
from frenetic.drivers.driver import Driver, DriveSetup
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.road import Pose, Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.drive_loop import RECORD_PERIOD, run_drive
from frenetic.simulators.embedded.rollout import start_state
from frenetic.simulators.simulator import Ready, StartingPlace


class Motion(NamedTuple):
    """Position and motion of a car at one moment."""

    x: float
    """x of the centre of mass on the map, in m."""
    y: float
    """y of the centre of mass on the map, in m."""
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
    """Base of simulators that override two methods: `start` and `step`.

    The base asks the driver, records the car, ends drives by the rules, and blames the part whose
    code broke. Override `__enter__` and `__exit__` to start and end what the simulator needs, and
    the class attributes below if the car has other sizes and limits.

    Args:
        rules: Speed limit, oob tolerance and when a drive ends.
        wall_limit: Wall time that a drive may take, in s; a longer one is an ERROR.
        start_offset: Distance of the car's start to the left of the ego lane's centre, in m, -2..2.
        start_heading: Angle of the car's start to the left of the road's direction, in rad, within
            an eighth of a turn.

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
    """Shortest time that `step` can be called with, in s; whole milliseconds. Drivers may have a
    period that is a multiple of it."""

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
            road: Road of the next drive; the last drive is over.
            pose: Pose of the car's centre of mass.
            setup: Setup that the driver gets.

        Returns:
            Motion of the car: ``Motion(*pose)`` if the car stands at the pose.
        """
        raise NotImplementedError

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Move the car for some simulated time.

        Args:
            steering: Angle asked of the front wheels, in rad, within `max_steering`.
            throttle: Throttle, 0..1.
            brake: Brake, 0..1.
            seconds: Simulated time, in s.

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
            RoadError: The road leans, rises or widens, and the simulator has only flat roads.
            ArithmeticError: The car's motion is no longer finite.
            TypeError: `car` is not a `CarBody`.
        """
        check_road(self, driver, road)
        setup = self.setup(road)
        state = start_state(road.table, road.lane_width, self.start_offset, self.start_heading)
        pose = Pose(*state[:3].tolist())
        motion = self.start(road, pose, setup)
        car = _SteppedCar(self, motion, road.pose.heading, setup.max_steering)
        return run_drive(
            car,
            driver,
            road=road,
            rules=self.rules,
            body=_body(self),
            setup=setup,
            limit=self.wall_limit,
            period_step=self.period_step,
        )


def _body(simulator: SteppedSimulator) -> CarBody:
    """Return a simulator's `car`, which a subclass may have taken for something else.

    Raises:
        TypeError: `car` is not a `CarBody`.
    """
    body: object = simulator.car
    if not isinstance(body, CarBody):
        raise TypeError(
            f"{type(simulator).__name__}.car is the box that the car covers, a CarBody: "
            f"keep the {type(body).__name__} under another name"
        )
    return body


class _SteppedCar:
    """The car of one drive.

    Args:
        simulator: Simulator that moves the car.
        motion: Motion at the start.
        heading: Heading of the road's start in rad, near which the car's heading begins.
        max_steering: Largest angle of the front wheels, in rad.
    """

    def __init__(
        self, simulator: SteppedSimulator, motion: Motion, heading: float, max_steering: float
    ) -> None:
        self._simulator = simulator
        self._heading = heading
        self._max_steering = max_steering
        self._set_motion(motion)

    def _set_motion(self, motion: Motion) -> None:
        """Take over a motion of the simulator, with the heading unwrapped.

        Raises:
            ArithmeticError: A number is not finite.
        """
        motion = Motion(*map(float, motion))
        if not all(map(math.isfinite, motion)):
            raise ArithmeticError(f"the physics broke: the car's motion is {tuple(motion)}")
        self._heading += wrapped(motion.heading - self._heading)
        self._motion = motion._replace(heading=self._heading)

    def motion(self) -> Motion:
        """Return the car's motion, with the heading unwrapped."""
        return self._motion

    def picture(self) -> None:
        """Return None: the simulator draws nothing."""

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car for some seconds, with the steering cut to what the wheels can do."""
        steering = min(max(steering, -self._max_steering), self._max_steering)
        self._set_motion(self._simulator.step(steering, throttle, brake, seconds))
