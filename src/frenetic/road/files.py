"""Roads in files and folders: JSON with curvatures or points, competition test files, OpenDRIVE."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from frenetic._support.files import require_list
from frenetic.errors import LaneError, RoadError
from frenetic.road.opendrive import from_opendrive
from frenetic.road.road import MAX_SAMPLES, START, Pose, Road, checked_lane_width
from frenetic.road.validity import MAP_SIZE, Verdict, check_validity

MAX_BYTES: Final = 8 * 2**20
"""Largest road file that is read; a competition's test file of a long drive has about 1 MiB."""
_SUFFIXES: Final = {".json", ".xodr"}
"""Of the files that are looked into in a folder."""


@dataclass(frozen=True)
class RoadFile:
    """A road as a file gives it: its curvatures or its points, unchanged."""

    path: Path
    curvatures: object | None
    step: object
    pose: Pose | None
    road_points: object | None
    lane_width: object
    entries: Mapping[str, Any] = field(default_factory=dict)
    """All entries of its JSON object, unchecked."""

    def road(self) -> Road:
        """The road; one given by points stays in place.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        try:
            if self.curvatures is not None:
                return Road(
                    self.curvatures,  # type: ignore[arg-type]
                    self.step,  # type: ignore[arg-type]
                    self.pose or START,
                    lane_width=self.lane_width,  # type: ignore[arg-type]
                )
            return Road.from_points(
                self.road_points,  # type: ignore[arg-type]
                lane_width=self.lane_width,  # type: ignore[arg-type]
            )
        except RoadError as error:
            raise RoadError(f"{self.path}: {error}") from None

    def check_validity(self, map_size: float = MAP_SIZE) -> Verdict:
        """The competition's verdict on points in place, or on curvatures fitted to the map.

        Raises:
            RoadError: the values describe no road; the message names the file.
        """
        if self.curvatures is None:
            try:
                checked_lane_width(self.lane_width)  # type: ignore[arg-type]
                return check_validity(self.road_points, map_size)  # type: ignore[arg-type]
            except RoadError as error:
                raise RoadError(f"{self.path}: {error}") from None
        _, verdict = self.road().placed(map_size)
        return verdict


def read_road(path: Path | str, *, lane: int | None = None) -> RoadFile:
    """Reads a road from a JSON or an OpenDRIVE file.

    A JSON file holds an object with ``curvatures`` (1/m) and optionally ``step`` (m, 10), ``pose``
    ([x, y, heading] in m, m, rad) and ``lane_width`` (m, 4); or one with ``road_points`` ([x, y] or
    {"x": x, "y": y} in m each), which a test file of the competition is; or just a list of points.
    An OpenDRIVE file, known by its suffix ``.xodr`` or by being XML, holds one road,
    see `from_opendrive`; ``lane`` is the id of the lane to drive on there.

    Raises:
        RoadError: the file is missing, unreadable, too large, neither JSON nor OpenDRIVE, or holds
            no road.
    """
    path = Path(path)
    data = _load(path)
    if path.suffix.lower() == ".xodr" or data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return _read_opendrive(path, data, -1 if lane is None else lane)
    if lane is not None:
        raise RoadError(f"{path} is no OpenDRIVE file: a lane can be chosen in those only")
    content = _parse_json(path, data)
    if isinstance(content, list):
        content = {"road_points": content}
    if not isinstance(content, Mapping):
        raise RoadError(
            f"{path} holds {type(content).__name__}: an object with curvatures or road_points,"
            " or a list of points, is needed"
        )
    return road_file(path, content)


def road_file(path: Path, content: Mapping[str, Any]) -> RoadFile:
    """The road of a JSON object, as `read_road` describes it.

    Args:
        path: where the object is from, for messages.
        content: the object.

    Raises:
        RoadError: it holds no road.
    """
    curvatures, points = content.get("curvatures"), content.get("road_points")
    if curvatures is None and points is None:
        keys = ", ".join(sorted(map(str, content))[:8]) or "nothing"
        raise RoadError(f"{path} has neither 'curvatures' nor 'road_points', but {keys}")
    if curvatures is not None and not _is_list_of_numbers(curvatures):
        raise RoadError(f"{path}: 'curvatures' is not a list of numbers")
    if curvatures is None:
        points = _pairs(path, points)
    return RoadFile(
        path,
        curvatures,
        content.get("step", 10.0),
        _pose(path, content.get("pose")),
        points,
        content.get("lane_width", 4.0),
        content,
    )


def _read_opendrive(path: Path, data: bytes, lane: int) -> RoadFile:
    try:
        road = from_opendrive(data, lane=lane)
    except RoadError as error:
        raise type(error)(f"{path} cannot be read as OpenDRIVE: {error}") from None
    return RoadFile(path, road.curvatures, road.step, road.pose, None, road.lane_width)


def _load(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise RoadError(f"{path} is a folder: a JSON or OpenDRIVE file is needed")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise RoadError(
                f"{path} has more than {MAX_BYTES} bytes ({MAX_BYTES // 2**20} MiB): no road file"
                " is that large"
            )
    except FileNotFoundError:
        raise RoadError(f"there is no file {path}") from None
    except OSError as error:
        raise RoadError(f"{path} cannot be read: {error.strerror or error}") from None
    return data


def _parse_json(path: Path, data: bytes) -> Any:
    try:
        return json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise RoadError(f"{path} is not a text file: JSON in UTF-8 is needed") from None
    except json.JSONDecodeError as error:
        raise RoadError(
            f"{path} is not JSON: {error.msg} in line {error.lineno}, column {error.colno}"
        ) from None
    except (RecursionError, ValueError):
        raise RoadError(
            f"{path} is not JSON that can be read: nested too deeply, or too long a number"
        ) from None


def _is_list_of_numbers(values: object) -> bool:
    """Whether it is a list of numbers, as far as a road may be long."""
    return isinstance(values, list) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in values[: MAX_SAMPLES + 1]
    )


def _pairs(path: Path, points: object) -> object:
    """Points as [x, y] each, if some of them are objects with x and y; else what was given."""
    if not isinstance(points, list):
        return points
    if len(points) > MAX_SAMPLES:
        raise RoadError(f"{path}: a road of {len(points)} points: 2 to {MAX_SAMPLES} are allowed")
    pairs = []
    for i, point in enumerate(points):
        if isinstance(point, Mapping):
            missing = [key for key in ("x", "y") if key not in point]
            if missing:
                raise RoadError(f"{path}: point {i} has no '{missing[0]}'")
            pairs.append([point["x"], point["y"]])
        else:
            pairs.append(point)
    return pairs


def _pose(path: Path, value: object) -> Pose | None:
    if value is None:
        return None
    if not (isinstance(value, list) and len(value) == 3 and _is_list_of_numbers(value)):
        raise RoadError(f"{path}: 'pose' has to be [x, y, heading] in m, m and rad")
    return Pose(*value)


# Folders


@dataclass(frozen=True, eq=False)
class NamedRoad:
    """A road and its name, such as its file's."""

    name: str
    road: Road


