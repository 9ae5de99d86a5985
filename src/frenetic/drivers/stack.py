"""A driver under its wrappers, called a stack: its members, and what a simulator asks of them.

Frenetic's own wrappers derive from `OwnWrapper`. A user's wrapper may be any driver with another
driver in its attribute ``driver``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Final, Self

from frenetic.conditions.declaration import Condition
from frenetic.drivers.camera import Camera, Scene
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.errors import DriverError

PERIODS: Final = (0.01, 0.2)
"""Shortest and longest control period that a driver may ask for, in s; our choice."""
_PERIOD_ROUNDING: Final = 1e-6
"""Number of steps by which a period may miss a whole number of a simulator's steps; our choice."""


class OwnWrapper:
    """Base of Frenetic's own wrappers; it passes every call on to the driver underneath.

    Args:
        driver: the driver underneath.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the wrapper's effect: increase it when the effect changes."""
    place: ClassVar[int]
    """Position of the wrapper in a stack, counted from the outermost wrapper, 0."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls."""
        return self.driver.act(observation)

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene that the driver's camera sees, by default the passed scene."""
        return scene

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper by name: its public attributes."""
        return {
            name: value
            for name, value in vars(self).items()
            if name != "driver" and not name.startswith("_")
        }


class AmountWrapper(OwnWrapper):
    """Base of wrappers that put a driver into one condition, with one amount.

    Args:
        driver: the driver underneath.
        amount: amount of the wrapper's condition.

    Raises:
        ValueError: the amount is out of the condition's range.
    """

    condition: ClassVar[Condition]
    """Condition whose amount the wrapper has."""
    amount_name: ClassVar[str]
    """Name of the amount among the wrapper's options."""

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver)
        self.amount = self.condition.require(amount)

    @classmethod
    def over(cls, driver: Driver, amount: float, **seed: int) -> Self:
        """Return a driver under this wrapper; only a wrapper with noise takes a ``seed``."""
        return cls(driver, amount, **seed)

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper."""
        return {self.amount_name: self.amount}


def unwrapped(driver: Driver) -> Driver:
    """Return the driver without Frenetic's own wrappers over it."""
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
    """Return the outermost camera in a driver's stack; None without a camera.

    Raises:
        DriverError: the attribute ``camera`` is not a `Camera`.
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
    """Return the control period that a driver's stack asks for, in s; None if it asks for none.

    Args:
        driver: the driver with its wrappers.
        step: step in s of which the simulator's periods are multiples; None if its period is fixed.

    Raises:
        DriverError: the ``period`` is not 0.01 to 0.2 s, or the simulator does not allow it.
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
    if abs(period / step - round(period / step)) > _PERIOD_ROUNDING:
        raise DriverError(
            f"the driver's period is {period:g} s: this simulator allows multiples of {step:g} s"
        )
    return float(period)


def scene_of(driver: Driver) -> Scene:
    """Return the scene that the camera of a driver sees, as its wrappers change it."""
    scene = Scene()
    for wrapper in stack_of(driver):
        if isinstance(wrapper, OwnWrapper):
            scene = wrapper.in_scene(scene)
    return scene


def check_other_world(driver: Driver, world: str) -> None:
    """Refuse a driver whose images a simulator that draws its own world cannot draw.

    Args:
        driver: the driver; without a camera it is accepted.
        world: name of the simulator, for the message.

    Raises:
        DriverError: the camera's lens is distorted, or a wrapper changes the scene.
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
