"""Roads in files and folders: JSON with curvatures or points, competition test files, OpenDRIVE."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct, convert

from frenetic._support.arrays import FloatArray
from frenetic._support.files import require_list
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.classes import RoadClass
from frenetic.road.opendrive import RoadMap, Stretch
from frenetic.road.opendrive.following import SLOPE_ERROR, WIDTH_ERROR
from frenetic.road.opendrive.ids import quoted_id
from frenetic.road.road import MAX_COORDINATE, MIN_DISTANCE, START, Road
from frenetic.road.validity import MAP_SIZE, Verdict, check_validity

MAX_BYTES: Final = 8 * 2**20
"""Largest road file that is read; a competition's test file of a long drive has about 1 MiB."""
MAX_MAP_BYTES: Final = 64 * 2**20
"""Largest OpenDRIVE file that is read."""
_SUFFIXES: Final = {".json", ".xodr"}
"""Of the files that are looked into in a folder."""
_OPENDRIVE: Final = " cannot be read as OpenDRIVE"
_NODE_ENTRIES: Final[Mapping[int, tuple[str, ...]]] = {
    2: (),
    3: ("grade",),
    4: ("grade", "widening", "lane_width"),
}
"""Numbers of a road point -> entries of a road file that say the same."""


class Point(Struct):
    """A road point that is an object."""

    x: float
    """m."""
    y: float
    """m."""
    z: float | None = None
    """Height in m."""
    width: float | None = None
    """Width of both lanes together, in m."""


class RoadEntries(Struct):
    """The entries of a road file that describe its road."""

    curvatures: list[float] | None = None
    """1/m."""
    road_points: list[list[float] | Point] | None = None
    """[x, y], [x, y, height] or [x, y, height, width of both lanes together], in m."""
    step: float = 10.0
    """m."""
    pose: tuple[float, float, float] | None = None
    """m, m and rad."""
    lane_width: float = 4.0
    """m."""
    superelevation: list[tuple[float, float]] | None = None
    """Pairs of m and m/m."""
    grade: list[tuple[float, float]] | None = None
    """Pairs of m and m/m."""
    widening: list[tuple[float, float]] | None = None
    """Pairs of m and m."""
    speed_limits: list[tuple[float, float]] | None = None
    """Pairs of m and km/h."""


@dataclass(frozen=True)
class RoadFile:
    """A road as a file gives it: its curvatures or its points, unchanged."""

    path: Path
    given: RoadEntries
    entries: Mapping[str, Any] = field(default_factory=dict)
    """All entries of its JSON object, unchecked."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of a map that do not quite meet."""
    map_road: str | None = None
    """Text for `RoadMap.stretches` that gives the road of a map where it lies."""

    def road(self) -> Road:
        """The road; one given by points stays in place.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        given = self.given
        with _naming(self.path):
            profiles = {name: values for name in profile.NAMES if (values := getattr(given, name))}
            if given.curvatures is not None:
                pose = given.pose or START
                road = Road(given.curvatures, given.step, pose, lane_width=given.lane_width)
            else:
                points = self._points()
                road = Road.from_points(points[:, :2], lane_width=given.lane_width)
                road = _with_nodes(road, points)
            return replace(road, **profiles)

    def check_validity(
        self, map_size: float = MAP_SIZE, road_class: RoadClass | None = None
    ) -> Verdict:
        """The verdict on points in place, or on curvatures fitted to the map.

        It is the competition's, or that of a road class.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        if self.given.curvatures is not None:
            return self.road().placed(map_size, road_class=road_class)[1]
        if road_class is not None:
            return self.road().check_validity(map_size, road_class)
        with _naming(self.path):
            return check_validity(self._points()[:, :2], map_size)

    def _points(self) -> FloatArray:
        """The points, (N, 2) x and y, (N, 3) with heights or (N, 4) also with widths, in m.

        Raises:
            RoadError: a point has other numbers than the first, or the file says slopes or widths
                beside those of the points.
        """
        points = self.given.road_points or []
        rows = [_node(point) if isinstance(point, Point) else point for point in points]
        count = len(rows[0]) if rows else 2
        for i, row in enumerate(rows):
            if len(row) not in _NODE_ENTRIES:
                raise RoadError(
                    f"road point {i} has {counted(len(row), 'number')}: [x, y], [x, y, z] or"
                    " [x, y, z, width] is needed"
                )
            if len(row) != count:
                raise RoadError(
                    f"road point {i} has {len(row)} numbers, but point 0 has {count}: all alike"
                    " are needed"
                )
        for name in _NODE_ENTRIES[count]:
            if name in self.entries:
                raise RoadError(f"its points say what {name!r} says, too: leave out one of the two")
        nodes = np.array(rows, dtype=np.float64).reshape(-1, count)
        bad = np.flatnonzero(~(np.abs(nodes[:, 2:]) <= MAX_COORDINATE).all(axis=1))
        if len(bad):
            raise RoadError(
                f"road point {bad[0]} is {nodes[bad[0]].tolist()}: a height and a width of at most"
                f" {MAX_COORDINATE:g} m are needed"
            )
        return nodes


