"""The Simulator protocol, and attributes of simulators that hold the amounts of conditions."""

from __future__ import annotations

from numbers import Real
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar, runtime_checkable

from frenetic.conditions.condition import condition_named
from frenetic.drivers.driver import Driver
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.road import Road


@runtime_checkable
class Simulator(Protocol):
    """A simulator: it drives a driver along roads, one after the other.

    A simulator is a context manager: entering starts what it needs, such as a process, and leaving
    ends that, also after an error. Its class takes ``rules=Rules(...)``, which `drive` puts into
    every `Drive`.

    `drive` puts the car at rest on the centre of the ego lane at the road's first point, aligned
    with the road, and records the car at a fixed rate until `frenetic.oracle.assessment` says that
    the drive has ended. If the driver or the simulator breaks, `drive` returns a `Drive` with
    `trouble` instead of raising an exception, and the next drive is not affected. The same road and
    driver give the same drive.
    """

    rules: Rules
    """Rules of the next drive; they may be set between two drives."""
    car: CarBody
    """The box that the car covers, the same in every drive."""

    def __enter__(self) -> Self:
        """Start the simulator."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the simulator."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Drive along the road."""


class Ready:
    """Base of simulators that start nothing when they are entered and end nothing afterwards."""

    def __enter__(self) -> Self:
        """Start nothing."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End nothing."""


T = TypeVar("T", float, float | None)


class Amount(Generic[T]):
    """Descriptor: an attribute of a simulator that holds the amount of a condition.

    A new amount must be in the condition's range.

    Args:
        name: Name of the condition.
        usual: Amount before one is set; it may lie outside the condition's range.
    """

    def __init__(self, name: str, usual: T) -> None:
        self._name = name
        self.usual: T = usual

    def __set_name__(self, owner: type, attribute: str) -> None:
        self._attribute = attribute

    def __get__(self, simulator: object | None, owner: type | None = None) -> T:
        value: T = self.usual
        if simulator is not None:
            value = vars(simulator).get(f"_{self._attribute}", value)
        return value

    def __set__(self, simulator: object, value: T) -> None:
        if value != self.usual:
            condition = condition_named(self._name)
            if not (isinstance(value, Real) and condition.low <= value <= condition.high):
                text = f"{self._attribute} is {value!r}: {condition.allowed} is needed"
                raise ValueError(text)
            value = float(value)
        vars(simulator)[f"_{self._attribute}"] = value


def unusual_amounts(simulator: object) -> dict[str, Any]:
    """Return attribute -> amount of a simulator's `Amount`s that are not at their usual amount."""
    return {
        name: value
        for kind in reversed(type(simulator).__mro__)
        for name, amount in vars(kind).items()
        if isinstance(amount, Amount) and (value := getattr(simulator, name)) != amount.usual
    }


class StartingPlace:
    """Base of simulators in which the car can start beside the lane's centre or turned."""

    start_offset = Amount[float]("start", 0.0)
    """Distance of the car's start to the left of the ego lane's centre, in m."""
    start_heading = Amount[float]("heading", 0.0)
    """Angle of the car's start to the left of the road's direction, in rad."""
