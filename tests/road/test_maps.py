"""OpenDRIVE files with slopes, widening lanes and many roads are read as they are drawn."""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax import saxutils

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.errors import RoadError
from frenetic.road import Road, profile
from frenetic.road.files import read_road
from frenetic.road.folders import find_roads
from frenetic.road.opendrive import RoadMap, to_opendrive
from frenetic.road.opendrive.ids import quoted_id

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

SLOPING = Road(
    [0.0, 0.01, 0.02, 0.0, -0.01, 0.0, 0.0, 0.01],
    20.0,
    (30.0, -20.0, 0.4),
    lane_width=3.25,
    superelevation=[(0.0, 0.0), (40.0, -0.06), (60.0, 0.0), (80.0, 0.03), (130.0, 0.0)],
    grade=[(10.0, 0.04), (60.0, 0.04), (120.0, -0.05)],
    widening=[(20.0, 0.0), (40.0, 0.5), (60.0, 0.0)],
)
LANE = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="{}"/></lane>'


def opendrive(*roads: str) -> bytes:
    """Return an OpenDRIVE file of these `<road>` elements."""
    return f'<OpenDRIVE><header revMajor="1"/>{"".join(roads)}</OpenDRIVE>'.encode()


def road(
    number: int,
    x: float,
    heading: float,
    length: float,
    *,
    shape: str = "<line/>",
    right: str = LANE.format(-1, "driving", 3.5, 0),
    left: str = "",
    profiles: str = "",
    junction: int = -1,
) -> str:
    """Return the `<road>` element of a road that begins at (x, 0)."""
    place = f'<geometry s="0" x="{x}" y="0" hdg="{heading}" length="{length}">{shape}</geometry>'
    lanes = f'<laneSection s="0"><left>{left}</left><right>{right}</right></laneSection>'
    return (
        f'<road id="{number}" length="{length}" junction="{junction}"><planView>{place}</planView>'
        f"{profiles}<lanes>{lanes}</lanes></road>"
    )


CASES = Path(__file__).parents[1] / "cases" / "maps"


def without_notes(text: str) -> bytes:
    """Remove Frenetic's notes, as in a file of another program."""
    return re.sub(r"<userData.*?/>", "", text).encode()


def assert_same(road: Road, other: Road) -> None:
    """Assert that two roads are equal bit for bit."""
    assert np.array_equal(road.curvatures, other.curvatures)
    assert (road.step, road.pose, road.lane_width) == (other.step, other.pose, other.lane_width)
    for name in profile.SHAPES:
        assert np.array_equal(getattr(road, name), getattr(other, name)), name


@given(
    st.lists(st.tuples(st.floats(1.0, 60.0), st.floats(-0.15, 0.15)), max_size=6),
    st.lists(st.tuples(st.floats(1.0, 60.0), st.floats(0.0, 2.0)), max_size=4),
)
def test_any_slopes_and_widths_are_read_back_exactly(
    slopes: list[tuple[float, float]], widths: list[tuple[float, float]]
) -> None:
    def ascending(pairs: list[tuple[float, float]]) -> np.ndarray:
        gaps, values = np.array(pairs).reshape(-1, 2).T
        return np.column_stack([np.cumsum(gaps), values])

    road = Road(
        [0.0, 0.02, 0.0, -0.01],
        30.0,
        superelevation=ascending(slopes),
        grade=ascending(slopes[::-1]),
        widening=ascending(widths),
    )
    read = RoadMap(to_opendrive(road).encode()).road()
    assert_same(read, road)


def test_slopes_without_our_notes_are_read_within_a_bound() -> None:
    read = RoadMap(without_notes(to_opendrive(SLOPING))).road()
    places = np.linspace(0.0, SLOPING.length, 1000)
    for name, error in (("superelevation", 4e-4), ("grade", 4e-4), ("widening", 0.01)):
        values, read_values = (
            profile.value_at(getattr(road, name), places) for road in (SLOPING, read)
        )
        assert read_values == pytest.approx(values, abs=error), name
    assert read.heights(places) == pytest.approx(SLOPING.heights(places), abs=0.02)
    assert read.lane_width == pytest.approx(3.25)
    assert len(read.grade) < 30
    assert len(read.superelevation) < 30


