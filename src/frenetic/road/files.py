"""Roads in files: JSON with curvatures or points, competition test files, and OpenDRIVE."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct, convert

from frenetic._support.arrays import FloatArray
from frenetic._support.files import open_file
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.classes import RoadClass
from frenetic.road.opendrive import RoadMap, Stretch
from frenetic.road.opendrive.following import SLOPE_ERROR, WIDTH_ERROR
from frenetic.road.opendrive.ids import quoted_id
from frenetic.road.road import Road
from frenetic.road.road_values import MAX_COORDINATE, MIN_DISTANCE, START
from frenetic.road.validity import LANE_WIDTH, MAP_SIZE, Verdict, check_validity

MAX_BYTES: Final = 8 * 2**20
"""Largest JSON file that is read, in bytes; our choice: a test file of the competition has about
1 MiB."""
MAX_MAP_BYTES: Final = 64 * 2**20
"""Largest OpenDRIVE file that is read, in bytes; our choice."""
MAP_SUFFIX: Final = ".xodr"
"""Suffix of OpenDRIVE files, in lower case."""
NO_OPENDRIVE: Final = " cannot be read as OpenDRIVE"
"""Problem for `path_in_errors`."""
_NODE_ENTRIES: Final[Mapping[int, tuple[str, ...]]] = {
    2: (),
    3: ("grade",),
    4: ("grade", "widening", "lane_width"),
}
"""Length of a road point -> entries of a road file that would repeat its height and width."""


class RoadPoint(Struct):
    """A road point of a file that is an object, not a list of numbers."""

    x: float
    """Coordinate in m."""
    y: float
    """Coordinate in m."""
    z: float | None = None
    """Height in m."""
    width: float | None = None
    """Width of both lanes together, in m."""


class RoadEntries(Struct):
    """The entries of a road file that describe its road."""

    curvatures: list[float] | None = None
    """Curvatures, in 1/m; None if the file has points."""
    road_points: list[list[float] | RoadPoint] | None = None
    """Points; None if the file has curvatures. Each is [x, y], [x, y, height] or [x, y, height,
    width of both lanes together] in m, or a `RoadPoint`."""
    step: float = 10.0
    """Distance between two curvatures, in m."""
    pose: tuple[float, float, float] | None = None
    """x, y and heading at the first curvature, in m, m and rad; None for the default, `START`."""
    lane_width: float = LANE_WIDTH
    """Width of a lane, in m."""
    superelevation: list[tuple[float, float]] | None = None
    """Pairs of a distance along the road in m and a slope in m/m, see `Road`."""
    grade: list[tuple[float, float]] | None = None
    """Pairs of a distance along the road in m and a slope in m/m."""
    widening: list[tuple[float, float]] | None = None
    """Pairs of a distance along the road in m and a width in m."""
    speed_limits: list[tuple[float, float]] | None = None
    """Pairs of a distance along the road in m and a speed limit in km/h."""


@dataclass(frozen=True)
class RoadFile:
    """The road of a file, as the file describes it."""

    path: Path
    """Path of the file."""
    road_entries: RoadEntries
    """Entries that describe the road."""
    entries: Mapping[str, Any] = field(default_factory=dict)
    """All entries of the file's JSON object, unchecked; empty for OpenDRIVE."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of a map that were joined although they do not quite meet."""
    map_road: str | None = None
    """Id of the road in its map, as a text for `RoadMap.stretches`; None without a map."""

    def road(self) -> Road:
        """Return the road, where the file has it.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        entries = self.road_entries
        with path_in_errors(self.path):
            profiles = {
                name: values for name in profile.NAMES if (values := getattr(entries, name))
            }
            if entries.curvatures is not None:
                pose = entries.pose or START
                road = Road(entries.curvatures, entries.step, pose, lane_width=entries.lane_width)
            else:
                points = self._points()
                road = Road.from_points(points[:, :2], lane_width=entries.lane_width)
                road = _with_nodes(road, points)
            return replace(road, **profiles)

    def check_validity(
        self, map_size: float = MAP_SIZE, road_class: RoadClass | None = None
    ) -> Verdict:
        """Return the verdict on the road.

        A road with curvatures is fitted into the map first. A road through points stays where it
        is, since the competition judges the points.

        Args:
            map_size: side of the map, in m.
            road_class: class whose rules replace the competition's rules; None for the
                competition's.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        if self.road_entries.curvatures is not None:
            return self.road().placed(map_size, road_class=road_class)[1]
        if road_class is not None:
            return self.road().check_validity(map_size, road_class)
        with path_in_errors(self.path):
            return check_validity(self._points()[:, :2], map_size)

    def _points(self) -> FloatArray:
        """Return the points in m: (N, 2) x and y, (N, 3) with heights, or (N, 4) with widths, too.

        Raises:
            RoadError: a point has more or fewer numbers than another, a height or width is out of
                range, or the file has slopes or widths beside heights and widths of points.
        """
        points = self.road_entries.road_points or []
        rows = [_numbers_of(point) if isinstance(point, RoadPoint) else point for point in points]
        count = len(rows[0]) if rows else 2
        for i, row in enumerate(rows):
            if len(row) not in _NODE_ENTRIES:
                raise RoadError(
                    f"road point {i} has {counted(len(row), 'number')}: [x, y], [x, y, z] or"
                    " [x, y, z, width] is needed"
                )
            if len(row) != count:
                raise RoadError(
                    f"road point {i} has {len(row)} numbers, but point 0 has {count}: equally many"
                    " are needed"
                )
        for name in _NODE_ENTRIES[count]:
            if name in self.entries:
                raise RoadError(f"its points have what {name!r} has, too: leave out one of the two")
        nodes = np.array(rows, dtype=np.float64).reshape(-1, count)
        bad = np.flatnonzero(~(np.abs(nodes[:, 2:]) <= MAX_COORDINATE).all(axis=1))
        if len(bad):
            raise RoadError(
                f"road point {bad[0]} is {nodes[bad[0]].tolist()}: a height and a width of at most"
                f" {MAX_COORDINATE:g} m are needed"
            )
        return nodes


