"""The record of one drive, which a simulator returns: trajectory, rules and the car's box."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import check
from frenetic._support.scalars import take_numpy_scalars
from frenetic.criteria.criterion import JUDGED_BY_LANE, CriteriaSet
from frenetic.errors import Trouble
from frenetic.oracle.notes import DriverNotes

if TYPE_CHECKING:
    from frenetic.oracle.drive_assessment import DriveAssessment
    from frenetic.road import Road


BODY_SIZE: Final = 3
"""Number of the values of `CarBody.to_array`."""


@dataclass(frozen=True)
class CarBody:
    """The rectangle that a car covers on the ground, relative to its centre of mass."""

    length: float = 4.508
    """Length from bumper to bumper, in m (BMW 320i, CommonRoad vehicle 2)."""
    width: float = 1.610
    """Width in m, without mirrors."""
    centre_ahead: float = 0.0
    """Distance of the rectangle's centre ahead of the centre of mass, in m."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        for name, value in (("length", self.length), ("width", self.width)):
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"the car's {name} is {value}: a positive number is needed")

    def to_array(self) -> FloatArray:
        """Return length, width and centre_ahead, (3,) in m, for the kernels."""
        return np.array([self.length, self.width, self.centre_ahead])


class HasLimits(Protocol):
    """An object with speed limits along a length: a `Road` or a `Candidate`."""

    @property
    def speed_limits(self) -> FloatArray | None:
        """Speed limits, (k, 2) in m and km/h, see `Road.speed_limits`; None without limits."""

    @property
    def length(self) -> float:
        """Length in m."""


