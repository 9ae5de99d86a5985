"""The road: curvature samples and a pose, from which its geometry follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.from_points import curvature_from_points
from frenetic.road.placing import MAP_MARGIN, fit_to_map
from frenetic.road.road_values import (
    MAX_COORDINATE,
    MAX_GRADE,
    MAX_LENGTH,
    MAX_SAMPLES,
    MAX_SPEED_LIMIT,
    MAX_SUPERELEVATION,
    MAX_WIDENING,
    MIN_DISTANCE,
    MIN_SPEED_LIMIT,
    MIN_STEP,
    START,
    USUAL_CHANGE,
    Pose,
    checked_curvatures,
    checked_lane_width,
    checked_length,
    checked_pose,
)
from frenetic.road.validity import (
    LANE_WIDTH,
    MAP_SIZE,
    RoadRules,
    Verdict,
    as_points,
    check_layout,
    check_validity,
)

if TYPE_CHECKING:
    import numpy.typing as npt


BEHAVIOUR = 1
"""Version of roads: increase it when a road gets another shape, place or validity."""

POINT_SPACING = 2.0
"""Largest distance between a road's points for validity, files and simulators, in m; our choice."""
_CHANGE_LENGTH = 10.0  # [m] over which a change of curvature counts
_CHANGE_ROUNDING = 1e-9  # [1/m] by which a change may exceed the usual one
_STEPS_ROUNDING = 1e-9
"""Number of pieces by which a computed number may exceed a whole number; our choice."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Road:
    """A centre line of curvature samples, with one lane on each side.

    The curvature is linear between samples, so every piece is a clothoid. The car drives on the
    right-hand lane, the ego lane, from the first sample to the last. Distances are measured on the
    map, even where the road rises.

    Profiles, see `frenetic.road.profile`, may make the road lean to a side, rise above the map and
    widen, and give it speed limits. A lane widens at its outer edge. The centre line of a lane,
    from which lateral offsets count, stays half of `lane_width` from the road's centre line.

    Raises:
        RoadError: there are fewer than 2 or more than 10000 samples, a curvature is no finite
            number or more than 10 1/m, the step is not positive, the road is longer than 50 km, a
            lane is not 0.1 to 100 m wide, the pose is beyond 10000 km, or a profile is no list of
            pairs or out of range.
    """

    curvatures: FloatArray
    """Curvature samples, (N,) in 1/m, positive turns left; read-only."""
    step: float = 10.0
    """Distance between two samples, in m."""
    pose: Pose = START
    """Pose of the first sample."""
    lane_width: float = LANE_WIDTH
    """Width of each of the two lanes without widening, in m."""
    superelevation: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Slope across the road: a profile, (k, 2) in m and m/m, positive falls to the right, as in
    OpenDRIVE."""
    grade: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Slope along the road: a profile, (k, 2) in m and m/m, positive rises."""
    widening: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Width of each lane beyond `lane_width`: a profile, (k, 2) in m and m."""
    speed_limits: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Speed limits, (k, 2) in m and km/h; each holds from its station on, and 0 means no limit.
    `frenetic.Rules.speed_limits_on` returns the limits of a drive."""

    def __init__(
        self,
        curvatures: npt.ArrayLike,
        step: float = 10.0,
        pose: tuple[float, float, float] = START,
        *,
        lane_width: float = LANE_WIDTH,
        superelevation: npt.ArrayLike = (),
        grade: npt.ArrayLike = (),
        widening: npt.ArrayLike = (),
        speed_limits: npt.ArrayLike = (),
    ) -> None:
        object.__setattr__(self, "curvatures", checked_curvatures(curvatures))
        object.__setattr__(self, "step", checked_length(step, "step", MIN_STEP, MAX_LENGTH))
        object.__setattr__(self, "lane_width", checked_lane_width(lane_width))
        if self.length > MAX_LENGTH:
            raise RoadError(
                f"a road of {self.length:.0f} m: at most {MAX_LENGTH:.0f} m can be represented"
            )
        object.__setattr__(self, "pose", checked_pose(pose))
        for name, pairs, most in (
            ("superelevation", superelevation, MAX_SUPERELEVATION),
            ("grade", grade, MAX_GRADE),
            ("widening", widening, MAX_WIDENING),
            (profile.LIMITS, speed_limits, MAX_SPEED_LIMIT),
        ):
            object.__setattr__(self, name, profile.checked(pairs, name, most))
        if len(self.widening) or len(self.speed_limits):
            self._check_low_values()

    def _check_low_values(self) -> None:
        """Raise a `RoadError` if a widening is negative, or a speed limit too low."""
        for name, unit in (("widening", "m"), (profile.LIMITS, "km/h")):
            if (least := getattr(self, name)[:, 1].min(initial=0.0)) < 0.0:
                raise RoadError(f"{name} is {least:g} {unit}: at least 0 is needed")
        limits = self.speed_limits[:, 1]
        if (low := limits[(limits > 0.0) & (limits < MIN_SPEED_LIMIT)]).size:
            raise RoadError(
                f"{profile.LIMITS} is {low[0]:g} km/h: at least {MIN_SPEED_LIMIT:g} is needed, or 0"
                " for none"
            )

    @classmethod
    def from_points(cls, points: npt.ArrayLike, *, lane_width: float = LANE_WIDTH) -> Road:
        """Return the road through points of its centre line at any distances.

        If the points sample a `Road` at equal distances, that road is recovered. Other points are
        joined, as in the competition, by a parametric spline (cubic from four points on). Samples
        about every half metre make the road stay within millimetres of the spline, unless the
        spline has a cusp, which no road can follow. A road of more than 5 km has 10000 samples; at
        50 km, with a sample every 5 m, it stays within centimetres.

        Args:
            points: the points, (N, 2) in m, at least 2; consecutive points differ.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: the points are not (N, 2) finite numbers, there are fewer than 2, two
                consecutive points are less than a micrometre apart, or a point is beyond 10000 km.
        """
        array = as_points(points)
        if not 2 <= len(array) <= MAX_SAMPLES:
            raise RoadError(f"a road of {len(array)} points: 2 to {MAX_SAMPLES} are allowed")
        too_far = np.flatnonzero(np.abs(array).max(axis=1) > MAX_COORDINATE)
        if len(too_far):
            x, y = array[too_far[0]]
            raise RoadError(
                f"point {too_far[0]} is ({x:g}, {y:g}): at most {MAX_COORDINATE:g} m from the"
                " origin are allowed"
            )
        lengths = np.hypot(*np.diff(array, axis=0).T)
        repeated = np.flatnonzero(lengths < MIN_DISTANCE)
        if len(repeated):
            i = int(repeated[0])
            raise RoadError(f"points {i} and {i + 1} are the same: consecutive points must differ")
        if lengths.sum() > MAX_LENGTH:
            raise RoadError(
                f"a road of {lengths.sum():.0f} m: at most {MAX_LENGTH:.0f} m can be represented"
            )
        curvatures, step, pose = curvature_from_points(array, MAX_SAMPLES)
        return cls(curvatures, step, Pose(*pose), lane_width=lane_width)

    @property
    def length(self) -> float:
        """Length of the centre line, in m."""
        return (len(self.curvatures) - 1) * self.step

    @cached_property
    def stations(self) -> FloatArray:
        """Distances of the curvature samples along the road, (N,) in m."""
        stations = np.arange(len(self.curvatures), dtype=np.float64) * self.step
        stations.setflags(write=False)
        return stations

    @cached_property
    def sub_step(self) -> float:
        """Distance between two rows of `table`, in m."""
        return self.step / geometry.sub_steps(self.curvatures, self.step)

    @cached_property
    def table(self) -> FloatArray:
        """The centre line cut into sub-steps, for the kernels of `frenetic.road.geometry`.

        An array (M, 6), or (M, 7) if the road widens; that module lists its columns.
        """
        table: FloatArray = geometry.build_table(
            self.curvatures, self.step, *self.pose, self._rows_per_step
        )
        if len(self.widening):
            stations = np.arange(len(table)) * self.sub_step
            table = np.column_stack([table, profile.value_at(self.widening, stations)])
        table.setflags(write=False)
        return table

    @property
    def _rows_per_step(self) -> int:
        """Number of rows of `table` from a sample to the next."""
        return round(self.step / self.sub_step)

    @property
    def is_flat(self) -> bool:
        """Whether the road neither leans nor rises anywhere."""
        return not len(self.superelevation) and not len(self.grade)

    @property
    def is_plain(self) -> bool:
        """Whether the road is flat and its lanes have the same width everywhere."""
        return self.is_flat and not len(self.widening)

    @cached_property
    def slopes(self) -> FloatArray:
        """Superelevation and grade at the rows of `table`, (M, 2) in m/m; (0, 2) if it is flat."""
        if self.is_flat:
            return profile.NOTHING
        stations = np.arange(len(self.table)) * self.sub_step
        slopes = np.column_stack(
            [profile.value_at(pairs, stations) for pairs in (self.superelevation, self.grade)]
        )
        slopes.setflags(write=False)
        return slopes

    def heights(self, distances: npt.ArrayLike) -> FloatArray:
        """Return heights above the centre line's start in m, at ``distances`` (any shape) in m."""
        return profile.integral_at(self.grade, distances)

    def piece(self, first: int, last: int | None = None) -> Road:
        """Return the piece of the road between two samples, where it lies on the map.

        Args:
            first: index of the piece's first sample.
            last: index of the piece's last sample; None for the road's last.

        Raises:
            RoadError: the piece has fewer than 2 samples.
        """
        last = len(self.curvatures) - 1 if last is None else last
        start, end = first * self.step, last * self.step
        x, y = self.points[first].tolist()
        return Road(
            self.curvatures[first : last + 1],
            self.step,
            self.pose if first == 0 else Pose(x, y, float(self.headings[first])),
            lane_width=self.lane_width,
            **{
                name: profile.piece_of(name, getattr(self, name), start, end)
                for name in profile.NAMES
            },
        )

    @property
    def headings(self) -> FloatArray:
        """Heading at the curvature samples, (N,) in rad, without jumps by a full turn."""
        return self.table[:: self._rows_per_step, geometry.HEADING]

    @property
    def points(self) -> FloatArray:
        """Positions of the curvature samples, (N, 2) in m."""
        return self.table[:: self._rows_per_step, : geometry.HEADING]

    @cached_property
    def road_points(self) -> FloatArray:
        """Points of the centre line for validity, files and simulators, (n, 2) in m.

        They are up to `POINT_SPACING` apart.
        """
        points = self.sample(POINT_SPACING)
        points.setflags(write=False)
        return points

    def distances(self, spacing: float = POINT_SPACING) -> FloatArray:
        """Return distances from the road's start to its end, (n,) in m, in equal steps.

        Args:
            spacing: largest step, in m.
        """
        spacing = checked_length(spacing, "spacing", MIN_STEP, math.inf)
        pieces = max(1, math.ceil(self.length / spacing - _STEPS_ROUNDING))
        # The same as numpy.linspace, which takes several times as long.
        distances = np.arange(pieces + 1, dtype=np.float64) * (self.length / pieces)
        distances[-1] = self.length
        return distances

    def sample(self, spacing: float = POINT_SPACING, offset: float = 0.0) -> FloatArray:
        """Return points of a line beside the centre line, at `distances`, (n, 2) in m.

        Args:
            spacing: largest distance between two points along the centre line, in m.
            offset: distance of the line to the left of the centre line, in m.
        """
        points: FloatArray = geometry.sample_line(
            self.table, self.sub_step, self.distances(spacing), float(offset)
        )
        return points

    def pose_at(self, distance: float) -> Pose:
        """Return the pose of the centre line at a distance in m along it.

        Beyond its ends the line is straight.
        """
        table, ds, s = self.table, self.sub_step, float(distance)
        x, y, *_ = geometry.frame_at(table, ds, s)
        return Pose(x, y, geometry.heading_at(table, ds, s))

    def curvature_at(self, distances: npt.ArrayLike) -> FloatArray:
        """Return curvatures in 1/m at ``distances`` (any shape) in m; 0 beyond the road's ends."""
        places = np.asarray(distances, dtype=np.float64)
        values: FloatArray = np.interp(places, self.stations, self.curvatures, left=0.0, right=0.0)
        return values

    def track(self, path: npt.ArrayLike) -> FloatArray:
        """Return distance along the road and lateral offset, (n, 2) in m, of a path's positions.

        The first position is projected onto the whole road, and each further position near the
        projection before. So a path stays on its piece of road where another piece is close.

        Args:
            path: positions of the path, (n, 2) in m.
        """
        xy = np.ascontiguousarray(path, dtype=np.float64).reshape(-1, 2)
        result: FloatArray = geometry.track(self.table, self.sub_step, xy)
        return result

    def fitted(self, map_size: float = MAP_SIZE, map_margin: float = MAP_MARGIN) -> Road | None:
        """Return this road moved and, if needed, rotated into the map [0, map_size]^2.

        Args:
            map_size: side of the map, in m.
            map_margin: least distance of the centre line from the map's edge, in m.

        Returns:
            The moved road; the road itself if it lies inside already; None if no pose fits.
        """
        motion = fit_to_map(self.road_points, map_size, map_margin)
        if motion is None:
            return None
        if motion.rotation == motion.dx == motion.dy == 0.0:
            return self
        pose = Pose(*motion.moved(*self.pose[:2]), self.pose.heading + motion.rotation)
        return self._moved_to(pose)

    def _moved_to(self, pose: Pose) -> Road:
        """Return this road with its first sample at another pose.

        Raises:
            RoadError: the pose is beyond 10000 km.
        """
        moved = object.__new__(Road)  # without a check of values that are checked already
        vars(moved).update({name: getattr(self, name) for name in _VALUES}, pose=checked_pose(pose))
        return moved

    def placed(
        self,
        map_size: float = MAP_SIZE,
        map_margin: float = MAP_MARGIN,
        road_class: RoadRules | None = None,
    ) -> tuple[Road | None, Verdict]:
        """Return this road fitted into the map, and the verdict on the fitted road.

        Args:
            map_size: side of the map, in m.
            map_margin: least distance of the centre line from the map's edge, in m.
            road_class: class whose rules replace the competition's rules; None for the
                competition's.

        Returns:
            The fitted road, valid or not, and its verdict; None with an invalid verdict if no pose
            fits.
        """
        fitted = self.fitted(map_size, map_margin)
        if fitted is None:
            return None, Verdict(
                False, f"The road does not fit the map of {map_size:g} m in any direction"
            )
        return fitted, fitted.check_validity(map_size, road_class)

    @property
    def largest_change(self) -> float:
        """Largest change of the curvature over 10 m of road, in 1/m.

        The curvature before the start counts as 0.
        """
        before = self.stations - _CHANGE_LENGTH
        earlier = np.where(before < 0.0, 0.0, self.curvature_at(np.maximum(before, 0.0)))
        return float(np.abs(self.curvatures - earlier).max())

    def as_text(self) -> str:
        """Return length, least radius, and largest grade, superelevation and widening in words.

        Also how fast the road bends, if that is faster than random roads of the paper do.
        """
        sharpest = float(np.abs(self.curvatures).max())
        radius = "straight" if sharpest < 1e-4 else f"sharpest radius {1.0 / sharpest:.0f} m"
        texts = [f"{self.length:.0f} m", radius]
        if (change := self.largest_change) > USUAL_CHANGE + _CHANGE_ROUNDING:
            texts.append(
                f"bends fast: by {change:.2f} 1/m in 10 m (usually at most {USUAL_CHANGE:g})"
            )
        superelevation, grade, widening = (
            profile.cut(getattr(self, name), 0.0, self.length)[:, 1] for name in profile.SHAPES
        )
        if len(grade):
            steepest = 100.0 * float(grade[np.abs(grade).argmax()])
            texts.append(f"grade up to {steepest:+.1f} %".replace("-", "−"))
        if len(superelevation):
            texts.append(f"superelevation up to {100.0 * np.abs(superelevation).max():.1f} %")
        if len(widening):
            texts.append(f"lanes up to {widening.max():.2f} m wider")
        return ", ".join(texts)

    def __repr__(self) -> str:
        """Return length, number of curvatures and largest curvature in short."""
        sharpest = float(np.abs(self.curvatures).max())
        return (
            f"<Road of {self.length:.0f} m: {len(self.curvatures)} curvatures, the sharpest"
            f" {sharpest:.3g} 1/m>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # Only the constructor's arguments are pickled; cached tables are computed again.
        profiles = {name: getattr(self, name) for name in profile.NAMES}
        construct = partial(Road, lane_width=self.lane_width, **profiles)
        return construct, (self.curvatures, self.step, tuple(self.pose))

    def check_validity(
        self, map_size: float = MAP_SIZE, road_class: RoadRules | None = None
    ) -> Verdict:
        """Return the verdict on this road where it lies, by the competition's rules or a class's.

        Args:
            map_size: side of the map, in m.
            road_class: class whose rules replace the competition's rules; the road still has to lie
                in the map and must not meet itself. None for the competition's.
        """
        if road_class is None:
            return check_validity(self.road_points, map_size)
        verdict = road_class.verdict(self)
        return verdict and check_layout(self.road_points, map_size)


_VALUES = tuple(item.name for item in fields(Road))


def placed_road(
    curvatures: npt.ArrayLike, step: float, lane_width: float, map_size: float, map_margin: float
) -> tuple[Road | None, Verdict]:
    """Return the `Road.placed` of a road without profiles and class; the last roads are cached.

    A search places a road to check it, and its campaign to drive it.

    Args:
        curvatures, step, lane_width: see `Road`.
        map_size, map_margin: see `Road.placed`.

    Raises:
        RoadError: the curvatures make no road.
    """
    values = np.asarray(curvatures, dtype=np.float64)
    return _placed_road(values.tobytes(), values.shape, step, lane_width, map_size, map_margin)


@lru_cache(maxsize=64)  # roads: more than a campaign has in flight (our choice)
def _placed_road(
    curvatures: bytes,
    shape: tuple[int, ...],
    step: float,
    lane_width: float,
    map_size: float,
    map_margin: float,
) -> tuple[Road | None, Verdict]:
    road = Road(np.frombuffer(curvatures).reshape(shape), step, lane_width=lane_width)
    return road.placed(map_size, map_margin)
