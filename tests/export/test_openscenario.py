"""The scenario beside an OpenDRIVE file, also checked by ASAM's checker and CARLA.

Set FRENETIC_ESMINI to the path of an esmini, which then plays the scenarios, too.
"""

from __future__ import annotations

import csv
import math
import os
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import environments
import pytest

from frenetic.export import ExportedRoad, to_openscenario, write_road
from frenetic.road import Road
from frenetic.road.opendrive import to_opendrive
from frenetic.simulators import Rules

if TYPE_CHECKING:
    from agreements import Agreements

ESMINI = os.environ.get("FRENETIC_ESMINI")
WINDING = [0.0, 0.02, 0.05, -0.03, 0.0, 0.01, 0.0]
ROADS = {
    "winding": Road(WINDING, 10.0, (60.0, 70.0, 1.0)),
    "straight": Road([0.0] * 20),
    "short": Road([0.01, 0.02], 25.0),
    "narrow": Road(WINDING, lane_width=2.75),
}

carla_has_a_wheel = pytest.mark.skipif(
    sys.version_info >= (3, 13)
    or sys.platform not in ("linux", "win32")
    or platform.machine() not in ("x86_64", "AMD64"),
    reason="CARLA is packaged for Linux and Windows on x86-64 and Python up to 3.12",
)


def scenario(road: Road, **rules: Any) -> ElementTree.Element:
    return ElementTree.fromstring(
        to_openscenario(road, "road.xodr", rules=replace(Rules(), **rules))
    )


def places(root: ElementTree.Element) -> list[float]:
    """Return the distance along the road of each position; all lie on the ego lane's centre."""
    distances = []
    for lane in root.iter("LanePosition"):
        assert (lane.get("roadId"), lane.get("laneId"), lane.get("offset")) == ("1", "-1", "0.0")
        distances.append(float(lane.attrib["s"]))
    return distances


def test_the_description_is_the_name_also_where_limits_change() -> None:
    road = Road([0.0] * 20, speed_limits=[[0.0, 50.0], [60.0, 30.0], [120.0, 80.0]])
    header = ElementTree.fromstring(to_openscenario(road, "road.xodr", name="hill")).find(
        "FileHeader"
    )
    assert header is not None
    assert header.get("description") == "hill"


def test_a_scenario_has_start_speed_route_and_end() -> None:
    road = ROADS["winding"]
    root = scenario(road, speed_limit=90.0, goal_distance=6.0)
    header, file = root.find("FileHeader"), root.find("RoadNetwork/LogicFile")
    assert header is not None
    assert (header.get("revMajor"), header.get("revMinor")) == ("1", "0")
    assert file is not None
    assert file.attrib == {"filepath": "road.xodr"}
    start, goal = 2.5, road.length - 0.01
    init = root.find("Storyboard/Init")
    assert init is not None
    # There is only one position: CARLA's runner starts at the last.
    assert places(init) == [start]
    assert [float(s.attrib["value"]) for s in init.iter("AbsoluteTargetSpeed")] == [0.0]
    story = root.find("Storyboard/Story")
    assert story is not None
    (route,) = story.iter("Route")
    assert places(route) == [start, pytest.approx(goal)]
    assert [float(s.attrib["value"]) for s in story.iter("AbsoluteTargetSpeed")] == [25.0]
    for parent in ("Storyboard", "Storyboard/Story/Act"):
        stop = root.find(f"{parent}/StopTrigger")
        assert stop is not None
        assert places(stop) == [pytest.approx(goal)]
        (reached,) = stop.iter("ReachPositionCondition")
        assert float(reached.attrib["tolerance"]) == 6.0
        (late,) = stop.iter("SimulationTimeCondition")
        assert float(late.attrib["value"]) == Rules().timeout(road.length)
        assert late.get("rule") == "greaterThan"


def test_the_same_road_gives_the_same_bytes() -> None:
    text = to_openscenario(Road(WINDING), "road.xodr")
    assert text == to_openscenario(Road(WINDING), "road.xodr")
    assert text.endswith("</OpenSCENARIO>\n")


