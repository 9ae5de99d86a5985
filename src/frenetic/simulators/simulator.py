"""The Simulator protocol, and the start of a car where a simulator can vary it."""

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

    It is a context manager: entering starts its parts, leaving ends them in every case. It is made
    with ``rules=Rules(...)`` and puts them into every `Drive`.

    `drive` puts the car at rest on the centre of the ego lane at the road's first point, aligned
    with the road, and records it at a fixed rate until `frenetic.oracle.verdict` says that the
    drive has ended. A driver or simulator that breaks gives a `Drive` with its `trouble` instead of
    an exception, and leaves the next drive clean. The same road and driver give the same drive.
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
    """Base of simulators that start and end nothing."""

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
    """An attribute of a simulator with the amount of a condition, checked when it is set.

    Args:
        name: Name of the condition.
        usual: Amount that holds until another is set; it need not be in the condition's range.
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
            row = condition_named(self._name)
            if not (isinstance(value, Real) and row.low <= value <= row.high):
                text = f"{self._attribute} is {value!r}: {row.allowed} is needed"
                raise ValueError(text)
            value = float(value)
        vars(simulator)[f"_{self._attribute}"] = value


def unusual_amounts(simulator: object) -> dict[str, Any]:
    """Return the unusual values of a simulator's `Amount`s, by their names."""
    return {
        name: value
        for kind in reversed(type(simulator).__mro__)
        for name, amount in vars(kind).items()
        if isinstance(amount, Amount) and (value := getattr(simulator, name)) != amount.usual
    }


class StartingPlace:
    """Base of simulators with the place of a car's start as two checked attributes."""

    start_offset = Amount[float]("start", 0.0)
    """Distance of the car's start to the left of the ego lane's centre, in m."""
    start_heading = Amount[float]("heading", 0.0)
    """Angle of the car's start to the left of the road's direction, in rad."""
