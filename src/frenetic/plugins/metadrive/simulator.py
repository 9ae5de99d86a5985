"""MetaDrive as a `frenetic.simulators.Simulator`."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from frenetic._support.bounds import Positive, check
from frenetic._support.trigonometry import wrapped
from frenetic._support.words import pip_install
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.stack import camera_of, check_other_world
from frenetic.errors import DriverError, FreneticError, Trouble, describe_error
from frenetic.oracle.drive import Drive, Rules, Trajectory
from frenetic.plugins.metadrive.car import PHYSICS_STEP, VEHICLE, Decision
from frenetic.plugins.metadrive.drawing import check_drawing, drawn_region
from frenetic.plugins.metadrive.drivers import PolicySimulator, metadrive_driver
from frenetic.road import Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.drive_loop import RECORD_PERIOD, run_drive
from frenetic.simulators.observer import LimitsAhead
from frenetic.simulators.simulator import StartingPlace, unusual_amounts

if TYPE_CHECKING:
    from frenetic.plugins.metadrive.policies import Policy
    from frenetic.plugins.metadrive.world import World

EXTRA: Final = pip_install("metadrive")
DECISION_PERIODS: Final = 2
"""Record periods between two decisions of MetaDrive's drivers: 0.1 s, as in MetaDrive."""
_POLICY_DECELERATION: Final = 2.0
"""Deceleration with which MetaDrive's drivers brake to a lower speed limit, in m/s²; our choice."""


class MetaDriveSimulator(StartingPlace, PolicySimulator):
    """MetaDrive: Bullet physics of a four-wheeled car, headless; needs the extra ``metadrive``.

    While the simulator is entered, its process has the only engine of MetaDrive that it can have.
    The engine draws only for drivers with a camera: it is restarted when a drive has another camera
    than the last one, or one of the two has none.

    Args:
        rules: Speed limit, oob tolerance and when a drive ends.
        friction: Friction of the road, where 1 is MetaDrive's: 0.9 of the load on the tyres.
        wall_limit: Wall time that a drive may take, in s; a longer one is an ERROR.
        start_offset: Distance of the car's start to the left of the ego lane's centre, in m, -2..2.
        start_heading: Angle of the car's start to the left of the road's direction, in rad, within
            an eighth of a turn.

    `rules`, `friction`, `start_offset` and `start_heading` may be set between two drives; they hold
    from the next drive on.

    Raises:
        ValueError: An option is out of range.
    """

    needs: Final = ("metadrive",)
    """Modules of the extra ``metadrive``."""
    preloads: Final = ("frenetic.plugins.metadrive.preloading",)

    draws: Final = True
    period_step: Final = RECORD_PERIOD
    BEHAVIOUR: ClassVar[int] = 1
    """Version of the drives: to be increased when they change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("metadrive-simulator",)
    """Distributions on whose versions the drives depend, too."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        friction: Positive = 1.0,
        wall_limit: Positive = 60.0,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        check({"wall_limit": wall_limit}, MetaDriveSimulator.__init__)
        self.rules = rules or Rules()
        self.car = VEHICLE.body()
        self.friction = friction
        self.start_offset = start_offset
        self.start_heading = start_heading
        self.wall_limit = wall_limit
        self._world: World | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Options of the simulator beside the rules, without conditions at their usual amounts."""
        unusual = unusual_amounts(self)
        if self.friction != 1.0:
            unusual["friction"] = self.friction
        return {"wall_limit": self.wall_limit, **unusual}

    @property
    def friction(self) -> float:
        """Friction of the road: 1 is dry."""
        return self._friction

    @friction.setter
    def friction(self, friction: float) -> None:
        check({"friction": friction}, MetaDriveSimulator.__init__)
        self._friction = float(friction)

    def __enter__(self) -> Self:
        """Start MetaDrive's engine.

        Raises:
            FreneticError: MetaDrive is missing or of an unknown version, or its engine is already
                running in this process.
        """
        try:
            from frenetic.plugins.metadrive.world import World  # imports the extra
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
        """End MetaDrive's engine."""
        world, self._world = self._world, None
        if world is not None:
            world.close()

    def check_driver(self, driver: Driver) -> None:
        """Refuse drivers that cannot drive in MetaDrive.

        Raises:
            DriverError: The driver is one of MetaDrive's own under wrappers, or has a camera, and
                MetaDrive cannot draw here, or not with the camera's lens or wrappers.
        """
        metadrive_driver(driver)
        check_other_world(driver, "MetaDrive")
        if camera_of(driver) is not None:
            check_drawing()

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road, for its driver."""
        # Wheels in MetaDrive turn at once, and do not slide before the friction limit.
        return replace(
            VEHICLE.setup(self.rules, road, RECORD_PERIOD),
            front_cornering_stiffness=None,
            rear_cornering_stiffness=None,
            steering_rate=math.inf,
            steering_lag=0.0,
        )

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Drive along the road.

        Raises:
            FreneticError: The simulator has not been entered, or the road is too long to be drawn.
            RoadError: The road leans, rises or widens.
            ArithmeticError: MetaDrive's physics broke.
        """
        check_road(self, driver, road)
        world = self._world_for(road, camera_of(driver))
        try:
            own_driver = metadrive_driver(driver)
        except DriverError as error:
            trouble = Trouble.of(error, "simulator")
            return Drive(Trajectory.empty(), self.car, self.rules, road, trouble)
        world.load(
            road,
            friction=self.friction,
            left=self.start_offset,
            turned=self.start_heading,
        )
        car = _MetaDriveCar(world, road.pose.heading)
        run = partial(
            run_drive,
            road=road,
            rules=self.rules,
            body=self.car,
            setup=self.setup(road),
            limit=self.wall_limit,
        )
        if own_driver is None:
            return run(car, driver)
        from frenetic.plugins.metadrive.policies import make_policy  # imports the extra

        with closing(make_policy(own_driver, world)) as policy:
            policy_car = _PolicyCar(car, policy, road, self.rules)
            return run(policy_car, policy_car)

    def _world_for(self, road: Road, camera: Camera | None) -> World:
        """Return the world for a road and a camera; None for no camera.

        The engine is restarted if it has another camera or too small a region for the road.

        Raises:
            FreneticError: The simulator has not been entered, or the road is too long to be drawn.
        """
        world = self._world
        if world is None:
            raise FreneticError("MetaDrive is not running: drive roads in a with statement")
        region = 0 if camera is None else drawn_region(road)
        if camera != world.camera or region > world.region:
            # Until the new world has started, `__exit__` has nothing to end.
            kind, self._world = type(world), None
            world.close()
            world = self._world = kind(camera, region)
        return world


