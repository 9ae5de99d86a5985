"""BeamNG.tech as a `frenetic.simulators.Simulator`."""

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
from frenetic.drivers import BeamngAi, Driver, DriveSetup
from frenetic.drivers.stack import camera_of, check_other_world, unwrapped
from frenetic.errors import DriverError, Trouble
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.plugins.beamng.car import BeamngCar, MeasuredCar
from frenetic.plugins.beamng.car_state import CarState
from frenetic.plugins.beamng.link import BeamngError, Link, place_of
from frenetic.road import Pose, Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.checks import SimulatorCheck, drive_checks
from frenetic.simulators.drive_loop import RECORD_PERIOD, follow
from frenetic.simulators.observer import LimitsAhead, wrap

WALL_LIMIT: Final = 600.0
"""Default limit of a drive's wall time, in s."""
LEVELS: Final = {"tech_ground": 0.0, "smallgrid": 0.0, "gridmap_v2": 100.0}
"""Levels with room for a flat map -> m, height of their ground."""

_SETTLING: Final = 3.0  # s: a count-down passes, then the car comes to rest on its springs
_SETTLINGS: Final = 3
_AT_REST: Final = 0.1  # m/s
_ASTRAY: Final = 0.3  # m, the farthest from its place that a car may stand at the start
_ACCELERATION, _DECELERATION = 4.0, 9.0  # m/s^2, what drivers are told of a car that is unknown

logger = logging.getLogger(__name__)


