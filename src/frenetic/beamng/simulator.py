"""BeamNG.tech as a `frenetic.simulators.Simulator`."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from types import TracebackType
from typing import Any, ClassVar, Final, Self

import numpy as np

from frenetic.beamng.car import (
    LENGTHS,
    WIDTHS,
    CarState,
    MeasuredCar,
    measured_box,
)
from frenetic.beamng.link import BeamngError, Link, Place, beamngpy, executable
from frenetic.beamng.options import RECORD_RATE, check_options
from frenetic.beamng.scene import (
    LEVELS,
    WIDEST_AI_LANE,
    ego_start,
    open_field,
    scene_of,
)
from frenetic.drive import Breakdown, CarBody, Drive, Rules, Trajectory
from frenetic.drivers import BeamngAi, Driver, DriveSetup
from frenetic.drivers.driver import (
    blaming_driver,
    camera_of,
    check_other_world,
    checked_controls,
    under_layers,
)
from frenetic.errors import DriverError
from frenetic.road import Road
from frenetic.simulators.checks import Check, drive_checks
from frenetic.simulators.observing import Observer, wrap
from frenetic.simulators.wall_limit import WallLimitExceeded, wall_limit

PERIOD: Final = 1.0 / RECORD_RATE
"""Time between two records, in s."""
WALL_LIMIT: Final = 600.0
"""Default limit of a drive's wall time, in s."""

_SETTLING: Final = 3.0  # s: a count-down passes, then the car comes to rest on its springs
_SETTLINGS: Final = 3
_AT_REST: Final = 0.1  # m/s
_CREEP: Final = 0.3  # m/s, below which braking is left to the parking brake
_ASTRAY: Final = 0.3  # m, the farthest from its place that a car may stand at the start
_TURNED: Final = 0.05  # rad, likewise
_CLOCK_SHARE, _CLOCK_SLACK = 0.02, 0.01  # how far the clock may be off: of the time, and s
_BODY_SLACK: Final = 0.02  # m by which a given length or width may be wrong
_ACCELERATION, _DECELERATION = 4.0, 9.0  # m/s^2, what drivers are told of a car that is unknown
_REPLY_LIMIT: Final = 60.0  # s

_MORE: Final = "see the message; 'frenetic --debug doctor' says more"

logger = logging.getLogger(__name__)

