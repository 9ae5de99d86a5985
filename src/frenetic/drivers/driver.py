"""The Driver protocol: the system under test sees observations and answers with controls."""

from __future__ import annotations

import math
import signal
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol, runtime_checkable

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.camera import Camera, Scene
from frenetic.errors import ControlsError, DriverError, FreneticError, describe_raised

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image
    from frenetic.drivers.lane import Lane
    from frenetic.road import Road

AHEAD_SPACING = 2.0
"""Distance along the road between two points of the view ahead, in m."""
AHEAD_POINTS = 40
"""Points of a full view: 78 m."""
DRAG_FADE_SPEED: Final = 0.5
"""Rolling speed below which brakes and `DriveSetup.rolling_drag` fade out, in m/s, for a smooth
stop."""
PERIODS: Final = (0.01, 0.2)
"""Shortest and longest period that a driver may ask for, in s."""
MOST_STEERING: Final = 1e9
"""Largest angle that a driver may ask for, in rad: a campaign's database holds it."""
MOST_LANE_POINTS: Final = 100_000
"""Points of the longest `Observation.lane`."""


@dataclass(frozen=True)
class DriveSetup:
    """The setup of a drive for its driver: the car, the lane and the limits."""

    speed_limit: float
    """Speed limit at the start, in m/s; `Observation.speed_limit` holds where the car is."""
    lane_width: float
    """Width of the lane, in m."""
    period: float
    """Time between two calls of `act`, in s."""
    front_axle: float
    """Distance from the centre of mass to the front axle, in m."""
    rear_axle: float
    """Distance from the centre of mass to the rear axle, in m."""
    car_length: float
    """Length of the car, in m."""
    car_width: float
    """Width of the car, in m."""
    max_steering: float
    """Largest angle of the front wheels, in rad."""
    max_acceleration: float
    """Acceleration at full throttle and low speed, in m/s^2."""
    max_deceleration: float
    """Deceleration at full brake on a dry road, in m/s^2."""
    switch_speed: float = math.inf
    """Speed above which the engine's power limits the acceleration, to 1/speed, in m/s."""
    rolling_drag: float = 0.0
    """Deceleration of a rolling car without pedals, in m/s^2; 0 if the simulator does not know."""
    air_drag: float = 0.0
    """Further deceleration per square of the speed, in 1/m; 0 if the simulator does not know."""
    mass: float | None = None
    """Mass of the car, in kg; None, as in the fields below, if the simulator does not know."""
    yaw_inertia: float | None = None
    """Yaw inertia about the vertical axis, in kg m^2."""
    front_cornering_stiffness: float | None = None
    """Lateral force of the front axle per slip angle at small ones, under its load at rest, in
    N/rad: of a Pacejka tyre B C D times the load of both wheels, without its minus sign."""
    rear_cornering_stiffness: float | None = None
    """Lateral force of the rear axle per slip angle, in N/rad."""
    steering_rate: float | None = None
    """Fastest change of the front wheels' angle, in rad/s."""
    steering_lag: float | None = None
    """Time constant with which the front wheels follow the wanted angle, in s."""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, in m."""
        return self.front_axle + self.rear_axle


@dataclass(frozen=True, eq=False)
class Observation:
    """A driver's view: its car relative to the ego lane, and the lane ahead."""

    time: float
    """Time since the start, in s."""
    speed: float
    """Speed along the car, in m/s."""
    yaw_rate: float
    """Yaw rate in rad/s, positive to the left."""
    steering: float
    """Angle of the front wheels in rad, positive to the left."""
    lateral_offset: float
    """Offset of the centre of mass to the left of the ego lane's centre line, in m."""
    heading_error: float
    """The car's heading less the lane's in rad, positive when it points to the left, in -pi..pi."""
    ahead: FloatArray
    """The ego lane's centre line in the car's frame, (n, 2) in m: x ahead, y to the left.

    The origin is the centre of mass. The first point is abreast of it, the next points follow every
    2 m of road; beyond the road's end they go on straight. n is at most 40; a limited view has
    fewer points."""
    curvature_ahead: FloatArray
    """Curvature of the ego lane's centre line at the points of `ahead`, (n,) in 1/m."""
    distance: float = 0.0
    """Distance along the road, in m."""
    image: Image | None = None
    """The camera's picture, (height, width, 3) RGB from 0 to 255; None without a camera.

    The first row is on top."""
    x: float = 0.0
    """Coordinate of the centre of mass on the map, in m."""
    y: float = 0.0
    """Coordinate of the centre of mass on the map, in m."""
    heading: float = 0.0
    """The car's heading on the map in rad, counter-clockwise from +x, unwrapped."""
    lateral_speed: float = 0.0
    """Speed across the car, in m/s, positive to the left."""
    view: float = math.inf
    """Length of road ahead at which `lane` ends, in m, where the view is limited."""
    speed_limit: float = math.inf
    """Speed limit where the car is, in m/s."""
    speed_limit_ahead: FloatArray = field(default_factory=lambda: np.empty(0))
    """Lowest speed limit from each point of `ahead` to the next, (n,) in m/s."""
    _road: Road | None = field(default=None, repr=False)

    def lane(self, spacing: float = 1.0, ahead: float = 100.0, behind: float = 0.0) -> Lane:
        """Return the ego lane's centre line, at any spacing and length, also behind the car.

        The lane follows from this observation's `distance`, `lateral_offset` and `heading_error`,
        so a wrapper that changes these changes the lane, and one that limits the view ends it
        sooner.
        Beyond both ends of the road the lane goes on straight, as `ahead` does.

        Args:
            spacing: m of road between two points, one of which is abreast of the car.
            ahead: m of road ahead of the car.
            behind: m of road behind it.

        Raises:
            ValueError: A length is out of range.
            FreneticError: The simulator does not say on which road the car is.
        """
        from frenetic.drivers.lane import lane_of  # numba takes long, also where nobody drives

        if self._road is None:
            raise FreneticError("no lane is known: the simulator makes observations of its own")
        if not (spacing > 0.0 and ahead >= 0.0 and behind >= 0.0):
            raise ValueError(
                f"a lane {ahead:g} m ahead and {behind:g} m behind, every {spacing:g} m: numbers"
                " of at least 0 and a spacing above 0 are needed"
            )
        lengths = (behind / spacing, min(ahead, self.view) / spacing)
        if not sum(lengths) < MOST_LANE_POINTS:
            raise ValueError(
                f"a lane {ahead:g} m ahead and {behind:g} m behind, every {spacing:g} m: at most"
                f" {MOST_LANE_POINTS} points are allowed"
            )
        # As many whole steps as there are but for rounding: 0.3 m are 3 steps of 0.1 m.
        first, last = (math.floor(length + 1e-9) for length in lengths)
        return lane_of(
            self._road,
            self.distance,
            self.lateral_offset,
            self.heading_error,
            spacing * np.arange(-first, last + 1, dtype=np.float64),
        )