def _numbers_of(point: RoadPoint) -> list[float]:
    """Return x and y of a point in m, with height and width if it has them."""
    if point.width is not None:
        return [point.x, point.y, point.z or 0.0, point.width]
    return [point.x, point.y] if point.z is None else [point.x, point.y, point.z]


def _with_nodes(road: Road, nodes: FloatArray) -> Road:
    """Return a flat road with the heights and widths of its nodes.

    Args:
        road: the road through the nodes.
        nodes: x, y and maybe height and width of both lanes, (N, 2) to (N, 4) in m.

    Raises:
        RoadError: a slope or a width is out of range.
    """
    if nodes.shape[1] == 2:
        return road
    stations = _stations_of(nodes[:, :2], road)
    is_ahead = np.concatenate([[True], np.diff(stations) > MIN_DISTANCE])
    stations, nodes = stations[is_ahead], nodes[is_ahead]
    profiles: dict[str, Any] = {}
    grades = np.gradient(nodes[:, 2], stations)
    if np.abs(grades).max() > SLOPE_ERROR:
        grade = np.column_stack([stations, grades])
        profiles["grade"] = profile.simplified(grade, SLOPE_ERROR)
    if nodes.shape[1] == 3:
        return replace(road, **profiles)
    widths = 0.5 * nodes[:, 3]  # of one lane
    wider = widths - widths.min()
    if wider.max() > WIDTH_ERROR:
        profiles["widening"] = profile.simplified(np.column_stack([stations, wider]), WIDTH_ERROR)
    return replace(road, lane_width=float(widths.min()), **profiles)


def _stations_of(points: FloatArray, road: Road) -> FloatArray:
    """Return the distances along a road, (N,) in m, of points (N, 2) through which it leads."""
    stations = [0.0]
    chords = np.hypot(*np.diff(points, axis=0).T)
    for (x, y), chord in zip(points[1:], chords, strict=True):
        # The distance from the point before is one chord, or up to two chords in a tight bend.
        near = stations[-1] + 1.5 * chord
        station, _ = geometry.project_near(road.table, road.sub_step, x, y, near, 0.5 * chord + 1.0)
        stations.append(max(station, stations[-1]))
    return np.array(stations)


