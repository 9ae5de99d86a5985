"""Exported roads have the place, shape and units of each format."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frenetic.errors import FreneticError
from frenetic.export import FORMATS, ExportedRoad, road_format, to_openscenario, write_road
from frenetic.export.roads import CSV_COLUMNS
from frenetic.road import Road
from frenetic.road.files import read_road
from frenetic.simulators import Rules

ROAD = Road([0.0, 0.01, 0.05, -0.03, -0.03], 10.0, (60.0, 70.0, 1.0), lane_width=3.5)


def write(tmp_path: Path, name: str, road: Road = ROAD) -> Path:
    path = tmp_path / f"road{road_format(name).suffix}"
    write_road(ExportedRoad(road, "road", Rules(speed_limit=50.0)), name, path)
    return path


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_bytes_twice(tmp_path: Path, name: str) -> None:
    first = write(tmp_path, name).read_bytes()
    second = write(tmp_path, name, Road(ROAD.curvatures, 10.0, ROAD.pose, lane_width=3.5))
    assert second.read_bytes() == first
    assert first.endswith(b"\n")
    assert b"\r" not in first
    beside = {"road.xosc"} if name == "opendrive" else set()
    assert {path.name for path in tmp_path.iterdir()} == {second.name} | beside


@pytest.mark.parametrize("name", ["opendrive", "json"])
def test_an_exported_road_is_read_back_the_same(tmp_path: Path, name: str) -> None:
    road = read_road(write(tmp_path, name)).road()
    assert road.curvatures.tolist() == ROAD.curvatures.tolist()
    assert (road.step, road.pose, road.lane_width) == (10.0, ROAD.pose, 3.5)


def test_a_scenario_lies_beside_an_opendrive_file(tmp_path: Path) -> None:
    write_road(
        ExportedRoad(ROAD, "mine", Rules(speed_limit=50.0)), "opendrive", tmp_path / "a b.1.xodr"
    )
    text = (tmp_path / "a b.1.xosc").read_text()
    assert text == to_openscenario(ROAD, "a b.1.xodr", name="mine", rules=Rules(speed_limit=50.0))
    assert {path.name for path in tmp_path.iterdir()} == {"a b.1.xodr", "a b.1.xosc"}
    with pytest.raises(FreneticError, match=r"choose one that ends in \.xodr"):
        write_road(ExportedRoad(ROAD, "mine"), "opendrive", tmp_path / "road.xosc")


@pytest.mark.parametrize("step", [0.3, 0.7, 3.0, 10.0])
def test_csv_has_centre_line_lane_and_edges_every_metre(tmp_path: Path, step: float) -> None:
    road = Road([0.0, 0.03, -0.05, 0.01], step, (60.0, 70.0, 1.0))
    with write(tmp_path, "csv", road).open(newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == CSV_COLUMNS
    table = np.array(rows, dtype=float)
    distance = table[:, 0]
    assert (distance[0], distance[-1]) == (0.0, pytest.approx(road.length))
    assert np.diff(distance).max() <= 1.0 + 1e-6
    for row in table:
        pose = road.pose_at(row[0])
        assert row[1:4] == pytest.approx(tuple(pose), abs=1e-6)
        assert row[4] == pytest.approx(float(road.curvature_at(row[0] - 1e-9)), abs=1e-6)
    for columns, offset in ((slice(5, 7), -2.0), (slice(7, 9), 4.0), (slice(9, 11), -4.0)):
        track = road.track(table[:, columns])
        assert track[:, 1] == pytest.approx(offset, abs=1e-5)
        assert track[:, 0] == pytest.approx(distance, abs=1e-5)


def test_csv_and_beamng_nodes_have_height_tilt_and_width(tmp_path: Path) -> None:
    road = replace(
        ROAD,
        grade=np.array([[0.0, 0.05]]),
        superelevation=np.array([[0.0, 0.03]]),
        widening=np.array([[0.0, 0.0], [ROAD.length, 1.0]]),
    )
    table = np.loadtxt(write(tmp_path, "csv", road), delimiter=",", skiprows=1)
    distance = table[:, 0]
    wider = 3.5 + distance / road.length
    for columns, side in ((slice(7, 9), 1.0), (slice(9, 11), -1.0)):
        assert road.track(table[:, columns])[:, 1] == pytest.approx(side * wider, abs=1e-5)
    assert table[:, 11] == pytest.approx(0.05 * distance, abs=1e-6)
    assert set(table[:, 12]) == {0.03}
    nodes = np.array(json.loads(write(tmp_path, "beamng", road).read_text()))
    assert nodes[-1, 2] == pytest.approx(-28.0 + 0.05 * road.length)
    assert nodes[-1, 3] == pytest.approx(9.0)


def test_the_competition_format_moves_a_road_onto_the_map(tmp_path: Path) -> None:
    far = Road([0.0, 0.02, 0.0, -0.02, 0.0], pose=(5000.0, -300.0, 2.0))
    document = json.loads(write(tmp_path, "competition", far).read_text())
    assert document["is_valid"] is True
    points = np.array(document["road_points"])
    assert points.min() > 0.0
    assert points.max() < 200.0
    endless = json.loads(write(tmp_path, "competition", Road([0.0] * 50)).read_text())
    assert endless["is_valid"] is False
    assert "does not fit" in endless["validation_message"]


def test_a_failed_export_leaves_no_files(tmp_path: Path) -> None:
    exported = ExportedRoad(ROAD, "road")
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder").mkdir()
    for place in ("file/road.csv", "folder"):
        with pytest.raises(FreneticError, match=r"cannot be written: .*; choose another place"):
            write_road(exported, "csv", tmp_path / place)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "in the way"