@dataclass(frozen=True)
class Controls:
    """A driver's answer, held until it is asked again."""

    steering: float
    """Wanted angle of the front wheels in rad, positive to the left; the car limits it."""
    throttle: float = 0.0
    """Pedal position 0..1; values beyond are cut."""
    brake: float = 0.0
    """Pedal position 0..1; values beyond are cut."""

    @classmethod
    def from_acceleration(
        cls, acceleration: float, steering: float, *, speed: float, setup: DriveSetup
    ) -> Controls:
        """Return controls for an acceleration, as far as the car's engine and brakes allow.

        The pedals make up for the drag that the setup knows. An acceleration beyond the car's
        becomes a full pedal.

        Args:
            acceleration: m/s^2, negative to brake.
            steering: rad, positive to the left.
            speed: m/s, speed of the car, `Observation.speed`.
            setup: The setup with which the driver was reset.
        """
        rolling = setup.rolling_drag * min(max(speed / DRAG_FADE_SPEED, -1.0), 1.0)
        wanted = acceleration + rolling + setup.air_drag * speed * abs(speed)
        engine = setup.max_acceleration
        if speed > setup.switch_speed:
            engine *= setup.switch_speed / speed
        if wanted >= 0.0:
            return cls(steering, throttle=min(wanted / engine, 1.0))
        return cls(steering, brake=min(-wanted / setup.max_deceleration, 1.0))


