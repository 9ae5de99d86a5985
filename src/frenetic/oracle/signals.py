"""The quantities that criteria limit, record by record, and how a drive keeps a profile.

A derivative is ``np.gradient``'s, and the mean of one over a window is the difference between its
ends, divided by the window. A value whose window begins before the drive does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, Literal, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.criteria.criterion import EDGE_DISTANCE, Criterion, quantity
from frenetic.errors import FreneticError
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.road import Road
from frenetic.road.geometry import project_near, reach_of
from frenetic.road.profile import steps_at, value_at

_POINTS: Final = 9
"""Points of each side of the car whose distances from the lane's edges are taken."""
_STANDS: Final = 0.1  # m/s

_Series: TypeAlias = Callable[["Seen", float], FloatArray]


@dataclass(frozen=True, eq=False)
class Seen:
    """A drive seen from its road, up to the record that ended it."""

    road: Road
    path: Trajectory
    """Its records up to that one."""
    car: CarBody
    rules: Rules
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""

    @classmethod
    def of(cls, road: Road, drive: Drive, distance: FloatArray, offset: FloatArray) -> Self:
        """A drive whose first records are at these places; no two of its times are the same."""
        n, path = len(distance), drive.trajectory
        kept = np.diff(path.time[:n], prepend=-np.inf) > 0.0
        if n < len(path) or not kept.all():
            path = Trajectory.from_rows(path.to_rows()[:n][kept])
        return cls(road, path, drive.car, drive.rules, distance[kept], offset[kept])

    @cached_property
    def known(self) -> dict[tuple[str, float], FloatArray]:
        """What `series` has measured: name and window -> values."""
        return {}

    @cached_property
    def edge_distances(self) -> FloatArray:
        """Distances of the car's outline from the left and right edge of its lane, (n, 2) in m."""
        path, road, car = self.path, self.road, self.car
        ahead = np.linspace(-0.5, 0.5, _POINTS) * car.length + car.centre_ahead
        ahead, left = np.tile(ahead, 2), np.repeat([-0.5, 0.5], _POINTS) * car.width
        cos, sin = np.cos(path.heading)[:, None], np.sin(path.heading)[:, None]
        x = path.x[:, None] + cos * ahead - sin * left
        y = path.y[:, None] + sin * ahead + cos * left
        reach = reach_of(float(np.hypot(ahead, left).max()))
        places = _places(road.table, road.sub_step, x, y, self.distance, reach)
        wider = value_at(road.widening, places[:, :, 0].ravel()).reshape(x.shape)
        right = places[:, :, 1] + road.lane_width + wider
        return np.column_stack([-places[:, :, 1].max(axis=1), right.min(axis=1)])


@njit()
def _places(
    table: FloatArray, ds: float, x: FloatArray, y: FloatArray, along: FloatArray, reach: float
) -> FloatArray:
    """(n, m, 2) distance along the road and lateral offset of (n, m) points near (n,) places."""
    n, m = x.shape
    found = np.empty((n, m, 2))
    for i in range(n):
        for k in range(m):
            s, d = project_near(table, ds, x[i, k], y[i, k], along[i], reach)
            found[i, k, 0] = s
            found[i, k, 1] = d
    return found


# Filters


