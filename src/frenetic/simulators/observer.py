"""Observe a car along a road: when its drive ends, and what its driver sees.

Every simulator uses this module, so drivers see the same and drives end alike in all of them: the
compiled rollout calls the kernels, a simulator in Python calls an `Observer`.

``s`` is a distance along the road in m, ``d`` the distance to the left of its centre line in m, and
``ds`` the distance between two rows of the road's table in m (`frenetic.road.geometry`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, hypotenuse, sine, wrapped
from frenetic.drivers.driver import AHEAD_POINTS, AHEAD_SPACING, Observation, new_observation
from frenetic.oracle.assessment import (
    RECORD_HEADING,
    RECORD_TIME,
    RECORD_X,
    RECORD_Y,
    RUNNING,
    assess_record,
    rules_array,
)
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import Road
from frenetic.road.geometry import (
    COS,
    CURVATURE,
    SIN,
    X,
    Y,
    heading_at,
    project_near,
    reach_of,
)

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image

_LANES_PER_BLOCK: Final = 64
"""Number of observations whose arrays are rows of one array (our choice): making an array takes
longer than making a row of it."""


@njit(error_model="numpy", force_inline=True, interpret_first=0.2)
def look_ahead(
    table: FloatArray,
    ds: float,
    lane_width: float,
    pose: tuple[float, float, float],
    s: float,
    first: int,
    stop: int,
    ahead: FloatArray,
) -> None:
    """Write points of the ego lane's centre ahead of a car into an array.

    Between two rows of the table the centre line is taken for the arc of the nearest row, which is
    exact to a millimetre.

    Args:
        table, ds: The road, see `frenetic.road.geometry`.
        lane_width: Width of the ego lane, in m.
        pose: x, y and heading of the car, in m, m and rad.
        s: Distance of the car along the road, in m.
        first, stop: Points to write: from number ``first`` up to, but without, ``stop``. Number 0
            is at the car, and the points are `AHEAD_SPACING` apart on the centre line.
        ahead: (n, 2) points in m, ahead and to the left of the car.
    """
    last = len(table) - 1
    length = last * ds
    offset = -0.5 * lane_width
    x, y, heading = pose
    c, n = cosine(heading), sine(heading)
    for i in range(first, stop):
        at = s + i * AHEAD_SPACING
        if at < 0.0:
            j, bend = 0, 0.0
        elif at > length:
            j, bend = last, 0.0
        else:
            j = int(at / ds + 0.5)
            bend = table[j, CURVATURE]
        u = at - j * ds
        along_x, along_y = table[j, COS], table[j, SIN]
        across = 0.5 * bend * u * u
        turned = bend * u
        px = table[j, X] + u * along_x - across * along_y - offset * (along_y + turned * along_x)
        py = table[j, Y] + u * along_y + across * along_x + offset * (along_x - turned * along_y)
        px -= x
        py -= y
        ahead[i, 0] = c * px + n * py
        ahead[i, 1] = c * py - n * px


@njit(error_model="numpy", force_inline=True, interpret_first=0.2)
def write_curvatures_ahead(
    table: FloatArray,
    ds: float,
    lane_width: float,
    s: float,
    rows: int,
    curvature_ahead: FloatArray,
) -> None:
    """Write the curvature of the ego lane at the points ahead into an array.

    Args:
        table, ds, lane_width, s: See `look_ahead`.
        rows: Number of points.
        curvature_ahead: (n,) in 1/m.
    """
    last = len(table) - 1
    offset = -0.5 * lane_width
    start, spacing = s / ds, AHEAD_SPACING / ds  # in rows of the table
    # The points before number `stop` are on the road, unless the car is before the road's start.
    stop = min(max(int((last - start) / spacing) + 1, 0), rows)
    for i in range(stop):
        at = start + i * spacing
        k = min(max(int(at), 0), last - 1)
        kappa = table[k, CURVATURE]
        curvature_ahead[i] = kappa + (at - k) * (table[k + 1, CURVATURE] - kappa)
    for i in range(rows):
        is_on_road = i < stop and start + i * spacing >= 0.0
        kappa = curvature_ahead[i] if is_on_road else 0.0
        # A parallel of an arc is an arc about the same centre.
        curvature_ahead[i] = kappa / max(1.0 - offset * kappa, 0.05)


@njit(interpret_first=4.0)
def observe(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    records: FloatArray,
    i: int,
    s: float,
    least: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
) -> tuple[int, float, float, float, float]:
    """Return how the drive stands at record ``i``, and write the lane ahead into two arrays.

    Args:
        table, ds, lane_width, rules, car, records, i, s, least: see
            `frenetic.oracle.assessment.assess_record`.
        ahead: (n, 2), see `look_ahead`.
        curvature_ahead: (n,), see `write_curvatures_ahead`.

    Returns:
        RUNNING or how the drive ended, distance along the road in m, offset to the left of the
        road's centre line in m, heading error in rad, and oob share 0..1.
    """
    end, s, d, road_heading, share = assess_record(
        table, ds, lane_width, rules, car, records, i, s, least
    )
    heading, rows = records[i, RECORD_HEADING], len(ahead)
    pose = records[i, RECORD_X], records[i, RECORD_Y], heading
    look_ahead(table, ds, lane_width, pose, s, 0, rows, ahead)
    write_curvatures_ahead(table, ds, lane_width, s, rows, curvature_ahead)
    return end, s, d, wrapped(heading - road_heading), share


@njit(interpret_first=0.1)
def limit_at(limits: FloatArray, s: float) -> float:
    """Return the limit at ``s`` m along the road, see `write_limits_ahead` for ``limits``."""
    k = 0
    while k < len(limits) - 1 and limits[k + 1, 0] <= s:
        k += 1
    limit: float = limits[k, 1]
    return limit


@njit(error_model="numpy", force_inline=True, interpret_first=0.2)
def write_limits_ahead(limits: FloatArray, s: float, rows: int, limit_ahead: FloatArray) -> None:
    """Write the lowest limit between each point ahead and the next one into ``limit_ahead``.

    Args:
        limits: (k, 2), k >= 1: station in m, and the limit that holds from there on.
        s: Distance of the first point along the road, in m.
        rows: Number of points, `AHEAD_SPACING` apart.
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
    """Convert speed limits from km/h to m/s: (k, 2), each with its station in m."""
    return np.column_stack([limits[:, 0], limits[:, 1] / 3.6])