STEP_SPEED: Final = 15.0
"""Speed at which the lag of steering is measured, in m/s."""
STEP_ANGLE: Final = 0.03
"""Step of the front wheels' angle there, in rad: 2.5 m/s^2 to the side."""
STEP_SHARE: Final = 0.63
"""Share of the step after which it counts as done, as of a first-order lag after its time."""
STEERING_LAG: Final = 0.2
"""Most lag that is fine, in s: twice that of the embedded simulator; the car goes 3 m meanwhile."""
_TRIED: Final = 0.5  # steering input of a car at rest, to find out how it steers


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
        port: its port, 25252 by default; a free one if BeamNG.tech is started.
        headless: started without a window.
        no_gpu: started without a graphics card, too.
        vehicle: name of the car's model.
        aggression: of BeamNG.AI, above 0 and up to 2: the share of grip that it uses in curves.
        steps_per_second: frames into which a simulated second is cut, a multiple of 20.
        level: a flat one, in which the road is built.
        ground: m, height of the ground of an unknown level.
        car_length: m, to be given with `car_width` if the car cannot be measured before a campaign,
            as on a machine without BeamNG.tech that uses a cluster.
        car_width: m, without what sticks out of the bounding box.
        wall_limit: s of wall time that a drive may take.
        reply_limit: s that BeamNG.tech may take for an answer.
        restart_every: drives after which BeamNG.tech is started anew; by default it goes on as long
            as it works.

    Raises:
        ValueError: an option is out of range.
        BeamngError: no option names BeamNG.tech's place, or the options contradict each other.
    """

    needs: Final = ("beamngpy",)
    """Modules that the extra brings."""
    preloads: Final = ("frenetic.beamng.preloading",)
    usual_wall_limit: Final = WALL_LIMIT
    usual_workers: Final = 1
    """One worker by default: a BeamNG.tech takes a whole graphics card."""

    place_options: Final = ("home", "user", "headless", "no_gpu", "host", "port", "restart_every")
    draws: Final = True
    BEHAVIOUR: ClassVar[int] = 2
    """Raised when its drives change; campaigns record it."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        home: str | None = None,
        user: str | None = None,
        host: str | None = None,
        port: int | None = None,
        headless: bool = False,
        no_gpu: bool = False,
        vehicle: str = "etk800",
        aggression: float = 0.7,
        steps_per_second: int = 60,
        level: str = "tech_ground",
        ground: float | None = None,
        car_length: float | None = None,
        car_width: float | None = None,
        wall_limit: float = WALL_LIMIT,
        reply_limit: float = _REPLY_LIMIT,
        restart_every: int | None = None,
    ) -> None:
        check_options(locals())
        if ground is None and level not in LEVELS:
            raise ValueError(
                f"level is {level!r}, whose ground is not known: give its height with ground, or"
                f" choose one of {', '.join(LEVELS)}"
            )
        if (car_length is None) is not (car_width is None):
            raise ValueError("car_length and car_width have to be given together")
        self.place = Place.of(home, user, host, port, headless, no_gpu)
        if restart_every is not None and self.place.home is None:
            raise BeamngError(
                "restart_every is for a BeamNG.tech that is started", "give home, too"
            )
        self.rules = rules or Rules()
        self.vehicle = vehicle
        self.aggression = float(aggression)
        self.steps_per_second = int(steps_per_second)
        self.level = level
        self.ground = LEVELS[level] if ground is None else float(ground)
        self.wall_limit = wall_limit
        self.reply_limit = reply_limit
        self.restart_every = restart_every
        self.car = CarBody()
        self._given_car = car_length is not None
        if car_length is not None and car_width is not None:
            self.car = CarBody(float(car_length), float(car_width))
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
            "steps_per_second": self.steps_per_second,
            "level": self.level,
            "wall_limit": self.wall_limit,
        }

    @property
    def workers_at_most(self) -> int | None:
        """Most workers at once: a running BeamNG.tech serves one."""
        return 1 if self.place.home is None or self.place.port is not None else None

    @property
    def link(self) -> Link:
        """The connection, while the simulator is entered."""
        if self._link is None:
            raise BeamngError("BeamNG.tech is not started: use the simulator in a with statement")
        return self._link

    def __getstate__(self) -> dict[str, Any]:
        # The connection stays here; the measurements are copied.
        return self.__dict__ | {"_link": None}

    def prepare(self) -> None:
        """Measures the car if its box is unknown, for which BeamNG.tech is started and ended."""
        if self._measured is None and not self._given_car:
            with self:
                pass

    def __enter__(self) -> Self:
        """Starts BeamNG.tech or connects to it, and measures the car unless that is done."""
        self.connect()
        try:
            if self._measured is None:
                self.measure()
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

    def connect(self) -> None:
        """Only starts BeamNG.tech or connects to it; `measure` is the rest of entering."""
        self._link = Link(self.place, reply_limit=self.reply_limit)
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
        """The setup of a drive along the road for its driver."""
        car = self.measured
        return DriveSetup(
            speed_limit=self.rules.speed_limit / 3.6,
            lane_width=road.lane_width,
            period=PERIOD,
            front_axle=0.5 * car.wheelbase,
            rear_axle=0.5 * car.wheelbase,
            car_length=car.length,
            car_width=car.width,
            max_steering=abs(car.steering),
            max_acceleration=_ACCELERATION,
            max_deceleration=_DECELERATION,
        )

    @property
    def measured(self) -> MeasuredCar:
        """The measured car."""
        if self._measured is None:
            raise BeamngError("the car is not measured yet: use the simulator in a with statement")
        return self._measured

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road.

        A BeamNG.tech that cannot remove the road after the drive, or has reached `restart_every`,
        is entered again before the next one.

        Raises:
            BeamngError: BeamNG.tech broke or is out of reach.
        """
        try:
            by_ai = self._drives_itself(driver)
            if by_ai and road.lane_width >= WIDEST_AI_LANE:
                raise DriverError(
                    f"lanes of {road.lane_width:g} m are two lanes each to BeamNG.AI: less than"
                    f" {WIDEST_AI_LANE:g} m are needed"
                )
        except DriverError as error:
            empty = Trajectory.empty()
            return Drive.of(empty, self.car, self.rules, road, Breakdown.of(error))
        if self._is_worn:
            self._leave()
            self.connect()
        self._place_car(road)
        recording = _Recording(self, road)
        breakdown: Breakdown | None = None
        try:
            with wall_limit(self.wall_limit):
                if by_ai:
                    self.link.let_ai_drive(self.rules.speed_limit / 3.6, self.aggression)
                    recording.drive(None)
                else:
                    self._open_camera(driver)
                    recording.drive(driver)
        except WallLimitExceeded as limit:
            if not recording.driver_acts:
                raise BeamngError(
                    f"BeamNG.tech did not finish a drive within {self.wall_limit:g} s of wall time"
                    f" ({len(recording)} records)"
                ) from None
            breakdown = Breakdown.of(
                limit,
                f"the driver did not finish its drive within {self.wall_limit:g} s of wall time"
                f"{limit.place}",
            )
        except DriverError as error:
            breakdown = Breakdown.of(error)
        self._finish()
        path = recording.trajectory()
        return Drive.of(path, self.car, self.rules, road, breakdown)

    def _finish(self) -> None:
        """Removes the road; the drive counts even if that fails."""
        self._drives += 1
        self._is_worn = self._drives == self.restart_every
        try:
            self.link.unload()
        except BeamngError as trouble:
            logger.info("BeamNG.tech is entered again before the next drive: %s", trouble)
            self._is_worn = True

    def checks(self) -> Iterator[Check]:
        """Checks of package, installation, start, version and licence, then `_car_checks`."""
        try:
            beamngpy()
        except BeamngError as error:
            yield _broken("package", error)
            return
        yield Check("package", True, f"beamngpy {version('beamngpy')}")
        place = self.place
        if place.home is not None:
            try:
                yield Check("installation", True, str(executable(place.home)))
            except BeamngError as error:
                yield _broken("installation", error)
                return
        name = "port" if place.home is None else "start"
        try:
            self.connect()
        except BeamngError as error:
            yield _broken(name, error)
            return
        try:
            yield Check(name, True, f"BeamNG.tech {self.link.version} answers")
            yield _licence(self.link)
            yield from self._car_checks()
        finally:
            self.__exit__(None, None, None)

    def _car_checks(self) -> Iterator[Check]:
        """Checks of level, vehicle, measurement and driving."""
        try:
            for name, wanted, known in (
                ("level", self.level, self.link.levels()),
                ("vehicle", self.vehicle, self.link.vehicles()),
            ):
                if wanted not in known:
                    listed = ", ".join(sorted(known)[:20])
                    yield Check(
                        name, False, f"there is no {name} {wanted}", f"choose one of {listed}"
                    )
                    return
                yield Check(name, True, f"{wanted}, one of {len(known)}")
            self.measure()
            car = self.measured
            lag = self._steering_lag()
        except BeamngError as error:
            yield _broken("car", error)
            return
        side = "left" if car.steering > 0.0 else "right"
        yield Check(
            "car",
            True,
            f"{car.length:g} by {car.width:g} m, steers by {abs(car.steering):.2f} rad, a positive"
            f" input to the {side}",
        )
        yield from _steering_checks(car, lag)
        for driver, who in ((BeamngAi(), "BeamNG.AI"), (None, "Stanley")):
            yield from drive_checks(self, driver, who=who)

    def check_driver(self, driver: Driver) -> None:
        """Refuses options that BeamNG.AI or BeamNG.tech's camera lacks.

        Raises:
            DriverError: there is such an option.
        """
        self._drives_itself(driver)
        if camera_of(driver) is not None and self.place.no_gpu:
            raise DriverError(
                "without a graphics card BeamNG.tech draws nothing, and the driver has a camera:"
                " leave out no_gpu"
            )
        check_other_world(driver, "BeamNG.tech")

    def _open_camera(self, driver: Driver) -> None:
        """Puts the driver's camera on the car, which stands on its road."""
        camera = camera_of(driver)
        if camera is not None:
            car, height = self.measured, float(self.link.state().position[2]) - self.ground
            self.link.open_camera(
                camera, car.ahead + camera.forward, car.left + camera.left, camera.up - height
            )

    def _drives_itself(self, driver: Driver) -> bool:
        """Whether the driver is BeamNG.AI; raises a `DriverError` for options that it lacks."""
        inner = under_layers(driver)
        if type(inner) is not BeamngAi:
            return False
        if inner is not driver:
            raise DriverError(
                "BeamNG.AI takes no noise, delay or view: leave them out, those of a campaign with"
                " noise=0, delay=0 or view=inf, or choose another driver"
            )
        if inner != BeamngAi():
            raise DriverError(
                "in BeamNG.tech beamng-ai is BeamNG.AI itself, which has no options of a driver:"
                " use aggression of the simulator, and the speed limit"
            )
        return True

    def _load(self, road: Road, ahead: float, left: float) -> CarState:
        """Builds a road and lets the car come to rest on it."""
        scene = scene_of(road, self.ground, ahead, left)
        self.link.load(self.level, scene, self.vehicle, self.steps_per_second)
        for _ in range(_SETTLINGS):
            self.link.control(0.0, 0.0, 0.0, parking=1.0)
            self.link.step(round(_SETTLING * self.steps_per_second))
            state = self.link.state()
            if state.speed < _AT_REST:
                break
        else:
            raise BeamngError(
                f"{self.vehicle} does not come to rest in level {self.level}: it rolls at"
                f" {state.speed:.1f} m/s; is the ground flat and {self.ground:g} m high?"
            )
        if abs(wrap(state.heading - scene.heading)) > _TURNED:
            raise BeamngError(
                f"{self.vehicle} points to {state.heading:.2f} rad in level {self.level}, not to"
                f" {scene.heading:.2f} rad as it was put there"
            )
        return state

    def _place_car(self, road: Road) -> None:
        car = self.measured
        state = self._load(road, car.ahead, car.left)
        x, y = car.middle(state)
        start = ego_start(road)
        away = math.hypot(x - start.x, y - start.y)
        if away > _ASTRAY:
            raise BeamngError(
                f"{self.vehicle} stands {away:.2f} m from its place in level {self.level}: is"
                f" the ground flat and {self.ground:g} m high?"
            )

    def measure(self) -> None:
        """Measures the car's box and its steering, even if they are known."""
        state = self._load(open_field(), 0.0, 0.0)
        length, width, ahead, left = measured_box(self.link.box(), state)
        if not (LENGTHS[0] < length < LENGTHS[1] and WIDTHS[0] < width < WIDTHS[1]):
            raise BeamngError(
                f"the box of {self.vehicle} is {length:g} by {width:g} m: is it a car?"
            )
        given = self.car
        if self._given_car and not (
            abs(given.length - length) <= _BODY_SLACK and abs(given.width - width) <= _BODY_SLACK
        ):
            raise BeamngError(
                f"the box of {self.vehicle} is {length:g} by {width:g} m, not {given.length:g} by"
                f" {given.width:g} m: give car_length={length:g} and car_width={width:g}"
            )
        car = MeasuredCar(length, width, ahead, left, 1.0, *self._found_steering())
        self._measured = replace(car, steering=self._measured_steering(car))
        if not self._given_car:
            self.car = self._measured.body
        self.link.unload()

    def _found_steering(self) -> tuple[bool, float]:
        """Whether the car at rest can be steered directly, and the sign that it reports."""
        for directly in (True, False):
            try:
                self.link.control(_TRIED, 0.0, 0.0, 1.0, directly=directly)
            except BeamngError as error:
                if not directly:
                    raise
                logger.info("the steering passes a filter: %s", error)
                continue
            for _ in range(RECORD_RATE):
                self.step()
            shown = self.link.state().steering_input
            self.link.control(0.0, 0.0, 0.0, 1.0, directly=directly)
            if abs(shown) > 0.2 * _TRIED:
                return directly, math.copysign(1.0, shown * _TRIED)
        return False, 0.0

    def _steering_lag(self) -> float:
        """Time in s until a small step of steering at speed is done by `STEP_SHARE`.

        Infinite if it is not within 2 s.
        """
        car = self.measured
        self._load(open_field(), 0.0, 0.0)
        for _ in range(60 * RECORD_RATE):
            self.link.control(0.0, 1.0, 0.0, directly=car.steers_directly)
            self.step()
            if self.link.state().speed >= STEP_SPEED:
                break
        else:
            raise BeamngError(f"{self.vehicle} does not reach {3.6 * STEP_SPEED:g} km/h")
        start, done = self.link.state(), 0.0
        for i in range(2 * RECORD_RATE):
            self.link.control(car.input_of(STEP_ANGLE), 0.2, 0.0, directly=car.steers_directly)
            self.step()
            turned = self.link.state().steering_input - start.steering_input
            before, done = done, car.angle_shown(turned) / STEP_ANGLE
            if done >= STEP_SHARE:
                return PERIOD * (i + (STEP_SHARE - before) / (done - before))
        return math.inf

    def _measured_steering(self, car: MeasuredCar) -> float:
        """Front wheels' angle at input 1 in rad, from the circle that the car drives slowly."""
        share, slow = 0.25, 3.0
        for _ in range(10 * RECORD_RATE):
            self.link.control(share, 0.3, 0.0, directly=car.steers_directly)
            self.step()
            if self.link.state().speed >= slow:
                break
        else:
            raise BeamngError(f"{self.vehicle} does not drive off in level {self.level}")
        turned = driven = 0.0
        before = self.link.state()
        for _ in range(RECORD_RATE):
            self.link.control(share, 0.05, 0.0, directly=car.steers_directly)
            self.step()
            now = self.link.state()
            turned += wrap(now.heading - before.heading)
            driven += math.dist(car.middle(now), car.middle(before))
            before = now
        steering = math.atan(car.wheelbase * turned / max(driven, 0.1)) / share
        if not 0.1 < abs(steering) < 1.5:
            raise BeamngError(
                f"{self.vehicle} turned by {turned:.2f} rad within {driven:.1f} m at a steering"
                f" input of {share:g}: it does not steer as a car does"
            )
        return round(steering, 3)

    def step(self) -> None:
        """Advances time by one period."""
        self.link.step(self.steps_per_second // RECORD_RATE)


class _Recording:
    """One drive, record by record."""

    def __init__(self, simulator: BeamngSimulator, road: Road) -> None:
        self._simulator = simulator
        self._car = simulator.measured
        self._setup = simulator.setup(road)
        # The record after the timeout ends every drive.
        self._most = math.ceil(simulator.rules.timeout(road.length) / PERIOD) + 2
        self._observer = Observer(road, simulator.rules, simulator.car, self._most)
        self._rows = np.empty((self._most, len(Trajectory.names())))
        self._written = 0
        self._started_at = 0.0
        self.driver_acts = False

    def __len__(self) -> int:
        return self._written

    def trajectory(self) -> Trajectory:
        """The record."""
        return Trajectory.from_rows(self._rows[: self._written])

    def drive(self, driver: Driver | None) -> None:
        """Drives until the rules end it; with None, BeamNG.AI drives."""
        if driver is not None:
            self._ask(driver.reset, self._setup)
        for _ in range(self._most):
            state = self._simulator.link.state()
            if not self._record(state):
                return
            if driver is not None:
                self._steer(driver)
            self._simulator.step()

    def _record(self, state: CarState) -> bool:
        """Writes a record; says whether the drive goes on."""
        i, car, rows = self._written, self._car, self._rows
        if i == 0:
            self._started_at = state.time
        self._check_clock(state.time - self._started_at)
        x, y = car.middle(state)
        heading, yaw_rate = state.heading, 0.0
        if i > 0:
            turned = wrap(heading - rows[i - 1, 3])
            heading, yaw_rate = rows[i - 1, 3] + turned, turned / PERIOD
        c, s = math.cos(heading), math.sin(heading)
        # The velocity is that of the car's position; its middle swings round it.
        vx = state.velocity[0] - yaw_rate * (car.ahead * s + car.left * c)
        vy = state.velocity[1] + yaw_rate * (car.ahead * c - car.left * s)
        steering = car.angle_shown(state.steering_input)
        speeds = (c * vx + s * vy, c * vy - s * vx)
        asked = (steering, state.throttle_input, state.brake_input)
        rows[i] = i * PERIOD, x, y, heading, *speeds, yaw_rate, steering, *asked
        self._written = i + 1
        return self._observer.see(i * PERIOD, x, y, heading)

    def _check_clock(self, passed: float) -> None:
        due = self._written * PERIOD
        if abs(passed - due) > _CLOCK_SHARE * due + _CLOCK_SLACK:
            raise BeamngError(
                f"the clock of BeamNG.tech shows {passed:.3f} s after {due:.2f} s of steps: it does"
                f" not keep {self._simulator.steps_per_second} steps per second; try others"
            )

    def _steer(self, driver: Driver) -> None:
        row = self._rows[self._written - 1]
        speed, yaw_rate, steering = row[4], row[6], row[7]
        image = None if camera_of(driver) is None else self._simulator.link.picture()
        seen = self._observer.observation(speed, yaw_rate, steering, image)
        asked, throttle, brake = checked_controls(self._ask(driver.act, seen))
        row[8:] = asked, throttle, brake
        # The automatic gearbox takes the brake of a car at rest for the wish to drive backwards.
        holds = brake > 0.0 and throttle == 0.0 and speed < _CREEP
        self._simulator.link.control(
            self._car.input_of(asked),
            throttle,
            0.0 if holds else brake,
            1.0 if holds else 0.0,
            directly=self._car.steers_directly,
        )

    def _ask(self, call: Any, *arguments: Any) -> Any:
        # A limit on the wall time that strikes in between leaves the mark.
        self.driver_acts = True
        with blaming_driver():
            answer = call(*arguments)
        self.driver_acts = False
        return answer


def _broken(name: str, error: BeamngError) -> Check:
    return Check(name, False, error.found, error.remedy or _MORE)


def _steering_checks(car: MeasuredCar, lag: float) -> Iterator[Check]:
    """Checks of the sign and the lag of steering."""
    if car.sign_shown == 0.0:
        found = "BeamNG.tech does not report the steering input, so records lack the wheels' angle"
        yield Check("steering sign", False, found, "look at electrics.steering_input; is it 0?")
        return
    found = "BeamNG.tech reports the sign that it is told"
    if car.sign_shown < 0.0:
        found = "BeamNG.tech reports the opposite of what it is told; records allow for that"
    yield Check("steering sign", True, found)
    way = "directly" if car.steers_directly else "through the filter of the Control message"
    speed = f"at {3.6 * STEP_SPEED:.0f} km/h"
    if lag > STEERING_LAG:
        took = f"{lag:.2f} s" if math.isfinite(lag) else "more than 2 s"
        yield Check(
            "steering lag",
            False,
            f"{STEP_SHARE:.0%} of a step {speed} takes {took}, {way}: at most {STEERING_LAG:g} s"
            " would be fine",
            "your drivers steer late, so they leave the lane sooner than elsewhere: lower"
            " the speed limit, or search elsewhere with as much delay",
        )
    else:
        yield Check("steering lag", True, f"{lag:.2f} s {speed}, {way}")


def _licence(link: Link) -> Check:
    if link.is_licensed:
        return Check("licence", True, "it found its licence")
    return Check(
        "licence",
        False,
        "it did not find its licence",
        f"put tech.key into its user folder{f' ({link.user_folder})' if link.user_folder else ''}",
    )