def test_an_edited_file_is_read_as_it_is_drawn() -> None:
    text = to_opendrive(Road([0.0] * 9, grade=0.04))
    assert 'b="0.04"' in text
    changed = RoadMap(text.replace('b="0.04"', 'b="0.02"').encode()).road()
    assert changed.grade == pytest.approx(np.array([[0.0, 0.02], [80.0, 0.02]]))


def test_a_removed_superelevation_is_not_read() -> None:
    text = re.sub(r"<superelevation .*?/>", "", to_opendrive(SLOPING))
    assert not len(RoadMap(text.encode()).road().superelevation)


def test_slopes_and_curvatures_are_reversed_in_the_other_direction() -> None:
    data = without_notes(to_opendrive(replace(SLOPING, widening=profile.NOTHING)))
    forwards, backwards = (RoadMap(data).road(lane=i) for i in (-1, 1))
    places = np.linspace(5.0, forwards.length - 5.0, 50)
    for name, sign in (("grade", -1.0), ("superelevation", -1.0), ("curvatures", -1.0)):
        if name == "curvatures":
            values, reversed_values = (
                forwards.curvature_at(places),
                backwards.curvature_at(backwards.length - places),
            )
        else:
            values = profile.value_at(getattr(forwards, name), places)
            reversed_values = profile.value_at(getattr(backwards, name), backwards.length - places)
        assert reversed_values == pytest.approx(sign * values, abs=2e-3), name


def test_a_lane_beside_the_centre_lies_higher_or_lower() -> None:
    # The outer lane begins 3 m right of the centre. The road leans more and more to the right: by
    # 0.1 rad after 100 m.
    lean = '<lateralProfile><superelevation s="0" a="0" b="0.001"/></lateralProfile>'
    lanes = LANE.format(-1, "driving", 3, 0) + LANE.format(-2, "driving", 3.5, 0)
    data = opendrive(road(1, 0.0, 0.0, 100.0, right=lanes, profiles=lean))
    outer = RoadMap(data).road(lane=-2)
    assert outer.heights(100.0) == pytest.approx(-3.0 * math.tan(0.1), abs=0.01)
    assert not len(RoadMap(data).road().grade)


def test_a_widening_lane_has_its_width_and_widening() -> None:
    lane = LANE.format(-1, "driving", 3, 0.01)
    read = RoadMap(opendrive(road(1, 0.0, 0.0, 100.0, right=lane))).road()
    assert read.lane_width == pytest.approx(3.0)
    assert profile.value_at(read.widening, [0.0, 50.0, 100.0]) == pytest.approx([0.0, 0.5, 1.0])


def test_a_lane_of_2_m_is_driven_and_a_narrower_one_refused() -> None:
    widths = {width: LANE.format(-1, "driving", width, 0) for width in (2.0, 1.99)}
    maps = {w: RoadMap(opendrive(road(1, 0.0, 0.0, 100.0, right=widths[w]))) for w in widths}
    assert maps[2.0].road().lane_width == 2.0
    with pytest.raises(RoadError, match=r"its lane is 1\.99 m wide"):
        maps[1.99].road()


TOWN = opendrive(
    road(1, 0.0, 0.0, 60.0),
    # Road 2 leads back to the end of road 1, so its left lane continues road 1.
    road(2, 100.0, math.pi, 40.0, right="", left=LANE.format(1, "driving", 3.5, 0)),
    road(3, 100.0, 0.0, 50.0, junction=9, right=LANE.format(-1, "entry", 3.5, 0)),
    road(4, 500.0, 0.0, 80.0),
)


def test_roads_that_continue_each_other_make_a_stretch(tmp_path: Path) -> None:
    first, second = RoadMap(TOWN).stretches("1,2,3,4")
    assert first.name == "1,2,3"
    assert first.road.length == pytest.approx(150.0)
    assert first.road.points[-1] == pytest.approx([150.0, 0.0], abs=1e-6)
    assert first.road.pose == pytest.approx((0.0, 0.0, 0.0))
    assert (second.name, second.road.pose.x) == ("4", 500.0)
    (tmp_path / "town.xodr").write_bytes(TOWN)
    with pytest.raises(RoadError, match="4 does not begin where 1 ends"):
        read_road(tmp_path / "town.xodr", roads="1,4")


