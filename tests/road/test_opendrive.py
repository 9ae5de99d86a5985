"""OpenDRIVE files: ours are exact and always the same, those of others are read or refused."""

from __future__ import annotations

import itertools
import math
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import Road
from frenetic.road.opendrive import from_opendrive, to_opendrive

NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def end_of(
    x: float, y: float, heading: float, length: float, start: float, end: float
) -> tuple[float, float, float]:
    """Where a clothoid ends, by a quadrature of its own."""
    pieces = max(1, math.ceil(length * max(abs(start), abs(end))))
    for i in range(pieces):
        u = length / pieces
        k0 = start + (end - start) * i / pieces
        rate = (end - start) / length
        t = 0.5 * u * (NODES + 1.0)
        angle = heading + t * (k0 + 0.5 * rate * t)
        x += 0.5 * u * float(WEIGHTS @ np.cos(angle))
        y += 0.5 * u * float(WEIGHTS @ np.sin(angle))
        heading += u * (k0 + 0.5 * rate * u)
    return x, y, heading


def plan_view(text: str) -> list[tuple[dict[str, float], ElementTree.Element]]:
    return [
        ({key: float(value) for key, value in geometry.attrib.items()}, geometry[0])
        for geometry in ElementTree.fromstring(text.encode()).iter("geometry")
    ]


def kinds(road: Road) -> list[str]:
    return [shape.tag for _, shape in plan_view(to_opendrive(road))]


def curvatures_of(shape: ElementTree.Element) -> tuple[float, float]:
    if shape.tag == "spiral":
        return float(shape.attrib["curvStart"]), float(shape.attrib["curvEnd"])
    same = float(shape.get("curvature", 0.0))
    return same, same


nearly = st.sampled_from([0.0, 1e-13, 1e-12, 3e-11, 1e-10, 5e-10, 1e-9, 2e-9, 1e-7])
curvature = st.floats(-0.07, 0.07).map(lambda value: round(value, 6))


@st.composite
def roads(draw: st.DrawFn) -> Road:
    """Roads as a search makes them, and ones with values that are nearly alike."""
    values = draw(st.lists(curvature, min_size=2, max_size=40))
    for i in range(1, len(values)):
        if draw(st.booleans()):
            values[i] = values[i - 1] + draw(nearly)
    step = draw(st.sampled_from([10.0, 0.5, 7.3, 25.0, 1.0 / 3.0]))
    place = st.floats(-1000.0, 1000.0)
    pose = (draw(place), draw(place), draw(st.floats(-7.0, 7.0)))
    return Road(values, step, pose, lane_width=draw(st.floats(2.0, 6.0)))


# Writing


def test_each_step_is_a_spiral_and_what_stays_the_same_an_arc_or_a_line() -> None:
    assert kinds(Road([0.0, 0.01, 0.03, -0.02])) == ["spiral"] * 3
    assert kinds(Road([0.0] * 9)) == ["line"]
    assert kinds(Road([0.02] * 9)) == ["arc"]
    assert kinds(Road([0.0, 0.0, 0.02, 0.02, 0.02, 0.0])) == ["line", "spiral", "arc", "spiral"]


def test_two_arcs_are_not_taken_for_one() -> None:
    road = Road([0.02, 0.02, 0.02 + 5e-10, 0.02 + 5e-10])
    assert kinds(road) == ["arc"] * 3


@given(roads())
def test_the_geometries_join_and_end_where_the_road_ends(road: Road) -> None:
    expected = tuple(road.pose)
    total = 0.0
    for attributes, shape in plan_view(to_opendrive(road)):
        x, y, heading = expected
        assert attributes["s"] == pytest.approx(total, abs=1e-8)
        assert math.hypot(attributes["x"] - x, attributes["y"] - y) < 1e-6
        assert attributes["hdg"] == pytest.approx(heading, abs=1e-7)
        # From where the file says, so that errors cannot add up unseen.
        start, end = curvatures_of(shape)
        expected = end_of(
            attributes["x"], attributes["y"], attributes["hdg"], attributes["length"], start, end
        )
        total += attributes["length"]
    x, y, _ = road.pose_at(road.length)
    assert math.hypot(expected[0] - x, expected[1] - y) < 1e-6
    assert total == pytest.approx(road.length)


@given(roads())
def test_no_spiral_is_nearly_an_arc_and_no_arc_nearly_a_line(road: Road) -> None:
    for _, shape in plan_view(to_opendrive(road)):
        start, end = curvatures_of(shape)
        if shape.tag == "spiral":
            assert abs(end - start) >= 1e-9
        if shape.tag == "arc":
            assert abs(start) >= 1e-10