def _node(point: Point) -> list[float]:
    """The numbers of a point that is an object."""
    if point.width is not None:
        return [point.x, point.y, point.z or 0.0, point.width]
    return [point.x, point.y] if point.z is None else [point.x, point.y, point.z]


def _with_nodes(road: Road, nodes: FloatArray) -> Road:
    """A flat road with the heights and widths, if any, of nodes (N, 2 to 4) through which it leads.

    Raises:
        RoadError: a slope or a width is out of range.
    """
    if nodes.shape[1] == 2:
        return road
    places = [0.0]
    for (x, y), chord in zip(
        nodes[1:, :2], np.hypot(*np.diff(nodes[:, :2], axis=0).T), strict=True
    ):
        # Behind the node before by the chord's length, or by up to twice that in a tight bend.
        near = places[-1] + 1.5 * chord
        place, _ = geometry.project_near(road.table, road.sub_step, x, y, near, 0.5 * chord + 1.0)
        places.append(max(place, places[-1]))
    is_ahead = np.concatenate([[True], np.diff(places) > MIN_DISTANCE])
    stations, nodes = np.array(places)[is_ahead], nodes[is_ahead]
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


def read_road(
    path: Path | str,
    *,
    lane: int | None = None,
    roads: str | None = None,
    test: int | None = None,
) -> RoadFile:
    """Reads a road from a JSON or an OpenDRIVE file.

    A JSON file holds an object with ``curvatures`` (1/m) and optionally ``step`` (m, 10), ``pose``
    ([x, y, heading] in m, m, rad) and ``lane_width`` (m, 4); or one with ``road_points`` ([x, y] or
    {"x": x, "y": y} in m each), which a test file of the competition is; or just a list of points.
    A point may also be a node [x, y, z, width of both lanes together], as of BeamNG.
    Either may have ``superelevation`` and ``grade``, pairs of m along the road and m/m, and
    ``widening``, of m and m, and ``speed_limits``, of m and km/h, see `Road`. A file may also hold
    a list of such objects.

    An OpenDRIVE file is known by its suffix ``.xodr`` or by being XML.

    Args:
        path: of the file.
        lane: OpenDRIVE only, id of the lane to drive on, see `RoadMap.road`.
        roads: OpenDRIVE only, ids of the roads that make the stretch, see `RoadMap.stretches`; None
            for the only road.
        test: number from 1 of an object in a list; None for a file that holds one road.

    Raises:
        RoadError: the file is missing, unreadable, too large, neither JSON nor OpenDRIVE, or holds
            no such road.
    """
    path = Path(path)
    if roads is not None:
        _, (first, *behind) = read_stretches(path, roads, lane=lane)
        if behind:
            with _naming(path, _OPENDRIVE):
                why = "".join(f": {note}" for note in behind[0].notes)
                raise RoadError(f"{behind[0].name} does not begin where {first.name} ends{why}")
        entries = convert(entries_of(first.road), RoadEntries)
        return RoadFile(path, entries, notes=first.notes)
    data = _load(path)
    if _is_opendrive(path, data):
        if test is not None:
            raise _no_list(path, test)
        with _naming(path, _OPENDRIVE):
            road_map = RoadMap(data)
            road = road_map.road(lane=lane)
        (road_id,) = map(quoted_id, road_map.ids)
        return RoadFile(path, convert(entries_of(road), RoadEntries), map_road=road_id)
    if lane is not None:
        raise RoadError(f"{path} is no OpenDRIVE file: a lane can be chosen in those only")
    try:
        content = read_json(data)
    except ValueError as error:
        raise RoadError(f"{path} is not JSON that can be read: {error}") from None
    if test is not None or (isinstance(content, list) and _are_tests(content)):
        content = _chosen(path, content, test)
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


def _are_tests(content: Sequence[object]) -> bool:
    """Whether a list holds objects with a road each, not points."""
    return bool(content) and all(
        isinstance(item, Mapping) and not item.keys().isdisjoint(("road_points", "curvatures"))
        for item in content
    )


