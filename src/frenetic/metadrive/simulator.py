"""MetaDrive as a `Simulator`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.metadata import PackageNotFoundError, version
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self, TypeAlias

import numpy as np

from frenetic._support.words import pip_install
from frenetic.drive import Breakdown, Drive, Rules, Trajectory
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import (
    Driver,
    blaming_driver,
    camera_of,
    check_other_world,
    checked_controls,
)
from frenetic.errors import DriverError, FreneticError, describe_error
from frenetic.metadrive.car import (
    PERIOD,
    STEPS_PER_PERIOD,
    VEHICLE,
    Decision,
)
from frenetic.metadrive.drawing import check_drawing, drawn_region
from frenetic.metadrive.drivers import MetaDriveDriver, PolicySimulator, metadrive_driver
from frenetic.road import Road
from frenetic.simulators.checks import Check, broken, drive_checks
from frenetic.simulators.observing import Observer, wrap
from frenetic.simulators.simulator import StartingPlace
from frenetic.simulators.wall_limit import WallLimitExceeded, wall_limit

if TYPE_CHECKING:
    from frenetic.metadrive.world import Motion, World

PACKAGE: Final = "metadrive-simulator"
EXTRA: Final = pip_install("metadrive")

Decide: TypeAlias = "Callable[[Observer, Motion, float], Decision]"
"""Decides for the next period; the last argument is the front wheels' angle in rad. Returning the
last decision, the very same object, holds it."""


class MetaDriveSimulator(StartingPlace, PolicySimulator):
    """MetaDrive: Bullet physics of a four-wheeled car, headless; needs the extra ``metadrive``.

    Its engine exists once in a process, from entering to leaving the simulator. It draws for
    drivers with a camera only: it starts anew where one comes or goes.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        friction: of the road; 1 is what MetaDrive's tyres have, 0.9 of their load.
        wall_limit: s of wall time that a drive may take; then it is an ERROR.
        start_offset: m to the left of the ego lane's centre at which the car starts, -2 to 2.
        start_heading: rad to the left of the road's direction in which it points there, within an
            eighth of a turn.

    `rules`, `friction`, `start_offset` and `start_heading` may be set between two drives; they hold
    from the next one on.

    Raises:
        ValueError: an option is out of range.
    """

    needs: Final = ("metadrive",)
    """Modules that the extra brings."""
    preloads: Final = ("frenetic.metadrive.preloading",)

    draws: Final = True
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its drives change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("metadrive-simulator",)
    """Distributions whose versions belong to it."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        friction: float = 1.0,
        wall_limit: float = 60.0,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        self.rules = rules or Rules()
        self.car = VEHICLE.body()
        self.friction = friction
        self.start_offset = start_offset
        self.start_heading = start_heading
        self.wall_limit = _positive(wall_limit, "wall_limit")
        self._world: World | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Its options beside the rules; of friction and start only unusual ones."""
        usual = {"friction": 1.0, "start_offset": 0.0, "start_heading": 0.0}
        unusual = {k: getattr(self, k) for k, v in usual.items() if getattr(self, k) != v}
        return {"wall_limit": self.wall_limit, **unusual}

    @property
    def friction(self) -> float:
        """Friction of the road: 1 is dry."""
        return self._friction

    @friction.setter
    def friction(self, friction: float) -> None:
        self._friction = _positive(friction, "friction")

    def __enter__(self) -> Self:
        """Starts MetaDrive's engine.

        Raises:
            FreneticError: MetaDrive is missing or of an unknown version, or its engine is already
                running in this process.
        """
        try:
            from frenetic.metadrive.world import World  # imports the extra
        except ModuleNotFoundError as error:
            package = str(error.name).partition(".")[0]
            raise FreneticError(
                f"the simulator metadrive needs the package {package}: {EXTRA}"
            ) from error
        except ImportError as error:
            raise FreneticError(
                f"MetaDrive cannot be imported: {describe_error(error)}; install it anew, in an"
                f" environment of its own: {EXTRA}"
            ) from error
        self._world = World()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends MetaDrive's engine."""
        world, self._world = self._world, None
        if world is not None:
            world.close()

    def checks(self) -> Iterator[Check]:
        """Checks of the package, the engine with its known car, and two drives.

        The engine draws nothing, so it needs no assets.
        """
        try:
            yield Check("package", True, f"{PACKAGE} {version(PACKAGE)}")
        except PackageNotFoundError:
            yield Check("package", False, f"{PACKAGE} is not installed", EXTRA)
            return
        try:
            self.__enter__()
        except Exception as error:
            yield broken(
                "engine", error, f"the message says what to do; or install it anew: {EXTRA}"
            )
            return
        try:
            yield Check("engine", True, "it starts, without any assets, and has the known car")
            yield from drive_checks(self)
        finally:
            self.__exit__(None, None, None)

    def check_driver(self, driver: Driver) -> None:
        """Refuses MetaDrive's own drivers under layers, and cameras where it cannot draw.

        Raises:
            DriverError: it is such a one; or it has a camera, and MetaDrive cannot draw here or
                not what its lens and layers ask for.
        """
        metadrive_driver(driver)
        check_other_world(driver, "MetaDrive")
        if camera_of(driver) is not None:
            check_drawing()

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road.

        Raises:
            FreneticError: the simulator has not been entered, or the road is too long to be drawn.
            ArithmeticError: MetaDrive's physics broke.
        """
        camera = camera_of(driver)
        world = self._world_for(road, camera)
        rows: list[list[float]] = []
        breakdown: Breakdown | None = None
        try:
            own = metadrive_driver(driver)
            world.load(
                road,
                friction=self.friction,
                left=self.start_offset,
                turned=self.start_heading,
            )
            with wall_limit(self.wall_limit):
                if own is None:
                    with blaming_driver():
                        driver.reset(VEHICLE.setup(self.rules, road, PERIOD))
                    look = None if camera is None else world.picture
                    self._follow(world, road, _asking(driver, look), rows)
                else:
                    self._follow_own(world, road, own, rows)
        except WallLimitExceeded as limit:
            breakdown = Breakdown.of(
                limit,
                f"the drive did not end within {self.wall_limit:g} s of wall time (the car had"
                f" driven {max(len(rows) - 1, 0) * PERIOD:.1f} s{limit.place})",
            )
        except DriverError as trouble:
            breakdown = Breakdown.of(trouble)
        columns = np.array(rows).reshape(-1, len(Trajectory.names()))
        path = Trajectory.from_rows(columns)
        return Drive.of(path, self.car, self.rules, road, breakdown)

    def _world_for(self, road: Road, camera: Camera | None) -> World:
        """The world with this camera, None for none; started anew if it is another one's."""
        world = self._world
        if world is None:
            raise FreneticError("MetaDrive is not running: drive roads in a with statement")
        region = 0 if camera is None else drawn_region(road)
        if camera != world.camera or region > world.region:
            # While there is none, leaving the simulator has nothing to end.
            kind, self._world = type(world), None
            world.close()
            world = self._world = kind(camera, region)
        return world

    def _follow_own(
        self, world: World, road: Road, driver: MetaDriveDriver, rows: list[list[float]]
    ) -> None:
        """Like `_follow`, with one of MetaDrive's drivers."""
        # These import the extra.
        from frenetic.metadrive.policies import DECISION_PERIODS, make_policy

        with closing(make_policy(driver, world, self.rules.speed_limit)) as policy:
            held = Decision()
            periods = 0

            def decide(observer: Observer, motion: Motion, wheels: float) -> Decision:  # noqa: ARG001
                nonlocal held, periods
                if periods % DECISION_PERIODS == 0:
                    held = policy.act()
                periods += 1
                return held

            self._follow(world, road, decide, rows)

    def _follow(self, world: World, road: Road, decide: Decide, rows: list[list[float]]) -> None:
        """Drives until the drive ends and writes the records into ``rows`` as it goes."""
        most = math.ceil(self.rules.timeout(road.length) / PERIOD) + 2
        observer = Observer(road, self.rules, self.car, most)
        heading = road.pose.heading
        decision = Decision()
        for i in range(most):
            motion = world.motion()
            if not all(map(math.isfinite, motion)):
                raise ArithmeticError(f"MetaDrive's physics broke: the car's motion is {motion}")
            heading += wrap(motion.heading - heading)
            wheels = decision.wheel_angle
            record = [i * PERIOD, motion.x, motion.y, heading, *motion[3:], wheels]
            rows.append([*record, *_asked(decision)])
            if not observer.see(i * PERIOD, motion.x, motion.y, heading):
                return
            last, decision = decision, decide(observer, motion, wheels)
            rows[-1] = [*record, *_asked(decision)]
            if decision is not last:
                world.steer(*decision.action)
            world.advance(STEPS_PER_PERIOD)


def _asking(driver: Driver, look: Callable[[], Image] | None) -> Decide:
    """Decides as the driver does for its observation, with a picture if there is one to look at."""

    def decide(observer: Observer, motion: Motion, wheels: float) -> Decision:
        image = None if look is None else look()
        observation = observer.observation(motion.speed, motion.yaw_rate, wheels, image)
        with blaming_driver():
            return Decision(*checked_controls(driver.act(observation)))

    return decide


def _asked(decision: Decision) -> tuple[float, float, float]:
    """A record's columns steering_input, throttle and brake."""
    return decision.steering, decision.throttle, min(decision.brake, 1.0)


def _positive(value: float, name: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value}: a positive number is needed")
    return float(value)