@dataclass(frozen=True)
class FoundRoads:
    """The roads of files and folders, in the order of their names within each folder."""

    roads: tuple[NamedRoad, ...]
    faults: tuple[str, ...]
    """Files that were named and hold no road, each in one line."""
    skipped: tuple[Path, ...]
    """JSON and OpenDRIVE files within folders that hold no road."""
    other_lanes: tuple[str, ...] = ()
    """OpenDRIVE files within folders of which only other lanes can be driven, each in one line."""


def find_roads(places: Iterable[Path | str], *, lane: int | None = None) -> FoundRoads:
    """The roads in files, see `read_road`, and in folders.

    In a folder every file that ends in .json or .xodr is read, and in the folders below it. One
    that holds no road is skipped there, since folders hold other files, too; one that lacks only
    the lane is told.

    Args:
        places: files and folders.
        lane: OpenDRIVE only, id of the lane to drive on.

    Raises:
        RoadError: no file holds a road, or a folder cannot be read.
    """
    roads: list[NamedRoad] = []
    faults: list[str] = []
    skipped: list[Path] = []
    other_lanes: list[str] = []
    places = require_list("places", places, "files and folders")
    for place in map(Path, places):
        is_folder = place.is_dir()
        for path in _files_in(place) if is_folder else [place]:
            try:
                chosen = lane if not is_folder or path.suffix.lower() == ".xodr" else None
                roads.append(NamedRoad(str(path), read_road(path, lane=chosen).road()))
            except RoadError as error:
                if is_folder and isinstance(error, LaneError):
                    other_lanes.append(str(error))
                elif is_folder:
                    skipped.append(path)
                else:
                    faults.append(str(error))
    if not roads and (told := [*faults, *other_lanes]):
        raise RoadError(told[0])
    if not roads:
        looked = ", ".join(map(str, places))
        raise RoadError(
            f"no road in {looked}: files with curvatures or road_points (.json) or OpenDRIVE"
            " (.xodr) are needed"
        )
    return FoundRoads(tuple(roads), tuple(faults), tuple(skipped), tuple(other_lanes))


def _files_in(folder: Path) -> list[Path]:
    try:
        return sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in _SUFFIXES and path.is_file()
        )
    except OSError as error:
        raise RoadError(f"cannot look into {folder}: {error.strerror or error}") from None