@dataclass(frozen=True)
class Rules:
    """Rules for the end of a drive and for failing it."""

    speed_limit: float = 70.0
    """Speed limit where the road has no limit, in km/h; see `road_limits`."""
    oob_tolerance: float = 0.95
    """Largest share of the car's box that may be outside the ego lane, above 0 and at most 1; a
    larger share is a FAIL."""
    goal_distance: float = 8.0
    """Distance from the road's last point at which the car has reached the end, in m."""
    stuck_distance: float = 1.0
    """Distance that a car has to move within `stuck_time`, in m."""
    stuck_time: float = 10.0
    """Time within which a car has to move `stuck_distance`, in s."""
    timeout_base: float = 20.0
    """Time granted to every drive, in s, whatever its length."""
    timeout_speed: float = 2.5
    """Mean speed that a drive has to reach beyond `timeout_base`, in m/s; see `timeout`."""
    criteria: CriteriaSet = JUDGED_BY_LANE
    """Criteria beside staying in the lane; a breach is a FAIL and does not end the drive."""
    road_limits: Literal["kept", "scaled", "ignored"] = "kept"
    """Use of a road's own speed limits: ``kept`` as they are; ``scaled``, so that the highest is
    `speed_limit`; or ``ignored``, so that `speed_limit` holds everywhere."""
    scaled_from: float | None = None
    """Speed limit before scaling where the road has no limit, in km/h; None without scaling."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        check({"road_limits": self.road_limits}, Rules)
        for item in fields(self):
            value = getattr(self, item.name)
            is_number = item.name not in ("criteria", "road_limits")
            if not is_number or value is None:
                continue
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{item.name} is {value}: a positive number is needed")
        if self.oob_tolerance > 1.0:
            raise ValueError(
                f"oob_tolerance is {self.oob_tolerance}: a share above 0 and up to 1 is needed"
            )

    def as_json(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        return asdict(self) | {"criteria": self.criteria.as_json()}

    def speed_limits_on(self, road: HasLimits) -> FloatArray:
        """Return the speed limits along a road, (k, 2) in m and km/h, k >= 1.

        Each limit holds from its station on, the first from 0 m. Stations beyond the road's end are
        left out.
        """
        limits = road.speed_limits
        if self.road_limits == "ignored" or limits is None or not len(limits):
            return np.array([[0.0, self.speed_limit]])
        from frenetic.road.profile import LIMITS, merged, piece_of  # numba takes its time

        stations, values = piece_of(LIMITS, limits, 0.0, road.length).T
        values = np.where(values > 0.0, values, self.scaled_from or self.speed_limit)
        if self.road_limits == "scaled":
            values = values * (self.speed_limit / values.max())
        return merged(np.column_stack([stations, values]))

    def start_limit_on(self, road: Road) -> float:
        """Return the speed limit at a road's start, in m/s."""
        return float(self.speed_limits_on(road)[0, 1]) / 3.6

    def with_speed(self, amount: float) -> Rules:
        """Return the rules with another speed limit.

        The speed limits of a road are scaled to it, unless these rules ignore them.

        Args:
            amount: the speed limit, in km/h.
        """
        if self.road_limits == "ignored":
            return replace(self, speed_limit=amount)
        base = self.scaled_from or self.speed_limit
        return replace(self, speed_limit=amount, road_limits="scaled", scaled_from=base)

    def limit_text(self, road: Road | None = None, class_name: str = "") -> str:
        """Return the speed limit of a road and its source in words.

        Example: ``30 to 70 km/h, of the road; where it has none, 70 km/h, assumed``.

        Args:
            road: the road; None for the roads of a search, which have no limits.
            class_name: name of the road class to which `speed_limit` belongs; empty for no class.
        """
        from frenetic.road.profile import LIMITS, piece_of  # numba takes its time

        general_limit = f"{self.speed_limit:.4g} km/h"
        if self.road_limits == "kept":
            general_limit += f", of {class_name}" if class_name else ", assumed"
        else:
            general_limit += ", as given"
        if road is None or self.road_limits == "ignored":
            return general_limit
        limits = piece_of(LIMITS, road.speed_limits, 0.0, road.length)[:, 1]
        if not limits.any():
            return general_limit
        if self.road_limits == "scaled":
            values = self.speed_limits_on(road)[:, 1]
            if np.ptp(values) == 0.0:
                return general_limit
            return f"{_range_text(values)}, the road's own, scaled"
        elsewhere = "" if limits.all() else f"; where it has none, {general_limit}"
        return f"{_range_text(limits[limits > 0.0])}, of the road{elsewhere}"

    def timeout(self, road_length: float) -> float:
        """Return the longest time that a drive may take, in s; a longer drive fails.

        Args:
            road_length: length of the road, in m.
        """
        return self.timeout_base + road_length / self.timeout_speed


