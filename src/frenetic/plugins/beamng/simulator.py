"""BeamNG.tech as a `frenetic.simulators.Simulator`, and the measurement of its car."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import replace
from types import TracebackType
from typing import Annotated, Any, ClassVar, Final, Self

import numpy as np
from msgspec import Meta

from frenetic._support.bounds import Count, Finite, Positive, Text, check
from frenetic._support.trigonometry import wrapped
from frenetic.drivers import BeamngAi, Driver, DriveSetup
from frenetic.drivers.stack import camera_of, check_other_world, unwrapped
from frenetic.errors import DriverError, Trouble
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.plugins.beamng.car import BeamngCar, MeasuredCar
from frenetic.plugins.beamng.car_state import CarState
from frenetic.plugins.beamng.link import Link
from frenetic.plugins.beamng.location import location_arguments
from frenetic.plugins.beamng.package import BeamngError
from frenetic.road import Pose, Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.checks import SimulatorCheck, drive_checks
from frenetic.simulators.drive_loop import RECORD_PERIOD, run_drive
from frenetic.simulators.observer import LimitsAhead

WALL_LIMIT: Final = 600.0
"""Default of the wall time that a drive may take, in s; our choice."""
LEVELS: Final = {"tech_ground": 0.0, "smallgrid": 0.0, "gridmap_v2": 100.0}
"""Level with room for a flat map -> height of its ground, in m."""

_SETTLING_TIME: Final = 3.0
"""Simulated time in s in which a count-down passes and the car comes to rest on its springs."""
_MAX_SETTLINGS: Final = 3
"""Number of settling times after which a car has to be at rest; our choice."""
_REST_SPEED: Final = 0.1
"""Speed in m/s below which the car counts as at rest; our choice."""
_MAX_START_ERROR: Final = 0.3
"""Distance from its place at which a car may be at the start, in m; our choice."""
_ASSUMED_ACCELERATION: Final = 4.0
"""Acceleration of the car that drivers are told, in m/s²; our choice, since it is not measured."""
_ASSUMED_DECELERATION: Final = 9.0
"""Deceleration of the car that drivers are told, in m/s²; our choice, since it is not measured."""

# The drive by which the car's steering is measured, all our choice
_MEASURED_INPUT: Final = 0.25
"""Steering input, 0..1."""
_MEASURED_SPEED: Final = 3.0
"""Speed up to which the car accelerates before, in m/s."""
_SPEED_UP_TIME: Final = 10.0
"""Longest simulated time for accelerating, in s."""
_SPEED_UP_THROTTLE: Final = 0.3
_MEASURING_TIME: Final = 1.0
"""Simulated time on the circle, in s."""
_MEASURING_THROTTLE: Final = 0.05
_STEERING_RANGE: Final = (0.1, 1.5)
"""Range of the front wheels' angle at full steering input, in rad, outside of which the measured
value is wrong."""
_LEAST_REPORTED_SHARE: Final = 0.2
"""Share of the steering input that BeamNG.tech has to report, else it reports none."""

logger = logging.getLogger(__name__)


class BeamngSimulator:
    """BeamNG.tech, started or already running; a drive takes about as long as on a real road.

    With the driver `BeamngAi`, BeamNG.AI itself drives; any other driver steers the car. A drive
    records the middle of the car's bounding box. The box and the car's answer to steering are
    measured in BeamNG.tech when the simulator is entered for the first time.

    Args:
        rules: Speed limit, oob tolerance and when a drive ends.
        home: Folder of the installation to start; by default the environment variable BNG_HOME.
        user: Folder for what BeamNG.tech writes; by default BeamNG.tech's own choice.
        host: Host of a running BeamNG.tech to connect to, instead of starting one.
        port: Port of a running BeamNG.tech to connect to, 25252 by default.
        headless: Whether BeamNG.tech is started without a window.
        no_gpu: Whether BeamNG.tech is started without a graphics card.
        vehicle: Name of the car's model.
        aggression: Share of the grip that BeamNG.AI uses in curves, above 0 and up to 2.
        level: Name of a flat level, in which the road is built.
        ground: Height of the level's ground in m, needed unless the level is in `LEVELS`.
        wall_limit: Wall time that a drive may take, in s.
        restart_every: Number of drives after which BeamNG.tech is started anew; None restarts it
            only when it breaks.

    Raises:
        ValueError: An option is out of range.
        BeamngError: No option says where BeamNG.tech is, or the options contradict each other.
    """

    needs: Final = ("beamngpy",)
    """Modules of the extra ``beamng``."""
    preloads: Final = ("frenetic.plugins.beamng.preloading",)
    usual_wall_limit: Final = WALL_LIMIT
    usual_workers: Final = 1
    """One worker by default: a BeamNG.tech takes a whole graphics card."""

    place_options: Final = ("home", "user", "headless", "no_gpu", "host", "port", "restart_every")
    draws: Final = True
    period_step: Final = RECORD_PERIOD
    BEHAVIOUR: ClassVar[int] = 2
    """Version of the drives: to be increased when they change; campaigns record it."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        home: Text | None = None,
        user: Text | None = None,
        host: Text | None = None,
        port: Annotated[int, Meta(ge=1, le=65535)] | None = None,
        headless: bool = False,
        no_gpu: bool = False,
        vehicle: Text = "etk800",
        aggression: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.7,
        level: Text = "tech_ground",
        ground: Finite | None = None,
        wall_limit: Positive = WALL_LIMIT,
        restart_every: Count | None = None,
    ) -> None:
        check(locals(), BeamngSimulator.__init__)
        if ground is None and level not in LEVELS:
            raise ValueError(
                f"level is {level!r}, whose ground is not known: give its height with ground, or"
                f" choose one of {', '.join(LEVELS)}"
            )
        self.place = location_arguments(home, user, host, port, headless, no_gpu)
        if restart_every is not None and self.place["home"] is None:
            raise BeamngError("restart_every is for a BeamNG.tech that is started: give home, too")
        self.rules = rules or Rules()
        self.vehicle = vehicle
        self.aggression = aggression
        self.level = level
        self.ground = LEVELS[level] if ground is None else ground
        self.wall_limit = wall_limit
        self.restart_every = restart_every
        self.car = CarBody()
        self._measured: MeasuredCar | None = None
        self._link: Link | None = None
        self._drives = 0  # number of drives since BeamNG.tech was connected to
        self._needs_restart = False  # whether BeamNG.tech is entered again before the next drive

    @property
    def options(self) -> dict[str, Any]:
        """Options that the drives depend on, beside the rules."""
        return {
            "vehicle": self.vehicle,
            "aggression": self.aggression,
            "level": self.level,
            "wall_limit": self.wall_limit,
        }

    @property
    def workers_at_most(self) -> int | None:
        """Largest number of workers; a running BeamNG.tech serves the first, others are started."""
        return 1 if self.place["home"] is None else None

    @property
    def link(self) -> Link:
        """Connection to BeamNG.tech.

        Raises:
            BeamngError: the simulator is not entered.
        """
        if self._link is None:
            raise BeamngError("BeamNG.tech is not started: use the simulator in a with statement")
        return self._link

    @property
    def measured(self) -> MeasuredCar:
        """Measured sizes of the car.

        Raises:
            BeamngError: the simulator was never entered.
        """
        if self._measured is None:
            raise BeamngError("the car is not measured yet: use the simulator in a with statement")
        return self._measured

    def __getstate__(self) -> dict[str, Any]:
        # A copy for another process has the measured sizes, but no connection.
        return self.__dict__ | {"_link": None}

    def prepare(self) -> None:
        """Measure the car unless that is done; this starts and ends BeamNG.tech."""
        if self._measured is None:
            with self:
                pass

    def __enter__(self) -> Self:
        """Start BeamNG.tech or connect to it, and measure the car unless that is done."""
        self._connect()
        try:
            if self._measured is None:
                self._measure()
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Disconnect; end BeamNG.tech if it was started here."""
        self._leave()

    def _connect(self) -> None:
        """Start BeamNG.tech or connect to it."""
        self._link = Link(self.place)
        self._drives, self._needs_restart = 0, False

    def _leave(self) -> None:
        """Remove the road and disconnect."""
        link, self._link = self._link, None
        if link is not None:
            try:
                link.unload()
            except BeamngError as error:
                logger.debug("left a road behind: %s", error)
            finally:
                link.close()

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road, for its driver."""
        car = self.measured
        return DriveSetup(
            speed_limit=self.rules.start_limit_on(road),
            lane_width=road.lane_width,
            period=RECORD_PERIOD,
            front_axle=0.5 * car.wheelbase,
            rear_axle=0.5 * car.wheelbase,
            car_length=car.length,
            car_width=car.width,
            max_steering=abs(car.steering),
            max_acceleration=_ASSUMED_ACCELERATION,
            max_deceleration=_ASSUMED_DECELERATION,
        )

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Drive along the road.

        If BeamNG.tech cannot remove the road afterwards, or has made `restart_every` drives, it is
        left and entered again before the next drive.

        Raises:
            RoadError: The road leans, rises or widens.
            BeamngError: BeamNG.tech broke or is out of reach.
        """
        check_road(self, driver, road)
        try:
            by_ai = self._is_beamng_ai(driver)
        except DriverError as error:
            trouble = Trouble.of(error, "simulator")
            return Drive(Trajectory.empty(), self.car, self.rules, road, trouble)
        if self._needs_restart:
            self._leave()
            self._connect()
        self._load(road, self.measured.ahead, self.measured.left)
        if by_ai:
            self.link.let_ai_drive(self.rules.start_limit_on(road), self.aggression)
        else:
            self._open_camera(driver)
        drive = run_drive(
            BeamngCar(
                self.link,
                self.measured,
                road,
                LimitsAhead(road, self.rules),
                by_ai=by_ai,
                has_camera=camera_of(driver) is not None,
            ),
            None if by_ai else driver,
            road=road,
            rules=self.rules,
            body=self.car,
            setup=self.setup(road),
            limit=self.wall_limit,
            may_stall=True,
        )
        self._finish()
        return drive

    def _finish(self) -> None:
        """Remove the road after a drive, which is valid even if that fails."""
        self._drives += 1
        self._needs_restart = self._drives == self.restart_every
        try:
            self.link.unload()
        except BeamngError as error:
            logger.info("BeamNG.tech is entered again before the next drive: %s", error)
            self._needs_restart = True

    def checks(self) -> Iterator[SimulatorCheck]:
        """Yield the checks of licence and car, and two drives of BeamNG.AI."""
        link, car = self.link, self.measured
        if link.is_licensed:
            yield SimulatorCheck("licence", is_ok=True, state="found")
        else:
            remedy = f"put tech.key into its user folder ({link.user_folder})"
            yield SimulatorCheck("licence", is_ok=False, state="not found", remedy=remedy)
        size = f"{car.length:g} by {car.width:g} m, steers by {abs(car.steering):.2f} rad"
        state = f"{self.vehicle} in BeamNG.tech {link.version}, {size}"
        yield SimulatorCheck("car", is_ok=True, state=state)
        yield from drive_checks(self, BeamngAi(), driver_name="BeamNG.AI")

    def check_driver(self, driver: Driver) -> None:
        """Refuse drivers that cannot drive in BeamNG.tech.

        Raises:
            DriverError: The driver is `BeamngAi` with options or wrappers that BeamNG.AI lacks, or
                has a camera that BeamNG.tech lacks.
        """
        self._is_beamng_ai(driver)
        if camera_of(driver) is not None and self.place.get("nogpu"):
            raise DriverError(
                "without a graphics card BeamNG.tech draws nothing, and the driver has a camera:"
                " leave out no_gpu"
            )
        check_other_world(driver, "BeamNG.tech")

    def _open_camera(self, driver: Driver) -> None:
        """Put the driver's camera, if it has one, on the car, which stands on its road."""
        camera = camera_of(driver)
        if camera is not None:
            # A camera is placed from the car's middle and the ground, BeamNG.tech's from the node.
            car, node_height = self.measured, float(self.link.state().position[2]) - self.ground
            self.link.open_camera(
                camera,
                ahead=car.ahead + camera.forward,
                left=car.left + camera.left,
                up=camera.up - node_height,
            )

    def _is_beamng_ai(self, driver: Driver) -> bool:
        """Return whether BeamNG.AI itself drives.

        Raises:
            DriverError: The driver is `BeamngAi` with options or wrappers that BeamNG.AI lacks.
        """
        inner = unwrapped(driver)
        if type(inner) is not BeamngAi:
            return False
        if inner is not driver:
            raise DriverError(
                "BeamNG.AI takes no noise, delay, view, or errors of sensors and steering: leave"
                " them out, or take them away from a campaign's drives, as with noise=0 or"
                " view=inf, or choose another driver"
            )
        if inner != BeamngAi():
            raise DriverError(
                "in BeamNG.tech beamng-ai is BeamNG.AI itself, which has no options of a driver:"
                " use aggression of the simulator, and the speed limit"
            )
        return True

    def _load(self, road: Road, ahead: float, left: float) -> CarState:
        """Build a road, and let the car come to rest at its start on the ego lane's centre.

        Args:
            road: road to build.
            ahead, left: position of the middle of the car's box relative to the car's reference
                node, in m.

        Returns:
            State of the car at rest.

        Raises:
            BeamngError: The car does not come to rest, or rests elsewhere.
        """
        x, y, heading = ego_start(road)
        c, s = math.cos(heading), math.sin(heading)
        start = Pose(x - ahead * c + left * s, y - ahead * s - left * c, heading)
        self.link.load(self.level, self.ground, road, start, self.vehicle)
        for _ in range(_MAX_SETTLINGS):
            self.link.control(steering=0.0, throttle=0.0, brake=0.0, parking=1.0)
            self.link.step(_SETTLING_TIME)
            state = self.link.state()
            if state.speed < _REST_SPEED:
                break
        start_error = math.dist(state.point(ahead, left), (x, y))
        if state.speed >= _REST_SPEED or start_error > _MAX_START_ERROR:
            raise BeamngError(
                f"{self.vehicle} stands {start_error:.2f} m from its place in level {self.level}"
                f" and rolls at {state.speed:.1f} m/s: is the ground flat and {self.ground:g} m"
                " high?"
            )
        return state

    def _measure(self) -> None:
        """Measure the car's box and its answer to steering, and set `car`."""
        self.link.require(self.level, self.vehicle)
        state = self._load(MEASURING_ROAD, ahead=0.0, left=0.0)
        corners = self.link.box()
        front, rear, left, right = corners[:4], corners[4:], corners[::2], corners[1::2]
        middle = corners.mean(axis=0) - state.position
        left_vector = np.cross(state.up, state.forward)
        car = MeasuredCar(
            length=_millimetres(np.linalg.norm(front.mean(axis=0) - rear.mean(axis=0))),
            width=_millimetres(np.linalg.norm(left.mean(axis=0) - right.mean(axis=0))),
            ahead=_millimetres(middle @ state.forward),
            left=_millimetres(middle @ left_vector),
        )
        self._measured = self._with_steering(car)
        self.car = CarBody(car.length, car.width, 0.0)
        self.link.unload()

    def _with_steering(self, car: MeasuredCar) -> MeasuredCar:
        """Return the car with its answer to steering, measured on a circle at low speed.

        Raises:
            BeamngError: The car does not turn as a car does.
        """
        for _ in range(round(_SPEED_UP_TIME / RECORD_PERIOD)):
            self.link.control(_MEASURED_INPUT, _SPEED_UP_THROTTLE, brake=0.0)
            self.link.step(RECORD_PERIOD)
            if self.link.state().speed >= _MEASURED_SPEED:
                break
        turned = driven = 0.0  # in rad and m
        before = self.link.state()
        for _ in range(round(_MEASURING_TIME / RECORD_PERIOD)):
            self.link.control(_MEASURED_INPUT, _MEASURING_THROTTLE, brake=0.0)
            self.link.step(RECORD_PERIOD)
            now = self.link.state()
            turned += wrapped(now.heading - before.heading)
            driven += math.dist(now.point(car.ahead, car.left), before.point(car.ahead, car.left))
            before = now
        # A car without slip turns by tan(angle) / wheelbase per metre; 0.1 m if it hardly moved.
        steering = math.atan(car.wheelbase * turned / max(driven, 0.1)) / _MEASURED_INPUT
        low, high = _STEERING_RANGE
        if not low < abs(steering) < high:
            raise BeamngError(
                f"{self.vehicle} turned by {turned:.2f} rad within {driven:.1f} m at a steering"
                f" input of {_MEASURED_INPUT:g}: it does not steer as a car does"
            )
        steering = round(steering, 3)
        # BeamNG.tech may report inputs with the opposite sign, or none.
        reported = now.steering_input
        if abs(reported) <= _LEAST_REPORTED_SHARE * _MEASURED_INPUT:
            return replace(car, steering=steering, reported_steering=0.0)
        reported_steering = math.copysign(steering, steering * reported)
        return replace(car, steering=steering, reported_steering=reported_steering)


def _millimetres(value: np.floating[Any]) -> float:
    """Return a length in m, rounded to millimetres and without a negative zero."""
    return round(float(value), 3) + 0.0


MEASURING_ROAD: Final = Road([0.0] * 13, pose=Pose(40.0, 100.0, 0.0))
"""A straight road, on which the car is measured."""


def ego_start(road: Road) -> Pose:
    """Return the pose of the car's middle at the start of a drive."""
    pose = road.pose_at(0.0)
    half = 0.5 * road.lane_width
    return Pose(
        pose.x + half * math.sin(pose.heading), pose.y - half * math.cos(pose.heading), pose.heading
    )