@given(roads())
def test_no_spiral_has_ends_that_numpy_takes_for_equal(road: Road) -> None:
    for _, shape in plan_view(to_opendrive(road)):
        if shape.tag == "spiral":
            assert not np.isclose(*curvatures_of(shape))


def test_a_long_step_that_hardly_bends_is_several_arcs() -> None:
    assert kinds(Road([0.05, 0.05 + 1e-7, 0.0], 40.0)) == ["arc"] * 12 + ["spiral"]


def test_same_road_same_bytes_without_a_date() -> None:
    values = [0.01, -0.02, 0.03]
    text = to_opendrive(Road(values))
    assert text == to_opendrive(Road(np.array(values)))
    assert "date" not in text
    assert text.endswith("</OpenDRIVE>\n")
    assert '-0.0"' not in to_opendrive(Road([0.0, -0.0], pose=(-0.0, 0.0, 0.0)))


def test_the_header_says_where_the_road_lies() -> None:
    road = Road([0.01, 0.05, -0.03, 0.0], pose=(5.0, -7.0, 1.0))
    header = ElementTree.fromstring(to_opendrive(road, shoulder=2.0)).find("header")
    assert header is not None
    assert (header.get("revMajor"), header.get("revMinor")) == ("1", "7")
    east, west, north, south = (float(header.attrib[k]) for k in ("east", "west", "north", "south"))
    edges = np.concatenate([road.sample(0.1, 6.0), road.sample(0.1, -6.0)])
    assert [west, south] == pytest.approx(edges.min(axis=0), abs=0.01)
    assert [east, north] == pytest.approx(edges.max(axis=0), abs=0.01)
    place = header.find("geoReference")
    assert place is not None
    assert place.text is not None
    assert place.text.startswith("+proj=tmerc +lat_0=49.0 +lon_0=8.4 ")


def test_lanes_marks_and_speed() -> None:
    root = ElementTree.fromstring(to_opendrive(Road([0.0, 0.0], lane_width=3.5), speed_limit=50.0))
    found = {
        lane.attrib["id"]: (
            lane.attrib["type"],
            [float(width.attrib["a"]) for width in lane.findall("width")],
            [mark.attrib["type"] for mark in lane.findall("roadMark")],
            [(s.attrib["max"], s.attrib["unit"]) for s in lane.findall("speed")],
        )
        for lane in root.iter("lane")
    }
    driven = ("driving", [3.5], ["solid"], [("50.0", "km/h")])
    assert found == {"1": driven, "0": ("none", [], ["broken"], []), "-1": driven}
    speed = root.find("road/type/speed")
    assert speed is not None
    assert speed.attrib == {"max": "50.0", "unit": "km/h"}


def test_shoulders_lie_outside_the_lanes() -> None:
    root = ElementTree.fromstring(to_opendrive(Road([0.0, 0.0]), shoulder=2.5))
    lanes = [(lane.get("id"), lane.get("type")) for lane in root.iter("lane")]
    assert lanes == [
        ("2", "shoulder"),
        ("1", "driving"),
        ("0", "none"),
        ("-1", "driving"),
        ("-2", "shoulder"),
    ]
    assert from_opendrive(to_opendrive(Road([0.0, 0.0]), shoulder=2.5).encode()).lane_width == 4.0


@pytest.mark.parametrize(
    "name", ['a "b" <c> & d', "zero\x00, bell\x07, surrogate\udcff", "é 路", ""]
)
def test_any_name_can_be_written(name: str) -> None:
    root = ElementTree.fromstring(to_opendrive(Road([0.0, 0.0]), name=name).encode("utf-8"))
    road = root.find("road")
    assert road is not None
    assert road.get("name") == re.sub(r"[\x00\x07\udcff]", "?", name)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"speed_limit": 0.0}, "speed_limit is 0"),
        ({"speed_limit": math.nan}, "speed_limit is nan"),
        ({"shoulder": -1.0}, "shoulder is -1"),
        ({"shoulder": math.inf}, "shoulder is inf"),
        ({"origin": (91.0, 0.0)}, r"origin is \(91, 0\)"),
        ({"origin": (0.0, math.nan)}, r"origin is \(0, nan\)"),
    ],
)
def test_senseless_options_are_refused(options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(RoadError, match=complaint):
        to_opendrive(Road([0.0, 0.0]), **options)


# Reading what we wrote


@given(roads())
def test_our_own_file_gives_the_same_road(road: Road) -> None:
    read = from_opendrive(to_opendrive(road).encode())
    assert len(read.curvatures) == len(road.curvatures)
    assert np.abs(read.curvatures - road.curvatures).max() <= 1e-9
    assert (read.step, read.pose) == (road.step, road.pose)
    assert read.lane_width == road.lane_width


@given(
    st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=30).filter(
        lambda values: all(abs(a - b) > 1e-9 for a, b in itertools.pairwise(values))
    )
)
def test_curvatures_that_change_come_back_bit_for_bit(values: list[float]) -> None:
    assert from_opendrive(to_opendrive(Road(values)).encode()).curvatures.tolist() == values


