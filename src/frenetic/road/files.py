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
from frenetic._support.files import open_file, require_list
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
"""Largest road file that is read, in bytes; ours: a competition's test file has about 1 MiB."""
MAX_MAP_BYTES: Final = 64 * 2**20
"""Largest OpenDRIVE file that is read, in bytes; ours."""
_SUFFIXES: Final = {".json", ".xodr"}
"""Suffixes of the files that are read in a folder."""
_OPENDRIVE: Final = " cannot be read as OpenDRIVE"
_NODE_ENTRIES: Final[Mapping[int, tuple[str, ...]]] = {
    2: (),
    3: ("grade",),
    4: ("grade", "widening", "lane_width"),
}
"""Count of a road point's numbers -> entries of a road file that would repeat them."""


class RoadPoint(Struct):
    """A road point in the form of an object."""

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
    """Curvatures, in 1/m."""
    road_points: list[list[float] | RoadPoint] | None = None
    """[x, y], [x, y, height] or [x, y, height, width of both lanes together], in m."""
    step: float = 10.0
    """Distance between two curvatures, in m."""
    pose: tuple[float, float, float] | None = None
    """x, y and heading of the first curvature, in m, m and rad."""
    lane_width: float = LANE_WIDTH
    """Width of a lane, in m."""
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
    """A road in a file: its curvatures or its points, unchanged."""

    path: Path
    road_entries: RoadEntries
    """Entries that describe the road."""
    entries: Mapping[str, Any] = field(default_factory=dict)
    """All entries of the JSON object, unchecked."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of a map that do not quite meet."""
    map_road: str | None = None
    """Text for `RoadMap.stretches` that returns the road at its place in the map."""

    def road(self) -> Road:
        """Return the road; a road through points stays in place.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        entries = self.road_entries
        with _naming(self.path):
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
        """Return the verdict on points in place, or on curvatures fitted to the map.

        The rules are the competition's, or the road class's.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        if self.road_entries.curvatures is not None:
            return self.road().placed(map_size, road_class=road_class)[1]
        if road_class is not None:
            return self.road().check_validity(map_size, road_class)
        with _naming(self.path):
            return check_validity(self._points()[:, :2], map_size)

    def _points(self) -> FloatArray:
        """Return the points, (N, 2) x and y, (N, 3) with heights or (N, 4) also with widths, in m.

        Raises:
            RoadError: two points have different counts of numbers, or the file has slopes or widths
                beside the points' heights and widths.
        """
        points = self.road_entries.road_points or []
        rows = [_node(point) if isinstance(point, RoadPoint) else point for point in points]
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


def _node(point: RoadPoint) -> list[float]:
    """Return the numbers of a point in the form of an object."""
    if point.width is not None:
        return [point.x, point.y, point.z or 0.0, point.width]
    return [point.x, point.y] if point.z is None else [point.x, point.y, point.z]


def _with_nodes(road: Road, nodes: FloatArray) -> Road:
    """Return a flat road with the heights and widths, if any, of its nodes (N, 2 to 4).

    Raises:
        RoadError: a slope or a width is out of range.
    """
    if nodes.shape[1] == 2:
        return road
    places = [0.0]
    for (x, y), chord in zip(
        nodes[1:, :2], np.hypot(*np.diff(nodes[:, :2], axis=0).T), strict=True
    ):
        # The node lies one chord behind the node before it, in a tight bend up to two chords.
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
    """Read a road from a JSON or an OpenDRIVE file.

    A JSON file holds an object with ``curvatures`` (1/m) and optionally ``step`` (m, 10), ``pose``
    ([x, y, heading] in m, m, rad) and ``lane_width`` (m, 4); or one with ``road_points`` ([x, y] or
    {"x": x, "y": y} in m each), which a test file of the competition is; or just a list of points.
    A point may also be a node [x, y, z, width of both lanes together], as of BeamNG.
    Either may have ``superelevation`` and ``grade``, pairs of m along the road and m/m, and
    ``widening``, of m and m, and ``speed_limits``, of m and km/h, see `Road`. A file may also hold
    a list of such objects.

    An OpenDRIVE file is known by its suffix ``.xodr`` or by being XML.

    Args:
        path: the file.
        lane: OpenDRIVE only, id of the lane to drive on, see `RoadMap.road`.
        roads: OpenDRIVE only, ids of the roads of a stretch, see `RoadMap.stretches`; None for the
            map's only road.
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
                notes = "".join(f": {note}" for note in behind[0].notes)
                raise RoadError(f"{behind[0].name} does not begin where {first.name} ends{notes}")
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
    """Return whether a list holds objects with a road each, not points."""
    return bool(content) and all(
        isinstance(item, Mapping) and not item.keys().isdisjoint(("road_points", "curvatures"))
        for item in content
    )


def _chosen(path: Path, content: object, test: int | None) -> Any:
    """Return the object with a number in a file's list of tests.

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
    return RoadError(
        f"{path} is not a folder of a campaign and holds no list of tests: leave out the ID {test}"
    )


def read_stretches(
    path: Path | str, roads: str, *, lane: int | None = None
) -> tuple[RoadMap, list[Stretch]]:
    """Return an OpenDRIVE file's map, and stretches of its roads, see `RoadMap.stretches`.

    Raises:
        RoadError: the file is missing, unreadable, too large or no OpenDRIVE file, or lacks a road.
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
def _naming(path: Path, problem: str = "") -> Iterator[None]:
    """Put the file's path and a problem in front of errors that the block raises."""
    try:
        yield
    except RoadError as error:
        raise RoadError(f"{path}{problem}: {error}") from None


def entries_of(road: Road) -> dict[str, Any]:
    """Return the entries of a road's file, without profiles that the road lacks."""
    profiles = {name: getattr(road, name) for name in profile.NAMES}
    return {
        "curvatures": road.curvatures.tolist(),
        "step": road.step,
        "pose": list(road.pose),
        "lane_width": road.lane_width,
        **{name: pairs.tolist() for name, pairs in profiles.items() if len(pairs)},
    }


def road_file(path: Path, content: Mapping[str, Any]) -> RoadFile:
    """Return the road of a JSON object, as `read_road` describes it.

    Args:
        path: file of the object, for messages.
        content: the object.

    Raises:
        RoadError: an entry has a wrong type, or the object has neither curvatures nor points.
    """
    try:
        entries = convert(content, RoadEntries)
    except ValueError as error:  # half a character, too
        raise RoadError(f"{path}: {error}") from None
    if entries.curvatures is None and entries.road_points is None:
        keys = ", ".join(sorted(map(str, content))[:8]) or "nothing"
        raise RoadError(f"{path} has neither 'curvatures' nor 'road_points', but {keys}")
    return RoadFile(path, entries, content)


def _load(path: Path) -> bytes:
    most = MAX_MAP_BYTES if path.suffix.lower() == ".xodr" else MAX_BYTES
    try:
        if path.is_dir():
            raise RoadError(f"{path} is a folder: a JSON or OpenDRIVE file is needed")
        with open_file(path) as file:
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
    """JSON and OpenDRIVE files within folders that hold no road, then roads of maps that cannot be
    read, each in one line."""


def find_roads(places: Iterable[Path | str]) -> FoundRoads:
    """Return the roads in files, see `read_road`, and in folders.

    In a folder and the folders below it, every file that ends in .json or .xodr is read. Files
    without a road are skipped there, since folders hold other files, too. A map (.xodr) contributes
    each road outside junctions that can be read.

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
    """Add the roads of an OpenDRIVE file outside junctions; return the errors of unreadable roads.

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