@runtime_checkable
class Driver(Protocol):
    """The system under test.

    A simulator calls `reset` before every drive and `act` every control period (20 Hz). A driver
    may be of any class that has these two methods. It must behave the same after every `reset`, or
    a failing road cannot be reproduced; draw random numbers from a seeded generator made there.

    A driver with an attribute ``period`` in s, 0.01 to 0.2, is asked that often instead.
    """

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive and prepare for the next."""

    def act(self, observation: Observation) -> Controls:
        """Return the controls for the next period."""


@runtime_checkable
class SelectiveDriver(Driver, Protocol):
    """A driver that cannot drive in every simulator."""

    def check_simulator(self, simulator: Any) -> None:
        """Raise a `DriverError` if the driver cannot drive in this simulator."""


@runtime_checkable
class CameraDriver(Driver, Protocol):
    """A driver that sees through a camera: its observations have an `image`."""

    camera: Camera
    """The driver's camera, the same in every drive."""


class OwnWrapper:
    """Base of our own wrappers: a drive begins for the driver underneath, too.

    Args:
        driver: the driver underneath.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when the wrapper's effect changes, as a driver's is."""
    place: ClassVar[int]
    """Rank among the wrappers around a driver, from the outermost, 0; each class has its own."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls."""
        return self.driver.act(observation)

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene that a camera sees in place of a scene."""
        return scene

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper, which are its public attributes."""
        return {k: v for k, v in vars(self).items() if k != "driver" and not k.startswith("_")}


def unwrapped(driver: Driver) -> Driver:
    """Return the driver itself, without wrappers of ours over it."""
    while isinstance(driver, OwnWrapper):
        driver = driver.driver
    return driver


def inner_driver(driver: object) -> Driver | None:
    """Return the driver under a wrapper; None if the object is no wrapper."""
    inner = getattr(driver, "driver", None)
    return inner if inner is not None and isinstance(inner, Driver) else None


def stack_of(driver: Driver) -> Iterator[Driver]:
    """Yield a driver and the drivers under it, the outermost first."""
    under: Driver | None = driver
    while under is not None:
        yield under
        under = inner_driver(under)


def camera_of(driver: Driver) -> Camera | None:
    """Return the camera of a driver or of the driver under its wrappers; None without a camera.

    Raises:
        DriverError: The attribute ``camera`` is not a `Camera`.
    """
    for part in stack_of(driver):
        camera = getattr(part, "camera", None)
        if isinstance(camera, Camera):
            return camera
        if camera is not None:
            raise DriverError(
                f"the driver's camera is {repr(camera)[:60]}: a frenetic.Camera is needed"
            )
    return None


def period_of(driver: Driver, step: float | None) -> float | None:
    """Return the period that a driver or the driver under its wrappers asks for, in s, or None.

    Args:
        driver: Any driver.
        step: s of which a simulator allows multiples; None if its period is fixed.

    Raises:
        DriverError: The ``period`` is not 0.01 to 0.2 s, or the simulator cannot keep it.
    """
    periods = (getattr(part, "period", None) for part in stack_of(driver))
    period = next((value for value in periods if value is not None), None)
    if period is None:
        return None
    low, high = PERIODS
    if not isinstance(period, (int, float)) or not low <= period <= high:
        raise DriverError(
            f"the driver's period is {repr(period)[:40]}: {low:g} to {high:g} s are needed"
        )
    if step is None:
        raise DriverError(
            f"the driver's period is {period:g} s, and this simulator cannot change its own: use"
            " another, such as the embedded one"
        )
    if abs(period / step - round(period / step)) > 1e-6:
        raise DriverError(
            f"the driver's period is {period:g} s: this simulator allows multiples of {step:g} s"
        )
    return float(period)