@given(roads())
def test_curvatures_that_hardly_change_come_back_bit_for_bit(road: Road) -> None:
    read = from_opendrive(to_opendrive(road).encode())
    assert read.curvatures.tolist() == road.curvatures.tolist()


def test_noted_curvatures_do_not_count_where_the_geometries_say_something_else() -> None:
    text = to_opendrive(Road([0.02, 0.02 + 1e-10]))
    assert 'code="frenetic:curvatures"' in text
    bent = re.sub(r'curvature="0.02\d*"', 'curvature="0.03"', text)
    assert set(from_opendrive(bent.encode()).curvatures) == {0.03}
    longer = text.replace('length="10.0"', 'length="20.0"')
    assert from_opendrive(longer.encode()).length == 20.0
    for damage in ("", "x", "0.02", "9 9", "nan nan"):
        damaged = re.sub(r'(frenetic:curvatures" value=)"[^"]*"', rf'\1"{damage}"', text)
        read = from_opendrive(damaged.encode())
        assert read.curvatures == pytest.approx([0.02] * 2, abs=1e-9)


def test_a_file_that_was_edited_counts_for_what_it_says() -> None:
    text = to_opendrive(Road([0.0, 0.01, 0.0]))
    shorter = text.replace('length="10.0"', 'length="5.0"', 1).replace('value="10.0"', 'value="x"')
    with pytest.raises(RoadError, match="value='x'"):
        from_opendrive(shorter.encode())
    noted = to_opendrive(Road([0.01] * 5)).replace('value="10.0"', 'value="7.0"')
    read = from_opendrive(noted.encode())
    assert (read.length, set(read.curvatures)) == (40.0, {0.01})
    without = re.sub(r"<userData.*/>", "", to_opendrive(Road([0.0, 0.0, 0.02, 0.0])))
    assert from_opendrive(without.encode()).curvatures.tolist() == [0.0, 0.0, 0.02, 0.0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
def test_other_encodings_and_a_namespace(encoding: str) -> None:
    text = to_opendrive(Road([0.0, 0.03]), name="Straße")
    text = text.replace("UTF-8", encoding.removesuffix("-sig"))
    text = text.replace("<OpenDRIVE>", '<OpenDRIVE xmlns="http://asam.net/opendrive">')
    assert from_opendrive(text.encode(encoding)).curvatures.tolist() == [0.0, 0.03]


# Reading what others wrote

WIDTH = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
LANE = f'<lane id="-1" type="driving">{WIDTH}</lane>'
LINE = '<geometry s="0" x="0" y="0" hdg="0" length="30"><line/></geometry>'


def foreign(
    plan: str = LINE,
    *,
    header: str = '<header revMajor="1" revMinor="4"/>',
    attributes: str = 'length="30" id="7" junction="-1"',
    before_lanes: str = "",
    offsets: str = "",
    sections: str = f'<laneSection s="0"><right>{LANE}</right></laneSection>',
    after: str = "",
) -> bytes:
    return (
        f"<OpenDRIVE>{header}<road {attributes}><planView>{plan}</planView>{before_lanes}"
        f"<lanes>{offsets}{sections}</lanes></road>{after}</OpenDRIVE>"
    ).encode()


def chain(pieces: list[tuple[float, float, float]], digits: int = 12) -> tuple[str, FloatArray]:
    """A plan view of (length, start, end) clothoids, and points of it every 5 cm or so, (n, 2)."""
    pose = (12.0, -3.0, 0.4)
    plan, points, s = [], [pose[:2]], 0.0
    for length, start, end in pieces:
        x, y, heading = (round(v, digits) for v in pose)
        shape = f'<spiral curvStart="{start}" curvEnd="{end}"/>'
        if start == end:
            shape = f'<arc curvature="{start}"/>' if start else "<line/>"
        place = f's="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}"'
        plan.append(f"<geometry {place}>{shape}</geometry>")
        for share in np.linspace(0.0, 1.0, math.ceil(length / 0.5) + 1)[1:].tolist():
            there = start + (end - start) * share
            points.append(end_of(*pose, length * share, start, there)[:2])
        pose = end_of(*pose, length, start, end)
        s += length
    return "".join(plan), np.array(points)


def away(road: Road, points: FloatArray) -> float:
    track = road.track(points)
    ends = abs(track[0, 0]), abs(track[-1, 0] - road.length)
    return max(*map(float, ends), float(np.abs(track[:, 1]).max()))


def test_a_file_of_another_tool_that_is_a_clothoid_chain_is_read_as_it_is() -> None:
    pieces = [(50.0, 0.0, 0.0), (20.0, 0.0, 0.05), (30.0, 0.05, 0.05), (20.0, 0.05, -0.01)]
    plan, points = chain(pieces, digits=4)
    road = from_opendrive(foreign(plan))
    assert (road.step, road.lane_width) == (10.0, 3.5)
    expected = [0.0] * 6 + [0.025, 0.05, 0.05, 0.05, 0.05, 0.02, -0.01]
    assert road.curvatures == pytest.approx(expected, abs=1e-15)
    assert away(road, points) < 1e-3


lengths = st.floats(0.5, 60.0)
clothoids = st.one_of(
    st.tuples(lengths, st.just(0.0), st.just(0.0)),
    st.tuples(lengths, curvature).map(lambda p: (p[0], p[1], p[1])),
    st.tuples(lengths, curvature, curvature),
)


@given(st.lists(clothoids, min_size=1, max_size=6))
def test_a_road_keeps_within_a_centimetre_of_a_line_whose_curvature_jumps(
    pieces: list[tuple[float, float, float]],
) -> None:
    plan, points = chain(pieces)
    road = from_opendrive(foreign(plan))
    assert road.length == pytest.approx(sum(piece[0] for piece in pieces))
    assert away(road, points) < 0.01


def test_lines_and_arcs_as_they_are_usually_drawn() -> None:
    plan, points = chain([(50.0, 0.0, 0.0), (31.4, 0.066, 0.066), (40.0, 0.0, 0.0)], digits=5)
    road = from_opendrive(foreign(plan))
    assert away(road, points) < 0.004
    assert road.step == pytest.approx(0.5, abs=0.01)
    assert road.curvature_at([25.0, 65.0, 100.0]) == pytest.approx([0.0, 0.066, 0.0], abs=1e-3)


@pytest.mark.parametrize("p_range", ["arcLength", "normalized", None])
def test_param_poly3(p_range: str | None) -> None:
    # A cubic Bezier curve from (0, 0) to (60, 20), both ends along +x.
    u, v = np.array([0.0, 90.0, -90.0, 60.0]), np.array([0.0, 0.0, 60.0, -40.0])
    p = np.linspace(0.0, 1.0, 4001)
    points = np.column_stack([np.polyval(u[::-1], p), np.polyval(v[::-1], p)])
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    attribute = "" if p_range is None else f'pRange="{p_range}"'
    if p_range == "arcLength":
        u, v = (c / length ** np.arange(4) for c in (u, v))
    numbers = " ".join(
        f'{name}{axis}="{value}"'
        for axis, values in (("U", u), ("V", v))
        for name, value in zip("abcd", values.tolist(), strict=True)
    )
    plan = (
        f'<geometry s="0" x="0" y="0" hdg="0" length="{length}">'
        f"<paramPoly3 {numbers} {attribute}/></geometry>"
    )
    road = from_opendrive(foreign(plan))
    assert road.length == pytest.approx(length, abs=1e-3)
    assert away(road, points[::10]) < 0.01


def test_poly3_after_a_line() -> None:
    x = np.linspace(0.0, 50.0, 5001)
    points = np.column_stack([x + 30.0, 0.006 * x**2 - 0.00008 * x**3])
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    poly = (
        f'<geometry s="30" x="30" y="0" hdg="0" length="{length}">'
        '<poly3 a="0" b="0" c="0.006" d="-0.00008"/></geometry>'
    )
    road = from_opendrive(foreign(LINE + poly))
    assert road.length == pytest.approx(30.0 + length, abs=1e-3)
    line = np.column_stack([np.linspace(0.0, 29.9, 300), np.zeros(300)])
    assert away(road, np.concatenate([line, points[::10]])) < 0.01


def test_shifted_lanes_follow_the_middle_of_the_road() -> None:
    radius = 40.0
    plan = (
        f'<geometry s="0" x="0" y="0" hdg="0" length="62.8"><arc curvature="{1 / radius}"/>'
        "</geometry>"
    )
    road = from_opendrive(foreign(plan, offsets='<laneOffset s="0" a="1.5"/>'))
    assert road.points[0] == pytest.approx([0.0, 1.5], abs=1e-6)
    assert road.length == pytest.approx(62.8 * (radius - 1.5) / radius, abs=1e-3)
    assert np.hypot(*(road.points - [0.0, radius]).T) == pytest.approx(radius - 1.5, abs=0.002)


def test_lanes_that_move_over() -> None:
    plan = '<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>'
    # From 0 at 20 m to 2 m at 60 m, smoothly.
    offsets = (
        '<laneOffset s="0" a="0"/><laneOffset s="20" a="0" b="0" c="0.00375" d="-0.0000625"/>'
        '<laneOffset s="60" a="2"/>'
    )
    road = from_opendrive(foreign(plan, offsets=offsets))
    points = road.sample(1.0)
    p = np.clip(points[:, 0] - 20.0, 0.0, 40.0)
    assert points[:, 1] == pytest.approx(0.00375 * p**2 - 0.0000625 * p**3, abs=0.01)
    assert points[-1] == pytest.approx([100.0, 2.0], abs=0.01)


def test_offsets_and_slopes_that_are_nothing_do_not_matter() -> None:
    data = foreign(
        before_lanes='<elevationProfile><elevation s="0" a="7.5" b="1e-9"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="1e-6" b="0"/></lateralProfile>',
        offsets='<laneOffset s="0" a="1e-12"/>',
    )
    assert from_opendrive(data).curvatures.tolist() == [0.0, 0.0]


def test_other_lanes_and_a_changed_section_do_not_matter() -> None:
    other = f'<left><lane id="1" type="driving">{WIDTH}</lane></left>'
    outer = f'<lane id="-2" type="sidewalk">{WIDTH}</lane>'
    sections = (
        f'<laneSection s="0">{other}<right>{LANE}{outer}</right></laneSection>'
        f'<laneSection s="12"><right>{LANE}</right></laneSection>'
    )
    assert from_opendrive(foreign(sections=sections)).lane_width == 3.5


def lane_section(lane: str) -> str:
    return f'<laneSection s="0"><right>{lane}</right></laneSection>'


def profile(inside: str, kind: str = "lateralProfile") -> dict[str, str]:
    return {"before_lanes": f"<{kind}>{inside}</{kind}>"}


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "not XML: no element found in line 1"),
        (b"{}", "not XML: .* in line 1, column 1"),
        (b"<OpenDRIVE>", "not XML: no element found"),
        (b"<a/>", "no OpenDRIVE: its root is <a>"),
        (b'<?xml version="1.0" encoding="klingon"?><a/>', "not XML|encoding"),
        (b"<OpenDRIVE/>", "revMajor None, but only OpenDRIVE 1.x"),
        (
            foreign(header='<header revMajor="2" revMinor="0"/>'),
            "revMajor '2', but only OpenDRIVE 1.x",
        ),
        (b'<OpenDRIVE><header revMajor="1"/></OpenDRIVE>', "it has 0 roads"),
        (foreign(after="<road/>"), "it has 2 roads"),
        (foreign(after='<junction id="1"/>'), "it has a junction"),
        (foreign(attributes='length="30" junction="4"'), "belongs to a junction"),
        (foreign(attributes='length="30" rule="LHT"'), "rule is 'LHT'"),
        (foreign(attributes='length="30" rule="a&#10;b"'), r"rule is 'a\\nb'"),
        (foreign(attributes=""), "a <road> has no 'length'"),
        (foreign(""), "has no geometry"),
        (foreign(LINE.replace("<line/>", "")), "holds nothing: line, arc"),
        (foreign(LINE.replace("<line/>", "<bezier/>")), "holds bezier: line, arc"),
        (foreign(LINE.replace('"30"', '"-1"')), "has length -1"),
        (foreign(LINE.replace('"30"', '"1e9"')), "longer than the 50000 m"),
        (foreign(LINE.replace('"30"', '"nan"')), "length='nan': a finite number"),
        (foreign(LINE.replace('hdg="0"', "")), "a <geometry> has no 'hdg'"),
        (foreign(LINE.replace('hdg="0"', 'hdg="east"')), "hdg='east'"),
        (foreign(LINE.replace("<line/>", '<arc curvature="11"/>')), "curvature of 11 1/m"),
        (foreign(LINE.replace("<line/>", "<arc/>")), "an? <arc> has no 'curvature'"),
        (foreign(LINE + LINE.replace('x="0"', 'x="31"')), "jumps by 1.000 m 30.00 m along"),
        (
            foreign(LINE + LINE.replace('x="0"', 'x="30"').replace('hdg="0"', 'hdg="0.1"')),
            "kink of 5.7 degrees 30.00 m along",
        ),
        (
            foreign(LINE.replace("<line/>", '<paramPoly3 bU="90" bV="0"/>')),
            "is 90 m long, not 30 m",
        ),
        (
            foreign(LINE.replace("<line/>", '<paramPoly3 cU="30" pRange="normalized"/>')),
            "has a cusp",
        ),
        (foreign(LINE.replace("<line/>", '<paramPoly3 bU="1e300" cV="1e300"/>')), "m long, not"),
        (foreign(LINE.replace('x="0"', 'x="1e200"')), r"at \(1e\+200, 0\): at most 1e\+07 m"),
        (foreign(**profile('<elevation s="0" b="0.01"/>', "elevationProfile")), "rises or falls"),
        (
            foreign(
                **profile(
                    '<elevation s="0" a="1"/><elevation s="9" a="2"/>', kind="elevationProfile"
                )
            ),
            "rises or falls",
        ),
        (foreign(**profile('<superelevation s="0" a="0.05"/>')), r"leans .* \(superelevation\)"),
        (foreign(**profile('<crossfall side="both" s="0" a="0.02"/>')), r"leans .* \(crossfall\)"),
        (foreign(**profile('<shape s="0" t="0" a="0" b="0.02"/>')), "not level across"),
        (foreign(sections=""), "has no lanes"),
        (foreign(sections='<laneSection s="0"/>'), "lane -1, right of the centre, is missing"),
        (foreign(sections=lane_section(LANE.replace("driving", "biking"))), "is of type 'biking'"),
        (
            foreign(sections=lane_section(LANE.replace("type", 'direction="reversed" type'))),
            "driven against the road",
        ),
        (foreign(sections=lane_section('<lane id="-1" type="driving"/>')), "has no width"),
        (
            foreign(sections=lane_section(LANE.replace('b="0"', 'b="0.02"'))),
            "3.5 to 4.1 m wide",
        ),
        (foreign(sections=lane_section(LANE.replace("3.5", "-3.5"))), "lane_width is -3.5"),
        (
            foreign(
                LINE.replace("<line/>", '<arc curvature="0.1"/>'),
                offsets='<laneOffset s="0" a="12"/>',
            ),
            "beyond the centre of a bend",
        ),
        (foreign(LINE, offsets='<laneOffset s="0"/><laneOffset s="10" a="3"/>'), "no road can"),
        (foreign(offsets='<laneOffset s="0" a="-1e308"/>'), "a='-1e308': at most 1e\\+07"),
        (foreign(LINE.replace('hdg="0"', 'hdg="1e300"')), "hdg='1e300': at most 1e\\+06"),
        (foreign(sections=lane_section(LANE.replace("3.5", "1e308"))), "a='1e308': at most"),
        (foreign(sections=lane_section(LANE.replace("3.5", "1e4"))), "lane_width is 10000"),
    ],
)
def test_what_is_no_single_flat_road_gets_one_line(data: bytes, complaint: str) -> None:
    with pytest.raises(RoadError, match=complaint) as caught:
        from_opendrive(data)
    assert "\n" not in str(caught.value)