def test_a_stretch_may_begin_at_any_place() -> None:
    town = RoadMap(TOWN)
    (stretch,) = town.stretches("1@20,2")
    assert stretch.road.pose.x == pytest.approx(20.0)
    assert stretch.road.length == pytest.approx(80.0)
    assert stretch.name == "1@20,2"
    assert stretch.rest_name(49.2) == "1@70,2"
    (rest,) = town.stretches(stretch.rest_name(49.2))
    assert rest.road.pose.x == pytest.approx(70.0)
    for wrong in ("1@100,2", "1@-1", "1@x", "1@nan"):
        with pytest.raises(RoadError, match="is no place on a stretch of"):
            town.stretches(wrong)


def test_without_a_choice_the_lane_is_a_driving_lane() -> None:
    lanes = LANE.format(-1, "median", 2, 0) + LANE.format(-2, "driving", 3.5, 0)
    data = opendrive(road(1, 0.0, 0.0, 60.0, right=lanes))
    assert RoadMap(data).road().pose.y == pytest.approx(-2.0)
    only_left = opendrive(road(1, 0.0, 0.0, 60.0, right="", left=LANE.format(1, "driving", 3, 0)))
    assert RoadMap(only_left).road().pose.x == pytest.approx(60.0)


def test_the_roads_of_a_map_in_a_folder_are_found_without_junctions(tmp_path: Path) -> None:
    (tmp_path / "town.xodr").write_bytes(TOWN)
    roads = find_roads([tmp_path])
    names = [name.removeprefix(str(tmp_path / "town.xodr")) for name in roads.roads]
    assert names == [" road 4", " road 1", " road 2"]


def test_a_map_of_many_roads_asks_for_a_choice() -> None:
    with pytest.raises(RoadError) as caught:
        RoadMap(TOWN).road()
    assert str(caught.value) == (
        "it has 4 roads; choose with --road: 4 (80 m), 1 (60 m), 2 (40 m), .."
    )
    with pytest.raises(RoadError, match=r"has no road '7', but 4 \(80 m\), 1"):
        RoadMap(TOWN).road("7")


def joined_map(gap: float, aside: float, turn: float, *, link: str = "") -> RoadMap:
    """Return a map of two roads, 60 and 40 m, with a joint that is off by m and degrees."""
    first = road(1, 0.0, 0.0, 60.0).replace("<planView>", f"{link}<planView>")
    second = road(2, 60.0 + gap, math.radians(turn), 40.0).replace('y="0"', f'y="{aside}"')
    return RoadMap(opendrive(first, second))


@pytest.mark.parametrize(
    ("gap", "aside", "turn"),
    [(0.02, 0.0, 0.0), (-0.02, 0.0, 0.0), (0.0, 0.05, 0.0), (0.03, -0.03, 1.9), (0.0, 0.0, -2.0)],
)
def test_roads_with_a_small_gap_are_joined_with_a_note(
    gap: float, aside: float, turn: float
) -> None:
    (stretch,) = joined_map(gap, aside, turn).stretches("1,2")
    miss = f"{100.0 * math.hypot(gap, aside):.1f} cm and {abs(turn):.1f} degrees"
    assert stretch.notes == (
        f"road 2 begins {miss} off the end of road 1: joined by a blend over 10 m",
    )
    assert stretch.road.length == pytest.approx(100.0 + gap, abs=0.01)
    # Outside the blend the road is as drawn; inside, its radius is at least 140 m.
    heading = math.radians(turn)
    along = np.array([10.0, 30.0])
    behind = np.column_stack(
        [60.0 + gap + along * math.cos(heading), aside + along * math.sin(heading)]
    )
    offsets = stretch.road.track(np.concatenate([[(10.0, 0.0), (50.0, 0.0)], behind]))[:, 1]
    assert np.abs(offsets).max() < 0.01
    assert np.abs(stretch.road.curvatures).max() < 1.0 / 140.0


