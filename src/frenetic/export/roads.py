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

Distance along, place, heading and curvature of the centre line; centre of the ego lane; left edge
and right edge of the road; height of the centre line above its start, slope to the right. The ego
lane lies between the centre line and the right edge.
"""


SCENARIO: Final = ".xosc"
"""Suffix of the scenario beside an OpenDRIVE file."""


@dataclass(frozen=True)
class ExportedRoad:
    """A road with everything else that its file contains."""

    road: Road
    name: str
    """Name of the road, for a file with a place for it."""
    rules: Rules = field(default_factory=Rules)
    """Rules of its drives, which say its speed limits."""
    test: Test | None = None
    """The campaign's test with this road, if any."""
    origin: tuple[float, float] = ORIGIN
    """Latitude and longitude of (0, 0), in degrees; only OpenDRIVE knows them."""

    def __post_init__(self) -> None:
        try:
            convert(self.origin, tuple[Finite, Finite])
        except ValidationError:
            raise ValueError(
                f"origin is {self.origin!r}: [latitude, longitude] in degrees is needed"
            ) from None


class RoadFormat(NamedTuple):
    """A way to write down a road."""

    name: str
    suffix: str
    """Suffix of the file's name, different for each format."""
    render: Callable[[ExportedRoad], str]
    """Function that returns the file's text."""


def _opendrive(exported: ExportedRoad) -> str:
    return to_opendrive(
        replace(exported.road, speed_limits=exported.rules.speed_limits_on(exported.road)),
        name=exported.name,
        origin=exported.origin,
    )


def _competition(exported: ExportedRoad) -> str:
    if exported.test is not None:
        document = stored_test_document(exported.test)
    else:
        # In place if it fits there, or else where 'frenetic drive' would move it.
        fitted, verdict = exported.road.placed(MAP_SIZE)
        document = competition_document(fitted or exported.road, 1, verdict)
    return json.dumps(document) + "\n"


def _csv(exported: ExportedRoad) -> str:
    road = exported.road
    table = road.table
    places = np.arange(len(table)) * road.sub_step
    wider = profile.value_at(road.widening, places)[:, None]
    middle, left, right = (
        road.sample(road.sub_step, share * road.lane_width) for share in (-0.5, 1.0, -1.0)
    )
    outwards = (left - right) / (2.0 * road.lane_width) * wider
    columns = np.column_stack(
        [
            places,
            table[:, : CURVATURE + 1],
            *(middle, left + outwards, right - outwards),
            road.heights(places),
            profile.value_at(road.superelevation, places),
        ]
    )
    lines = [",".join(CSV_COLUMNS)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in columns.tolist()]
    return "\n".join(lines) + "\n"


def _json(exported: ExportedRoad) -> str:
    return json.dumps(entries_of(exported.road)) + "\n"


def _beamng(exported: ExportedRoad) -> str:
    road = exported.road
    places = road.distances()
    height = GROUND + road.heights(places).round(6)
    width = 2.0 * (road.lane_width + profile.value_at(road.widening, places))
    nodes = np.column_stack([road.road_points.round(6), height, width]).tolist()
    return "[\n" + ",\n".join(map(json.dumps, nodes)) + "\n]\n"


FORMATS: Final[Mapping[str, RoadFormat]] = MappingProxyType(
    {
        item.name: item
        for item in (
            RoadFormat("opendrive", ".xodr", _opendrive),
            RoadFormat("competition", ".competition.json", _competition),
            RoadFormat("csv", ".csv", _csv),
            RoadFormat("json", ".json", _json),
            RoadFormat("beamng", ".beamng.json", _beamng),
        )
    }
)
"""Name -> format."""


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
    """Return the format of a file's name, by its suffix.

    Raises:
        UnknownNameError: several formats have the suffix, or none.
    """
    named = [item for item in FORMATS.values() if Path(path).name.lower().endswith(item.suffix)]
    longest = max((item.suffix for item in named), key=len, default="")
    # A name that ends in just .json may be meant for any of the formats that are JSON.
    possible = [item for item in FORMATS.values() if item.suffix.endswith(longest)]
    if len(possible) > 1:
        known = ", ".join(item.name for item in possible)
        raise UnknownNameError(f"{path} does not say its format: choose a format from {known}")
    return possible[0]


def write_road(exported: ExportedRoad, name: str, path: Path | str) -> None:
    """Write a road to a file in the format with this name, whole or not at all.

    Beside an OpenDRIVE file comes an OpenSCENARIO file of the same name, with the suffix ``.xosc``.

    Raises:
        UnknownNameError: no format has this name.
        FreneticError: a file cannot be written, or road and scenario would have the same name.
    """
    path = Path(path)
    texts = {path: road_format(name).render(exported)}
    if name == "opendrive":
        beside = path.with_suffix(SCENARIO)
        if path == beside:
            raise FreneticError(
                f"{path} would be the name of the scenario beside the road: choose one that ends in"
                " .xodr"
            )
        text = to_openscenario(exported.road, path.name, name=exported.name, rules=exported.rules)
        texts[beside] = text
    for file, text in texts.items():
        # Bytes, since text files have other line ends on Windows.
        write_file(file, text.encode("utf-8"), remedy="choose another place", parents=True)
