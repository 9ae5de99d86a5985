"""Other programs read our OpenDRIVE files and find the lane at its place, without complaints."""

from __future__ import annotations

import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import environments
import numpy as np
import opendrive_readers as readers
import pytest

from frenetic.road import Road
from frenetic.road.opendrive import RoadMap, to_opendrive

if TYPE_CHECKING:
    from agreements import Agreements

pytestmark = pytest.mark.heavy

ROADS = readers.varied_roads()
HERE = Path(__file__).parent
LANELETS = "commonroad_lanelets.py"
NEW_IN_1_8 = "check_asam_xodr_junctions_connection_one_link_to_incoming"
GONE_IN_1_8 = "check_asam_xodr_junctions_connection_one_connection_element"

carla_has_a_wheel = pytest.mark.skipif(
    sys.version_info >= (3, 13)
    or sys.platform not in ("linux", "win32")
    or platform.machine() not in ("x86_64", "AMD64"),
    reason="CARLA is packaged for Linux and Windows on x86-64 and Python up to 3.12",
)
commonroad_can_be_installed = pytest.mark.skipif(
    sys.version_info >= (3, 14), reason="CommonRoad's Scenario Designer ends at Python 3.13"
)
checker_can_be_installed = pytest.mark.skipif(
    sys.version_info >= (3, 13), reason="the ASAM checker wants numpy 1, which ends at Python 3.12"
)


@carla_has_a_wheel
@pytest.mark.parametrize("name", ROADS)
def test_carla_finds_the_lane_within_a_centimetre(name: str) -> None:
    road = ROADS[name]
    lane = readers.read_with_carla(to_opendrive(road), road)
    assert lane.width == pytest.approx(road.lane_width)
    assert readers.distance_at_places(road, lane) < 0.01
    # CARLA ignores superelevation: its lanes are level across.
    assert readers.height_difference(road, lane) < 0.01


@carla_has_a_wheel
def test_carla_places_the_road_on_the_globe() -> None:
    import carla

    text = to_opendrive(ROADS["straight"], origin=(-33.5, 151.25))
    here, east = (
        carla.Map("road", text).transform_to_geolocation(carla.Location(x, 0.0, 0.0))
        for x in (0.0, 1000.0)
    )
    assert (here.latitude, here.longitude) == (pytest.approx(-33.5), pytest.approx(151.25))
    metres_per_degree = 111_320.0 * np.cos(np.radians(33.5))
    assert east.longitude - here.longitude == pytest.approx(1000.0 / metres_per_degree, rel=0.01)


@pytest.fixture(scope="module")
def netconverted() -> dict[str, readers.ReadLane]:
    """The lanes of all roads as SUMO's netconvert reads them."""
    return readers.read_with_sumo({name: to_opendrive(road) for name, road in ROADS.items()})


@pytest.mark.parametrize("name", ROADS)
def test_netconvert_finds_the_lane_within_15_centimetres(
    name: str, netconverted: dict[str, readers.ReadLane]
) -> None:
    road, lane = ROADS[name], netconverted[name]
    # netconvert gives a lane its largest width everywhere.
    widening = float(road.widening[:, 1].max(initial=0.0))
    assert lane.width == pytest.approx(road.lane_width + widening)
    assert readers.distance_from_line(road, lane) < 0.15 + 0.5 * widening