def scene_of(driver: Driver) -> Scene:
    """Return the scene that a driver's wrappers ask for."""
    scene = Scene()
    for wrapper in stack_of(driver):
        if isinstance(wrapper, OwnWrapper):
            scene = wrapper.in_scene(scene)
    return scene


def check_other_world(driver: Driver, world: str) -> None:
    """Refuse a driver whose camera or scene a simulator with a world of its own cannot draw.

    Args:
        driver: The driver; without a camera it is accepted.
        world: Name of the simulator.

    Raises:
        DriverError: The camera's lens is distorted, or a wrapper changes the scene.
    """
    camera = camera_of(driver)
    if camera is None:
        return
    if camera.distortion != 0.0:
        raise DriverError(
            f"{world}'s camera has no distortion: the driver's has {camera.distortion:g}, where 0"
            " is needed"
        )
    if scene_of(driver) != Scene():
        raise DriverError(
            f"{world} draws its own world: leave out scene and wear, or give them 0 where a"
            " campaign has them"
        )


@contextmanager
def blaming_driver() -> Iterator[None]:
    """Turn an error of a driver into a `DriverError` that says where in its code it was raised.

    A `KeyboardInterrupt` stays one where it may be Ctrl-C.
    """
    try:
        yield
    except DriverError:
        raise
    except BaseException as error:
        is_driver = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        if isinstance(error, KeyboardInterrupt) and not is_driver:
            raise
        raise DriverError(f"the driver raised {describe_raised(error)}") from error


def is_of_driver(error: BaseException, driver: Driver) -> bool:
    """Return whether a call of the driver, or of a driver under its wrappers, raised an error."""
    codes = {
        getattr(getattr(type(part), name, None), "__code__", None)
        for part in stack_of(driver)
        for name in ("reset", "act")
    }
    return any(frame.f_code in codes for frame, _ in traceback.walk_tb(error.__traceback__))


def checked_controls(controls: Any) -> tuple[float, float, float]:
    """Return steering, throttle and brake of a driver's answer, pedals cut to 0..1.

    Raises:
        ControlsError: The answer is not `Controls`, a value is not a finite number, or the steering
            is more than `MOST_STEERING`.
    """
    if not isinstance(controls, Controls):
        raise ControlsError(
            f"the driver returned {type(controls).__name__} instead of frenetic.Controls"
        )
    steering, throttle, brake = controls.steering, controls.throttle, controls.brake
    if not (
        type(steering) is type(throttle) is type(brake) is float
        and math.isfinite(throttle + brake)
        and -MOST_STEERING <= steering <= MOST_STEERING
    ):
        steering, throttle, brake = _numbers(controls)
    return steering, min(max(throttle, 0.0), 1.0), min(max(brake, 0.0), 1.0)


def _short_repr(value: object) -> str:
    """Return the beginning of a value's repr, or its class where the repr fails."""
    try:
        return repr(value)[:40]
    except Exception:  # a whole number may be too long, and foreign code may raise anything
        return f"<{type(value).__name__}>"


def _numbers(controls: Controls) -> tuple[float, float, float]:
    values = []
    for name in ("steering", "throttle", "brake"):
        value = getattr(controls, name)
        try:
            number = math.nan if isinstance(value, (str, bytes)) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ControlsError(
                f"the driver returned {name} = {_short_repr(value)}, not a finite number"
            )
        values.append(number)
    steering, throttle, brake = values
    if abs(steering) > MOST_STEERING:
        raise ControlsError(
            f"the driver returned steering = {steering:g}: an angle of at most"
            f" {MOST_STEERING:g} rad is needed"
        )
    return steering, throttle, brake
