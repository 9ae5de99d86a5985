"""Speed limits along a road: read from maps, kept in files, applied by rules."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.errors import RoadError
from frenetic.oracle.drive import Rules
from frenetic.road import Road, profile
from frenetic.road.files import entries_of, read_road
from frenetic.road.opendrive import RoadMap, to_opendrive

LIMITS = st.lists(
    st.tuples(st.integers(0, 250), st.sampled_from([0.0, 20.0, 30.5, 50.0, 130.0])),
    max_size=5,
    unique_by=lambda pair: pair[0],
).map(sorted)


def road_map(types: str, right: str = "", left: str = "", *, sections: str = "") -> RoadMap:
    """Return a map of one straight road of 200 m with a lane on each side."""
    width = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
    lanes = sections or (
        f'<laneSection s="0"><left><lane id="1" type="driving">{width}{left}</lane></left>'
        f'<right><lane id="-1" type="driving">{width}{right}</lane></right></laneSection>'
    )
    text = (
        '<OpenDRIVE><header revMajor="1" revMinor="7"/><road id="1" length="200" junction="-1">'
        f'{types}<planView><geometry s="0" x="0" y="0" hdg="0" length="200"><line/></geometry>'
        f"</planView><lanes>{lanes}</lanes></road></OpenDRIVE>"
    )
    return RoadMap(text.encode())


def type_of(s: float, speed: str) -> str:
    """Return a `<type>` of a road, from s m on, with a speed."""
    return f'<type s="{s}" type="town">{speed}</type>'


@pytest.mark.parametrize(
    ("speed", "limit"),
    [
        ('<speed max="50" unit="km/h"/>', 50.0),
        ('<speed max="50" unit="KM/H"/>', 50.0),
        ('<speed max="30" unit="mph"/>', 48.28032),
        ('<speed max="10" unit="m/s"/>', 36.0),
        ('<speed max="10"/>', 36.0),  # m/s is the default unit of the standard
    ],
)
def test_a_limit_is_read_in_its_unit_and_written_in_kmh(speed: str, limit: float) -> None:
    of_type = road_map(type_of(0, speed)).road()
    of_lane = road_map(
        type_of(0, '<speed max="70"/>'), speed.replace("<speed", '<speed sOffset="0"')
    )
    assert of_type.speed_limits.tolist() == [[0.0, pytest.approx(limit)]]
    assert of_lane.road().speed_limits.tolist() == [[0.0, pytest.approx(limit)]]
    assert Rules().start_limit_on(of_type) == pytest.approx(limit / 3.6)
    text = to_opendrive(of_type)
    assert text.count(f'max="{limit!r}" unit="km/h"') == 3  # the road's type, and both lanes


@pytest.mark.parametrize("text", ["no limit", "undefined", "0", "-1", "999", "1e-9"])
def test_a_road_has_no_limit_where_its_map_has_none(text: str) -> None:
    road = road_map(type_of(0, f'<speed max="{text}" unit="km/h"/>')).road()
    assert len(road.speed_limits) == 0
    assert Rules(speed_limit=80.0).speed_limits_on(road).tolist() == [[0.0, 80.0]]


@pytest.mark.parametrize(
    ("speed", "message"),
    [
        ('<speed max="50" unit="knots"/>', "unit='knots': km/h, kmh, kph, mph, m/s are known"),
        ('<speed max="fast"/>', "max='fast'"),
        ('<speed max="nan"/>', "max='nan'"),
    ],
)
def test_a_limit_that_is_no_speed_is_refused(speed: str, message: str) -> None:
    with pytest.raises(RoadError, match="a <speed> has") as error:
        road_map(type_of(0, speed)).road()
    assert message in str(error.value)


def test_the_limit_of_a_lane_overrides_the_limit_of_the_road_type() -> None:
    types = type_of(0, '<speed max="100" unit="km/h"/>') + type_of(
        150, '<speed max="80" unit="km/h"/>'
    )
    right = '<speed sOffset="40" max="60" unit="km/h"/><speed sOffset="90" max="no limit"/>'
    left = '<speed sOffset="120" max="30" unit="km/h"/>'
    roads = road_map(types, right, left)
    assert_steps(roads.road(), [(0, 100), (40, 60), (90, 100), (150, 80)])
    # Against the road's direction, the 30 km/h hold from 200 m down to 120 m.
    assert_steps(roads.road(lane=1), [(0, 30), (80, 100)])


def assert_steps(road: Road, expected: list[tuple[float, float]]) -> None:
    """Assert the road's limits, in km/h, and their places, in m."""
    assert road.speed_limits[:, 1].tolist() == [limit for _, limit in expected]
    assert road.speed_limits[:, 0] == pytest.approx([s for s, _ in expected], abs=0.06)