def test_a_short_road_between_two_joints_is_blended_once() -> None:
    """The blend of the first joint moves the end of the short road; this opens no second gap."""
    heading = math.radians(1.9)
    end = 100.0 + 0.5 * math.cos(heading), 0.5 * math.sin(heading)
    third = road(3, end[0], heading, 100.0).replace('y="0"', f'y="{end[1]}"')
    roads = road(1, 0.0, 0.0, 100.0), road(2, 100.0, heading, 0.5), third
    (stretch,) = RoadMap(opendrive(*roads)).stretches("1,2,3")
    assert stretch.notes == (
        "road 2 begins 0.0 cm and 1.9 degrees off the end of road 1: joined by a blend over 10 m",
    )
    assert stretch.road.length == pytest.approx(200.5, abs=0.02)
    steps = np.hypot(*np.diff(stretch.road.points, axis=0).T)
    assert steps == pytest.approx(np.full(len(steps), stretch.road.step), rel=1e-3)


@pytest.mark.parametrize("gap", [0.05, -0.05])
def test_a_gap_of_five_centimetres_is_joined(gap: float) -> None:
    (stretch,) = joined_map(gap, 0.0, 0.0).stretches("1,2")
    assert "joined by a blend" in stretch.notes[0]


@pytest.mark.parametrize(("gap", "turn"), [(0.06, 0.0), (0.0, 2.1), (160.0, 0.0)])
def test_linked_roads_that_do_not_meet_stay_separate_with_a_note(gap: float, turn: float) -> None:
    link = '<link><successor elementType="road" elementId="2" contactPoint="start"/></link>'
    miss = f"{gap:.1f} m" if gap > 1.0 else f"{100.0 * gap:.1f} cm"
    first, second = joined_map(gap, 0.0, turn, link=link).stretches("1,2")
    assert first.notes == ()
    (note,) = second.notes
    assert note.startswith(f"road 2 begins {miss} and {turn:.1f} degrees off the end of road 1")
    assert "up to 5 cm and 2 degrees are joined" in note
    unlinked = joined_map(gap, 0.0, turn).stretches("1,2")
    assert [stretch.notes for stretch in unlinked] == [(), ()]


def test_the_rest_of_a_joined_stretch_lies_on_the_same_line() -> None:
    road_map = joined_map(0.02, 0.02, 1.0)
    (whole,) = road_map.stretches("1,2")
    (rest,) = road_map.stretches(whole.rest_name(57.3))
    assert rest.name == "1@58,2"
    offsets = whole.road.track(rest.road.points)[:, 1]
    assert np.abs(offsets).max() < 0.005


def map_with_ids(*ids: str) -> RoadMap:
    """Return a map of straight roads of 60, 61, .. m with these ids."""
    roads = [
        road(i, 500.0 * i, 0.0, 60.0 + i).replace(f'id="{i}"', f"id={saxutils.quoteattr(name)}", 1)
        for i, name in enumerate(ids)
    ]
    return RoadMap(opendrive(*roads))


@given(st.lists(st.text(min_size=1, max_size=90), min_size=1, max_size=4, unique=True))
def test_any_id_can_be_named(ids: list[str]) -> None:
    ids = [name for name in ids if name.isprintable()] + ['7,left"@8']
    road_map = map_with_ids(*ids)
    assert list(road_map.lengths) == ids[::-1]  # the longest first
    stretches = road_map.stretches(",".join(f"{quoted_id(name)}@3" for name in ids))
    assert [stretch.ids for stretch in stretches] == [(name,) for name in ids]
    for stretch, name in zip(stretches, ids, strict=True):
        (same_stretch,) = road_map.stretches(stretch.name)
        assert same_stretch.ids == (name,)
        assert same_stretch.road.pose == stretch.road.pose


def test_an_id_needs_quotes_only_if_it_is_ambiguous() -> None:
    road_map = map_with_ids("7,left", "8@20", "7", "8")
    assert [stretch.ids for stretch in road_map.stretches("8@20")] == [("8",)]
    assert [stretch.ids for stretch in road_map.stretches('"8@20"@20')] == [("8@20",)]
    assert [stretch.ids for stretch in road_map.stretches("7,left")] == [("7,left",)]
    for wrong in ('"7', '"7"x', '"7,left"8'):
        with pytest.raises(RoadError, match="stands in double quotes"):
            road_map.stretches(wrong)
    with pytest.raises(RoadError, match=r'no road \'9\', but 8 .*, "8@20" .*double quotes'):
        road_map.stretches("9")


