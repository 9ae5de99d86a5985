"""The road: curvature samples, a pose, and everything that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.from_points import curvature_from_points
from frenetic.road.placing import MAP_MARGIN, fit_to_map
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
"""Version of roads: raised when a road gets another shape, place or validity."""
MAX_SAMPLES = 10_000
"""Most curvature samples of a road."""
MAX_LENGTH = 50_000.0
"""Length of the longest road, in m."""
MAX_CURVATURE = 10.0
"""Sharpest curve that can be represented, in 1/m; valid roads stay below 0.07."""
MAX_COORDINATE = 1e7
"""Largest coordinate of a point, in m."""
MIN_DISTANCE = 1e-6
"""Least distance of two consecutive points, in m."""
MIN_STEP = 1e-7
"""Shortest step, in m: hardly shorter than the step of points that are `MIN_DISTANCE` apart."""
MIN_LANE_WIDTH = 0.1
"""Width of the narrowest lane, in m."""
MAX_LANE_WIDTH = 100.0
"""Width of the widest lane, in m."""
MAX_HEADING = 1e6
"""Largest heading of a pose in either direction, in rad."""
MAX_SUPERELEVATION = 1.0
"""Steepest slope across a road in either direction; a race track's may be 0.6."""
MAX_GRADE = 0.5
"""Steepest slope along a road in either direction."""
MAX_WIDENING = 100.0
"""Largest widening of a lane, in m."""
MIN_SPEED_LIMIT = 1.0
"""Lowest speed limit, in km/h."""
MAX_SPEED_LIMIT = 500.0
"""Highest speed limit, in km/h."""
POINT_SPACING = 2.0
"""Spacing of a road's points for validity, files and other simulators, in m."""


class Pose(NamedTuple):
    """A place and a direction in the plane."""

    x: float
    """m."""
    y: float
    """m."""
    heading: float
    """Heading in rad, counter-clockwise from +x."""


