"""One road as a file for other tools: OpenDRIVE, competition JSON, CSV, our own JSON, BeamNG."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from msgspec import ValidationError, convert

from frenetic._support.bounds import Finite
from frenetic._support.files import write_file
from frenetic.campaign.record import Test
from frenetic.errors import FreneticError, UnknownNameError
from frenetic.export.official_format import GROUND, competition_document, stored_test_document
from frenetic.export.openscenario import to_openscenario
from frenetic.road import MAP_SIZE, Road, profile
from frenetic.road.files import entries_of
from frenetic.road.geometry import CURVATURE
from frenetic.road.opendrive import ORIGIN, to_opendrive
from frenetic.simulators import Rules

CSV_COLUMNS: Final = (
    "distance_m",
    "x_m",
    "y_m",
    "heading_rad",
    "curvature_per_m",
    "lane_x_m",
    "lane_y_m",
    "left_edge_x_m",
    "left_edge_y_m",
    "right_edge_x_m",
    "right_edge_y_m",
    "height_m",
    "superelevation",
)
"""Columns of the CSV format.

``distance_m`` to ``curvature_per_m`` belong to the centre line, ``lane_x_m`` and ``lane_y_m`` to
the centre of the ego lane, the edges to the road: the ego lane lies between the centre line and the
right edge. ``height_m`` is the centre line's height above its start, ``superelevation`` the slope
to the right.
"""


SCENARIO: Final = ".xosc"
"""Suffix of the scenario beside an OpenDRIVE file."""


@dataclass(frozen=True)
class ExportedRoad:
    """A road with what else its file contains."""

    road: Road
    name: str
    """Name of the road, in formats that hold a name."""
    rules: Rules = field(default_factory=Rules)
    """Rules of the road's drives, which include speed limits."""
    test: Test | None = None
    """The campaign's test with this road, if any."""
    origin: tuple[float, float] = ORIGIN
    """Latitude and longitude of the map's origin, in degrees; only OpenDRIVE holds them."""

    def __post_init__(self) -> None:
        try:
            convert(self.origin, tuple[Finite, Finite])
        except ValidationError:
            raise ValueError(
                f"origin is {self.origin!r}: [latitude, longitude] in degrees is needed"
            ) from None


class RoadFormat(NamedTuple):
    """A format of road files."""

    name: str
    """Name of the format, as ``frenetic export --format`` takes it."""
    suffix: str
    """Suffix of the file's name, different for each format."""
    render: Callable[[ExportedRoad], str]
    """Function that returns the file's text."""


def _opendrive(exported: ExportedRoad) -> str:
    """Return the road as OpenDRIVE."""
    return to_opendrive(
        replace(exported.road, speed_limits=exported.rules.speed_limits_on(exported.road)),
        name=exported.name,
        origin=exported.origin,
    )


def _competition(exported: ExportedRoad) -> str:
    """Return the road's test, or the road as a test without outcome, as the competition's JSON."""
    if exported.test is not None:
        document = stored_test_document(exported.test)
    else:
        # A road that leaves the map is moved as 'frenetic drive' would move it.
        fitted, verdict = exported.road.placed(MAP_SIZE)
        document = competition_document(fitted or exported.road, test_id=1, verdict=verdict)
    return json.dumps(document) + "\n"


def _csv(exported: ExportedRoad) -> str:
    """Return the road as CSV, with a row for each row of its table."""
    road = exported.road
    table = road.table
    distances = np.arange(len(table)) * road.sub_step
    lane_centre, left_edge, right_edge = (
        road.sample(road.sub_step, share * road.lane_width) for share in (-0.5, 1.0, -1.0)
    )
    to_left = (left_edge - right_edge) / (2.0 * road.lane_width)  # unit vectors
    widened = to_left * profile.value_at(road.widening, distances)[:, None]
    columns = np.column_stack(
        [
            distances,
            table[:, : CURVATURE + 1],
            *(lane_centre, left_edge + widened, right_edge - widened),
            road.heights(distances),
            profile.value_at(road.superelevation, distances),
        ]
    )
    lines = [",".join(CSV_COLUMNS)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in columns.tolist()]
    return "\n".join(lines) + "\n"


def _json(exported: ExportedRoad) -> str:
    """Return the road as our own JSON."""
    return json.dumps(entries_of(exported.road)) + "\n"


def _beamng(exported: ExportedRoad) -> str:
    """Return the road as nodes of a BeamNG decal road: x, y, height and width, in m."""
    road = exported.road
    distances = road.distances()
    height = GROUND + road.heights(distances).round(6)
    width = 2.0 * (road.lane_width + profile.value_at(road.widening, distances))
    nodes = np.column_stack([road.road_points.round(6), height, width]).tolist()
    return "[\n" + ",\n".join(map(json.dumps, nodes)) + "\n]\n"


FORMATS: Final[Mapping[str, RoadFormat]] = MappingProxyType(
    {
        road_format.name: road_format
        for road_format in (
            RoadFormat("opendrive", ".xodr", _opendrive),
            RoadFormat("competition", ".competition.json", _competition),
            RoadFormat("csv", ".csv", _csv),
            RoadFormat("json", ".json", _json),
            RoadFormat("beamng", ".beamng.json", _beamng),
        )
    }
)
"""Name -> format of road files."""


def road_format(name: str) -> RoadFormat:
    """Return the format with this name.

    Raises:
        UnknownNameError: no format has this name.
    """
    if name not in FORMATS:
        known = ", ".join(FORMATS)
        raise UnknownNameError(f"no road format is called {name!r}: choose from {known}")
    return FORMATS[name]


def format_of(path: Path | str) -> RoadFormat:
    """Return the format that the suffix of a file's name stands for.

    Raises:
        UnknownNameError: several formats have the suffix, or none.
    """
    name = Path(path).name.lower()
    suffixes = [known.suffix for known in FORMATS.values() if name.endswith(known.suffix)]
    longest = max(suffixes, key=len, default="")
    # A name that ends in just .json may be meant for any of the formats that are JSON.
    possible = [known for known in FORMATS.values() if known.suffix.endswith(longest)]
    if len(possible) > 1:
        known = ", ".join(choice.name for choice in possible)
        raise UnknownNameError(f"{path} does not say its format: choose a format from {known}")
    return possible[0]


def write_road(exported: ExportedRoad, name: str, path: Path | str) -> None:
    """Write a road to a file, whole or not at all.

    An OpenDRIVE file gets an OpenSCENARIO file of the same name, with the suffix ``.xosc``, beside
    it.

    Args:
        exported: the road.
        name: name of the format.
        path: path of the file; an existing file is replaced.

    Raises:
        UnknownNameError: no format has this name.
        FreneticError: a file cannot be written, or the path ends in ``.xosc``, the suffix of the
            scenario.
    """
    path = Path(path)
    texts = {path: road_format(name).render(exported)}
    if name == "opendrive":
        scenario_path = path.with_suffix(SCENARIO)
        if path == scenario_path:
            raise FreneticError(
                f"{path} would be the name of the scenario beside the road: choose one that ends in"
                " .xodr"
            )
        texts[scenario_path] = to_openscenario(
            exported.road, path.name, name=exported.name, rules=exported.rules
        )
    for file, text in texts.items():
        # Bytes, since text files have other line ends on Windows.
        write_file(file, text.encode("utf-8"), remedy="choose another place", parents=True)
