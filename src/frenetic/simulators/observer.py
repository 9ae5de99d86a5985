"""Observation of a car along a road: the end of its drive, and its driver's view.

Every simulator uses this, so drivers see the same and drives end alike everywhere: the compiled
rollout calls the kernels, a simulator in Python an `Observer`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.driver import AHEAD_POINTS, AHEAD_SPACING, Observation
from frenetic.oracle.assessment import RUNNING, assess_record, rules_array
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import Road
from frenetic.road.geometry import heading_at, project_near, reach_of

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image


@njit()
def wrap(angle: float) -> float:
    """Return the angle less whole turns, in -pi..pi."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit()
def look_ahead(
    table: FloatArray,
    ds: float,
    lane_width: float,
    x: float,
    y: float,
    heading: float,
    s: float,
    rows: int,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
) -> None:
    """Write the ego lane ahead of a car at ``s`` into ``ahead`` and ``curvature_ahead``.

    Between a table's rows the centre line is the arc of the nearest row, exact to a millimetre.
    """
    last = len(table) - 1
    length = last * ds
    offset = -0.5 * lane_width
    c, n = math.cos(heading), math.sin(heading)
    for i in range(rows):
        at = s + i * AHEAD_SPACING
        on_road = 0.0 <= at <= length
        if at < 0.0:
            j, kappa = 0, 0.0
        elif at > length:
            j, kappa = last, 0.0
        else:
            j = int(at / ds + 0.5)
            k = min(int(at / ds), last - 1)
            t = at / ds - k
            kappa = table[k, 3] + t * (table[k + 1, 3] - table[k, 3])
        u = at - j * ds
        bend = table[j, 3] if on_road else 0.0
        cosine, sine = table[j, 4], table[j, 5]
        across = 0.5 * bend * u * u
        turned = bend * u
        px = table[j, 0] + u * cosine - across * sine - offset * (sine + turned * cosine)
        py = table[j, 1] + u * sine + across * cosine + offset * (cosine - turned * sine)
        px -= x
        py -= y
        ahead[i, 0] = c * px + n * py
        ahead[i, 1] = c * py - n * px
        # A parallel of an arc is an arc about the same centre.
        curvature_ahead[i] = kappa / max(1.0 - offset * kappa, 0.05)


@njit()
def observe(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    records: FloatArray,
    i: int,
    heading: float,
    s: float,
    least: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
) -> tuple[int, float, float, float, float]:
    """Return end, s, offset from the ego lane's centre, heading error and oob share at ``i``.

    Args:
        table, ds, lane_width, rules, car, heading, s, least: see
        `frenetic.oracle.assessment.assess_record`.
        records: (3, n) times, xs and ys of the records, or more rows.
        i: Number of the record.
        ahead, curvature_ahead: Room, which is filled with points of the lane ahead.
    """
    end, s, d, road_heading, share = assess_record(
        table, ds, lane_width, rules, car, records[0], records[1], records[2], heading, i, s, least
    )
    x, y, rows = records[1, i], records[2, i], len(ahead)
    look_ahead(table, ds, lane_width, x, y, heading, s, rows, ahead, curvature_ahead)
    return end, s, d + 0.5 * lane_width, wrap(heading - road_heading), share


@njit()
def limit_at(limits: FloatArray, s: float) -> float:
    """Return the limit ``s`` m along the road, in the unit of ``limits``."""
    k = 0
    while k < len(limits) - 1 and limits[k + 1, 0] <= s:
        k += 1
    limit: float = limits[k, 1]
    return limit


@njit()
def look_for_limits(limits: FloatArray, s: float, rows: int, limit_ahead: FloatArray) -> None:
    """Write the lowest limit from each point ahead of ``s`` m to the next into ``limit_ahead``.

    Args:
        limits: (k, 2), k >= 1; each holds from its station in m on.
        s: m along the road.
        rows: Number of points ahead.
        limit_ahead: (rows,), in the unit of ``limits``.
    """
    last = len(limits) - 1
    k = 0
    for i in range(rows):
        start = s + i * AHEAD_SPACING
        while k < last and limits[k + 1, 0] <= start:
            k += 1
        limit_ahead[i] = limits[k, 1]
        j = k + 1
        while j <= last and limits[j, 0] < start + AHEAD_SPACING:
            limit_ahead[i] = min(limit_ahead[i], limits[j, 1])
            j += 1


def in_metres_per_second(limits: FloatArray) -> FloatArray:
    """Return speed limits, given as (k, 2) in m and km/h, in m and m/s."""
    return np.column_stack([limits[:, 0], limits[:, 1] / 3.6])