@pytest.mark.endurance
@checker_can_be_installed
def test_the_asam_checker_finds_nothing(
    agreements: Agreements, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    files = {}
    for i, (name, road) in enumerate(ROADS.items()):
        text = to_opendrive(road, name=name)
        files[tmp_path / f"{i}.xodr"] = text
        # Some rules hold in one version only, so a few roads are checked as the next version, too.
        if i % 10 < 2:
            files[tmp_path / f"{i}-8.xodr"] = text.replace('revMinor="7"', 'revMinor="8"')
    bad = tmp_path / "bad.xodr"
    files[bad] = to_opendrive(Road([0.0, 0.01])).replace('hdg="', 'heading="')
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
    checker, script = environments.OPENDRIVE_CHECKER, environments.ASAM_CHECKS
    texts = files.values()
    with agreements.upon("ASAM", checker, script.read_bytes(), *texts) as is_agreed:
        if is_agreed:
            return
        python = environments.python_with(checker, request)
        answers = environments.answers(python, script, "qc_opendrive", *files)
        issues_of_bad = answers.pop(str(bad))
        assert len(issues_of_bad["check_asam_xodr_xml_valid_schema"]) > 1
        assert len(answers) == len(files) - 1
        for file, answer in answers.items():
            skipped = {name for name, (status, *_) in answer.items() if status == "skipped"}
            assert skipped == {GONE_IN_1_8 if file.endswith("-8.xodr") else NEW_IN_1_8}
            assert len(answer) == 23
            assert all(status in ("completed", "skipped") for status, *_ in answer.values())
            assert not any(issues for _, *issues in answer.values())


def imported_roads() -> dict[str, Road]:
    """Return roads of other programs' files: lines that join an arc, a spiral or a polynomial."""
    bends = {
        "arc": '<arc curvature="0.066"/>',
        "spiral": '<spiral curvStart="0.01" curvEnd="0.01002"/>',
        "param": '<paramPoly3 bU="30" cV="5" dV="-2" pRange="normalized"/>',
    }
    header = '<header revMajor="1" revMinor="4"/>'
    lane = '<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
    lanes = f'<lanes><laneSection s="0"><right>{lane}</right></laneSection></lanes>'
    roads = {}
    for name, bend in bends.items():
        length = 30.234 if name == "param" else 31.4
        line = '<geometry s="0" x="-50" y="0" hdg="0" length="50"><line/></geometry>'
        curve = f'<geometry s="50" x="0" y="0" hdg="0" length="{length}">{bend}</geometry>'
        data = (
            f'<OpenDRIVE>{header}<road length="{50 + length}" id="1" junction="-1">'
            f"<planView>{line}{curve}</planView>{lanes}</road></OpenDRIVE>"
        )
        roads[f"imported {name}"] = RoadMap(data.encode()).road()
    return roads


@pytest.mark.endurance
@commonroad_can_be_installed
def test_commonroad_finds_the_lane_within_3_centimetres_and_places_it(
    agreements: Agreements, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    roads = ROADS | imported_roads()
    files = {tmp_path / f"{i}.xodr": road for i, road in enumerate(roads.values())}
    for path, road in files.items():
        path.write_text(to_opendrive(road), encoding="utf-8")
    elsewhere, bend = tmp_path / "elsewhere.xodr", ROADS["S-bend"]
    elsewhere.write_text(to_opendrive(bend, origin=(-33.5, 151.25)), encoding="utf-8")
    east = "+proj=tmerc +lat_0=-33.5 +lon_0=151.25 +x_0=1000 +datum=WGS84 +units=m"
    inputs = [path.read_bytes() for path in (HERE / LANELETS, *files, elsewhere)]
    with agreements.upon("CommonRoad", environments.COMMONROAD, east, *inputs) as is_agreed:
        if is_agreed:
            return
        python = environments.python_with(environments.COMMONROAD, request)
        answers = environments.answers(python, HERE / LANELETS, *files, east, elsewhere)
        assert len(answers) == len(files) + 1
        for path, road in files.items():
            lanes = answers[str(path)]
            assert isinstance(lanes, list), lanes
            distances = [
                readers.distance_from_line(road, readers.ReadLane(np.array(lane), road.lane_width))
                for lane in lanes
            ]
            assert min(distances) < 0.03
        moved = [np.array(lane) - [1000.0, 0.0] for lane in answers[str(elsewhere)]]
        assert (
            min(readers.distance_from_line(bend, readers.ReadLane(at, 4.0)) for at in moved) < 0.03
        )