def _chosen(path: Path, content: object, test: int | None) -> Any:
    """The object with a number in a file's list of tests.

    Raises:
        RoadError: there is none, or no number to choose by.
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
    return RoadError(
        f"{path} is not a folder of a campaign and holds no list of tests: leave out the ID {test}"
    )


def read_stretches(
    path: Path | str, roads: str, *, lane: int | None = None
) -> tuple[RoadMap, list[Stretch]]:
    """An OpenDRIVE file, and stretches of its roads, see `RoadMap.stretches`.

    Raises:
        RoadError: as for `read_road`.
    """
    path = Path(path)
    data = _load(path)
    if not _is_opendrive(path, data):
        raise RoadError(f"{path} is no OpenDRIVE file: a road can be chosen in those only")
    with _naming(path, _OPENDRIVE):
        road_map = RoadMap(data)
        return road_map, road_map.stretches(roads, lane=lane)


def _is_opendrive(path: Path, data: bytes) -> bool:
    return path.suffix.lower() == ".xodr" or data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


@contextmanager
def _naming(path: Path, what: str = "") -> Iterator[None]:
    """Names the file in errors."""
    try:
        yield
    except RoadError as error:
        raise RoadError(f"{path}{what}: {error}") from None


def entries_of(road: Road) -> dict[str, Any]:
    """The entries of a road's file; profiles only if it has some."""
    profiles = {name: getattr(road, name) for name in profile.NAMES}
    return {
        "curvatures": road.curvatures.tolist(),
        "step": road.step,
        "pose": list(road.pose),
        "lane_width": road.lane_width,
        **{name: one.tolist() for name, one in profiles.items() if len(one)},
    }


def road_file(path: Path, content: Mapping[str, Any]) -> RoadFile:
    """The road of a JSON object, as `read_road` describes it.

    Args:
        path: where the object is from, for messages.
        content: the object.

    Raises:
        RoadError: it holds no road.
    """
    try:
        given = convert(content, RoadEntries)
    except ValueError as error:  # half a character, too
        raise RoadError(f"{path}: {error}") from None
    if given.curvatures is None and given.road_points is None:
        keys = ", ".join(sorted(map(str, content))[:8]) or "nothing"
        raise RoadError(f"{path} has neither 'curvatures' nor 'road_points', but {keys}")
    return RoadFile(path, given, content)


def _load(path: Path) -> bytes:
    most = MAX_MAP_BYTES if path.suffix.lower() == ".xodr" else MAX_BYTES
    try:
        if path.is_dir():
            raise RoadError(f"{path} is a folder: a JSON or OpenDRIVE file is needed")
        with path.open("rb") as file:
            data = file.read(most + 1)
    except FileNotFoundError:
        raise RoadError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:  # a NUL in its name
        reason = getattr(error, "strerror", None) or error
        raise RoadError(f"{path} cannot be read: {reason}") from None
    if len(data) > most:
        raise RoadError(
            f"{path} has more than {most} bytes ({most // 2**20} MiB): no road file is that large"
        )
    return data


# Folders


@dataclass(frozen=True)
class FoundRoads:
    """The roads of files and folders, in the order of their names within each folder."""

    roads: Mapping[str, Road]
    """Name of a file -> its road."""
    skipped: tuple[str, ...]
    """JSON and OpenDRIVE files within folders that hold none, then roads of maps that cannot be
    read, each in one line."""


def find_roads(places: Iterable[Path | str]) -> FoundRoads:
    """The roads in files, see `read_road`, and in folders.

    In a folder every file that ends in .json or .xodr is read, and in the folders below it. What
    holds no road is skipped there, since folders hold other files, too. Of a map
    (.xodr) each road counts that is not within a junction and can be read.

    Args:
        places: files and folders.

    Raises:
        RoadError: a named file or all files of the folders hold no road, or a folder cannot be
            read.
    """
    roads: dict[str, Road] = {}
    skipped: list[str] = []
    unread: list[str] = []
    places = require_list("places", places, "files and folders")
    for place in map(Path, places):
        is_folder = place.is_dir()
        for path in _files_in(place) if is_folder else [place]:
            try:
                if path.suffix.lower() == ".xodr":
                    unread += _add_map(roads, path)
                else:
                    roads[str(path)] = read_road(path).road()
            except RoadError as error:
                if not is_folder:
                    raise
                skipped.append(str(error))
    if not roads:
        looked = ", ".join(map(str, places))
        nothing = (
            f"no road in {looked}: files with curvatures or road_points (.json) or OpenDRIVE"
            " (.xodr) are needed"
        )
        raise RoadError([*skipped, *unread, nothing][0])
    return FoundRoads(roads, (*skipped, *unread))


def _add_map(roads: dict[str, Road], path: Path) -> list[str]:
    """Adds the roads of an OpenDRIVE file outside junctions; gives what cannot be read, in words.

    Raises:
        RoadError: the file, or its only road, cannot be read.
    """
    skipped: list[str] = []
    with _naming(path, _OPENDRIVE):
        road_map = RoadMap(_load(path))
        lengths = road_map.lengths
        if len(lengths) < 2:
            roads[str(path)] = road_map.road(next(iter(lengths), None))
            return skipped
    for road_id in lengths:
        try:
            with _naming(path, _OPENDRIVE):
                road = road_map.road(road_id)
        except RoadError as error:
            skipped.append(str(error))
        else:
            roads[f"{path} road {road_id}"] = road
    return skipped


def _files_in(folder: Path) -> list[Path]:
    try:
        return sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in _SUFFIXES and path.is_file()
        )
    except OSError as error:
        raise RoadError(f"cannot look into {folder}: {error.strerror or error}") from None