class LimitsAhead:
    """The speed limits that a car meets along a road.

    Args:
        road: The road under the car.
        rules: Rules of the drive, which keep, scale or ignore the road's limits.
    """

    def __init__(self, road: Road, rules: Rules) -> None:
        self._limits = in_metres_per_second(rules.speed_limits_on(road))
        self.is_constant = len(self._limits) == 1
        """Whether one limit holds everywhere."""
        self._look(0.0)

    def at(self, s: float) -> tuple[float, FloatArray]:
        """Return the limit ``s`` m along the road and the limits at the points ahead, in m/s."""
        if not self.is_constant:
            self._look(s)
        return self._limit, self._ahead

    def speed_at(self, s: float, deceleration: float) -> float:
        """Return the highest speed from which a car can brake to every limit ahead, in m/s.

        Args:
            s: m along the road.
            deceleration: Deceleration of the car, in m/s^2.
        """
        limit, ahead = self.at(s)
        if self.is_constant:
            return limit
        distances = AHEAD_SPACING * np.arange(AHEAD_POINTS)
        return float(np.sqrt((ahead**2 + 2.0 * deceleration * distances).min()))

    def _look(self, s: float) -> None:
        self._limit = limit_at(self._limits, s)
        self._ahead = np.empty(AHEAD_POINTS)
        look_for_limits(self._limits, s, AHEAD_POINTS, self._ahead)
        self._ahead.setflags(write=False)


class Observer:
    """An observer of one drive of a car that a simulator moves.

    Call `see` for every record, in order; while it says that the drive goes on, `observation` gives
    the driver's view, also at a place between two records after `glance`.

    Args:
        road: The road under the car.
        rules: Rules by which the drive ends.
        car: The box that the car covers.
        records: Largest number of records.
    """

    def __init__(self, road: Road, rules: Rules, car: CarBody, records: int) -> None:
        self._road = road
        self._line = road.table, road.sub_step, road.lane_width
        self._rules = rules_array(rules, road.length)
        self._car = car.to_array()
        self._tolerance = rules.oob_tolerance
        self._places = np.empty((3, records))
        self._count = 0
        self._s = 0.0  # at the last record
        self._now = (0.0,) * 7  # time, x, y, heading, s, lateral offset, heading error
        self._ahead = self._curvature_ahead = np.empty(0)
        self._limits = LimitsAhead(road, rules)

    def see(self, time: float, x: float, y: float, heading: float) -> bool:
        """Take in a record (s, m, m, rad); return whether the drive goes on."""
        self._ahead, self._curvature_ahead = np.empty((AHEAD_POINTS, 2)), np.empty(AHEAD_POINTS)
        places, i = self._places, self._count
        places[0, i], places[1, i], places[2, i] = time, x, y
        end, self._s, offset, heading_error, _ = observe(
            *self._line,
            self._rules,
            self._car,
            places,
            i,
            heading,
            self._s,
            self._tolerance,
            self._ahead,
            self._curvature_ahead,
        )
        self._count += 1
        self._now = time, x, y, heading, self._s, offset, heading_error
        return bool(end == RUNNING)

    def glance(self, time: float, x: float, y: float, heading: float) -> None:
        """Take in a place between two records, which ends no drive."""
        table, ds, lane_width = self._line
        _, before_x, before_y = (float(value) for value in self._places[:, self._count - 1])
        reach = reach_of(math.hypot(x - before_x, y - before_y))
        s, d = project_near(table, ds, float(x), float(y), self._s, reach)
        error = wrap(heading - heading_at(table, ds, s))
        self._now = time, x, y, heading, s, d + 0.5 * lane_width, error
        self._ahead, self._curvature_ahead = np.empty((AHEAD_POINTS, 2)), np.empty(AHEAD_POINTS)
        views = self._ahead, self._curvature_ahead
        look_ahead(*self._line, float(x), float(y), float(heading), s, AHEAD_POINTS, *views)

    def observation(
        self,
        speed: float,
        yaw_rate: float,
        steering: float,
        image: Image | None = None,
        *,
        lateral_speed: float = 0.0,
    ) -> Observation:
        """Return the driver's view at the last place (m/s, rad/s, rad), with its camera's picture.

        The arrays of the view become read-only.
        """
        time, x, y, heading, s, lateral_offset, heading_error = self._now
        self._ahead.setflags(write=False)
        self._curvature_ahead.setflags(write=False)
        speed_limit, speed_limit_ahead = self._limits.at(s)
        if image is not None:
            image.setflags(write=False)
        # Faster than the constructor, which sets each attribute of a frozen class by a call.
        observation = object.__new__(Observation)
        observation.__dict__.update(
            time=float(time),
            speed=float(speed),
            yaw_rate=float(yaw_rate),
            steering=float(steering),
            lateral_offset=lateral_offset,
            heading_error=heading_error,
            ahead=self._ahead,
            curvature_ahead=self._curvature_ahead,
            distance=s,
            image=image,
            x=float(x),
            y=float(y),
            heading=float(heading),
            lateral_speed=float(lateral_speed),
            view=math.inf,
            speed_limit=speed_limit,
            speed_limit_ahead=speed_limit_ahead,
            _road=self._road,
        )
        return observation