def read_road(
    path: Path | str,
    *,
    lane: int | None = None,
    roads: str | None = None,
    test: int | None = None,
) -> RoadFile:
    """Read a road from a JSON or an OpenDRIVE file.

    A JSON file holds one of these:

    - an object with ``curvatures``, and optionally ``step``, ``pose`` and ``lane_width``
    - an object with ``road_points``, such as a test file of the competition
    - a list of points, without an object
    - a list of such objects

    The entries of an object, with their units, are the fields of `RoadEntries`. An OpenDRIVE
    file has the suffix ``.xodr``, or is XML.

    Args:
        path: the file.
        lane: OpenDRIVE only, id of the lane to drive on, see `RoadMap.road`.
        roads: OpenDRIVE only, ids of the roads of a stretch, see `RoadMap.stretches`; None for the
            map's only road.
        test: number, from 1, of an object in a list; None for a file that holds one road.

    Raises:
        RoadError: the file is missing, unreadable, too large, neither JSON nor OpenDRIVE, or holds
            no such road.
    """
    path = Path(path)
    if roads is not None:
        return _read_stretch(path, roads, lane)
    data = load_bytes(path)
    if _is_opendrive(path, data):
        if test is not None:
            raise _no_list(path, test)
        return _read_map_road(path, data, lane)
    if lane is not None:
        raise RoadError(f"{path} is no OpenDRIVE file: a lane can be chosen in those only")
    try:
        content = read_json(data)
    except ValueError as error:
        raise RoadError(f"{path} is not JSON that can be read: {error}") from None
    if test is not None or (isinstance(content, list) and _are_tests(content)):
        content = _chosen_test(path, content, test)
    if isinstance(content, list):
        try:
            return road_file(path, {"road_points": content})
        except RoadError as error:  # it names the entry road_points, which a bare list lacks
            raise RoadError(str(error).replace("$.road_points", "$")) from None
    if not isinstance(content, Mapping):
        raise RoadError(
            f"{path} holds {type(content).__name__}: an object with curvatures or road_points,"
            " or a list of points, is needed"
        )
    return road_file(path, content)


def _read_stretch(path: Path, roads: str, lane: int | None) -> RoadFile:
    """Return one stretch of an OpenDRIVE file's roads, see `read_road`.

    Raises:
        RoadError: the file cannot be read, or the roads make more than one stretch.
    """
    _, (first, *others) = read_stretches(path, roads, lane=lane)
    if others:
        with path_in_errors(path, NO_OPENDRIVE):
            notes = "".join(f": {note}" for note in others[0].notes)
            raise RoadError(f"{others[0].name} does not begin where {first.name} ends{notes}")
    entries = convert(entries_of(first.road), RoadEntries)
    return RoadFile(path, entries, notes=first.notes)


def _read_map_road(path: Path, data: bytes, lane: int | None) -> RoadFile:
    """Return the only road of an OpenDRIVE file's content, see `read_road`.

    Raises:
        RoadError: the content cannot be read, or holds several roads.
    """
    with path_in_errors(path, NO_OPENDRIVE):
        road_map = RoadMap(data)
        road = road_map.road(lane=lane)
    (road_id,) = map(quoted_id, road_map.ids)
    return RoadFile(path, convert(entries_of(road), RoadEntries), map_road=road_id)


def _are_tests(content: Sequence[object]) -> bool:
    """Return whether a list holds objects with one road each, rather than points."""
    return bool(content) and all(
        isinstance(item, Mapping) and not item.keys().isdisjoint(("road_points", "curvatures"))
        for item in content
    )


