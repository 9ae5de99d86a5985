"""The interface of a manoeuvre: its road, the conditions of its drive, and what is measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Final, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic.drivers.driver import AHEAD_POINTS, AHEAD_SPACING
from frenetic.errors import RoadError
from frenetic.oracle.drive import Drive
from frenetic.oracle.signals import LocatedDrive
from frenetic.oracle.verdict import Result
from frenetic.road import Road
from frenetic.road.road_values import USUAL_CHANGE
from frenetic.road.validity import MIN_RADIUS

VIEW: Final = AHEAD_POINTS * AHEAD_SPACING
"""Length of the road ahead that a driver usually sees, in m."""
RUN_OUT: Final = VIEW + 20.0
"""Length of the straight at the end of a manoeuvre's road, in m; our choice."""
_RUN_UP_ACCELERATION: Final = 2.0  # [m/s²] with which a car surely reaches its speed; our choice
_RUN_UP_TIME: Final = 5.0  # [s] in which speed and steering become steady; our choice
STEADY_TIME: Final = 2.0
"""Time at the end of a response whose mean is the final value, in s; our choice."""
Hold: TypeAlias = Annotated[float, Meta(gt=STEADY_TIME, le=300.0)]
"""A driving time that is measured, in s: long enough for a steady end."""
Period: TypeAlias = Annotated[float, Meta(gt=0.0, le=60.0)]
"""A period of a sine, in s."""
Transition: TypeAlias = Annotated[float, Meta(gt=0.0, le=500.0)]
"""A length of a clothoid, in m."""
_OFFSET_UNREST: Final = 0.1  # [m] by which a steady offset may still move; our choice
_WALKING_PACE: Final = 1.0  # [m/s], which keeps a quotient finite; our choice
_CHANGE_LENGTH: Final = 10.0  # [m] over which `USUAL_CHANGE` counts
MAX_CHANGE: Final = USUAL_CHANGE / _CHANGE_LENGTH
"""Largest change of the curvature along a road, in 1/m per m."""
_CHANGE_ROUNDING: Final = 1e-9  # share by which a computed change may exceed it


@dataclass(frozen=True)
class Quantity:
    """A measured number, or why it cannot be measured."""

    name: str
    """Name, such as ``rise_time``."""
    of: str
    """Signal that is measured, such as ``curvature``."""
    unit: str
    value: float | None
    """Value in the unit; None if it cannot be measured."""
    reason: str = ""
    """Reason without a value, in words; empty with a value."""

    @property
    def text(self) -> str:
        """Value with three significant digits and at most four decimals, or why there is none."""
        return self.reason if self.value is None else f"{round(self.value, 4) + 0.0:.3g}"


class QuantityName(NamedTuple):
    """Name, signal and unit of a quantity that a manoeuvre measures."""

    name: str
    of: str
    unit: str

    def measured(self, value: float) -> Quantity:
        """Return the quantity with a value in the unit."""
        return Quantity(self.name, self.of, self.unit, float(value))

    def missing(self, reason: str) -> Quantity:
        """Return the quantity without a value, for a reason in words."""
        return Quantity(self.name, self.of, self.unit, None, reason)

    def measured_if(self, value: float | None, reason: str) -> Quantity:
        """Return the quantity with a value, or with the reason why the value is None."""
        return self.missing(reason) if value is None else self.measured(value)


CURVATURE: Final = "curvature"
"""Signal: curvature that the car drives."""
OFFSET: Final = "lateral offset"
"""Signal: distance of the car's centre to the left of the lane's centre."""
CAR: Final = "car"
"""Signal: motion of the car."""
FRONT_WHEELS: Final = "front wheels"
"""Signal: angle of the front wheels."""

