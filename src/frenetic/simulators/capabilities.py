"""Capabilities of a simulator beyond the methods of the protocol.

A simulator declares a capability by an attribute or method of the capability's name; an undeclared
capability has its default. Only this module reads the declarations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.bounds import Count, Positive, check
from frenetic.conditions.condition import attributes
from frenetic.conditions.declaration import Condition
from frenetic.drivers.driver import Driver, SelectiveDriver
from frenetic.drivers.stack import camera_of, period_of, stack_of
from frenetic.errors import DriverError, FreneticError, RoadError
from frenetic.oracle.drive import Drive
from frenetic.road import Road
from frenetic.simulators.checks import SimulatorCheck
from frenetic.simulators.simulator import Simulator

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

_FLAT_ROADS: Final = "flat roads of one width only"
_FLATTEN: Final = "leave superelevation, grade and widening out"
_HANGING_FACTOR: Final = 1.5
"""Wall time of a drive that hangs, as a multiple of `Capabilities.wall_limit`; our choice."""
_HANGING_EXTRA: Final = 10.0
"""Wall time of a drive that hangs in addition, in s; our choice."""


def _accept(_: Driver) -> None:
    """Accept every driver."""


@dataclass(frozen=True)
class SimulatorDefaults:
    """Capabilities that a simulator's class declares, known before a simulator is made."""

    needs: tuple[str, ...] = ()
    """Modules without which the simulator is not installed."""
    preloads: tuple[str, ...] = ()
    """Modules that are imported once, before worker processes are forked, because importing them
    takes long; importing them raises nothing."""
    usual_wall_limit: Positive = 60.0
    """Wall time that a drive may take unless another limit is given, in s."""
    usual_workers: Count | None = None
    """Number of workers unless another is given; None: one per processor core."""

    place_options: tuple[str, ...] = ()
    """Names of options that say where the simulator is installed or running, and change no drive:
    a campaign may be resumed with other values, and a road's file never sets them."""
    variable: frozenset[str] = frozenset()
    """Attributes of the simulator that hold the amounts of conditions (`frenetic.conditions`) and
    may be set between two drives. A `steering_lag` of None stands for the lag of its
    ``vehicle``."""

    @property
    def missing_modules(self) -> list[str]:
        """Modules of `needs` that are not installed."""
        return [module for module in self.needs if find_spec(module) is None]

    def can_apply(self, condition: Condition) -> bool:
        """Return whether drives can have a condition.

        A condition without an attribute needs none of the simulator: it is a wrapper of the driver.
        """
        return not condition.attribute or condition.attribute in self.variable


@dataclass(frozen=True)
class Capabilities(SimulatorDefaults):
    """Capabilities of a simulator."""

    wall_limit: Positive = 60.0
    """Wall time after which the simulator ends a drive itself, in s."""
    workers_at_most: Count | None = None
    """Number of workers that can use the simulator at once; None if there is no limit."""
    prepare: Callable[[], None] = lambda: None
    """Called before a campaign: sets the `car` of a simulator that must start to measure it."""
    check_driver: Callable[[Driver], None] = _accept
    """Called before anything else: raises a `DriverError` if a driver cannot drive in the
    simulator."""
    checks: Callable[[], Iterable[SimulatorCheck]] = tuple
    """Yields further checks for 'frenetic doctor'; called while the simulator is entered."""
    drives_compiled: Callable[[Driver], bool] = lambda _: False
    """Whether a driver's drives run compiled code of Frenetic alone, and so need no separate
    process."""
    compiled_drive: Callable[[Road, Driver], Any] | None = None
    """Returns a drive in the present conditions, which `drive_compiled` drives; None if the
    simulator drives one road at a time."""
    drive_compiled: Callable[..., Sequence[Drive]] | None = None
    """Drives many drives of `compiled_drive` side by side, on ``threads`` threads."""
    period_step: Positive | None = None
    """Time of which a driver's period is a multiple, in s; None if all drivers have the
    simulator's period."""
    draws: bool = False
    """Whether the simulator draws pictures for a driver with a camera."""
    lays_slopes: bool = False
    """Whether the simulator's roads lean, rise and widen as `Road` says; without it, the simulator
    refuses all but flat roads."""

    @property
    def drive_limit(self) -> float:
        """Wall time in s after which a worker that drives one road counts as hanging."""
        return _HANGING_FACTOR * self.wall_limit + _HANGING_EXTRA


