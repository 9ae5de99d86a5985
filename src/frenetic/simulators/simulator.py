"""The Simulator protocol."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from frenetic.drivers.driver import Driver
from frenetic.road import Road
from frenetic.simulators.drive import CarBody, Drive, Rules


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