class BeamngSimulator:
    """BeamNG.tech, started or already running; a drive takes about as long as on a real road.

    The driver `BeamngAi` stands for BeamNG.AI itself; any other driver steers the car. Drives
    record the middle of the car's bounding box. The box and the car's answer to steering are
    measured in BeamNG.tech when the simulator is entered for the first time.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        home: folder of the installation to start; by default the environment variable BNG_HOME.
        user: folder for what BeamNG.tech writes; by default its own.
        host: host of a running BeamNG.tech to connect to, instead of starting one.
        port: its port, 25252 by default.
        headless: started without a window.
        no_gpu: started without a graphics card, too.
        vehicle: name of the car's model.
        aggression: of BeamNG.AI, above 0 and up to 2: the share of grip that it uses in curves.
        level: a flat one, in which the road is built.
        ground: m, height of the ground of an unknown level.
        wall_limit: s of wall time that a drive may take.
        restart_every: drives after which BeamNG.tech is started anew; by default it goes on as long
            as it works.

    Raises:
        ValueError: an option is out of range.
        BeamngError: no option names BeamNG.tech's place, or the options contradict each other.
    """

    needs: Final = ("beamngpy",)
    """Modules that the extra brings."""
    preloads: Final = ("frenetic.plugins.beamng.preloading",)
    usual_wall_limit: Final = WALL_LIMIT
    usual_workers: Final = 1
    """One worker by default: a BeamNG.tech takes a whole graphics card."""

    place_options: Final = ("home", "user", "headless", "no_gpu", "host", "port", "restart_every")
    draws: Final = True
    period_step: Final = RECORD_PERIOD
    BEHAVIOUR: ClassVar[int] = 2
    """Raised when its drives change; campaigns record it."""

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
        self.place = place_of(home, user, host, port, headless, no_gpu)
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
        self._drives = 0  # since it was connected
        self._is_worn = False  # so that it is entered again before the next drive

    @property
    def options(self) -> dict[str, Any]:
        """The options that its drives depend on, beside the rules."""
        return {
            "vehicle": self.vehicle,
            "aggression": self.aggression,
            "level": self.level,
            "wall_limit": self.wall_limit,
        }

    @property
    def workers_at_most(self) -> int | None:
        """Most workers at once: a running BeamNG.tech serves one."""
        return 1 if self.place["home"] is None else None

    @property
    def link(self) -> Link:
        """The connection, while the simulator is entered."""
        if self._link is None:
            raise BeamngError("BeamNG.tech is not started: use the simulator in a with statement")
        return self._link

    @property
    def measured(self) -> MeasuredCar:
        """The measured car."""
        if self._measured is None:
            raise BeamngError("the car is not measured yet: use the simulator in a with statement")
        return self._measured

    def __getstate__(self) -> dict[str, Any]:
        # The connection stays here; the measurements are copied.
        return self.__dict__ | {"_link": None}

    def prepare(self) -> None:
        """Measure the car if that is not done, for which BeamNG.tech is started and ended."""
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
        """Disconnects; ends BeamNG.tech if it was started here."""
        self._leave()

    def _connect(self) -> None:
        self._link = Link(self.place)
        self._drives, self._is_worn = 0, False

    def _leave(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            try:
                link.unload()
            except BeamngError as trouble:
                logger.debug("left a road behind: %s", trouble)
            finally:
                link.close()

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
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
            max_acceleration=_ACCELERATION,
            max_deceleration=_DECELERATION,
        )

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road.

        A BeamNG.tech that cannot remove the road after the drive, or has reached `restart_every`,
        is entered again before the next one.

        Raises:
            RoadError: the road leans or rises.
            BeamngError: BeamNG.tech broke or is out of reach.
        """
        check_road(self, driver, road)
        try:
            by_ai = self._drives_itself(driver)
        except DriverError as error:
            trouble = Trouble.of(error, "simulator")
            return Drive(Trajectory.empty(), self.car, self.rules, road, trouble)
        if self._is_worn:
            self._leave()
            self._connect()
        self._load(road, self.measured.ahead, self.measured.left)
        if by_ai:
            self.link.let_ai_drive(self.rules.start_limit_on(road), self.aggression)
        else:
            self._open_camera(driver)
        drive = follow(
            BeamngCar(
                self.link,
                self.measured,
                road,
                LimitsAhead(road, self.rules),
                by_ai=by_ai,
                has_camera=camera_of(driver) is not None,
            ),
            road,
            self.rules,
            self.car,
            self.setup(road),
            None if by_ai else driver,
            self.wall_limit,
            may_stall=True,
        )
        self._finish()
        return drive

    def _finish(self) -> None:
        """Remove the road; the drive counts even if that fails."""
        self._drives += 1
        self._is_worn = self._drives == self.restart_every
        try:
            self.link.unload()
        except BeamngError as trouble:
            logger.info("BeamNG.tech is entered again before the next drive: %s", trouble)
            self._is_worn = True

    def checks(self) -> Iterator[SimulatorCheck]:
        """Checks of the licence, and two drives of BeamNG.AI."""
        link, car = self.link, self.measured
        remedy = f"put tech.key into its user folder ({link.user_folder})"
        state = "found" if link.is_licensed else "not found"
        yield SimulatorCheck("licence", link.is_licensed, state, "" if link.is_licensed else remedy)
        size = f"{car.length:g} by {car.width:g} m, steers by {abs(car.steering):.2f} rad"
        yield SimulatorCheck("car", True, f"{self.vehicle} in BeamNG.tech {link.version}, {size}")
        yield from drive_checks(self, BeamngAi(), who="BeamNG.AI")

    def check_driver(self, driver: Driver) -> None:
        """Refuse options that BeamNG.AI or BeamNG.tech's camera lacks.

        Raises:
            DriverError: there is such an option.
        """
        self._drives_itself(driver)
        if camera_of(driver) is not None and self.place.get("nogpu"):
            raise DriverError(
                "without a graphics card BeamNG.tech draws nothing, and the driver has a camera:"
                " leave out no_gpu"
            )
        check_other_world(driver, "BeamNG.tech")

    def _open_camera(self, driver: Driver) -> None:
        """Put the driver's camera on the car, which stands on its road."""
        camera = camera_of(driver)
        if camera is not None:
            car, height = self.measured, float(self.link.state().position[2]) - self.ground
            self.link.open_camera(
                camera, car.ahead + camera.forward, car.left + camera.left, camera.up - height
            )

    def _drives_itself(self, driver: Driver) -> bool:
        """Whether the driver is BeamNG.AI; raises a `DriverError` for options that it lacks."""
        inner = unwrapped(driver)
        if type(inner) is not BeamngAi:
            return False
        if inner is not driver:
            raise DriverError(
                "BeamNG.AI takes no noise, delay or view: leave them out, or take them away"
                " from a campaign's drives with noise=0, delay=0 or view=inf, or choose another"
                " driver"
            )
        if inner != BeamngAi():
            raise DriverError(
                "in BeamNG.tech beamng-ai is BeamNG.AI itself, which has no options of a driver:"
                " use aggression of the simulator, and the speed limit"
            )
        return True

    def _load(self, road: Road, ahead: float, left: float) -> CarState:
        """Build a road and let the car come to rest on it, its middle on the ego lane's centre.

        Args:
            road: what is built.
            ahead, left: m by which the middle of the car's box lies ahead and left of its position.
        """
        x, y, heading = ego_start(road)
        c, s = math.cos(heading), math.sin(heading)
        start = Pose(x - ahead * c + left * s, y - ahead * s - left * c, heading)
        self.link.load(self.level, self.ground, road, start, self.vehicle)
        for _ in range(_SETTLINGS):
            self.link.control(0.0, 0.0, 0.0, parking=1.0)
            self.link.step(_SETTLING)
            state = self.link.state()
            if state.speed < _AT_REST:
                break
        away = math.dist(state.place(ahead, left), (x, y))
        if state.speed >= _AT_REST or away > _ASTRAY:
            raise BeamngError(
                f"{self.vehicle} stands {away:.2f} m from its place in level {self.level} and rolls"
                f" at {state.speed:.1f} m/s: is the ground flat and {self.ground:g} m high?"
            )
        return state

    def _measure(self) -> None:
        """Measure the car's box and its steering."""
        self.link.require(self.level, self.vehicle)
        state = self._load(OPEN_FIELD, 0.0, 0.0)
        corners = self.link.box()
        pairs = ((corners[:4], corners[4:]), (corners[::2], corners[1::2]))
        size = [np.linalg.norm(side.mean(axis=0) - other.mean(axis=0)) for side, other in pairs]
        away = corners.mean(axis=0) - state.position
        aside = np.cross(state.up, state.forward)
        car = MeasuredCar(
            *(round(float(v), 3) + 0.0 for v in (*size, away @ state.forward, away @ aside))
        )
        self._measured = self._with_steering(car)
        self.car = CarBody(car.length, car.width, 0.0)
        self.link.unload()

    def _with_steering(self, car: MeasuredCar) -> MeasuredCar:
        """Return the car with its steering, from the circle that it drives slowly."""
        share, slow = 0.25, 3.0
        for _ in range(round(10.0 / RECORD_PERIOD)):
            self.link.control(share, 0.3, 0.0)
            self.link.step(RECORD_PERIOD)
            if self.link.state().speed >= slow:
                break
        turned = driven = 0.0
        before = self.link.state()
        for _ in range(round(1.0 / RECORD_PERIOD)):
            self.link.control(share, 0.05, 0.0)
            self.link.step(RECORD_PERIOD)
            now = self.link.state()
            turned += wrap(now.heading - before.heading)
            driven += math.dist(now.place(car.ahead, car.left), before.place(car.ahead, car.left))
            before = now
        steering = math.atan(car.wheelbase * turned / max(driven, 0.1)) / share
        if not 0.1 < abs(steering) < 1.5:
            raise BeamngError(
                f"{self.vehicle} turned by {turned:.2f} rad within {driven:.1f} m at a steering"
                f" input of {share:g}: it does not steer as a car does"
            )
        steering = round(steering, 3)
        is_shown = abs(now.steering_input) > 0.2 * share
        shown = math.copysign(steering, steering * now.steering_input) if is_shown else 0.0
        return replace(car, steering=steering, shown=shown)


OPEN_FIELD: Final = Road([0.0] * 13, pose=Pose(40.0, 100.0, 0.0))
"""Straight, for measuring a car."""


def ego_start(road: Road) -> Pose:
    """Place of the car's middle at the start of a drive."""
    pose = road.pose_at(0.0)
    half = 0.5 * road.lane_width
    return Pose(
        pose.x + half * math.sin(pose.heading), pose.y - half * math.cos(pose.heading), pose.heading
    )