def test_ids_are_shown_short_and_compared_whole() -> None:
    ids = [f"{'n' * 300}-{i}" for i in range(2)]
    road_map = map_with_ids(*ids)
    assert [road_map.road(name).length for name in ids] == [60.0, 61.0]
    with pytest.raises(RoadError) as caught:
        road_map.road("x" * 300)
    assert len(str(caught.value)) < 500
    with pytest.raises(RoadError, match="2 roads with the id 'a': give each its own"):
        map_with_ids("a", "a").road("a")


# Maps that an earlier version could not read, see tests/cases/maps


@pytest.mark.parametrize(
    ("file", "roads", "length"),
    [
        ("03-gaps-4mm.xodr", "1", 200.012),
        ("03-gaps-4mm-three.xodr", "1", 150.008),
        ("05-long-ids.xodr", "district-north/ring/section-0000000000000-A", 180.0),
        ("05-long-ids.xodr", "district-north/ring/section-0000000000000-B", 90.0),
        ("06-comma-id.xodr", "7,left", 180.0),
        ("06-comma-id.xodr", "8@2024", 90.0),
        ("06-comma-id.xodr", '"8@2024"@20', 70.0),
        ("07-level.xodr", "1", 180.0),
        ("08-single-side.xodr", "1", 180.0),
        ("09-one-road-500m.xodr", "1", 500.0),
        ("13-joint-2cm.xodr", "a,b", 160.02),
    ],
)
def test_real_maps_are_driven(frenetic: Frenetic, file: str, roads: str, length: float) -> None:
    (driven,) = frenetic("drive", str(CASES / file), "--road", roads, "--json").json
    assert driven["length"] == pytest.approx(length, abs=1e-3)
    assert driven["outcome"] == "PASS"
    if file in ("07-level.xodr", "08-single-side.xodr"):
        assert driven["moobd"] == pytest.approx(0.933, abs=0.001)


def test_gaps_along_a_straight_leave_it_straight(frenetic: Frenetic) -> None:
    path = CASES / "03-gaps-4mm.xodr"
    assert frenetic("drive", str(path), "--road", "1", "--dry").code == 0
    assert np.abs(RoadMap(path.read_bytes()).road().points[:, 1]).max() < 1e-9


def test_both_sides_of_a_map_with_a_section_for_one_side_are_driven(frenetic: Frenetic) -> None:
    arguments = (
        "drive",
        str(CASES / "08-single-side.xodr"),
        "--road",
        "1",
        "--lane",
        "1",
        "--json",
    )
    (driven,) = frenetic(*arguments).json
    assert (driven["outcome"], driven["length"]) == ("PASS", pytest.approx(180.0))


def test_a_map_of_one_road_that_does_not_fit_names_the_option(frenetic: Frenetic) -> None:
    answer = frenetic("drive", str(CASES / "09-one-road-500m.xodr"))
    assert answer.code == 1
    assert "in any direction; --road 1 drives it where it lies" in answer.out


def test_only_drivable_roads_are_listed_and_errors_name_the_road(frenetic: Frenetic) -> None:
    path = str(CASES / "10-footpath.xodr")
    assert frenetic("drive", path).refuses("choose with --road: street (180 m), lane (70 m)")
    answer = frenetic("drive", path, "--road", "street,path,lane")
    assert answer.refuses("road path: it has no driving lane")


def test_the_note_of_a_joint_is_in_text_json_and_export(frenetic: Frenetic, tmp_path: Path) -> None:
    arguments = [str(CASES / "13-joint-2cm.xodr"), "--road", "a,b"]
    note = "road b begins 2.0 cm and 0.0 degrees off the end of road a: joined"
    assert f"Note: {note}" in frenetic("drive", *arguments, "--dry").err
    for options in ((), ("--dry",)):
        (document,) = frenetic("drive", *arguments, "--json", *options).json
        assert document["notes"][0].startswith(note)
    out = tmp_path / "r.json"
    exported = frenetic("export", *arguments, "--format", "json", "--out", str(out))
    assert f"Note: {note}" in exported.err
    assert read_road(out).road().length == pytest.approx(160.02, abs=1e-3)