def mean(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Moving average over the window up to each record, (n,); NaN where it begins too early."""
    if window == 0.0:
        return values
    steps = np.diff(time) * 0.5 * (values[1:] + values[:-1])
    whole = np.concatenate([[0.0], np.cumsum(steps)])
    start = time - window
    first = np.clip(np.searchsorted(time, start, side="right") - 1, 0, max(len(time) - 2, 0))
    at = np.interp(start, time, values)
    before = whole[first] + 0.5 * (start - time[first]) * (values[first] + at)
    found: FloatArray = np.where(_is_whole(time, window), (whole - before) / window, np.nan)
    return found


def rate(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Change of values in their unit per s, (n,), in the mean of the window up to each record."""
    if len(time) < 2:
        return np.full(len(time), np.nan)
    if window == 0.0:
        found: FloatArray = np.gradient(values, time)
        return found
    change = (values - np.interp(time - window, time, values)) / window
    mean_change: FloatArray = np.where(_is_whole(time, window), change, np.nan)
    return mean_change


def spread(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Largest less least value within the window up to each record, (n,)."""
    first = np.searchsorted(time, time - window - 1e-9)
    return np.array([np.ptp(values[k : i + 1]) for i, k in enumerate(first)], dtype=np.float64)


def _is_whole(time: FloatArray, window: float) -> npt.NDArray[np.bool_]:
    whole: npt.NDArray[np.bool_] = time - window >= time[0] - 1e-9
    return whole


# Quantities


def _speeding_up(seen: Seen) -> FloatArray:
    """Acceleration of the centre of mass along the car, (n,) in m/s²."""
    path = seen.path
    return rate(path.time, path.speed, 0.0) - path.lateral_speed * path.yaw_rate


def _speed_excess(seen: Seen, window: float) -> FloatArray:
    """Speed above the limit, (n,) in km/h."""
    limits = seen.rules.speed_limits_on(seen.road)
    speed = mean(seen.path.time, seen.path.speed, window)
    if len(limits) == 1:
        return 3.6 * speed - float(limits[0, 1])
    limit = steps_at(limits, np.maximum(seen.distance, 0.0))
    return 3.6 * speed - mean(seen.path.time, limit, window)


def _standing(seen: Seen, _: float) -> FloatArray:
    time, moves = seen.path.time, np.abs(seen.path.speed) >= _STANDS
    last = np.maximum.accumulate(np.where(moves, time, -np.inf))
    return np.where(np.isfinite(last), time - last, 0.0)


_SERIES: Final[Mapping[str, _Series]] = MappingProxyType(
    {
        EDGE_DISTANCE: lambda seen, _: seen.edge_distances.min(axis=1),
        "lateral_acceleration": lambda seen, window: mean(
            seen.path.time, seen.path.lateral_acceleration, window
        ),
        "lateral_jerk": lambda seen, window: rate(
            seen.path.time, seen.path.lateral_acceleration, window
        ),
        "yaw_rate": lambda seen, window: np.degrees(
            mean(seen.path.time, seen.path.yaw_rate, window)
        ),
        "steering_rate": lambda seen, window: np.degrees(
            rate(seen.path.time, seen.path.steering, window)
        ),
        "sway": lambda seen, window: spread(seen.path.time, seen.lateral_offset, window),
        "acceleration": lambda seen, window: mean(seen.path.time, _speeding_up(seen), window),
        "deceleration": lambda seen, window: mean(seen.path.time, -_speeding_up(seen), window),
        "longitudinal_jerk": lambda seen, window: np.abs(
            rate(seen.path.time, _speeding_up(seen), window)
        ),
        "speed_excess": _speed_excess,
        "stop": _standing,
        "duration": lambda seen, _: seen.path.time,
    }
)
"""Name of a quantity -> its values record by record, (n,), in its unit."""


@dataclass(frozen=True)
class Measured:
    """The worst value of a quantity in a drive."""

    criterion: Criterion
    value: float
    record: int
    """Where it is."""
    distance: float
    """Where it is along the road, in m."""
    side: Literal["left", "right"] | None
    """Side to which it is, or of the lane's nearer edge; None if the quantity has no sides."""

    @property
    def margin(self) -> float:
        """Distance from the limit in the quantity's unit, negative beyond it."""
        return self.criterion.margin(self.value)

    @property
    def share(self) -> float:
        """The margin in the quantity's scale, to be compared with that of others."""
        return self.margin / quantity(self.criterion.quantity).scale

    def told(self) -> str:
        """Value and limit in words."""
        what, criterion = quantity(self.criterion.quantity), self.criterion
        return f"{what.words} {what.told(self.value)} ({criterion.told()})"


def series(name: str, seen: Seen, window: float) -> FloatArray:
    """Values of a quantity, (n,), in its unit; NaN where there is none.

    Raises:
        FreneticError: a quantity of another package gives something else.
    """
    if (own := quantity(name).series) is None:
        if (name, window) not in seen.known:
            seen.known[name, window] = _SERIES[name](seen, window)
        return seen.known[name, window]
    try:
        values = np.asarray(own(seen, window), dtype=np.float64)
    except Exception as error:  # foreign code may raise anything
        raise FreneticError(f"the quantity {name} raised {error!r}") from error
    if values.shape != seen.distance.shape:
        raise FreneticError(
            f"the quantity {name} gave {values.shape}: one value a record is needed"
        )
    return values


def measure(criterion: Criterion, seen: Seen) -> Measured | None:
    """The worst value of a criterion's quantity; None in a drive that is shorter than its window.

    Raises:
        FreneticError: see `series`.
    """
    what = quantity(criterion.quantity)
    values = series(what.name, seen, criterion.window)
    if not np.isfinite(values).any():
        return None
    amounts = np.abs(values) if what.has_sides else values
    record = int(np.nanargmin(amounts) if what.is_least else np.nanargmax(amounts))
    is_left = bool(values[record] > 0.0)
    if what.name == EDGE_DISTANCE:
        is_left = int(np.argmin(seen.edge_distances[record])) == 0
    side: Literal["left", "right"] | None = None
    if what.has_sides or what.name == EDGE_DISTANCE:
        side = "left" if is_left else "right"
    place = float(seen.distance[record])
    return Measured(criterion, float(amounts[record]), record, place, side)


def worst(name: str, seen: Seen) -> Measured | None:
    """The worst value of a quantity, by the drive's criterion for it or else in its usual window.

    Raises:
        FreneticError: see `series`.
    """
    chosen = {one.quantity: one for one in seen.rules.criteria.criteria}
    return measure(chosen.get(name) or Criterion(name, 0.0, quantity(name).window), seen)