# Chains of roads, and lanes


def linked(
    name: str, plan: str, before: str = "", after: str = "", lanes: str = LANE, left: str = ""
) -> str:
    """A road of 20 m; ``before`` and ``after`` are the id and the end of its neighbours."""
    links = ""
    for kind, there in (("predecessor", before), ("successor", after)):
        if there:
            other, contact = there.split()
            link = f'elementType="road" elementId="{other}" contactPoint="{contact}"'
            links += f"<{kind} {link}/>"
    section = f'<laneSection s="0"><left>{left}</left><right>{lanes}</right></laneSection>'
    return (
        f'<road length="20" id="{name}" junction="-1"><link>{links}</link>'
        f"<planView>{plan}</planView><lanes>{section}</lanes></road>"
    )


def file_of(*roads: str) -> bytes:
    return f'<OpenDRIVE><header revMajor="1"/>{"".join(roads)}</OpenDRIVE>'.encode()


def along(x: float, heading: float, shape: str = "<line/>", y: float = 0.0) -> str:
    return f'<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="20">{shape}</geometry>'


def test_a_chain_of_roads_is_read_as_one() -> None:
    plan, points = chain([(20.0, 0.0, 0.0), (20.0, 0.0, 0.05), (20.0, 0.05, 0.05)])
    first, second, third = re.findall("<geometry.*?</geometry>", plan)
    roads = (
        linked("c", third, before="b end"),
        linked("a", first, after="b start"),
        linked("b", second, before="a end", after="c start"),
    )
    for order in itertools.permutations(roads):
        road = from_opendrive(file_of(*order))
        assert (road.step, road.length) == (20.0, 60.0)
        assert road.curvatures == pytest.approx([0.0, 0.0, 0.05, 0.05], abs=1e-12)
        assert away(road, points) < 1e-3