def test_each_exported_road_of_a_map_has_its_own_file(frenetic: Frenetic, tmp_path: Path) -> None:
    ids = ["7,left", "7-left", "n" * 300 + "1", "n" * 300 + "2"]
    path = tmp_path / "m.xodr"
    path.write_bytes(opendrive(*(road(0, 9.0, 0.0, 60.0).replace('"0"', f'"{i}"', 1) for i in ids)))
    files = [
        frenetic("export", str(path), "--road", quoted_id(i), "--format", "json", "--json").json
        for i in ids
    ]
    assert len({file["file"] for file in files}) == len(ids)


# Driving on the command line


def test_the_roads_of_a_map_are_driven_at_their_place(frenetic: Frenetic, tmp_path: Path) -> None:
    path = tmp_path / "town.xodr"
    path.write_bytes(TOWN)
    driven = frenetic("drive", str(path), "--road", "1,2,4", "--json").json
    assert [result["outcome"] for result in driven] == ["PASS", "PASS"]
    assert [result["road"] for result in driven] == [f"{path} --road 1,2", f"{path} --road 4"]
    assert frenetic("drive", str(path)).refuses("4 roads", "4 (80 m)")
    assert frenetic("drive", str(path), "--road", "9").refuses("has no road '9'")
    assert frenetic("drive", str(tmp_path), "--road", "1").refuses("--road")
    judged = frenetic("drive", str(path), "--road", "1", "--roads", "rural-80", "--dry")
    assert judged.code == 0
    narrow = frenetic("drive", str(path), "--road", "1", "--roads", "motorway-130", "--dry")
    assert (narrow.code, "The lanes are 3.5 m wide" in narrow.out) == (1, True)
    out = tmp_path / "stretch.json"
    assert (
        frenetic("export", str(path), "--road", "1,2", "--format", "json", "--out", str(out)).code
        == 0
    )
    assert read_road(out).road().length == pytest.approx(100.0)


def test_a_drive_continues_behind_each_departure(frenetic: Frenetic, tmp_path: Path) -> None:
    bends = np.tile(np.repeat([0.0, 0.04, 0.0, 0.0, -0.04, 0.0], 3), 5)
    path = tmp_path / "winding.xodr"
    path.write_text(to_opendrive(Road(bends, 10.0)))
    arguments = ("drive", str(path), "--driver", "planner,aggression=2")
    driven = frenetic(*arguments, "--road", "1", "--json").json
    failed = [result for result in driven if result["outcome"] == "FAIL"]
    assert len(failed) > 2
    for result in failed[1:3]:
        roads = result["road"].split(" --road ")[1]
        (repeated, *_) = frenetic(*arguments, "--road", roads, "--json").json
        assert repeated == result


# Maps of the package SUMO


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Makes an OpenDRIVE file of a net that SUMO ships, with SUMO's own program."""
    import sumo

    folder, home = tmp_path_factory.mktemp("maps"), Path(sumo.SUMO_HOME)

    def convert(net: str) -> Path:
        path = folder / f"{Path(net).name.partition('.')[0]}.xodr"
        source = home / "tools" / "game" / net
        arguments = ["-s", str(source), "--opendrive-output", str(path)]
        subprocess.run(
            [str(home / "bin" / "netconvert"), *arguments], check=True, capture_output=True
        )
        return path

    return convert


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("net", "count", "longest"),
    [("A10KW/osm.net.xml", 1739, 1197.6), ("racing/spreewaldring.net.xml", 45, 1636.0)],
)
def test_maps_of_real_places_are_read(
    shipped: Callable[[str], Path], frenetic: Frenetic, net: str, count: int, longest: float
) -> None:
    path = shipped(net)
    road_map = RoadMap(path.read_bytes())
    lengths = road_map.lengths
    assert next(iter(lengths.values())) == pytest.approx(longest, abs=1.0)
    folder_roads = find_roads([path.parent])
    names = [name for name in folder_roads.roads if name.startswith(str(path))]
    assert len(names) > 0.7 * len(lengths)
    assert f"it has {count} roads" in frenetic("drive", str(path)).err
    drivable = next(name for name in names if folder_roads.roads[name].length > 900.0)
    driven = frenetic("drive", str(path), "--road", drivable.split(" road ")[1], "--json").json
    assert driven[0]["outcome"] in ("PASS", "FAIL")
