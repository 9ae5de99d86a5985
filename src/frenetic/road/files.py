"""Roads in files and folders: JSON with curvatures or points, competition test files, OpenDRIVE."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, convert

from frenetic._support.files import require_list
from frenetic._support.outside_text import read_json
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.road.opendrive import RoadMap, Stretch
from frenetic.road.road import START, Road
from frenetic.road.validity import MAP_SIZE, Verdict, check_validity

MAX_BYTES: Final = 8 * 2**20
"""Largest road file that is read; a competition's test file of a long drive has about 1 MiB."""
MAX_MAP_BYTES: Final = 64 * 2**20
"""Largest OpenDRIVE file that is read."""
_SUFFIXES: Final = {".json", ".xodr"}
"""Of the files that are looked into in a folder."""
_OPENDRIVE: Final = " cannot be read as OpenDRIVE"


class Point(Struct):
    """A road point that is an object."""

    x: float
    """m."""
    y: float
    """m."""


class RoadEntries(Struct):
    """The entries of a road file that describe its road."""

    curvatures: list[float] | None = None
    """1/m."""
    road_points: list[tuple[float, float] | Point] | None = None
    """m."""
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


@dataclass(frozen=True)
class RoadFile:
    """A road as a file gives it: its curvatures or its points, unchanged."""

    path: Path
    given: RoadEntries
    entries: Mapping[str, Any] = field(default_factory=dict)
    """All entries of its JSON object, unchecked."""

    def road(self) -> Road:
        """The road; one given by points stays in place.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        given = self.given
        with _naming(self.path):
            if given.curvatures is None:
                road = Road.from_points(self._points(), lane_width=given.lane_width)
            else:
                pose = given.pose or START
                road = Road(given.curvatures, given.step, pose, lane_width=given.lane_width)
            profiles: dict[str, Any] = {name: getattr(given, name) or () for name in profile.NAMES}
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
            return check_validity(self._points(), map_size)

    def _points(self) -> list[tuple[float, float]]:
        points = self.given.road_points or []
        return [(p.x, p.y) if isinstance(p, Point) else p for p in points]


def read_road(path: Path | str, *, lane: int | None = None, roads: str | None = None) -> RoadFile:
    """Reads a road from a JSON or an OpenDRIVE file.

    A JSON file holds an object with ``curvatures`` (1/m) and optionally ``step`` (m, 10), ``pose``
    ([x, y, heading] in m, m, rad) and ``lane_width`` (m, 4); or one with ``road_points`` ([x, y] or
    {"x": x, "y": y} in m each), which a test file of the competition is; or just a list of points.
    Either may have ``superelevation`` and ``grade``, pairs of m along the road and m/m, and
    ``widening``, of m and m, see `Road`.

    An OpenDRIVE file is known by its suffix ``.xodr`` or by being XML.

    Args:
        path: of the file.
        lane: OpenDRIVE only, id of the lane to drive on, see `RoadMap.road`.
        roads: OpenDRIVE only, ids of the roads that make the stretch, see `RoadMap.stretches`; None
            for the only road.

    Raises:
        RoadError: the file is missing, unreadable, too large, neither JSON nor OpenDRIVE, or holds
            no such road.
    """
    path = Path(path)
    if roads is not None:
        _, (first, *others) = read_stretches(path, roads, lane=lane)
        if others:
            with _naming(path, _OPENDRIVE):
                raise RoadError(f"{others[0].name} does not begin where {first.name} ends")
        return RoadFile(path, convert(entries_of(first.road), RoadEntries))
    data = _load(path)
    if _is_opendrive(path, data):
        with _naming(path, _OPENDRIVE):
            road = RoadMap(data).road(lane=lane)
        return RoadFile(path, convert(entries_of(road), RoadEntries))
    if lane is not None:
        raise RoadError(f"{path} is no OpenDRIVE file: a lane can be chosen in those only")
    try:
        content = read_json(data)
    except ValueError as error:
        raise RoadError(f"{path} is not JSON that can be read: {error}") from None
    if isinstance(content, list):
        content = {"road_points": content}
    if not isinstance(content, Mapping):
        raise RoadError(
            f"{path} holds {type(content).__name__}: an object with curvatures or road_points,"
            " or a list of points, is needed"
        )
    return road_file(path, content)


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
    faults: tuple[str, ...]
    """Files that were named and hold no road, each in one line."""
    skipped: tuple[str, ...]
    """JSON and OpenDRIVE files within folders that hold none, each in one line."""


def find_roads(places: Iterable[Path | str]) -> FoundRoads:
    """The roads in files, see `read_road`, and in folders.

    In a folder every file that ends in .json or .xodr is read, and in the folders below it. What
    holds no road is skipped there, since folders hold other files, too. Of a map
    (.xodr) each road counts that is not within a junction and can be read.

    Args:
        places: files and folders.

    Raises:
        RoadError: no file holds a road, or a folder cannot be read.
    """
    roads: dict[str, Road] = {}
    faults: list[str] = []
    skipped: list[str] = []
    places = require_list("places", places, "files and folders")
    for place in map(Path, places):
        is_folder = place.is_dir()
        for path in _files_in(place) if is_folder else [place]:
            try:
                if path.suffix.lower() == ".xodr":
                    skipped += _add_map(roads, path)
                else:
                    roads[str(path)] = read_road(path).road()
            except RoadError as error:
                (skipped if is_folder else faults).append(str(error))
    if not roads:
        looked = ", ".join(map(str, places))
        nothing = (
            f"no road in {looked}: files with curvatures or road_points (.json) or OpenDRIVE"
            " (.xodr) are needed"
        )
        raise RoadError([*faults, *skipped, nothing][0])
    return FoundRoads(roads, tuple(faults), tuple(skipped))


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
            roads[str(path)] = road_map.road()
            return skipped
    for road_id in lengths:
        try:
            with _naming(path, _OPENDRIVE):
                road = road_map.road(road_id)
        except RoadError as error:
            skipped.append(f"{error} (road {road_id})")
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