START = Pose(0.0, 0.0, math.pi / 2)
"""Default start of a road."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Road:
    """A centre line of curvature samples, with one lane on each side.

    The curvature is linear between samples, so every piece is a clothoid. The car drives on the
    right-hand lane, the ego lane, from the first sample to the last. All distances are those on the
    map. By profiles, see `frenetic.road.profile`, the road may lean to a side, rise above the map
    and widen. Each lane then widens at its outer edge; the middle of a lane, from which lateral
    offsets count, stays half of `lane_width` from the centre line. It may have speed limits.

    Raises:
        RoadError: fewer than 2 or more than 10000 samples, values that are not finite numbers or
            are beyond 10 1/m, a step that is not positive, more than 50 km in all, a lane that is
            not 0.1 to 100 m wide, a pose beyond 10000 km, or a profile that is no list of pairs or
            out of range.
    """

    curvatures: FloatArray
    """Curvature samples, (N,) in 1/m, positive turns left; read-only."""
    step: float = 10.0
    """Distance between two samples, in m."""
    pose: Pose = START
    """Place and direction of the first sample."""
    lane_width: float = LANE_WIDTH
    """Width of each of the two lanes, in m."""
    superelevation: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Slope across the road, (k, 2) in m and m/m, positive falls to the right, as in OpenDRIVE."""
    grade: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Slope along the road, (k, 2) in m and m/m, positive rises."""
    widening: FloatArray = field(default_factory=lambda: profile.NOTHING)
    """Additional width of each lane beyond `lane_width`, (k, 2) in m and m."""
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
        object.__setattr__(self, "curvatures", _checked_curvatures(curvatures))
        object.__setattr__(self, "step", _metres(step, "step", MIN_STEP, MAX_LENGTH))
        object.__setattr__(self, "lane_width", checked_lane_width(lane_width))
        if self.length > MAX_LENGTH:
            raise RoadError(
                f"a road of {self.length:.0f} m: at most {MAX_LENGTH:.0f} m can be represented"
            )
        object.__setattr__(self, "pose", _checked_pose(pose))
        for name, pairs, most in (
            ("superelevation", superelevation, MAX_SUPERELEVATION),
            ("grade", grade, MAX_GRADE),
            ("widening", widening, MAX_WIDENING),
            (profile.LIMITS, speed_limits, MAX_SPEED_LIMIT),
        ):
            object.__setattr__(self, name, profile.checked(pairs, name, most))
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
        """Return the road through centre-line points of any spacing, as in the competition.

        Points that sample a road with piecewise linear curvature at equal distances give exactly
        that curvature back. Any others are joined, as the competition does it, by a parametric
        spline (cubic from four points on), and the spline's curvature is sampled about every half
        metre such that the resulting road stays within millimetres of it, unless the spline has a
        cusp, which no road can follow. A road of more than 5 km has 10000 samples; at 50 km, with a
        sample every 5 m, it stays within centimetres.

        Args:
            points: (N, 2) m, N >= 2, no two consecutive ones equal.
            lane_width: m, of each lane.

        Raises:
            RoadError: not (N, 2) finite numbers, fewer than 2, two consecutive ones less than a
                micrometre apart, or any beyond 10000 km.
        """
        array = as_points(points)
        if not 2 <= len(array) <= MAX_SAMPLES:
            raise RoadError(f"a road of {len(array)} points: 2 to {MAX_SAMPLES} are allowed")
        far = np.flatnonzero(np.abs(array).max(axis=1) > MAX_COORDINATE)
        if len(far):
            x, y = array[far[0]]
            raise RoadError(
                f"point {far[0]} is ({x:g}, {y:g}): at most {MAX_COORDINATE:g} m from the origin"
            )
        lengths = np.hypot(*np.diff(array, axis=0).T)
        same = np.flatnonzero(lengths < MIN_DISTANCE)
        if len(same):
            i = int(same[0])
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
    def sub_step(self) -> float:
        """Distance between two rows of `table`, in m."""
        return self.step / geometry.sub_steps(self.curvatures, self.step)

    @cached_property
    def table(self) -> FloatArray:
        """The centre line cut into sub-steps, for the kernels of `frenetic.road.geometry`."""
        table: FloatArray = geometry.build_table(
            self.curvatures, self.step, *self.pose, round(self.step / self.sub_step)
        )
        if len(self.widening):
            places = np.arange(len(table)) * self.sub_step
            table = np.column_stack([table, profile.value_at(self.widening, places)])
        table.setflags(write=False)
        return table

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
        """Superelevation and grade at the rows of `table`, (M, 2); (0, 2) of a flat road."""
        if self.is_flat:
            return profile.NOTHING
        places = np.arange(len(self.table)) * self.sub_step
        slopes = np.column_stack(
            [profile.value_at(pairs, places) for pairs in (self.superelevation, self.grade)]
        )
        slopes.setflags(write=False)
        return slopes

    def heights(self, distances: npt.ArrayLike) -> FloatArray:
        """Return heights above the centre line's start in m, at ``distances`` (any shape) in m."""
        return profile.integral_at(self.grade, distances)

    def piece(self, first: int, last: int | None = None) -> Road:
        """Return the piece of the road between two samples, in its place.

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
        """Heading at the curvature samples, (N,) in rad, not wrapped."""
        return self.table[:: round(self.step / self.sub_step), geometry.HEADING]

    @property
    def points(self) -> FloatArray:
        """Positions of the curvature samples, (N, 2) in m."""
        return self.table[:: round(self.step / self.sub_step), : geometry.HEADING]

    @cached_property
    def road_points(self) -> FloatArray:
        """Centre line for validity, files and simulators, (n, 2) in m, every 2 m or denser."""
        points = self.sample(POINT_SPACING)
        points.setflags(write=False)
        return points

    def distances(self, spacing: float = POINT_SPACING) -> FloatArray:
        """Return distances along the road, (n,) in m: equal steps of ``spacing`` or a bit less."""
        spacing = _metres(spacing, "spacing", MIN_STEP, math.inf)
        pieces = max(1, math.ceil(self.length / spacing - 1e-9))
        # As numpy.linspace, which takes several times as long.
        places = np.arange(pieces + 1, dtype=np.float64) * (self.length / pieces)
        places[-1] = self.length
        return places

    def sample(self, spacing: float = POINT_SPACING, offset: float = 0.0) -> FloatArray:
        """Return points at `distances(spacing)`, (n, 2) in m, ``offset`` m left of the centre."""
        points: FloatArray = geometry.sample_line(
            self.table, self.sub_step, self.distances(spacing), float(offset)
        )
        return points

    def pose_at(self, distance: float) -> Pose:
        """Return the centre line's pose at a distance in m; beyond its ends it is straight."""
        place = (self.table, self.sub_step, float(distance))
        x, y, *_ = geometry.frame_at(*place)
        return Pose(x, y, geometry.heading_at(*place))

    def curvature_at(self, distances: npt.ArrayLike) -> FloatArray:
        """Return curvatures in 1/m at ``distances`` (any shape) in m; 0 beyond the road's ends."""
        places = np.arange(len(self.curvatures)) * self.step
        values: FloatArray = np.interp(
            np.asarray(distances, dtype=np.float64), places, self.curvatures, left=0.0, right=0.0
        )
        return values

    def track(self, path: npt.ArrayLike) -> FloatArray:
        """Return distance along and lateral offset, (n, 2) in m, of positions (n, 2) of a path.

        The first position is projected onto the whole road, and each other one near the position
        before. So a path stays on its piece of road where another piece passes close by.
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
            The road in its new place; the road itself if it lies inside already; None if no pose
            fits.
        """
        motion = fit_to_map(self.road_points, map_size, map_margin)
        if motion is None:
            return None
        if motion.rotation == motion.dx == motion.dy == 0.0:
            return self
        pose = Pose(*motion.moved(*self.pose[:2]), self.pose.heading + motion.rotation)
        return replace(self, pose=pose)

    def placed(
        self,
        map_size: float = MAP_SIZE,
        map_margin: float = MAP_MARGIN,
        road_class: RoadRules | None = None,
    ) -> tuple[Road | None, Verdict]:
        """Return this road fitted into the map, and the verdict on it there.

        Args:
            map_size: side of the map, in m.
            map_margin: least distance of the centre line from the map's edge, in m.
            road_class: class whose rules replace the competition's.

        Returns:
            (None, invalid) if no pose fits; otherwise the road there, valid or not.
        """
        has_profiles = any(len(getattr(self, name)) for name in profile.NAMES)
        if road_class is None and self.pose == START and not has_profiles:
            shape = self.curvatures.tobytes(), self.step, self.lane_width
            return _placed_again(*shape, map_size, map_margin)
        return _placed(self, map_size, map_margin, road_class)

    def as_text(self) -> str:
        """Return length, least radius, and largest grade, superelevation and widening in words."""
        sharpest = float(np.abs(self.curvatures).max())
        radius = "straight" if sharpest < 1e-4 else f"sharpest radius {1.0 / sharpest:.0f} m"
        words = [f"{self.length:.0f} m", radius]
        ends = [profile.cut(getattr(self, name), 0.0, self.length) for name in profile.SHAPES]
        lean, grade, wider = (pairs[:, 1] for pairs in ends)
        if len(grade):
            steepest = 100.0 * float(grade[np.abs(grade).argmax()])
            words.append(f"grade up to {steepest:+.1f} %".replace("-", "−"))
        if len(lean):
            words.append(f"superelevation up to {100.0 * np.abs(lean).max():.1f} %")
        if len(wider):
            words.append(f"lanes up to {wider.max():.2f} m wider")
        return ", ".join(words)

    def __repr__(self) -> str:
        """The road at a glance."""
        sharpest = float(np.abs(self.curvatures).max())
        return (
            f"<Road of {self.length:.0f} m: {len(self.curvatures)} curvatures, the sharpest"
            f" {sharpest:.3g} 1/m>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # The constructor's arguments alone: cached tables are computed anew.
        profiles = {name: getattr(self, name) for name in profile.NAMES}
        construct = partial(Road, lane_width=self.lane_width, **profiles)
        return construct, (self.curvatures, self.step, tuple(self.pose))

    def check_validity(
        self, map_size: float = MAP_SIZE, road_class: RoadRules | None = None
    ) -> Verdict:
        """Return the verdict on this road in its place, by the competition or a road class."""
        if road_class is None:
            return check_validity(self.road_points, map_size)
        verdict = road_class.verdict(self)
        return verdict and check_layout(self.road_points, map_size)


def checked_lane_width(value: float) -> float:
    """Return the width of a lane, in m.

    Raises:
        RoadError: the width is no number from 0.1 to 100 m.
    """
    return _metres(value, "lane_width", MIN_LANE_WIDTH, MAX_LANE_WIDTH)


def _checked_curvatures(curvatures: npt.ArrayLike) -> FloatArray:
    """Return curvatures as a read-only (N,) array.

    Raises:
        RoadError: they are no flat list of numbers, too few or too many, or one is too large.
    """
    try:
        values = np.array(curvatures, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RoadError("curvatures are not a list of numbers") from None
    if values.ndim != 1:
        raise RoadError(f"curvatures have shape {values.shape}: a flat list (N,) is needed")
    if not 2 <= len(values) <= MAX_SAMPLES:
        raise RoadError(
            f"a road of {len(values)} curvature samples: 2 to {MAX_SAMPLES} are allowed"
        )
    bad = np.flatnonzero(~(np.abs(values) <= MAX_CURVATURE))
    if len(bad):
        raise RoadError(
            f"curvature {bad[0]} is {values[bad[0]]:g} 1/m: every curvature must be a finite"
            f" number, at most {MAX_CURVATURE:g} in either direction"
        )
    values.setflags(write=False)
    return values


def _checked_pose(pose: tuple[float, float, float]) -> Pose:
    """Return a pose of three floats.

    Raises:
        RoadError: the pose is not x, y and heading, or a number is too large.
    """
    try:
        x, y, heading = map(float, pose)
    except (TypeError, ValueError, OverflowError):
        raise RoadError(f"pose {pose!r:.40}: x, y and heading are needed") from None
    if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE and abs(heading) <= MAX_HEADING):
        raise RoadError(
            f"pose ({x:g}, {y:g}, {heading:g}): x and y of at most {MAX_COORDINATE:g} m and a"
            f" heading of at most {MAX_HEADING:g} rad in either direction are needed"
        )
    return Pose(x, y, heading)


def _metres(value: float, name: str, least: float, most: float) -> float:
    """Return a length in m as a float.

    Raises:
        RoadError: the value is no number from ``least`` to ``most``.
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number, text = math.nan, f"{value!r:.40}"
    else:
        text = f"{number:g}"
    if not least <= number <= most:
        raise RoadError(f"{name} is {text}: {least:g} to {most:g} m are allowed")
    return number


def _placed(
    road: Road, map_size: float, map_margin: float, road_class: RoadRules | None
) -> tuple[Road | None, Verdict]:
    fitted = road.fitted(map_size, map_margin)
    if fitted is None:
        return None, Verdict(
            False, f"The road does not fit the map of {map_size:g} m in any direction"
        )
    return fitted, fitted.check_validity(map_size, road_class)


@lru_cache(maxsize=64)
def _placed_again(
    curvatures: bytes, step: float, lane_width: float, map_size: float, map_margin: float
) -> tuple[Road | None, Verdict]:
    """Return `_placed` of a flat road at `START`; cached, as a search and its campaign both ask."""
    road = Road(np.frombuffer(curvatures), step, lane_width=lane_width)
    return _placed(road, map_size, map_margin, None)