def defaults_of(factory: Callable[..., Any]) -> SimulatorDefaults:
    """Return the capabilities that a simulator's class declares.

    Raises:
        FreneticError: A declared value is invalid.
    """
    # Every simulator has `rules`, but sets them in the constructor: the class does not have them.
    return SimulatorDefaults(
        **_declared(factory, SimulatorDefaults) | {"variable": _variable(factory) | {"rules"}}
    )


def capabilities(simulator: Simulator) -> Capabilities:
    """Return the capabilities of a simulator.

    Raises:
        FreneticError: A declared value is invalid.
    """
    declared = _declared(simulator, Capabilities)
    return Capabilities(**declared | {"variable": _variable(simulator)})


def _variable(part: object) -> frozenset[str]:
    """Return the names of the attributes with amounts of conditions of a simulator or its class."""
    return frozenset(name for name in attributes() if hasattr(part, name))


def check_pair(simulator: Simulator, driver: Driver) -> None:
    """Check whether a driver can drive in a simulator, before anything is driven.

    The check reads the driver's period and camera, and asks the driver, the drivers under its
    wrappers (see `SelectiveDriver`) and the simulator's ``check_driver``.

    Raises:
        DriverError: The driver or the simulator refuses the other, the simulator cannot keep the
            driver's period, or the driver has a camera and the simulator draws nothing.
    """
    declared = capabilities(simulator)
    period_of(driver, declared.period_step)
    if camera_of(driver) is not None and not declared.draws:
        raise DriverError(
            f"{type(simulator).__name__} draws nothing, and the driver has a camera: use the"
            " embedded simulator, or a driver without a camera"
        )
    for part in stack_of(driver):
        if isinstance(part, SelectiveDriver):
            part.check_simulator(simulator)
    declared.check_driver(driver)


def check_road(simulator: Simulator, driver: Driver, road: Road) -> None:
    """Check whether a simulator can drive this road with this driver.

    Raises:
        RoadError: The road leans, rises or widens, and the simulator has only flat roads, or the
            driver has a camera.
    """
    if not road.is_plain and (reason := _flat_only_reason(simulator, driver)):
        raise RoadError(f"{reason}: {_FLATTEN}")


def check_class(simulator: Simulator, driver: Driver, road_class: RoadClass) -> None:
    """Check whether a simulator can drive the roads of a class with this driver.

    Raises:
        FreneticError: The roads lean, rise or widen, and `check_road` refuses such roads.
    """
    if road_class.plain and (reason := _flat_only_reason(simulator, driver)):
        other = "simulator" if not capabilities(simulator).lays_slopes else "driver"
        raise FreneticError(
            f"{reason}: choose another {other}, or the road class {road_class.plain}"
        )


def _flat_only_reason(simulator: Simulator, driver: Driver) -> str:
    """Return why a simulator with this driver drives flat roads only; empty if it drives all."""
    if not capabilities(simulator).lays_slopes:
        return f"{type(simulator).__name__} drives {_FLAT_ROADS}"
    return f"A camera sees {_FLAT_ROADS}" if camera_of(driver) is not None else ""


def check_drawn(road: Road) -> None:
    """Check whether a road can be drawn for a camera.

    Raises:
        RoadError: The road leans, rises or widens.
    """
    if not road.is_plain:
        raise RoadError(f"A camera sees {_FLAT_ROADS}: {_FLATTEN}")


def _declared(part: object, kind: type[SimulatorDefaults]) -> dict[str, Any]:
    """Return name -> value of the capabilities of a kind that a simulator or its class declares."""
    values = {item.name: getattr(part, item.name, None) for item in fields(kind)}
    # A property has no value on a class, only on an instance.
    declared = {
        name: value
        for name, value in values.items()
        if value is not None and not isinstance(value, property)
    }
    try:
        check(declared, kind)
    except ValueError as error:
        name = part.__name__ if isinstance(part, type) else type(part).__name__
        raise FreneticError(f"{name}.{error}") from None
    return declared