MEAN_SPEED: Final = QuantityName("speed", CAR, "km/h")
LARGEST_OFFSET: Final = QuantityName("largest_offset", OFFSET, "m")
STEADY_OFFSET: Final = QuantityName("steady_offset", OFFSET, "m")


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a graph."""

    name: str
    """Name, such as ``asked`` or ``reached``."""
    x: FloatArray
    """Positions, (n,)."""
    y: FloatArray
    """Values, (n,)."""


@dataclass(frozen=True)
class Graph:
    """Lines over a common axis, for a picture."""

    x_title: str
    y_title: str
    lines: tuple[Line, ...]
    is_logarithmic: bool = False
    """Whether the horizontal axis is logarithmic."""


@dataclass(frozen=True)
class Measures:
    """What was measured on the drive of a manoeuvre."""

    quantities: tuple[Quantity, ...]
    graphs: tuple[Graph, ...]
    tables: Mapping[str, list[dict[str, float]]] = field(default_factory=dict)
    """Name -> rows of a table, such as gain and phase over the frequency."""

    @classmethod
    def missing(cls, names: Iterable[QuantityName], reason: str) -> Self:
        """Return measures without a value, for a reason in words."""
        return cls(tuple(name.missing(reason) for name in names), ())


@dataclass(frozen=True)
class ManoeuvreDrive:
    """A drive of a manoeuvre, with the signals that manoeuvres measure."""

    located: LocatedDrive
    """The drive with the position of each record on its road."""
    speed: float
    """Speed limit on the road, in m/s: the speed that is asked."""
    wheelbase: float | None
    """Distance between the car's axles, in m; None if the simulator does not say."""

    @property
    def time(self) -> FloatArray:
        """Time of each record, (n,) in s."""
        return self.located.path.time

    @property
    def distance(self) -> FloatArray:
        """Distance along the road of each record, (n,) in m."""
        return self.located.distance

    @property
    def offset(self) -> FloatArray:
        """Distance of the car's centre to the left of the lane's centre, (n,) in m."""
        return self.located.lateral_offset

    @cached_property
    def asked_curvature(self) -> FloatArray:
        """Curvature of the lane's centre line beside each record, (n,) in 1/m."""
        road = self.located.road
        curvature = road.curvature_at(np.clip(self.distance, 0.0, road.length))
        # The lane's centre runs half a lane to the right of the road's centre line.
        return np.asarray(curvature / (1.0 + 0.5 * road.lane_width * curvature))

    @cached_property
    def driven_curvature(self) -> FloatArray:
        """Curvature that the car drives, its yaw rate divided by its speed, (n,) in 1/m.

        A car that is slower than a walker counts as one as fast as a walker.
        """
        path = self.located.path
        return np.asarray(path.yaw_rate / np.maximum(path.speed, _WALKING_PACE))

    def time_at(self, place: float) -> float | None:
        """Return when the car passed a place of the road, in s; None if it never did.

        Args:
            place: distance along the road, in m.
        """
        after = np.flatnonzero(self.distance >= place)
        if not len(after):
            return None
        i = int(after[0])
        if i == 0:
            return float(self.time[0])
        records = slice(i - 1, i + 1)
        return float(np.interp(place, self.distance[records], self.time[records]))

    def between(self, first: float, last: float) -> slice:
        """Return the records from one time to another, in s."""
        begin, end = np.searchsorted(self.time, [first, last]).tolist()
        return slice(begin, end)

    @property
    def end_text(self) -> str:
        """Reason why a place behind the drive's end is not measured, in words."""
        return f"not measured: the drive ended at {float(self.distance[-1]):.0f} m"

    def mean_speed(self, first: float, last: float) -> Quantity:
        """Return the mean speed from one time to another, in s, as a quantity."""
        return MEAN_SPEED.measured(3.6 * self.located.path.speed[self.between(first, last)].mean())

    def largest_offset(self, first: float, last: float) -> Quantity:
        """Return the offset furthest from the lane's centre between two times, as a quantity."""
        offset = self.offset[self.between(first, last)]
        return LARGEST_OFFSET.measured(offset[np.abs(offset).argmax()])

    def steady_offset(self, last: float) -> Quantity:
        """Return the mean offset in the last seconds before a time, if the offset is steady then.

        Args:
            last: the time, in s.
        """
        offset = self.offset[self.between(last - STEADY_TIME, last)]
        unrest = float(np.ptp(offset))
        if unrest > _OFFSET_UNREST:
            return STEADY_OFFSET.missing(unsettled_text(unrest, "m"))
        return STEADY_OFFSET.measured(offset.mean())


