"""OpenDRIVE: our files are exact and constant; files of other programs are read or refused."""

from __future__ import annotations

import math
import re
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import Road, profile
from frenetic.road.opendrive import RoadMap, to_opendrive

Clothoid: TypeAlias = tuple[float, float, float, float, float, float]
"""x, y, heading, length, curvature at the start, curvature at the end."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def end_of(geometry: Clothoid) -> tuple[float, float, float]:
    """Return x, y and heading at the end of a clothoid, by Gauss-Legendre quadrature."""
    x, y, heading, length, start, end = geometry
    u = 0.5 * length * (NODES + 1.0)
    angle = heading + u * (start + 0.5 * (end - start) / length * u)
    x += 0.5 * length * float(WEIGHTS @ np.cos(angle))
    y += 0.5 * length * float(WEIGHTS @ np.sin(angle))
    return x, y, heading + 0.5 * length * (start + end)


def plan_view(text: str) -> list[tuple[str, Clothoid]]:
    """Return kind and geometry of each `<geometry>`; assert that their distances have no gaps."""
    geometries, s = [], 0.0
    for geometry in ElementTree.fromstring(text.encode()).iter("geometry"):
        assert float(geometry.attrib["s"]) == pytest.approx(s, abs=1e-8)
        x, y, heading, length = (float(geometry.attrib[key]) for key in ("x", "y", "hdg", "length"))
        (shape,) = geometry
        bend = [float(value) for value in shape.attrib.values()] or [0.0]
        geometries.append((shape.tag, (x, y, heading, length, bend[0], bend[-1])))
        s += length
    return geometries


curvature = st.floats(-0.07, 0.07).map(lambda value: round(value, 6))


@st.composite
def roads(draw: st.DrawFn) -> Road:
    """Draw roads as of a search, some with neighbouring values that are nearly equal."""
    nearly = st.sampled_from([0.0, 1e-13, 1e-12, 3e-11, 1e-10, 5e-10, 1e-9, 2e-9, 1e-7])
    values = draw(st.lists(curvature, min_size=2, max_size=40))
    for i in range(1, len(values)):
        if draw(st.booleans()):
            values[i] = values[i - 1] + draw(nearly)
    step = draw(st.sampled_from([10.0, 0.5, 7.3, 25.0, 1.0 / 3.0]))
    place = st.floats(-1000.0, 1000.0)
    pose = (draw(place), draw(place), draw(st.floats(-7.0, 7.0)))
    width = draw(st.floats(2.0, 6.0))

    def along(most: float) -> FloatArray:
        pairs = draw(st.lists(st.tuples(st.floats(1.0, 60.0), st.floats(0.0, most)), max_size=4))
        return np.array(pairs).reshape(-1, 2).cumsum(axis=0) * (1.0, 0.2)

    names = [("superelevation", 0.15), ("grade", 0.15), ("widening", 2.0)]
    profiles: Any = {name: along(most) for name, most in names}
    return Road(values, step, pose, lane_width=width, **profiles)


# Writing


@given(roads())
def test_geometries_join_and_end_at_the_end_of_the_road(road: Road) -> None:
    expected: tuple[float, ...] = road.pose
    for kind, geometry in plan_view(to_opendrive(road)):
        x, y, heading, _, start, end = geometry
        assert math.hypot(x - expected[0], y - expected[1]) < 1e-6
        assert heading == pytest.approx(expected[2], abs=1e-7)
        if kind == "spiral":
            assert not np.isclose(start, end)
        if kind == "arc":
            assert abs(start) >= 1e-10
        expected = end_of(geometry)  # from the start in the file, so that errors do not add up
    x, y, _ = road.pose_at(road.length)
    assert math.hypot(expected[0] - x, expected[1] - y) < 1e-6


def test_header_lanes_marks_and_speed_are_written() -> None:
    road = Road([0.01, 0.05, -0.03, 0.0], pose=(5.0, -7.0, 1.0), lane_width=3.5)
    root = ElementTree.fromstring(to_opendrive(road, speed_limit=50.0, origin=(-33.5, 151.25)))
    header, speed = root.find("header"), root.find("road/type/speed")
    assert header is not None
    assert speed is not None
    assert (header.get("revMajor"), header.get("revMinor")) == ("1", "7")
    bounds = [float(header.attrib[key]) for key in ("west", "south", "east", "north")]
    edges = np.concatenate([road.sample(0.1, 3.5), road.sample(0.1, -3.5)])
    assert bounds == pytest.approx([*edges.min(axis=0), *edges.max(axis=0)], abs=0.01)
    assert "+proj=tmerc +lat_0=-33.5 +lon_0=151.25 " in (header.findtext("geoReference") or "")
    assert speed.attrib == {"max": "50.0", "unit": "km/h"}
    lanes = [
        (
            lane.attrib["id"],
            lane.attrib["type"],
            [float(width.attrib["a"]) for width in lane.findall("width")],
            [mark.attrib["type"] for mark in lane.findall("roadMark")],
            [(s.attrib["max"], s.attrib["unit"]) for s in lane.findall("speed")],
        )
        for lane in root.iter("lane")
    ]
    driven = ("driving", [3.5], ["solid"], [("50.0", "km/h")])
    assert lanes == [("1", *driven), ("0", "none", [], ["broken"], []), ("-1", *driven)]


@pytest.mark.parametrize("name", ['a "b" <c> & d', "zero\x00, bell\x07, surrogate\udcff", "é 路"])
def test_any_name_can_be_written(name: str) -> None:
    root = ElementTree.fromstring(to_opendrive(Road([0.0, 0.0]), name=name).encode("utf-8"))
    assert [road.get("name") for road in root.iter("road")] == [
        re.sub(r"[\x00\x07\udcff]", "?", name)
    ]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed_limit": 0.0}, "speed_limit is 0"),
        ({"speed_limit": math.nan}, "speed_limit is nan"),
        ({"origin": (91.0, 0.0)}, r"origin is \(91, 0\)"),
        ({"origin": (0.0, math.nan)}, r"origin is \(0, nan\)"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(RoadError, match=message):
        to_opendrive(Road([0.0, 0.0]), **options)


# Reading our files


@given(roads())
def test_a_written_road_is_read_back_bit_for_bit(road: Road) -> None:
    read = RoadMap(to_opendrive(road).encode()).road()
    assert read.curvatures.tolist() == road.curvatures.tolist()
    assert (read.step, read.pose, read.lane_width) == (road.step, road.pose, road.lane_width)
    for name in profile.SHAPES:
        assert np.array_equal(getattr(read, name), getattr(road, name)), name


def test_an_edited_file_is_read_from_its_geometries() -> None:
    text = to_opendrive(Road([0.02, 0.02 + 1e-10]))
    bent = re.sub(r'curvature="0.02\d*"', 'curvature="0.03"', text)
    assert RoadMap(bent.encode()).road().curvatures == pytest.approx([0.03] * 21, abs=1e-9)
    longer = text.replace('length="10.0"', 'length="20.0"')
    assert RoadMap(longer.encode()).road().length == 20.0
    steep = to_opendrive(Road([0.0, 0.0], grade=0.04)).replace('b="0.04"', 'b="0.02"')
    assert RoadMap(steep.encode()).road().grade[:, 1] == pytest.approx(0.02)
    lean = re.sub("<superelevation .*?/>", "", to_opendrive(Road([0.0, 0.0], superelevation=0.03)))
    assert not len(RoadMap(lean.encode()).road().superelevation)
    narrow = text.replace('sOffset="0.0" a="4.0"', 'sOffset="0.0" a="3.5"')
    assert RoadMap(narrow.encode()).road().lane_width == 3.5
    aside = text.replace('laneOffset s="0.0" a="0.0"', 'laneOffset s="0.0" a="1.0"')
    assert RoadMap(aside.encode()).road().pose.x == pytest.approx(-1.0)
    for note in ("", "x", "10 0.02", "10 9 9", "nan nan nan", "0 0 0"):
        damaged = re.sub(r'(frenetic:road" value=)"[^"]*"', rf'\1"{note}"', text)
        followed = RoadMap(damaged.encode()).road()
        assert followed.curvatures == pytest.approx([0.02] * 21, abs=1e-9)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
def test_other_encodings_and_a_namespace_are_read(encoding: str) -> None:
    text = to_opendrive(Road([0.0, 0.03]), name="Straße")
    text = text.replace("UTF-8", encoding.removesuffix("-sig"))
    text = text.replace("<OpenDRIVE>", '<OpenDRIVE xmlns="http://asam.net/opendrive">')
    assert RoadMap(text.encode(encoding)).road().curvatures.tolist() == [0.0, 0.03]


# Reading files of other programs

WIDTH = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
LANE = f'<lane id="-1" type="driving">{WIDTH}</lane>'
LINE = '<geometry s="0" x="0" y="0" hdg="0" length="30"><line/></geometry>'


SIDE_END = "</right></laneSection>"


def section(right: str, left: str = "", start: float = 0.0) -> str:
    """Return a `<laneSection>` with these lanes, from `start` m on."""
    return f'<laneSection s="{start}"><left>{left}</left><right>{right}</right></laneSection>'


def foreign(
    plan: str = LINE,
    *,
    header: str = '<header revMajor="1" revMinor="4"/>',
    attributes: str = 'length="30" id="7" junction="-1"',
    profiles: str = "",
    offsets: str = "",
    sections: str = section(LANE),
    after: str = "",
) -> bytes:
    """Return an OpenDRIVE file of one road."""
    return (
        f"<OpenDRIVE>{header}<road {attributes}><planView>{plan}</planView>{profiles}"
        f"<lanes>{offsets}{sections}</lanes></road>{after}</OpenDRIVE>"
    ).encode()


def chain(pieces: list[tuple[float, float, float]], digits: int = 12) -> tuple[str, FloatArray]:
    """Return a plan view of (length, start, end) clothoids, and its points every 50 cm, (n, 2)."""
    pose = (12.0, -3.0, 0.4)
    plan, points = [], [pose[:2]]
    for length, start, end in pieces:
        x, y, heading = (round(v, digits) for v in pose)
        shape = f'<spiral curvStart="{start}" curvEnd="{end}"/>'
        if start == end:
            shape = f'<arc curvature="{start}"/>' if start else "<line/>"
        place = f'x="{x}" y="{y}" hdg="{heading}" length="{length}"'
        plan.append(f"<geometry {place}>{shape}</geometry>")
        for share in np.linspace(0.0, 1.0, math.ceil(length / 0.5) + 1)[1:].tolist():
            curvature_there = start + (end - start) * share
            points.append(end_of((*pose, length * share, start, curvature_there))[:2])
        pose = end_of((*pose, length, start, end))
    return "".join(plan), np.array(points)


def distance_from(road: Road, points: FloatArray) -> float:
    """Return the largest distance in m between the points and the road, ends included."""
    track = road.track(points)
    ends = abs(track[0, 0]), abs(track[-1, 0] - road.length)
    return max(*map(float, ends), float(np.abs(track[:, 1]).max()))


def test_a_road_follows_a_line_whose_small_gaps_add_up() -> None:
    starts = np.array([(20.0 * i, 0.006 * i) for i in range(6)])
    geometry = '<geometry x="{}" y="{}" hdg="0" length="20"><line/></geometry>'
    road = RoadMap(foreign("".join(geometry.format(x, y) for x, y in starts))).road()
    assert np.abs(road.track(starts)[:, 1]).max() < 0.01


BENDS = 20  # of `rounded_map`


def rounded_map(seed: int, decimals: int, sideways: float = 0.0) -> tuple[bytes, FloatArray]:
    """Return a map of a road with 20 bends and rounded numbers, and the exact points, (n, 2).

    Args:
        seed: seed of the road.
        decimals: decimals of headings; coordinates and lengths have two.
        sideways: distance in m by which the second half of the road is moved sideways.
    """
    rng = np.random.default_rng(seed)
    pieces = []
    for _ in range(BENDS):
        bend = float(rng.choice([-1.0, 1.0]) / rng.uniform(15.0, 300.0))
        straight, ease, arc = rng.uniform(5.0, [80.0, 25.0, 1.5 / abs(bend)]).tolist()
        pieces += [(straight, 0.0, 0.0), (ease, 0.0, bend), (arc, bend, bend), (ease, bend, 0.0)]
    pose = (*rng.uniform(-500.0, 500.0, 2).tolist(), rng.uniform(-3.0, 3.0))
    plan, points = [], []
    for i, (length, start, end) in enumerate(pieces):
        if sideways and i == len(pieces) // 2:
            x, y, heading = pose
            pose = (x - sideways * math.sin(heading), y + sideways * math.cos(heading), heading)
        x, y, heading = pose
        shape = f'<spiral curvStart="{start}" curvEnd="{end}"/>'
        place = f'x="{x:.2f}" y="{y:.2f}" hdg="{heading:.{decimals}f}" length="{length:.2f}"'
        plan.append(f"<geometry {place}>{shape}</geometry>")
        for share in np.linspace(0.0, 1.0, 9)[1:].tolist():
            curvature_there = start + (end - start) * share
            points.append(end_of((*pose, length * share, start, curvature_there))[:2])
        pose = end_of((*pose, length, start, end))
    return foreign("".join(plan)), np.array(points)


@pytest.mark.parametrize("decimals", [2, 3, 4, 6])
def test_maps_with_coordinates_of_two_decimals_are_read(decimals: int) -> None:
    for seed in range(20):
        data, points = rounded_map(seed, decimals)
        road = RoadMap(data).road()
        # Half a centimetre in x and y, or the last heading's error, moves the exact road so far.
        assert np.abs(road.track(points)[:, 1]).max() < 0.012


def test_a_sideways_jump_is_refused_with_its_distance() -> None:
    for seed in range(10):
        data, _ = rounded_map(seed, 6, sideways=0.08)
        with pytest.raises(RoadError, match="jumps sideways by") as caught:
            RoadMap(data).road()
        number = re.search(r"by (0\.\d+) m", str(caught.value))
        assert number is not None
        assert float(number[1]) == pytest.approx(0.08, abs=0.0142)


def test_a_refusal_names_the_distance_at_the_nearest_place() -> None:
    # Lanes that step by 3 m at one place: no smooth road is near both parts.
    data = foreign(offsets='<laneOffset s="0"/><laneOffset s="10" a="3"/>')
    with pytest.raises(RoadError, match="the nearest lies") as caught:
        RoadMap(data).road()
    numbers = re.search(r"lies ([\d.]+) m beside it ([\d.]+) m along", str(caught.value))
    assert numbers is not None
    assert 1.5 < float(numbers[1]) < 3.01  # a smooth road misses a part by at least half the step


def test_overlaps_and_gaps_along_the_road_are_closed() -> None:
    for gap in (-0.04, 0.004, 0.04):
        starts = np.arange(8) * (20.0 + gap)
        geometry = '<geometry x="{}" y="0" hdg="0" length="20"><line/></geometry>'
        road = RoadMap(foreign("".join(map(geometry.format, starts)))).road()
        assert road.length == pytest.approx(starts[-1] + 20.0, abs=1e-6)
        assert np.abs(road.points[:, 1]).max() < 1e-9


def test_many_dense_gaps_are_closed() -> None:
    geometry = '<geometry x="{:.4f}" y="{}" hdg="0" length="0.005"><line/></geometry>'
    plan = [geometry.format(0.005 * i, 0.002 * (i % 2)) for i in range(20_000)]
    road = RoadMap(foreign("".join(plan))).road()
    assert np.abs(road.points[:, 1] - 0.001).max() < 2e-3


lengths = st.floats(0.5, 60.0)
clothoids = st.one_of(
    st.tuples(lengths, st.just(0.0), st.just(0.0)),
    st.tuples(lengths, curvature).map(lambda p: (p[0], p[1], p[1])),
    st.tuples(lengths, curvature, curvature),
)


@given(st.lists(clothoids, min_size=1, max_size=6))
def test_a_road_is_within_a_centimetre_of_a_line_with_jumps_of_curvature(
    pieces: list[tuple[float, float, float]],
) -> None:
    plan, points = chain(pieces)
    road = RoadMap(foreign(plan)).road()
    assert road.length == pytest.approx(sum(piece[0] for piece in pieces))
    assert distance_from(road, points) < 0.01


@pytest.mark.parametrize("shape", ["arcLength", "normalized", ""])
def test_polynomials_are_read(shape: str) -> None:
    p = np.linspace(0.0, 1.0, 4001)
    u, v = np.array([0.0, 90.0, -90.0, 60.0]), np.array([0.0, 0.0, 60.0, -40.0])  # a Bezier curve
    points = np.column_stack([30.0 + np.polyval(u[::-1], p), np.polyval(v[::-1], p)])
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    unit = length if shape == "arcLength" else 1.0
    numbers = {
        f"{name}{axis}": coefficient / unit**power
        for axis, values in (("U", u), ("V", v))
        for power, (name, coefficient) in enumerate(zip("abcd", values.tolist(), strict=True))
    }
    texts = " ".join(f'{name}="{value}"' for name, value in numbers.items())
    element = f"<paramPoly3 {texts} " + (f'pRange="{shape}"/>' if shape else "/>")
    bend = f'<geometry x="30" y="0" hdg="0" length="{length}">{element}</geometry>'
    road = RoadMap(foreign(LINE + bend)).road()
    assert road.length == pytest.approx(30.0 + length, abs=1e-3)
    line = np.column_stack([np.linspace(0.0, 29.9, 300), np.zeros(300)])
    assert distance_from(road, np.concatenate([line, points[::10]])) < 0.01


def test_any_lane_can_be_chosen() -> None:
    radius = 40.0
    narrow = '<width sOffset="0" a="2.5"/>'
    right = (
        f'<lane id="-1" type="median">{narrow}</lane><lane id="-2" type="driving">{narrow}</lane>'
        f'<lane id="-3" type="driving">{WIDTH}</lane>'
    )
    left = f'<lane id="2" type="driving">{WIDTH}</lane><lane id="1" type="driving">{narrow}</lane>'
    plan = LINE.replace("<line/>", f'<arc curvature="{1 / radius}"/>')
    data = foreign(plan, offsets='<laneOffset s="0" a="0.5"/>', sections=section(right, left))
    for lane, shift, width in ((-2, -2.0, 2.5), (-3, -4.5, 3.5), (1, 0.5, 2.5), (2, 3.0, 3.5)):
        road = RoadMap(data).road(lane=lane)
        assert road.lane_width == width
        assert road.length == pytest.approx(30.0 * (radius - shift) / radius, abs=1e-3)
        distances = np.hypot(*(road.points - [0.0, radius]).T)
        assert distances == pytest.approx(radius - shift, abs=0.005)
        ends = road.points[[0, -1]] if lane < 0 else road.points[[-1, 0]]
        assert ends[0] == pytest.approx([0.0, shift], abs=0.005)
        mean = float(road.curvature_at(0.5 * road.length))
        assert mean == pytest.approx(math.copysign(1.0 / (radius - shift), -lane), rel=0.01)
    for kind in (b"median", b"bus"):
        default_lane = RoadMap(data.replace(b"median", kind)).road()
        assert default_lane.points == pytest.approx(RoadMap(data).road(lane=-2).points)
    with pytest.raises(RoadError, match=r"lane -1.*'median'.*chosen as 'lane': -2, -3, 2, 1\)"):
        RoadMap(data).road(lane=-1)
    with pytest.raises(RoadError, match="lane -4, right of the centre, is missing"):
        RoadMap(data).road(lane=-4)
    with pytest.raises(RoadError, match="lane 0 is the centre"):
        RoadMap(data).road(lane=0)
    reverse = LANE.replace("type", 'direction="reversed" type')
    with pytest.raises(RoadError, match=r"lane -1, .* against the road's rule .*: none\)"):
        RoadMap(foreign(sections=section(reverse))).road(lane=-1)


def test_a_lane_follows_the_changing_width_of_inner_lanes() -> None:
    wider = '<width sOffset="0" a="3"/><width sOffset="5" a="3" c="0.03" d="-0.002"/>'
    wider += '<width sOffset="15" a="4"/>'
    right = (
        f'<lane id="-1" type="driving">{wider}</lane><lane id="-2" type="driving">{WIDTH}</lane>'
    )
    road = RoadMap(foreign(sections=section(right))).road(lane=-2)
    points = road.sample(0.5)
    p = np.clip(points[:, 0] - 5.0, 0.0, 10.0)
    assert points[:, 1] == pytest.approx(-3.0 - 0.03 * p**2 + 0.002 * p**3, abs=0.01)
    assert road.lane_width == 3.5


def linked(lane: int, kind: str = "", other: int = 0) -> str:
    """Return a `<lane>` with a link to another lane."""
    link = f'<link><{kind} id="{other}"/></link>' if kind else ""
    return f'<lane id="{lane}" type="driving">{link}{WIDTH}</lane>'


def test_links_of_lanes_are_followed_between_sections() -> None:
    # A lane of 3.5 m opens inside the driven lane, and the road moves aside by 3.5 m.
    offsets = '<laneOffset s="0" a="0"/><laneOffset s="12" a="3.5"/>'
    sections = section(linked(-1, "successor", -2)) + section(linked(-1) + linked(-2), start=12.0)
    road = RoadMap(foreign(offsets=offsets, sections=sections)).road()
    assert (set(road.curvatures), road.points[0].tolist()) == ({0.0}, [0.0, 0.0])
    against = offsets.replace("3.5", "-3.5")
    sections = section("", linked(1)) + section("", linked(1) + linked(2, "predecessor", 1), 12.0)
    road = RoadMap(foreign(offsets=against, sections=sections)).road(lane=2)
    assert distance_from(road, np.column_stack([np.linspace(30.0, 0.0, 31), np.zeros(31)])) < 1e-3
    sections = section(linked(-1, "successor", 1)) + section(linked(-1), start=12.0)
    with pytest.raises(RoadError, match="leads to lane 1, which is driven the other way"):
        RoadMap(foreign(sections=sections)).road()


@pytest.mark.parametrize("lane", [1, -1])
def test_a_section_for_one_side_does_not_end_the_section_of_the_other_side(lane: int) -> None:
    wide = WIDTH.replace("3.5", "3.25")
    both = section(LANE, LANE.replace("-1", "1"))
    side = "left" if lane < 0 else "right"
    other = f'<lane id="{-lane}" type="driving">{wide}</lane>'
    single = f'<laneSection s="12" singleSide="true"><{side}>{other}</{side}></laneSection>'
    road_map = RoadMap(foreign(sections=both + single))
    assert road_map.road(lane=lane).is_plain
    assert road_map.road(lane=lane).lane_width == 3.5
    assert road_map.road(lane=-lane).lane_width == 3.25
    # Without `singleSide` the section holds for both sides, and lacks this lane.
    with pytest.raises(RoadError, match=f"lane {lane}, .* is missing"):
        RoadMap(foreign(sections=both + single.replace("true", "false"))).road(lane=lane)


def level_lane(lane: int, *, is_level: bool, width: float = 3.0) -> str:
    """Return a `<lane>` with the attribute `level`."""
    level = "true" if is_level else "false"
    return (
        f'<lane id="{lane}" type="driving" level="{level}"><width sOffset="0" a="{width}"/></lane>'
    )


@pytest.mark.parametrize(
    ("are_level", "tilted", "lean"),
    [((False, False), 3.0, True), ((False, True), 3.0, False), ((True, True), 0.0, False)],
)
def test_level_lanes_do_not_lean_and_do_not_move_outer_lanes(
    are_level: tuple[bool, bool], tilted: float, lean: bool
) -> None:
    profiles = '<lateralProfile><superelevation s="0" a="0" b="0.005"/></lateralProfile>'
    for side in (-1, 1):
        lanes = "".join(level_lane(side * (i + 1), is_level=are_level[i]) for i in range(2))
        sections = section(lanes) if side < 0 else section("", lanes)
        road = RoadMap(foreign(profiles=profiles, sections=sections)).road(lane=2 * side)
        rise = -tilted * math.tan(0.15)  # to the right the lean falls, against the road it rises
        assert road.heights(30.0) == pytest.approx(rise, abs=0.01)
        assert len(road.superelevation) == (2 if lean else 0) or lean
        assert (len(road.superelevation) > 0) == lean


def test_a_shape_across_the_road_does_not_change_a_level_lane() -> None:
    shapes = '<shape s="0" t="-9" b="0.02"/><shape s="0" t="0" a="0.18" b="-0.02"/>'
    crossfall = '<crossfall side="both" s="0" a="0.02"/>'
    for profiles in (shapes, crossfall):
        profile_element = f"<lateralProfile>{profiles}</lateralProfile>"
        level = section(level_lane(-1, is_level=True))
        assert RoadMap(foreign(profiles=profile_element, sections=level)).road().is_plain
        second = section(level_lane(-1, is_level=False) + level_lane(-2, is_level=True))
        with pytest.raises(RoadError, match="is shaped across"):
            RoadMap(foreign(profiles=profile_element, sections=second)).road(lane=-2)
    rising = "<lateralProfile>" + shapes + shapes.replace('s="0"', 's="9"').replace("0.18", "0.3")
    with pytest.raises(RoadError, match="is shaped across"):
        RoadMap(foreign(profiles=rising + "</lateralProfile>", sections=level)).road()


def test_an_edited_level_lane_is_level() -> None:
    text = to_opendrive(Road([0.0] * 5, superelevation=0.05))
    level = text.replace(
        'id="-1" type="driving" level="false"', 'id="-1" type="driving" level="true"'
    )
    assert level != text
    assert RoadMap(level.encode()).road().is_flat


def profiled(elements: str, kind: str = "lateralProfile") -> bytes:
    """Return a file with these elements in a profile."""
    return foreign(profiles=f"<{kind}>{elements}</{kind}>")


def shape(element: str) -> bytes:
    """Return a file whose geometry has this shape."""
    return foreign(LINE.replace("<line/>", element))


def place(text: str, other: str) -> bytes:
    """Return a file with a text of its geometry replaced."""
    return foreign(LINE.replace(text, other))


def lane(text: str, other: str) -> bytes:
    """Return a file with a text of its lane replaced."""
    return foreign(sections=section(LANE.replace(text, other)))


def joint(text: str, other: str) -> bytes:
    """Return a file of two geometries with a text of the second replaced."""
    return foreign(LINE + LINE.replace('x="0"', 'x="30"').replace(text, other))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not XML: no element found"),
        (b'<?xml version="1.0" encoding="klingon"?><a/>', "not XML"),
        (b"<a/>", "no OpenDRIVE: its root is <a>"),
        (foreign(header='<header revMajor="2"/>'), "revMajor '2', but only OpenDRIVE 1.x"),
        (b'<OpenDRIVE><header revMajor="1"/></OpenDRIVE>', "it has no road"),
        (
            foreign(after='<road id="x y"/>'),
            r"it has 2 roads; choose with --road: 7 \(30 m\)$",
        ),
        (foreign(attributes='rule="LHT"'), "rule is 'LHT'"),
        (foreign(""), "has no geometry"),
        (shape(""), "holds nothing: line, arc"),
        (shape("<bezier/>"), "holds bezier: line, arc"),
        (shape('<arc curvature="11"/>'), "curvature='11': a number of at most 10"),
        (shape('<paramPoly3 bU="90" bV="0"/>'), "is 90 m long, not 30 m"),
        (shape('<paramPoly3 cU="30" pRange="normalized"/>'), "has a cusp"),
        (place('"30"', '"-1"'), "has length -1"),
        (place('"30"', '"1e9"'), "longer than the 50000 m"),
        (place('"30"', '"nan"'), "length='nan': a number"),
        (place('hdg="0"', ""), "a <geometry> has no 'hdg'"),
        (joint('"30"', '"31"'), "jumps by 1.000 m 30.00 m along"),
        (joint('y="0"', 'y="0.034"'), "jumps sideways by 0.034 m 30.00 m along.* 0.02 m is mended"),
        (joint('hdg="0"', 'hdg="0.1"'), "kink of 5.7 degrees 30.00 m along"),
        (profiled('<elevation s="0" b="0.6"/>', "elevationProfile"), "grade is 0.6 at 0 m"),
        (profiled('<superelevation s="0" a="1.3"/>'), "superelevation is 3.60"),
        (
            profiled('<elevation s="0" a="1"/><elevation s="9" a="2"/>', "elevationProfile"),
            "jumps in height 8.9",
        ),
        (
            foreign(
                profiles='<lateralProfile><superelevation s="0" a="0.1"/></lateralProfile>',
                sections=section(LANE.replace("driving", "median") + LANE.replace("-1", "-2"))
                + section(
                    LANE.replace('"driving"', '"median" level="true"')
                    + LANE.replace('id="-1"', 'id="-2" level="true"'),
                    start=9.0,
                ),
            ),
            "jumps in height 8.9",
        ),
        (profiled('<crossfall side="both" s="0" a="-0.02"/>'), r"shaped across \(crossfall\)"),
        (profiled('<shape s="0" t="0" a="0" b="0.02"/>'), r"shaped across \(shape\)"),
        (lane("type", 'direction="reversed" type'), "has no driving lane"),
        (foreign(sections=""), "has no lanes"),
        (foreign(sections='<laneSection s="0"/>'), "has no driving lane"),
        (lane("driving", "biking"), "has no driving lane"),
        (lane(WIDTH, ""), "has no width"),
        (lane('b="0"', 'b="-0.1"'), "its lane is 0.50 m wide at 30 m: at least 2 m"),
        (lane("3.5", "1e308"), "a='1e308': a number of at most"),
        (
            foreign(
                LINE.replace("<line/>", '<arc curvature="0.1"/>'),
                offsets='<laneOffset s="0" a="12"/>',
            ),
            "beyond the centre of a bend",
        ),
        (
            foreign(offsets='<laneOffset s="0"/><laneOffset s="10" a="3"/>'),
            r"no road can .* lies \d\.\d{4} m beside it 1\d.* at most 0.01 m is allowed",
        ),
        (
            foreign(sections='<laneSection s="9" singleSide="true"><right>' + LANE + SIDE_END),
            "no lanes right of the centre before 9.00 m",
        ),
        (b'<!DOCTYPE OpenDRIVE SYSTEM "file:///etc/passwd">' + foreign(), "DOCTYPE"),
        (foreign(after="<a/>" * 1_000_000), "more than 1000000 elements"),
    ],
)
def test_an_unreadable_file_is_a_one_line_error(data: bytes, message: str) -> None:
    with pytest.raises(RoadError, match=message) as caught:
        RoadMap(data).road()
    assert "\n" not in str(caught.value)


VALUE = re.compile(r'="[^"]*"')
FILES = [
    to_opendrive(Road([0.0, 0.0, 0.01, 0.05, 0.05, -0.02])),
    shape('<paramPoly3 bU="1" cV="0.01" pRange="arcLength"/>').decode(),
    foreign(
        profiles='<elevationProfile><elevation s="0" a="7"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0"/></lateralProfile>',
        offsets='<laneOffset s="0" a="0.5"/><laneOffset s="10" a="0.5" b="0" c="0" d="0"/>',
        sections=section(linked(-1, "successor", -1)) + section(linked(-1), start=12.0),
    ).decode(),
]
HOSTILE = ["x", "0", "-1", "0.5", "1e3", "1e5", "-9e6", "1e-300", "1e300", "-1e308", "nan", "inf"]


@given(st.data())
def test_a_damaged_file_gives_a_road_or_an_error(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(FILES))
    spots = st.lists(st.sampled_from(list(VALUE.finditer(text))), max_size=3, unique=True)
    for spot in sorted(data.draw(spots), key=lambda spot: -spot.start()):
        value = data.draw(st.sampled_from([*HOSTILE, "", "9" * 400]))
        text = f'{text[: spot.start()]}="{value}"{text[spot.end() :]}'
    try:
        road = RoadMap(text.encode()).road()
    except RoadError:
        return
    assert np.isfinite(road.points).all()