def _chosen_test(path: Path, content: object, test: int | None) -> Any:
    """Return the object with this number, from 1, in a file's list of tests.

    Raises:
        RoadError: the file has no list of tests, the list lacks the number, or no number chooses
            one of several tests.
    """
    if not isinstance(content, list) or not _are_tests(content):
        raise _no_list(path, test)
    if test is None and len(content) == 1:
        return content[0]
    if test is None or not 1 <= test <= len(content):
        example = f"frenetic drive {shlex.quote(str(path))} 1"
        lacks = "" if test is None else f", none of which is {test}"
        raise RoadError(
            f"{path} holds {counted(len(content), 'test')}{lacks}: choose one by its number from 1"
            f" to {len(content)}, as in '{example}'"
        )
    return content[test - 1]


def _no_list(path: Path, test: int | None) -> RoadError:
    """Return the error that a file holds no list in which to choose a test."""
    return RoadError(
        f"{path} is not a folder of a campaign and holds no list of tests: leave out the ID {test}"
    )


def read_stretches(
    path: Path | str, roads: str, *, lane: int | None = None
) -> tuple[RoadMap, list[Stretch]]:
    """Return the map in an OpenDRIVE file, and stretches of its roads, see `RoadMap.stretches`.

    Raises:
        RoadError: the file is missing, unreadable, too large or no OpenDRIVE file, or lacks a road.
    """
    path = Path(path)
    data = load_bytes(path)
    if not _is_opendrive(path, data):
        raise RoadError(f"{path} is no OpenDRIVE file: a road can be chosen in those only")
    with path_in_errors(path, NO_OPENDRIVE):
        road_map = RoadMap(data)
        return road_map, road_map.stretches(roads, lane=lane)


def _is_opendrive(path: Path, data: bytes) -> bool:
    """Return whether a file is OpenDRIVE: by its suffix, or because its content is XML."""
    return path.suffix.lower() == MAP_SUFFIX or data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


@contextmanager
def path_in_errors(path: Path, problem: str = "") -> Iterator[None]:
    """Put the file's path and a problem in front of `RoadError` messages that the block raises."""
    try:
        yield
    except RoadError as error:
        raise RoadError(f"{path}{problem}: {error}") from None


def entries_of(road: Road) -> dict[str, Any]:
    """Return the entries of a JSON file with this road; profiles without stations are left out."""
    profiles = {name: getattr(road, name) for name in profile.NAMES}
    return {
        "curvatures": road.curvatures.tolist(),
        "step": road.step,
        "pose": list(road.pose),
        "lane_width": road.lane_width,
        **{name: pairs.tolist() for name, pairs in profiles.items() if len(pairs)},
    }


def road_file(path: Path, content: Mapping[str, Any]) -> RoadFile:
    """Return the road of a JSON object, see `read_road`.

    Args:
        path: file of the object, for messages.
        content: the object.

    Raises:
        RoadError: an entry has a wrong type, or the object has neither curvatures nor points.
    """
    try:
        entries = convert(content, RoadEntries)
    except ValueError as error:  # also if a text holds half of a UTF-16 pair
        raise RoadError(f"{path}: {error}") from None
    if entries.curvatures is None and entries.road_points is None:
        keys = ", ".join(sorted(map(str, content))[:8]) or "nothing"
        raise RoadError(f"{path} has neither 'curvatures' nor 'road_points', but {keys}")
    return RoadFile(path, entries, content)


def load_bytes(path: Path) -> bytes:
    """Return the content of a road file.

    Raises:
        RoadError: the file is missing, a folder, unreadable or too large.
    """
    most = MAX_MAP_BYTES if path.suffix.lower() == MAP_SUFFIX else MAX_BYTES
    try:
        if path.is_dir():
            raise RoadError(f"{path} is a folder: a JSON or OpenDRIVE file is needed")
        with open_file(path) as file:
            data = file.read(most + 1)
    except FileNotFoundError:
        raise RoadError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise RoadError(f"{path} cannot be read: {reason}") from None
    if len(data) > most:
        raise RoadError(
            f"{path} has more than {most} bytes ({most // 2**20} MiB): no road file is that large"
        )
    return data