def test_a_road_that_is_drawn_backwards_in_a_chain_has_its_lane_on_the_left() -> None:
    left = f'<lane id="1" type="driving">{WIDTH}</lane>'
    roads = (
        linked("a", along(0.0, 0.0), after="b end"),
        linked("b", along(40.0, math.pi), after="a end", before="c start", left=left, lanes=""),
        linked("c", along(40.0, 0.0), before="b start"),
    )
    road = from_opendrive(file_of(*roads))
    assert road.length == pytest.approx(60.0)
    assert away(road, np.column_stack([np.linspace(0.0, 60.0, 61), np.zeros(61)])) < 1e-3


def test_any_lane_can_be_chosen() -> None:
    radius = 40.0
    narrow = '<width sOffset="0" a="2.5"/>'
    right = (
        f'<lane id="-1" type="median">{narrow}</lane>'
        f'<lane id="-2" type="driving">{narrow}</lane>'
        f'<lane id="-3" type="driving">{WIDTH}</lane>'
    )
    left = f'<lane id="2" type="driving">{WIDTH}</lane><lane id="1" type="driving">{narrow}</lane>'
    data = file_of(
        linked("a", along(0.0, 0.0, f'<arc curvature="{1 / radius}"/>'), "", "", right, left)
    )
    for lane, shift, width in ((-2, -2.5, 2.5), (-3, -5.0, 3.5), (1, 0.0, 2.5), (2, 2.5, 3.5)):
        road = from_opendrive(data, lane=lane)
        assert road.lane_width == width
        assert road.length == pytest.approx(20.0 * (radius - shift) / radius, abs=1e-3)
        distances = np.hypot(*(road.points - [0.0, radius]).T)
        assert distances == pytest.approx(radius - shift, abs=0.005)
        ends = road.points[[0, -1]] if lane < 0 else road.points[[-1, 0]]
        assert ends[0] == pytest.approx([0.0, shift], abs=0.005)
        mean = float(road.curvature_at(0.5 * road.length))
        assert mean == pytest.approx(math.copysign(1.0 / (radius - shift), -lane), rel=0.01)
    with pytest.raises(RoadError, match=r"lane -1.*'median'.*chosen as 'lane': -2, -3, 2, 1\)"):
        from_opendrive(data)
    with pytest.raises(RoadError, match=r"lane -4, right of the centre, is missing"):
        from_opendrive(data, lane=-4)
    with pytest.raises(RoadError, match=r"lane 0 is the centre"):
        from_opendrive(data, lane=0)


