"""Roads in files and folders: all roads of several places, such as a folder of real roads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from frenetic._support.files import require_list
from frenetic.errors import RoadError
from frenetic.road.files import MAP_SUFFIX, NO_OPENDRIVE, load_bytes, path_in_errors, read_road
from frenetic.road.opendrive import RoadMap
from frenetic.road.road import Road

_SUFFIXES: Final = {".json", MAP_SUFFIX}
"""Suffixes of the files that are read in a folder."""


@dataclass(frozen=True)
class FoundRoads:
    """The roads of files and folders, in the order of their names within each folder."""

    roads: Mapping[str, Road]
    """Path of a file -> its road. A road of a map has the path and its id, such as
    ``town.xodr road 12``."""
    skipped: tuple[str, ...]
    """Errors, one line each: of files in folders that hold no road, then of unreadable roads in
    maps."""


def find_roads(places: Iterable[Path | str]) -> FoundRoads:
    """Return the roads in files and folders.

    A file is read by `read_road`; a map (.xodr) contributes each readable road outside junctions.
    In a folder and the folders below it, every file that ends in .json or .xodr is read, and files
    without a road are skipped, since folders hold other files, too.

    Args:
        places: files and folders.

    Raises:
        RoadError: a named file or all files of the folders hold no road, or a folder cannot be
            read.
    """
    roads: dict[str, Road] = {}
    skipped: list[str] = []
    skipped_roads: list[str] = []
    places = require_list("places", places, "files and folders")
    for place in map(Path, places):
        is_folder = place.is_dir()
        for path in _files_in(place) if is_folder else [place]:
            try:
                if path.suffix.lower() == MAP_SUFFIX:
                    skipped_roads += _add_map(roads, path)
                else:
                    roads[str(path)] = read_road(path).road()
            except RoadError as error:
                if not is_folder:
                    raise
                skipped.append(str(error))
    if not roads:
        texts = ", ".join(map(str, places))
        no_road = (
            f"no road in {texts}: files with curvatures or road_points (.json) or OpenDRIVE"
            " (.xodr) are needed"
        )
        raise RoadError([*skipped, *skipped_roads, no_road][0])
    return FoundRoads(roads, (*skipped, *skipped_roads))


def _add_map(roads: dict[str, Road], path: Path) -> list[str]:
    """Add the roads of an OpenDRIVE file outside junctions; return the errors of unreadable roads.

    Args:
        roads: path of a file, and id of a road -> the road; the roads are added.
        path: the file.

    Raises:
        RoadError: the file, or its only road, cannot be read.
    """
    skipped: list[str] = []
    with path_in_errors(path, NO_OPENDRIVE):
        road_map = RoadMap(load_bytes(path))
        lengths = road_map.lengths
        if len(lengths) < 2:
            roads[str(path)] = road_map.road(next(iter(lengths), None))
            return skipped
    for road_id in lengths:
        try:
            with path_in_errors(path, NO_OPENDRIVE):
                road = road_map.road(road_id)
        except RoadError as error:
            skipped.append(str(error))
        else:
            roads[f"{path} road {road_id}"] = road
    return skipped


def _files_in(folder: Path) -> list[Path]:
    """Return the files in a folder and below it that may hold roads, in the order of their paths.

    Raises:
        RoadError: the folder cannot be read.
    """
    try:
        return sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in _SUFFIXES and path.is_file()
        )
    except OSError as error:
        raise RoadError(f"cannot look into {folder}: {error.strerror or error}") from None