def test_limits_continue_along_a_stretch_of_roads(tmp_path: Path) -> None:
    first = Road(np.zeros(11), speed_limits=[(0, 50), (60, 70)])
    second = Road(np.zeros(6), pose=first.pose_at(100.0), speed_limits=[(0, 70), (20, 30)])
    roads = [to_opendrive(road) for road in (first, second)]
    body = [text[text.index("<road ") : text.index("</road>") + len("</road>")] for text in roads]
    body[1] = body[1].replace('id="1"', 'id="2"', 1)
    path = tmp_path / "two.xodr"
    path.write_text(
        f'<OpenDRIVE><header revMajor="1" revMinor="7"/>{"".join(body)}</OpenDRIVE>',
        encoding="utf-8",
    )
    assert_steps(read_road(path, roads="1,2").road(), [(0, 50), (60, 70), (120, 30)])
    assert_steps(read_road(path, roads="1@70,2").road(), [(0, 70), (50, 30)])


@given(LIMITS)
def test_limits_are_read_back_from_road_files_and_opendrive(
    pairs: list[tuple[float, float]],
) -> None:
    road = Road(np.zeros(21), speed_limits=pairs)
    entries = json.loads(json.dumps(entries_of(road)))
    assert ("speed_limits" in entries) == any(limit for _, limit in pairs)
    read = Road(entries["curvatures"], speed_limits=entries.get("speed_limits", ()))
    assert np.array_equal(read.speed_limits, road.speed_limits)
    read_map = RoadMap(to_opendrive(road, speed_limit=70.0).encode()).road()
    places = np.linspace(0.0, 199.9, 1000)
    expected = profile.steps_at(Rules(speed_limit=70.0).speed_limits_on(road), places)
    assert np.array_equal(profile.steps_at(read_map.speed_limits, places), expected)


@given(LIMITS, st.integers(0, 19), st.integers(1, 20))
def test_a_piece_of_a_road_keeps_its_limits(
    pairs: list[tuple[float, float]], first: int, count: int
) -> None:
    road = Road(np.zeros(41), speed_limits=pairs)
    piece = road.piece(first, first + count)
    places = np.arange(0.0, piece.length, 0.5)
    expected = profile.steps_at(road.speed_limits, places + 10.0 * first)
    assert np.array_equal(profile.steps_at(piece.speed_limits, places), expected)
    assert all(a != b for a, b in pairwise(piece.speed_limits[:, 1]))


def test_limits_that_a_road_cannot_have_are_refused() -> None:
    for limits, message in (
        ([(0, 600)], "at most 500"),
        ([(0, -5)], "speed_limits is -5 km/h: at least 0"),
        ([(0, 0.5)], "speed_limits is 0.5 km/h: at least 1 is needed, or 0"),
        ([(10, 50), (0, 30)], "ascend"),
        ([50, 30], "shape"),
    ):
        with pytest.raises(RoadError, match=message):
            Road([0.0, 0.0], speed_limits=limits)


def test_rules_keep_scale_or_ignore_the_limits_of_a_road() -> None:
    road = Road(np.zeros(21), speed_limits=[(20, 50), (100, 100), (150, 0), (200, 5), (900, 300)])
    rules = Rules(speed_limit=80.0)
    assert rules.speed_limits_on(road).tolist() == [[0, 80], [20, 50], [100, 100], [150, 80]]
    scaled = rules.with_speed(60.0)
    assert scaled.speed_limits_on(road).tolist() == [[0, 48], [20, 30], [100, 60], [150, 48]]
    assert np.allclose(
        scaled.with_speed(80.0).speed_limits_on(road), [[0, 64], [20, 40], [100, 80], [150, 64]]
    )
    ignored = Rules(speed_limit=60.0, road_limits="ignored")
    assert ignored.speed_limits_on(road).tolist() == [[0, 60]]
    assert ignored.with_speed(40.0).speed_limits_on(road).tolist() == [[0, 40]]
    with pytest.raises(ValueError, match="road_limits is 'no'"):
        Rules(road_limits="no")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ([], "70 km/h, assumed"),
        ([(0, 0)], "70 km/h, assumed"),
        ([(0, 30)], "30 km/h, of the road"),
        ([(0, 30), (500, 120)], "30 km/h, of the road"),
        ([(0, 30), (500, 0)], "30 km/h, of the road"),
        ([(0, 30), (60, 90)], "30 to 90 km/h, of the road"),
        ([(60, 30)], "30 km/h, of the road; where it has none, 70 km/h, assumed"),
    ],
)
def test_the_text_names_the_limits_that_a_car_meets(
    limits: list[tuple[float, float]], text: str
) -> None:
    assert Rules().limit_text(Road(np.zeros(15), speed_limits=limits)) == text