def test_inner_lanes_whose_width_changes_move_the_lane() -> None:
    wider = '<width sOffset="0" a="3"/><width sOffset="5" a="3" c="0.03" d="-0.002"/>'
    wider += '<width sOffset="15" a="4"/>'
    right = (
        f'<lane id="-1" type="driving">{wider}</lane><lane id="-2" type="driving">{WIDTH}</lane>'
    )
    road = from_opendrive(file_of(linked("a", along(0.0, 0.0), lanes=right)), lane=-2)
    points = road.sample(0.5)
    p = np.clip(points[:, 0] - 5.0, 0.0, 10.0)
    assert points[:, 1] == pytest.approx(-3.0 - 0.03 * p**2 + 0.002 * p**3, abs=0.01)
    assert road.lane_width == 3.5


def test_the_links_of_lanes_are_followed() -> None:
    on_the_inside = f'<lane id="-1" type="driving">{WIDTH}</lane>'
    kept = '<lane id="-1" type="driving"><link><successor id="-2"/></link>' + WIDTH + "</lane>"
    roads = (
        linked("a", along(0.0, 0.0), after="b start", lanes=kept),
        linked(
            "b",
            along(20.0, 0.0, y=3.5),
            before="a end",
            lanes=f'{on_the_inside}<lane id="-2" type="driving">{WIDTH}</lane>',
        ),
    )
    road = from_opendrive(file_of(*roads))
    assert away(road, np.column_stack([np.linspace(0.0, 40.0, 41), np.zeros(41)])) < 1e-3


