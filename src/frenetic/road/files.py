"""Roads in files: JSON with curvatures or road points, competition test files, OpenDRIVE."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from frenetic.errors import RoadError
from frenetic.road.opendrive import from_opendrive
from frenetic.road.road import MAX_SAMPLES, START, Pose, Road, checked_lane_width
from frenetic.road.validity import MAP_SIZE, Verdict, check_validity

MAX_BYTES: Final = 8 * 2**20
"""Largest road file that is read; a competition's test file of a long drive has about 1 MiB."""


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
    An OpenDRIVE file, known by its suffix ``.xodr`` or by being XML, holds one road or a chain of
    them, see `from_opendrive`; ``lane`` is the id of the lane to drive on there.

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
