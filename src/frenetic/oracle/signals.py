"""The signals that criteria limit: their values at each record, and the worst value of a drive.

A signal's value at a record is averaged over a window, the last seconds before the record; the mean
of a derivative over a window is the difference between the values at the window's ends, divided by
the window. A record whose window begins before the drive has no value (NaN).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, Literal, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic.criteria.criterion import (
    EDGE_DISTANCE,
    LATERAL_JERK,
    LATERAL_OFFSET,
    Criterion,
    signal_named,
)
from frenetic.errors import FreneticError
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.rates import TIME_ROUNDING, rate
from frenetic.road import Road
from frenetic.road.geometry import project_near, reach_of
from frenetic.road.profile import steps_at, value_at

_POINTS_PER_SIDE: Final = 9
"""Number of points on each side of the car whose distances from the lane's edges count; our
choice."""
_STANDSTILL_SPEED: Final = 0.1  # [m/s] a slower car stands still; our choice

_Series: TypeAlias = Callable[["LocatedDrive", float], FloatArray]
"""Function that returns a signal's values, (n,), in a drive, for a window in s."""


@dataclass(frozen=True, eq=False)
class LocatedDrive:
    """A drive with the position of each record on its road, up to the record that ended it."""

    road: Road
    path: Trajectory
    """Records of the drive, up to the record that ended it."""
    car: CarBody
    rules: Rules
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""

    @classmethod
    def of(cls, road: Road, drive: Drive, distance: FloatArray, offset: FloatArray) -> Self:
        """Return a drive with the positions of its first records.

        Times increase strictly: of several records with the same time, the first stays.

        Args:
            road: the road.
            drive: the drive; records without a position are left out.
            distance: distance along the road, (n,) in m.
            offset: distance left of the ego lane's centre line, (n,) in m.
        """
        n, path = len(distance), drive.trajectory
        if n < len(path) or not (path.time[1:] > path.time[:-1]).all():
            is_later = np.ones(n, dtype=bool)
            is_later[1:] = path.time[1:n] > path.time[: n - 1] if n else False
            path = Trajectory.from_rows(path.to_rows()[:n][is_later])
            distance, offset = distance[is_later], offset[is_later]
        return cls(road, path, drive.car, drive.rules, distance, offset)

    @cached_property
    def cached_series(self) -> dict[tuple[str, float], FloatArray]:
        """Cache of `series`: name and window -> values."""
        return {}

    @cached_property
    def edge_distances(self) -> FloatArray:
        """Distances of the car's outline from the left and right edge of its lane, (n, 2) in m."""
        path, road, car = self.path, self.road, self.car
        # Points on the right side of the car, then on its left side, in the car's frame.
        ahead = np.linspace(-0.5, 0.5, _POINTS_PER_SIDE) * car.length + car.centre_ahead
        ahead, left = np.tile(ahead, 2), np.repeat([-0.5, 0.5], _POINTS_PER_SIDE) * car.width
        cos, sin = np.cos(path.heading)[:, None], np.sin(path.heading)[:, None]
        x = path.x[:, None] + cos * ahead - sin * left
        y = path.y[:, None] + sin * ahead + cos * left
        reach = reach_of(float(np.hypot(ahead, left).max()))
        positions = _project_points(road.table, road.sub_step, x, y, self.distance, reach)
        distances, offsets = positions[:, :, 0], positions[:, :, 1]
        # The lane's left edge is the road's centre line.
        widening = value_at(road.widening, distances.ravel()).reshape(x.shape)
        to_right_edge = offsets + road.lane_width + widening
        return np.column_stack([-offsets.max(axis=1), to_right_edge.min(axis=1)])


@njit(interpret_first=0.2)
def _project_points(
    table: FloatArray, ds: float, x: FloatArray, y: FloatArray, distance: FloatArray, reach: float
) -> FloatArray:
    """Return distances along the road and lateral offsets, (n, m, 2), of points (n, m).

    The points of a row are projected near the row's ``distance`` (n,), up to ``reach`` m away.
    """
    n, m = x.shape
    positions = np.empty((n, m, 2))
    for i in range(n):
        for k in range(m):
            s, d = project_near(table, ds, x[i, k], y[i, k], distance[i], reach)
            positions[i, k, 0] = s
            positions[i, k, 1] = d
    return positions