@pytest.mark.parametrize(
    ("roads", "complaint"),
    [
        (
            (linked("a", along(0.0, 0.0)), linked("b", along(20.0, 0.0))),
            "it has 2 roads, of which 1",
        ),
        ((linked("a", ""), linked("a", "")), "same id"),
        (
            (linked("a", "", "b end", "b start"), linked("b", "", "a end", "a start")),
            "closed loop",
        ),
        ((linked("a", "", after="c start"), linked("b", "")), "successor of road 'a' is missing"),
        ((linked("a", "", after="b middle"), linked("b", "")), "or where the two meet"),
        (
            (linked("a", "", after="b start"), linked("b", "", before="c end"), linked("c", "")),
            "is another one than the other road says",
        ),
        (
            (
                linked("a", "", after="b start").replace('Type="road"', 'Type="junction"'),
                linked("b", ""),
            ),
            "successor of road 'a' is a 'junction'",
        ),
        (
            (linked("a", along(0.0, 0.0), after="b start"), linked("b", along(25.0, 0.0))),
            "jumps by 5.000 m 20.00 m along",
        ),
        (
            (
                linked("a", along(0.0, 0.0), after="b start"),
                linked("b", along(20.0, 0.0), lanes=LANE.replace("3.5", "3")),
            ),
            "3 to 3.5 m wide",
        ),
        (
            (
                linked("a", along(0.0, 0.0), after="b end"),
                linked("b", along(40.0, math.pi)),
            ),
            "its lane 1, left of the centre, is missing",
        ),
    ],
)
def test_roads_that_are_no_chain_get_one_line(roads: tuple[str, ...], complaint: str) -> None:
    with pytest.raises(RoadError, match=complaint) as caught:
        from_opendrive(file_of(*roads))
    assert "\n" not in str(caught.value)


