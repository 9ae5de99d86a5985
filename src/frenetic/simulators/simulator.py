"""The Simulator protocol, and the start of a car where a simulator can vary it."""

from __future__ import annotations

from types import TracebackType
from typing import Annotated, Protocol, Self, runtime_checkable

from msgspec import Meta

from frenetic._support.bounds import check
from frenetic.drive import CarBody, Drive, Rules
from frenetic.drivers.driver import Driver
from frenetic.quantities import MAX_START_HEADING, MAX_START_OFFSET
from frenetic.road import Road


@runtime_checkable
class Simulator(Protocol):
    """Drives a driver along roads, one after the other.

    It is a context manager: entering starts its parts, leaving ends them in every case. It is made
    with ``rules=Rules(...)`` and puts them into every `Drive`.

    `drive` puts the car at rest on the centre of the ego lane at the road's first point, aligned
    with the road, and records it at a fixed rate until `frenetic.oracle` says that the drive has
    ended. A driver or simulator that breaks gives a `Drive` with `error` set instead of an
    exception, and leaves the next drive clean. The same road and driver give the same drive.
    """

    rules: Rules
    """Rules of the next drive; they may be set between two drives."""
    car: CarBody
    """The box that the car covers, the same in every drive."""

    def __enter__(self) -> Self:
        """Starts the simulator."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends the simulator."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road."""


class _Start:
    start_offset: Annotated[float, Meta(ge=-MAX_START_OFFSET, le=MAX_START_OFFSET)]
    start_heading: Annotated[float, Meta(ge=-MAX_START_HEADING, le=MAX_START_HEADING)]


class StartingPlace:
    """Base of simulators with the place of a car's start as two checked attributes."""

    _start_offset = 0.0
    _start_heading = 0.0

    @property
    def start_offset(self) -> float:
        """Distance of the car's start to the left of the ego lane's centre, in m."""
        return self._start_offset

    @start_offset.setter
    def start_offset(self, offset: float) -> None:
        check({"start_offset": offset}, _Start)
        self._start_offset = float(offset)

    @property
    def start_heading(self) -> float:
        """Angle of the car's start to the left of the road's direction, in rad."""
        return self._start_heading

    @start_heading.setter
    def start_heading(self, heading: float) -> None:
        check({"start_heading": heading}, _Start)
        self._start_heading = float(heading)
