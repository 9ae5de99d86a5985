"""Capabilities of a simulator beyond the methods of the protocol.

A simulator declares a capability by an attribute or method of that name; an undeclared one has its
default. Only this module looks for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.bounds import Count, Positive, check
from frenetic.conditions.condition import Condition, attributes
from frenetic.drivers.driver import Driver, SelectiveDriver
from frenetic.drivers.stack import camera_of, period_of, stack_of
from frenetic.errors import DriverError, FreneticError, RoadError
from frenetic.road import Road
from frenetic.simulators.checks import SimulatorCheck
from frenetic.simulators.simulator import Simulator

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

_FLAT: Final = "flat roads of one width only"
_REMEDY: Final = "leave superelevation, grade and widening out"


def _accept(_: Driver) -> None:
    """Accept every driver."""


@dataclass(frozen=True)
class SimulatorDefaults:
    """Capabilities that a simulator's class declares before one is made."""

    needs: tuple[str, ...] = ()
    """Modules without which the simulator is not installed."""
    preloads: tuple[str, ...] = ()
    """Modules that are imported before its processes are forked, so that what takes long is done
    once; importing them raises nothing."""
    usual_wall_limit: Positive = 60.0
    """Wall time that a drive may take unless another limit is given, in s."""
    usual_workers: Count | None = None
    """Number of workers unless another is given; None: one per processor core."""

    place_options: tuple[str, ...] = ()
    """Names of options that say where the simulator is and change no drive: a campaign may be
    resumed with other values, and a road's file never gives them."""
    variable: frozenset[str] = frozenset()
    """Attributes of the simulator that `frenetic.conditions` names: they may be set between two
    drives. With a `steering_lag` of None, its ``vehicle`` has one."""

    @property
    def missing(self) -> list[str]:
        """Modules of `needs` that are not installed."""
        return [module for module in self.needs if find_spec(module) is None]

    def lays(self, row: Condition) -> bool:
        """Return whether the simulator lays a condition, as an attribute or over the driver."""
        return not row.attribute or row.attribute in self.variable


@dataclass(frozen=True)
class Capabilities(SimulatorDefaults):
    """Capabilities of a simulator."""

    wall_limit: Positive = 60.0
    """Wall time after which the simulator ends a drive itself, in s."""
    workers_at_most: Count | None = None
    """Number of workers that can use the simulator at once; None if there is no limit."""
    prepare: Callable[[], None] = lambda: None
    """Finds out the `car` of a simulator that has to start for it; called before a campaign."""
    check_driver: Callable[[Driver], None] = _accept
    """Raises a `DriverError` if a driver cannot drive in the simulator; called first of all."""
    checks: Callable[[], Iterable[SimulatorCheck]] = tuple
    """Gives the checks of 'frenetic doctor' beside two drives; called once it is entered."""
    drives_compiled: Callable[[Driver], bool] = lambda _: False
    """Whether a driver's drives are compiled code of ours alone, which needs no process of its
    own."""
    period_step: Positive | None = None
    """Period of which a driver's own period may be a multiple, in s; None: it cannot have one."""
    draws: bool = False
    """Whether the simulator draws pictures for a driver with a camera."""
    lays_slopes: bool = False
    """Whether its roads lean, rise and widen as `Road` says; others are not driven in it."""

    @property
    def drive_limit(self) -> float:
        """Wall time in s after which a worker that drives one road counts as hanging."""
        return 1.5 * self.wall_limit + 10.0


def usual(factory: Callable[..., Any]) -> SimulatorDefaults:
    """Return the capabilities that a simulator's class declares.

    Raises:
        FreneticError: A declared value is invalid.
    """
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
    """Return the attributes with amounts that a simulator or its class has."""
    return frozenset(name for name in attributes() if hasattr(part, name))


def check_pair(simulator: Simulator, driver: Driver) -> None:
    """Check whether a driver can drive in a simulator, before anything is driven.

    It looks at the driver's period and camera, and asks the driver, the drivers under its wrappers
    (see `SelectiveDriver`) and the simulator's ``check_driver``.

    Raises:
        DriverError: Driver or simulator refuses, the simulator cannot keep the driver's period, or
            the driver has a camera and the simulator draws nothing.
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
        RoadError: The road leans, rises or widens, and the simulator lays only flat roads, or the
            driver has a camera.
    """
    if not road.is_plain and (reason := _lays_only(simulator, driver)):
        raise RoadError(f"{reason}: {_REMEDY}")


def check_class(simulator: Simulator, driver: Driver, road_class: RoadClass) -> None:
    """Check whether a simulator can drive the roads of a class with this driver.

    Raises:
        FreneticError: The roads lean, rise or widen, and `check_road` refuses such roads.
    """
    if road_class.plain and (reason := _lays_only(simulator, driver)):
        other = "simulator" if not capabilities(simulator).lays_slopes else "driver"
        raise FreneticError(
            f"{reason}: choose another {other}, or the road class {road_class.plain}"
        )


def _lays_only(simulator: Simulator, driver: Driver) -> str:
    """Return the limits of a simulator with this driver in words; empty if it lays every road."""
    if not capabilities(simulator).lays_slopes:
        return f"{type(simulator).__name__} drives {_FLAT}"
    return f"A camera sees {_FLAT}" if camera_of(driver) is not None else ""


def check_drawn(road: Road) -> None:
    """Check whether a road can be drawn for a camera.

    Raises:
        RoadError: The road leans, rises or widens.
    """
    if not road.is_plain:
        raise RoadError(f"A camera sees {_FLAT}: {_REMEDY}")


def _declared(part: object, kind: type[SimulatorDefaults]) -> dict[str, Any]:
    """Return the capabilities of a kind that a simulator or its class declares."""
    values = {item.name: getattr(part, item.name, None) for item in fields(kind)}
    # On a class, a property says nothing before there is an instance.
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