class _MetaDriveCar:
    """MetaDrive's car during one drive: a `MovedCar`.

    Args:
        world: MetaDrive's world with the car.
        heading: heading of the road's start in rad, near which the car's heading begins.
    """

    def __init__(self, world: World, heading: float) -> None:
        self._world = world
        self._heading = heading
        self._wheel_angle = 0.0  # in rad

    def motion(self) -> list[float]:
        """Return the car's motion.

        Raises:
            ArithmeticError: a number is not finite.
        """
        motion = self._world.motion()
        if not all(map(math.isfinite, motion)):
            raise ArithmeticError(f"MetaDrive's physics broke: the car's motion is {motion}")
        self._heading += wrapped(motion.heading - self._heading)
        return list(motion._replace(heading=self._heading, steering=self._wheel_angle))

    def picture(self) -> Image | None:
        """Return what the camera sees; None without a camera."""
        return None if self._world.camera is None else self._world.picture()

    def steer(self, decision: Decision) -> None:
        """Set the controls until the next call."""
        self._wheel_angle = decision.wheel_angle
        self._world.steer(*decision.action)

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Set the controls and move the car for some seconds."""
        self.steer(Decision(steering, throttle, brake))
        self.move(seconds)

    def move(self, seconds: float) -> None:
        """Move the car for some seconds with the controls that were set."""
        self._world.advance(round(seconds / PHYSICS_STEP))


class _PolicyCar:
    """MetaDrive's car with one of MetaDrive's drivers: a `MovedCar` and a `Driver` in one.

    The driver decides every `DECISION_PERIODS`; its decision holds until the next one.
    """

    def __init__(self, car: _MetaDriveCar, policy: Policy, road: Road, rules: Rules) -> None:
        self._car = car
        self._policy = policy
        self._limits = LimitsAhead(road, rules)
        self._only_limit = float(rules.speed_limits_on(road)[0, 1])  # km/h, if there is one alone
        self.motion = car.motion

    def picture(self) -> None:
        """Return None: MetaDrive's drivers look at MetaDrive's world."""

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002
        """Begin to count periods."""
        self._periods = 0

    def act(self, observation: Observation) -> Controls:
        """Return the controls of the policy's last decision; the brake may be above 1."""
        if self._periods % DECISION_PERIODS == 0:
            limit = self._only_limit
            if not self._limits.is_constant:
                limit = 3.6 * self._limits.speed_at(observation.distance, _POLICY_DECELERATION)
            self._decision = self._policy.act(limit)
            self._car.steer(self._decision)
        self._periods += 1
        return Controls(*self._decision)

    def advance(
        self,
        steering: float,  # noqa: ARG002
        throttle: float,  # noqa: ARG002
        brake: float,  # noqa: ARG002
        seconds: float,
    ) -> None:
        """Move the car for some seconds with the controls that `act` has set."""
        self._car.move(seconds)
