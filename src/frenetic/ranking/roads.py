"""The roads of files and folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from frenetic.errors import LaneError, RoadError
from frenetic.road import Road
from frenetic.road.files import read_road

_SUFFIXES = {".json", ".xodr"}


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


def find_roads(places: Sequence[Path], *, lane: int | None = None) -> FoundRoads:
    """The roads in files, see `frenetic.road.files.read_road`, and in folders.

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
    for place in places:
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