# Reading what means harm


def test_entities_do_not_expand() -> None:
    levels = "".join(f'<!ENTITY lol{i} "{f"&lol{i - 1};" * 10}">' for i in range(1, 12))
    bomb = f'<!DOCTYPE OpenDRIVE [<!ENTITY lol0 "lol">{levels}]><OpenDRIVE name="&lol11;"/>'
    with pytest.raises(RoadError, match="DOCTYPE"):
        from_opendrive(bomb.encode())


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE OpenDRIVE [<!ENTITY secret SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE OpenDRIVE SYSTEM "file:///etc/passwd">',
        '<!DOCTYPE OpenDRIVE [<!ENTITY % remote SYSTEM "http://localhost/x.dtd"> %remote;]>',
    ],
)
def test_nothing_is_fetched_from_elsewhere(doctype: str) -> None:
    with pytest.raises(RoadError, match="DOCTYPE"):
        from_opendrive(doctype.encode() + foreign())


def test_floods_and_pits_are_refused() -> None:
    with pytest.raises(RoadError, match="more than 200000 elements"):
        from_opendrive(foreign(after="<a/>" * 200_000))
    with pytest.raises(RoadError, match="nested deeper than 50"):
        from_opendrive(foreign(after="<a>" * 1_000_000))
    with pytest.raises(RoadError, match="10001 geometries"):
        from_opendrive(foreign(LINE * 10_001))


VALUE = re.compile(r'="[^"]*"')
OURS = [
    to_opendrive(Road([0.0, 0.0, 0.01, 0.05, 0.05, -0.02]), shoulder=1.0),
    foreign(LINE.replace("<line/>", '<paramPoly3 bU="1" cV="0.01" pRange="arcLength"/>')).decode(),
    file_of(
        linked("a", along(0.0, 0.0), after="b end"),
        linked("b", along(40.0, 3.14), left=LANE.replace("-1", "1")),
    ).decode(),
    foreign(
        before_lanes='<elevationProfile><elevation s="0" a="7"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0"/></lateralProfile>',
        offsets='<laneOffset s="0" a="0.5"/><laneOffset s="10" a="0.5" b="0" c="0" d="0"/>',
    ).decode(),
]


@settings(max_examples=100)
@given(st.data())
def test_a_damaged_file_gives_a_road_or_one_line(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(OURS))
    spots = list(VALUE.finditer(text))
    hostile = st.sampled_from(
        [
            *[
                "x",
                "0",
                "-1",
                "0.5",
                "1e3",
                "1e5",
                "-9e6",
                "1e-300",
                "1e300",
                "-1e308",
                "nan",
                "inf",
            ],
            "",
            "9" * 400,
        ]
    )
    for spot in sorted(
        data.draw(st.lists(st.sampled_from(spots), max_size=3, unique=True)),
        key=lambda spot: -spot.start(),
    ):
        text = f'{text[: spot.start()]}="{data.draw(hostile)}"{text[spot.end() :]}'
    try:
        road = from_opendrive(text.encode())
    except RoadError:
        return
    assert np.isfinite(road.points).all()