class LimitsAhead:
    """The speed limits at a car and ahead of it.

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
        """Return the limit at ``s`` m along the road and the limits at the points ahead, in m/s.

        The points are as far ahead as in a driver's view: (AHEAD_POINTS,).
        """
        if not self.is_constant:
            self._look(s)
        return self._limit, self._ahead

    def speed_at(self, s: float, deceleration: float) -> float:
        """Return the highest speed from which a car can brake to every limit ahead, in m/s.

        Args:
            s: Distance of the car along the road, in m.
            deceleration: Deceleration with which the car brakes, in m/s^2.
        """
        limit, ahead = self.at(s)
        if self.is_constant:
            return limit
        distances = AHEAD_SPACING * np.arange(AHEAD_POINTS)
        return float(np.sqrt((ahead**2 + 2.0 * deceleration * distances).min()))

    def _look(self, s: float) -> None:
        """Set the limits of a car at ``s`` m along the road."""
        self._limit = limit_at(self._limits, s)
        self._ahead = np.empty(AHEAD_POINTS)
        write_limits_ahead(self._limits, s, AHEAD_POINTS, self._ahead)
        self._ahead.setflags(write=False)


def glance(
    line: tuple[FloatArray, float, float],
    pose: tuple[float, float, float],
    before: tuple[float, float, float],
    lane: tuple[FloatArray, FloatArray, int],
) -> tuple[float, float, float]:
    """Return a car's place between two records, and write the lane ahead.

    Args:
        line: Table, ``ds`` and width of a lane, see `frenetic.road.geometry`.
        pose: x, y and heading of the car, in m, m and rad.
        before: x, y and distance along the road at the last record, in m.
        lane: Arrays and the row in which the lane ahead is written, see `DriverViews.new_lane`.

    Returns:
        Distance along the road and offset to the left of the ego lane's centre in m, and heading
        error in rad.
    """
    table, ds, lane_width = line
    x, y, heading = pose
    before_x, before_y, before_s = before
    reach = reach_of(hypotenuse(x - before_x, y - before_y))
    s, d = project_near(table, ds, x, y, before_s, reach)
    error = wrapped(heading - heading_at(table, ds, s))
    ahead, curvature_ahead, row = lane
    look_ahead(*line, pose, s, 0, AHEAD_POINTS, ahead[row])
    write_curvatures_ahead(*line, s, AHEAD_POINTS, curvature_ahead[row])
    return s, d + 0.5 * lane_width, error


class DriverViews:
    """The observations of one drive, which have the road and, mostly, the speed limits in common.

    Args:
        road: The road under the car.
        rules: Rules of the drive.
    """

    def __init__(self, road: Road, rules: Rules) -> None:
        self._limits = LimitsAhead(road, rules)
        # All attributes of an observation: each gets a copy with its own values.
        no_lane = np.empty((0, 2)), np.empty(0)
        self._attributes = vars(Observation(*(0.0,) * 6, *no_lane, _road=road)).copy()
        self._set_limits(0.0)
        self._row = _LANES_PER_BLOCK

    def new_lane(self) -> tuple[FloatArray, FloatArray, int]:
        """Return arrays and the row in which the lane ahead is written for the next observation.

        The points ahead, (m, n, 2), and their curvatures, (m, n).
        """
        self._row += 1
        if self._row >= _LANES_PER_BLOCK:
            self._row = 0
            self._block = (
                np.empty((_LANES_PER_BLOCK, AHEAD_POINTS, 2)),
                np.empty((_LANES_PER_BLOCK, AHEAD_POINTS)),
            )
            self._ahead, self._curvatures = (lanes.view() for lanes in self._block)
            self._ahead.setflags(write=False)
            self._curvatures.setflags(write=False)
        return *self._block, self._row

    def _set_limits(self, s: float) -> None:
        """Set the speed limits of the next observation, ``s`` m along the road."""
        attributes = self._attributes
        attributes["speed_limit"], attributes["speed_limit_ahead"] = self._limits.at(s)

    def observation(
        self,
        motion: Sequence[float],
        place: tuple[float, float, float],
        image: Image | None,
    ) -> Observation:
        """Return an observation with the lane that was written last; its arrays are read-only.

        Args:
            motion: Time and motion of the car, the first columns of a `Trajectory`, as floats.
            place: Distance along the road and offset to the left of the ego lane's centre in m, and
                heading error in rad.
            image: Picture of the driver's camera; None without a camera.
        """
        if not self._limits.is_constant:
            self._set_limits(place[0])
        values = self._attributes.copy()
        (
            values["time"],
            values["x"],
            values["y"],
            values["heading"],
            values["speed"],
            values["lateral_speed"],
            values["yaw_rate"],
            values["steering"],
        ) = motion
        values["distance"], values["lateral_offset"], values["heading_error"] = place
        values["ahead"], values["curvature_ahead"] = (
            self._ahead[self._row],
            self._curvatures[self._row],
        )
        if image is not None:
            image.setflags(write=False)
            values["image"] = image
        return new_observation(values)


class Observer:
    """Observer of one drive of a car that a simulator in Python moves.

    Call `see` with the pose of every record, in order. While it returns True, the drive continues,
    and `observation` returns the driver's view from there. For a view between two records, call
    `glance` with the pose before `observation`.

    Args:
        road: The road under the car.
        rules: Rules by which the drive ends.
        car: The box that the car covers.
        records: Largest number of records.
    """

    def __init__(self, road: Road, rules: Rules, car: CarBody, records: int) -> None:
        self._line = road.table, road.sub_step, road.lane_width
        self._rules = rules_array(rules, road.length)
        self._car = car.to_array()
        self._tolerance = rules.oob_tolerance
        self._records = np.empty((records, 4))  # time, x, y and heading
        self._count = 0  # of the records so far
        self._s = 0.0  # at the last record
        self._views = DriverViews(road, rules)
        self._pose = (0.0,) * 4  # time, x, y and heading
        self._place = (0.0,) * 3  # see `DriverViews.observation`

    def see(self, time: float, x: float, y: float, heading: float) -> bool:
        """Take in a record (s, m, m, rad); return whether the drive continues."""
        ahead, curvature_ahead, row = self._views.new_lane()
        records, i = self._records, self._count
        # A value at a time: numpy is slow to make an array of a tuple.
        records[i, RECORD_TIME], records[i, RECORD_HEADING] = time, heading
        records[i, RECORD_X], records[i, RECORD_Y] = x, y
        end, self._s, d, heading_error, _ = observe(
            *self._line,
            self._rules,
            self._car,
            records,
            i,
            self._s,
            self._tolerance,
            ahead[row],
            curvature_ahead[row],
        )
        self._count += 1
        self._pose = time, x, y, heading
        self._place = self._s, d + 0.5 * self._line[2], heading_error
        return bool(end == RUNNING)

    def glance(self, time: float, x: float, y: float, heading: float) -> None:
        """Take in a pose (s, m, m, rad) between two records, which ends no drive."""
        before = self._records[self._count - 1]
        before_pose = float(before[RECORD_X]), float(before[RECORD_Y]), self._s
        pose = float(x), float(y), float(heading)
        self._pose = time, x, y, heading
        self._place = glance(self._line, pose, before_pose, self._views.new_lane())

    def observation(
        self,
        speed: float,
        yaw_rate: float,
        steering: float,
        image: Image | None = None,
        *,
        lateral_speed: float = 0.0,
    ) -> Observation:
        """Return the driver's view from the last pose; its arrays become read-only.

        Args:
            speed: Speed along the car, in m/s.
            yaw_rate: Yaw rate in rad/s, positive to the left.
            steering: Angle of the front wheels in rad, positive to the left.
            image: Picture of the driver's camera; None without a camera.
            lateral_speed: Speed across the car in m/s, positive to the left.
        """
        motion = *self._pose, speed, lateral_speed, yaw_rate, steering
        return self._views.observation([float(v) for v in motion], self._place, image)