def test_characters_that_xml_cannot_hold_are_replaced() -> None:
    text = to_openscenario(ROADS["short"], "a\x00<b>.xodr", name="\x07")
    root = ElementTree.fromstring(text.encode())
    file, header = root.find("RoadNetwork/LogicFile"), root.find("FileHeader")
    assert file is not None
    assert header is not None
    assert (file.get("filepath"), header.get("description")) == ("a?<b>.xodr", "?")


@pytest.mark.heavy
@carla_has_a_wheel
@pytest.mark.parametrize("name", ROADS)
def test_carla_finds_every_position(name: str) -> None:
    import carla

    road = ROADS[name]
    carla_map = carla.Map("road", to_opendrive(road))
    for place in places(scenario(road)):
        waypoint = carla_map.get_waypoint_xodr(1, -1, place)
        assert waypoint is not None
        x, y, heading = road.pose_at(place)
        half = 0.5 * road.lane_width
        assert waypoint.transform.location.x == pytest.approx(
            x + half * math.sin(heading), abs=0.01
        )
        assert -waypoint.transform.location.y == pytest.approx(
            y - half * math.cos(heading), abs=0.01
        )


@pytest.mark.heavy
@pytest.mark.endurance
def test_the_asam_checker_finds_no_issue(
    agreements: Agreements, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    files = []
    for name, road in ROADS.items():
        path = tmp_path / f"{name}.xodr"
        write_road(ExportedRoad(road, name), "opendrive", path)
        text = path.with_suffix(".xosc").read_text()
        files.append(path.with_suffix(".xosc"))
        # Most rules exist only in later versions: the scenario is checked as these, too.
        for minor in (1, 2, 3):
            files.append(tmp_path / f"{name}-{minor}.xosc")
            files[-1].write_text(text.replace('revMinor="0"', f'revMinor="{minor}"'))
    bad = tmp_path / "bad.xosc"
    bad.write_text(text.replace("<CatalogLocations />", ""))
    checker, script = environments.OPENSCENARIO_CHECKER, environments.ASAM_CHECKS
    texts = [path.read_bytes() for path in (*files, bad)]
    with agreements.upon("ASAM", checker, script.read_bytes(), *texts) as is_agreed:
        if is_agreed:
            return
        python = environments.python_with(checker, request)
        answers = environments.answers(python, script, "qc_openscenario", *files, bad)
        assert len(answers.pop(str(bad))["check_asam_xosc_xml_valid_schema"]) > 1
        assert len(answers) == 16
        for file, answer in answers.items():
            assert answer["check_asam_xosc_xml_valid_schema"] == ["completed"]
            assert len(answer) == 17
            completed = [status for status, *issues in answer.values() if status == "completed"]
            assert len(completed) == (17 if file.endswith(("-2.xosc", "-3.xosc")) else 5)
            assert not any(issues for _, *issues in answer.values())


@pytest.mark.skipif(ESMINI is None, reason="FRENETIC_ESMINI names no esmini")
@pytest.mark.parametrize("name", ROADS)
def test_esmini_drives_from_the_start_to_the_goal(name: str, tmp_path: Path) -> None:
    road, log = ROADS[name], tmp_path / "log.csv"
    write_road(ExportedRoad(road, name), "opendrive", tmp_path / "road.xodr")
    command = [str(ESMINI), "--osc", "road.xosc", "--headless", "--fixed_timestep", "0.05"]
    command += ["--csv_logger", str(log)]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stdout
    assert "at the goal: true" in process.stdout
    with log.open(newline="") as file:
        rows = [row for row in csv.reader(file) if len(row) > 20]
    columns = [title.strip() for title in rows[0]]
    x, y, speed = (
        columns.index(f"#1 {t}")
        for t in ("World_Position_X [m]", "World_Position_Y [m]", "Current_Speed [m/s]")
    )
    path = [(float(row[x]), float(row[y])) for row in rows[1:]]
    track = road.track(path)
    assert track[0, 0] == pytest.approx(places(scenario(road))[0], abs=0.05)
    assert track[:, 1] == pytest.approx(-0.5 * road.lane_width, abs=0.05)
    assert float(rows[1][speed]) == 0.0