# Filters


def mean(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Return the mean of values over the window that ends at each record, (n,).

    NaN where the window begins before the drive. Values are linear between records.
    """
    if window == 0.0:
        return values
    steps = np.diff(time) * 0.5 * (values[1:] + values[:-1])
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    start = time - window
    # The integral up to each window's start, which lies between two records.
    before = np.clip(np.searchsorted(time, start, side="right") - 1, 0, max(len(time) - 2, 0))
    at_start = np.interp(start, time, values)
    integral_at_start = integral[before] + 0.5 * (start - time[before]) * (
        values[before] + at_start
    )
    means: FloatArray = np.where(
        _is_window_whole(time, window), (integral - integral_at_start) / window, np.nan
    )
    return means


def spread(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Return the largest minus the least value in the window that ends at each record, (n,).

    A window that begins before the drive is cut.
    """
    return _spreads(np.searchsorted(time, time - window - TIME_ROUNDING), values)


@njit(interpret_first=0.2)
def _spreads(first: IntArray, values: FloatArray) -> FloatArray:
    """Return the largest minus the least value from the record ``first[i]`` to each record i, (n,).

    NaN where one of these values is NaN.
    """
    spreads = np.empty(len(values))
    for i in range(len(values)):
        least = largest = values[i]
        for k in range(first[i], i):
            value = values[k]
            if value < least or value != value:
                least = value
            if value > largest:
                largest = value
            if value != value:
                break
        spreads[i] = largest - least
    return spreads


def _is_window_whole(time: FloatArray, window: float) -> npt.NDArray[np.bool_]:
    """Return whether the window that ends at each record lies within the drive, (n,)."""
    is_whole: npt.NDArray[np.bool_] = time - window >= time[0] - TIME_ROUNDING
    return is_whole


# Signals


def _acceleration_along_car(located: LocatedDrive) -> FloatArray:
    """Return the acceleration of the centre of mass along the car, (n,) in m/s²."""
    path = located.path
    acceleration = rate(path.time, path.speed, 0.0) - path.lateral_speed * path.yaw_rate
    acceleration.setflags(write=False)  # as columns: `rate` is compiled for such arrays
    return acceleration


def _speed_excess(located: LocatedDrive, window: float) -> FloatArray:
    """Return the mean speed in the window above the mean speed limit in it, (n,) in km/h."""
    limits = located.rules.speed_limits_on(located.road)
    speed = mean(located.path.time, located.path.speed, window)
    if len(limits) == 1:
        return 3.6 * speed - float(limits[0, 1])
    limit = steps_at(limits, np.maximum(located.distance, 0.0))
    return 3.6 * speed - mean(located.path.time, limit, window)


def _standing(located: LocatedDrive, _: float) -> FloatArray:
    """Return the time since the car last moved, (n,) in s; 0 before it has moved."""
    time, moves = located.path.time, np.abs(located.path.speed) >= _STANDSTILL_SPEED
    last = np.maximum.accumulate(np.where(moves, time, -np.inf))
    return np.where(np.isfinite(last), time - last, 0.0)


_SERIES: Final[Mapping[str, _Series]] = MappingProxyType(
    {
        EDGE_DISTANCE: lambda located, _: located.edge_distances.min(axis=1),
        LATERAL_OFFSET: lambda located, window: mean(
            located.path.time, located.lateral_offset, window
        ),
        "lateral_acceleration": lambda located, window: mean(
            located.path.time, located.path.lateral_acceleration, window
        ),
        LATERAL_JERK: lambda located, window: rate(
            located.path.time, located.path.lateral_acceleration, window
        ),
        "yaw_rate": lambda located, window: np.degrees(
            mean(located.path.time, located.path.yaw_rate, window)
        ),
        "steering_rate": lambda located, window: np.degrees(
            rate(located.path.time, located.path.steering, window)
        ),
        "sway": lambda located, window: spread(located.path.time, located.lateral_offset, window),
        "acceleration": lambda located, window: mean(
            located.path.time, _acceleration_along_car(located), window
        ),
        "deceleration": lambda located, window: mean(
            located.path.time, -_acceleration_along_car(located), window
        ),
        "longitudinal_jerk": lambda located, window: np.abs(
            rate(located.path.time, _acceleration_along_car(located), window)
        ),
        "speed_excess": _speed_excess,
        "stop": _standing,
        "duration": lambda located, _: located.path.time,
    }
)
"""Name of a built-in signal -> function that computes its values, (n,), in the signal's unit."""


@dataclass(frozen=True)
class Measurement:
    """The worst value of a criterion's signal in a drive."""

    criterion: Criterion
    value: float
    """The value; the absolute value if the signal has sides."""
    record: int
    """Index of the record with this value, in `LocatedDrive.path`."""
    distance: float
    """Distance of that record along the road, in m."""
    side: Literal["left", "right"] | None
    """Side to which the value points, or of the lane's nearer edge; None if the signal has no
    sides."""

    @property
    def margin(self) -> float:
        """Distance from the limit in the signal's unit, negative beyond the limit."""
        return self.criterion.margin(self.value)

    @property
    def share(self) -> float:
        """Margin divided by the signal's scale, which can be compared between signals."""
        return self.margin / signal_named(self.criterion.signal).scale

    def text(self) -> str:
        """Return value and limit in words."""
        signal = signal_named(self.criterion.signal)
        return f"{signal.words} {signal.text(self.value)} ({self.criterion.text()})"


def series(name: str, located: LocatedDrive, window: float) -> FloatArray:
    """Return the value of a signal at each record, (n,), in the signal's unit; NaN without a value.

    Raises:
        FreneticError: the function of another package's signal raised an error, or did not
            return one number for each record.
    """
    if (installed_series := signal_named(name).series) is None:
        if (name, window) not in located.cached_series:
            located.cached_series[name, window] = _SERIES[name](located, window)
        return located.cached_series[name, window]
    try:
        values = np.asarray(installed_series(located, window), dtype=np.float64)
    except Exception as error:  # foreign code may raise anything
        raise FreneticError(f"the signal {name} raised {error!r}") from error
    if values.shape != located.distance.shape:
        raise FreneticError(f"the signal {name} gave {values.shape}: one value a record is needed")
    return values


def measure(criterion: Criterion, located: LocatedDrive) -> Measurement | None:
    """Return the worst value of a criterion's signal; None if no record has a value.

    No record has a value if the drive is shorter than the criterion's window.

    Raises:
        FreneticError: `series` cannot compute the values.
    """
    signal = signal_named(criterion.signal)
    values = series(signal.name, located, criterion.window)
    if not np.isfinite(values).any():
        return None
    amounts = np.abs(values) if signal.has_sides else values
    record = int(np.nanargmin(amounts) if signal.is_least else np.nanargmax(amounts))
    side: Literal["left", "right"] | None = None
    if signal.name == EDGE_DISTANCE:
        to_left_edge, to_right_edge = located.edge_distances[record]
        side = "left" if to_left_edge <= to_right_edge else "right"
    elif signal.has_sides:
        side = "left" if values[record] > 0.0 else "right"
    distance = float(located.distance[record])
    return Measurement(criterion, float(amounts[record]), record, distance, side)


def worst(name: str, located: LocatedDrive) -> Measurement | None:
    """Return the worst value of a signal in a drive, by the drive's criterion for the signal.

    Without such a criterion, the value is measured in the signal's default window against a limit
    of 0.

    Raises:
        FreneticError: `series` cannot compute the values.
    """
    criteria = {criterion.signal: criterion for criterion in located.rules.criteria.criteria}
    unlimited = Criterion(name, limit=0.0, window=signal_named(name).window)
    return measure(criteria.get(name, unlimited), located)