def _range_text(limits: FloatArray) -> str:
    """Return speed limits in km/h in words, such as ``30 to 70 km/h``."""
    low, high = float(limits.min()), float(limits.max())
    return f"{low:.4g} to {high:.4g} km/h" if low < high else f"{low:.4g} km/h"


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """The records of a drive at a fixed rate: columns of equal length (n,), read-only float64.

    Coordinates and headings are on the map; speeds and yaw rates are in the plane of the road,
    which may lean.
    """

    time: FloatArray
    """Simulated time since the start, in s; the first record is the start."""
    x: FloatArray
    """Coordinate of the centre of mass, in m."""
    y: FloatArray
    """Coordinate of the centre of mass, in m."""
    heading: FloatArray
    """Heading in rad, counter-clockwise from +x, without jumps by a full turn."""
    speed: FloatArray
    """Speed along the car, in m/s."""
    lateral_speed: FloatArray
    """Speed across the car in m/s, positive to the left."""
    yaw_rate: FloatArray
    """Yaw rate in rad/s, positive to the left."""
    steering: FloatArray
    """Angle of the front wheels in rad, positive to the left."""
    steering_input: FloatArray
    """Angle that the driver asked for, in rad."""
    throttle: FloatArray
    """Position of the throttle pedal, 0 to 1, that the driver asked for."""
    brake: FloatArray
    """Position of the brake pedal, 0 to 1, that the driver asked for."""

    def __post_init__(self) -> None:
        n = len(self.time)
        for item in fields(self):
            column = np.array(getattr(self, item.name), dtype=np.float64)
            if column.shape != (n,):
                raise ValueError(
                    f"column {item.name} has shape {column.shape}, the time column ({n},)"
                )
            column.setflags(write=False)
            object.__setattr__(self, item.name, column)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        """Return the numbers of records and seconds."""
        return f"<Trajectory of {self.size_text()}>"

    def size_text(self) -> str:
        """Return the number of records and the time of the last record in words."""
        return f"{len(self)} records, {self.time[-1] if len(self) else 0.0:.1f} s"

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickling calls the constructor, so that the columns are read-only again.
        return Trajectory, tuple(getattr(self, name) for name in self.names())

    @cached_property
    def block(self) -> FloatArray:
        """The columns as rows of one array, (11, n) in the order of `names()`; read-only."""
        block = np.array([getattr(self, name) for name in self.names()])
        block.setflags(write=False)
        return block

    @cached_property
    def lateral_acceleration(self) -> FloatArray:
        """Acceleration of the centre of mass across the car, (n,) in m/s^2, positive to the left.

        The sum of yaw rate times speed and the change of the lateral speed.
        """
        from frenetic.oracle.rates import rate  # numba takes its time

        acceleration = self.yaw_rate * self.speed
        if len(self) > 1:
            acceleration += rate(self.time, self.lateral_speed, 0.0)
        acceleration.setflags(write=False)
        return acceleration

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the columns' names, in order."""
        return _COLUMNS

    @classmethod
    def from_rows(cls, rows: FloatArray) -> Trajectory:
        """Return a trajectory from an (n, 11) array with columns in the order of `names()`."""
        return cls.of_block(np.array(rows.T, dtype=np.float64, order="C"))

    @classmethod
    def of_block(cls, block: FloatArray) -> Trajectory:
        """Return a trajectory of an (11, n) array, whose rows become the columns without a copy.

        Nobody else may hold the array, which becomes read-only.
        """
        block.setflags(write=False)
        trajectory = object.__new__(cls)
        vars(trajectory).update(zip(_COLUMNS, block, strict=True), block=block)
        return trajectory

    @classmethod
    def empty(cls) -> Trajectory:
        """Return a trajectory without records."""
        return cls.from_rows(np.empty((0, len(cls.names()))))

    def to_rows(self) -> FloatArray:
        """Return the records as an (n, 11) array in the order of `names()`."""
        return self.block.T.copy()


_COLUMNS = tuple(item.name for item in fields(Trajectory))


@dataclass(frozen=True, eq=False, repr=False)
class Drive:
    """One execution of a road test."""

    trajectory: Trajectory
    car: CarBody = field(default_factory=CarBody)
    rules: Rules = field(default_factory=Rules)
    road: Road | None = None
    """Road of the drive, for pictures; None if the simulator does not say."""
    trouble: Trouble | None = None
    """Error of the driver or the simulator; None if the drive ended by the rules."""
    driver_seconds: float = field(default=0.0, compare=False)
    """Wall time in the driver's own code, in s; 0 if the simulator does not say."""

    assessed: DriveAssessment | None = field(default=None, compare=False)
    """Assessment by the simulator, which need not be made again; None if it made none."""
    notes: DriverNotes | None = field(default=None, compare=False)
    """What the driver was told, noted and planned; None if it was not kept."""

    def __post_init__(self) -> None:
        if not isinstance(self.trouble, Trouble | None):
            raise TypeError(
                f"the drive's trouble is {self.trouble!r}: a frenetic.errors.Trouble is needed"
            )

    def __repr__(self) -> str:
        """Return the road's length, the trajectory's size and the trouble in short."""
        road = "" if self.road is None else f" on {self.road.length:.0f} m of road"
        trouble = "" if self.trouble is None else f", trouble: {self.trouble.reason}"
        return f"<Drive{road}: {self.trajectory.size_text()}{trouble}>"