class Manoeuvre(Protocol):
    """A standard manoeuvre: a road, the conditions of its drive, and measures of the drive."""

    name: ClassVar[str]
    """Name on the command line."""
    QUANTITIES: ClassVar[tuple[QuantityName, ...]]
    """Quantities that the manoeuvre measures, in their order."""

    def conditions(self, speed: float) -> Mapping[str, float]:
        """Return the conditions of the drive beside those that its user sets, such as ``start``.

        Args:
            speed: speed limit on the road, in m/s.
        """

    def road(self, speed: float, lane_width: float) -> Road:
        """Return the manoeuvre's road.

        Args:
            speed: speed limit on the road, in m/s.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: no road may bend so.
        """

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return what was measured on a drive of the manoeuvre's road."""


@dataclass(frozen=True, eq=False)
class ManoeuvreResult:
    """A driven manoeuvre: the road, the drive, the verdict, and what was measured."""

    manoeuvre: Manoeuvre
    road: Road
    drive: Drive
    result: Result
    measures: Measures

    def __getitem__(self, name: str) -> float:
        """Return the value of a quantity.

        Raises:
            KeyError: there is no such quantity, or it has no value; the message says why.
        """
        quantity = self.quantity(name)
        if quantity.value is None:
            raise KeyError(f"{name}: {quantity.reason}")
        return quantity.value

    def quantity(self, name: str) -> Quantity:
        """Return a quantity by its name.

        Raises:
            KeyError: there is no such quantity; the message lists the names.
        """
        quantities = {quantity.name: quantity for quantity in self.measures.quantities}
        if name not in quantities:
            raise KeyError(f"no quantity {name!r}: there are {', '.join(quantities)}")
        return quantities[name]

    def as_json(self) -> dict[str, Any]:
        """Return manoeuvre, quantities and tables, for JSON."""
        return {
            "manoeuvre": self.manoeuvre.name,
            "options": dict(vars(self.manoeuvre)),
            "quantities": [asdict(quantity) for quantity in self.measures.quantities],
            **self.measures.tables,
        }


def unsettled_text(unrest: float, unit: str) -> str:
    """Return why a response has no final value, in words.

    Args:
        unrest: largest minus least value at the response's end, in the unit.
        unit: unit of the response.
    """
    return f"never settles: it still moves by {unrest:.2g} {unit} in the last {STEADY_TIME:g} s"


def run_up(speed: float) -> float:
    """Return the length of straight on which a car reaches a speed, in m/s, and becomes steady."""
    return 0.5 * speed * speed / _RUN_UP_ACCELERATION + _RUN_UP_TIME * speed


def require_drivable(curvature: float, change: float) -> None:
    """Refuse curvatures that no road of ours has.

    Args:
        curvature: largest curvature of the road, in 1/m.
        change: largest change of the curvature along the road, in 1/m per m.

    Raises:
        RoadError: a bend is too sharp, or the curvature changes too fast.
    """
    if abs(curvature) * MIN_RADIUS > 1.0:
        raise RoadError(
            f"a radius of {1.0 / abs(curvature):.3g} m: the bends of a road have at least"
            f" {MIN_RADIUS:.3g} m"
        )
    if abs(change) > (1.0 + _CHANGE_ROUNDING) * MAX_CHANGE:
        raise RoadError(
            f"the curvature changes by {abs(change) * _CHANGE_LENGTH:.3g} 1/m over"
            f" {_CHANGE_LENGTH:g} m: at most {USUAL_CHANGE:g} 1/m is allowed"
        )
