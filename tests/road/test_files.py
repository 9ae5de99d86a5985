"""Road files: their formats and their errors."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.errors import RoadError
from frenetic.export import ExportedRoad, write_road
from frenetic.road import Road, profile
from frenetic.road.files import MAX_BYTES, read_road
from frenetic.road.folders import find_roads
from frenetic.road.opendrive import to_opendrive

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

POINTS = [[40.0, 40.0], [90.0, 45.0], [120.0, 90.0], [120.0, 150.0]]


def write(folder: Path, content: object) -> Path:
    """Write a road file of this content; return its path."""
    path = folder / "road.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_curvatures_are_read_with_defaults_and_with_all_entries(tmp_path: Path) -> None:
    road = read_road(write(tmp_path, {"curvatures": [0.0, 0.01, 0.0]})).road()
    assert road.curvatures.tolist() == [0.0, 0.01, 0.0]
    assert (road.step, road.lane_width) == (10.0, 4.0)
    content = {"curvatures": [0, 0.01, 0], "step": 5, "pose": [1, 2, 3], "lane_width": 5, "id": 7}
    file = read_road(write(tmp_path, content))
    road = file.road()
    assert (road.step, tuple(road.pose), road.lane_width) == (5.0, (1.0, 2.0, 3.0), 5.0)
    assert file.entries["id"] == 7


@pytest.mark.parametrize(
    "content",
    [
        POINTS,
        {"id": 3, "is_valid": True, "road_points": POINTS, "min_oob_distance": math.nan},
        [{"x": x, "y": y, "z": 0.0} for x, y in POINTS],
        [{"road_points": POINTS}],
    ],
)
def test_points_are_read_as_a_list_a_competition_file_or_objects(
    tmp_path: Path, content: object
) -> None:
    loaded = read_road(write(tmp_path, content))
    assert loaded.check_validity().valid
    expected = Road.from_points(POINTS).curvatures
    assert loaded.road().curvatures.tolist() == expected.tolist()


@pytest.mark.parametrize("name", ["road.xodr", "ROAD.XODR", "road.xml", "road"])
def test_opendrive_is_recognised_by_suffix_or_content(tmp_path: Path, name: str) -> None:
    road = Road([0.0, 0.01, -0.02], 5.0, (1.0, 2.0, 3.0), lane_width=3.5)
    path = tmp_path / name
    path.write_text(to_opendrive(road), encoding="utf-8")
    read = read_road(path).road()
    assert read.curvatures.tolist() == [0.0, 0.01, -0.02]
    assert (read.step, tuple(read.pose), read.lane_width) == (5.0, (1.0, 2.0, 3.0), 3.5)


def test_points_are_judged_at_their_place_and_curvatures_where_they_fit(tmp_path: Path) -> None:
    points = [[-50.0, 10.0], [0.0, 10.0], [60.0, 10.0]]
    verdict = read_road(write(tmp_path, points)).check_validity()
    assert verdict.message == "Not entirely inside the map boundaries"
    assert read_road(write(tmp_path, {"curvatures": [0.0] * 12})).check_validity().valid
    verdict = read_road(write(tmp_path, {"curvatures": [0.0] * 50})).check_validity()
    assert "does not fit" in verdict.message
    path = tmp_path / "road.xodr"
    path.write_text(to_opendrive(Road([0.0] * 12, pose=(9000.0, -500.0, 1.0))), encoding="utf-8")
    assert read_road(path).check_validity().valid


HUGE = int("1" * 400)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("no json at all", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("<html></html>", "no OpenDRIVE: its root is <html>"),
        ({"a": 1}, "neither 'curvatures' nor 'road_points'"),
        ("3", "an object with curvatures or road_points"),
        ({"curvatures": "0 1 2"}, r"Expected `array.*, got `str` - at `\$.curvatures`"),
        ({"curvatures": [0.0, None]}, r"Expected `float`, got `null` - at `\$.curvatures\[1\]`"),
        ({"curvatures": [0, HUGE, 0]}, r"out of range - at `\$.curvatures\[1\]`"),
        ('{"curvatures": [0.0, NaN]}', "curvature 1 is nan"),
        ({"curvatures": [0.1]}, "1 curvature samples: 2 to 10000"),
        ({"curvatures": [0.0, 0.0], "step": 1e-300}, "step is 1e-300"),
        ({"curvatures": [0.0, 0.0], "pose": [1, 2]}, r"length 3, got 2 - at `\$.pose`"),
        ({"road_points": [[0, 0], [1]]}, r"point 1 has 1 number: \[x, y\], .* is needed"),
        ({"road_points": [[0, 0, 0], [1, 0]]}, "point 1 has 2 numbers, but point 0 has 3"),
        ([[0, 0, 0, 8, 1], [1, 0, 0, 8, 1]], "point 0 has 5 numbers"),
        ([[0, 0], [1, "x"]], r"Expected `float`, got `str` - at `\$\[1\]\[1\]`"),
        ([[0, 0, 0, 0], [10, 0, 0, 0]], "lane_width is 0: 0.1 to 100 m"),
        ("[[0, 0, NaN], [10, 0, 0]]", "a height and a width of at most"),
        ([[0, 0, 0], [10, 0, 9], [20, 0, 18]], "grade is 0.9 at 0 m"),
        ({"road_points": [[0, 0, 0], [9, 0, 0]], "grade": [[0, 0.1]]}, "have what 'grade' has"),
        ({"road_points": [[0, 0, 0, 8], [9, 0, 0, 8]], "lane_width": 4}, "'lane_width' has, too"),
        ({"road_points": [[0, 0], {"x": 1}]}, r"missing required field `y` - at `\$.road_points"),
        ({"road_points": [[0, 0], [0, 0]]}, "are the same"),
        ({"road_points": [[0, 0], [1e308, 0], [-1e308, 0]]}, "from the origin"),
    ],
)
def test_a_bad_file_is_a_one_line_error_that_names_it(
    tmp_path: Path, content: object, message: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(RoadError, match=message) as caught:
        read_road(path).road()
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    assert len(text) < len(str(path)) + 150


def test_folders_are_searched_and_files_without_a_road_are_skipped(tmp_path: Path) -> None:
    (folder := tmp_path / "roads" / "deeper").mkdir(parents=True)
    bend = write(folder, POINTS)
    road = write(folder.parent, {"curvatures": [0.0, 0.01, 0.0]})
    (settings := folder.parent / "settings.json").write_text("{}")
    (folder.parent / "notes.txt").write_text("none")
    roads_found = find_roads([folder.parent])
    assert list(roads_found.roads) == [str(bend), str(road)]
    (skipped,) = roads_found.skipped
    assert skipped.startswith(f"{settings} has neither")


def test_a_named_file_without_a_road_is_refused(tmp_path: Path) -> None:
    road, missing = write(tmp_path, POINTS), tmp_path / "missing.json"
    with pytest.raises(RoadError) as caught:
        find_roads([road, missing])
    assert str(caught.value) == f"there is no file {missing}"


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RoadError, match="there is no file"):
        read_road(tmp_path / "missing.json")
    with pytest.raises(RoadError, match="is a folder"):
        read_road(tmp_path)
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(RoadError, match=r"is not JSON .* no UTF-8 text: "):
        read_road(binary)
    with pytest.raises(RoadError, match="a lane can be chosen in those only"):
        read_road(write(tmp_path, POINTS), lane=-1)
    with binary.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(RoadError, match=r"more than .* bytes"):
        read_road(binary)


hostile: st.SearchStrategy[object] = st.sampled_from(
    [HUGE, -HUGE, 0, -1, 1e300, -1e300, 1e-300, math.nan, math.inf, True, None, "x", "9", [], {}]
)


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "curvatures": st.lists(st.floats(-0.07, 0.07) | hostile, max_size=6) | hostile,
            "road_points": st.lists(
                st.lists(st.floats(0.0, 200.0) | hostile, min_size=1, max_size=3)
                | st.fixed_dictionaries({"x": st.floats(0.0, 200.0) | hostile, "y": hostile}),
                max_size=6,
            ),
            "step": hostile,
            "pose": st.lists(st.floats(-10.0, 10.0) | hostile, max_size=4) | hostile,
            "lane_width": st.floats(2.0, 5.0) | hostile,
        },
    )
)
def test_a_damaged_file_gives_a_verdict_or_a_one_line_error(content: object) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), content)
        try:
            read_road(path).check_validity()
            points = read_road(path).road().points
        except RoadError as error:
            message = str(error)
        else:
            message, is_finite = str(path), np.isfinite(points).all()
            assert is_finite
        assert message.startswith(str(path))
        assert "\n" not in message


CASES = Path(__file__).parents[1] / "cases" / "maps"


def test_nodes_have_height_and_width(tmp_path: Path) -> None:
    road = read_road(CASES / "11-nodes.json").road()
    assert road.lane_width == 4.0
    assert road.is_plain
    nodes = [[10.0 * i, 0.0, -28.0 + 0.4 * i, 7.0 + 0.1 * i] for i in range(12)]
    for content in (nodes, [dict(zip(("x", "y", "z", "width"), n, strict=True)) for n in nodes]):
        road = read_road(write(tmp_path, content)).road()
        assert road.lane_width == 3.5
        places = np.linspace(0.0, 110.0, 23)
        assert road.heights(places) == pytest.approx(0.04 * places, abs=1e-3)
        assert profile.value_at(road.widening, places) == pytest.approx(0.005 * places, abs=1e-3)


@given(
    st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=20),
    st.floats(2.5, 6.0),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.floats(0.0, 1.5),
)
def test_an_exported_beamng_file_is_read_back(
    curvatures: list[float], lane_width: float, grades: tuple[float, float], wider: float
) -> None:
    road = Road(
        curvatures,
        10.0,
        lane_width=lane_width,
        grade=[(0.0, grades[0]), (20.0, grades[1])],
        widening=[(0.0, 0.0), (20.0, wider)],
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.beamng.json"
        write_road(ExportedRoad(road, "r"), "beamng", path)
        read = read_road(path).road()
    places = np.linspace(0.0, road.length, 50)
    assert np.abs(read.track(road.sample(0.5))[:, 1]).max() < 0.01
    assert read.length == pytest.approx(road.length, abs=0.01)
    assert read.heights(places) == pytest.approx(road.heights(places), abs=0.05)
    widths = [r.lane_width + profile.value_at(r.widening, places) for r in (road, read)]
    assert widths[1] == pytest.approx(widths[0], abs=0.02)


def test_the_error_of_a_list_of_tests_counts_them_and_names_the_command(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    path = str(CASES / "12-suite.json")
    assert frenetic("drive", path).refuses("holds 2 tests", f"'frenetic drive {path} 1'")
    lengths = [frenetic("drive", path, number, "--json").json["length"] for number in ("1", "2")]
    roads = [read_road(path, test=number).road() for number in (1, 2)]
    assert lengths == [road.length for road in roads]
    assert roads[0].points[20, 1] > 100.0 > roads[1].points[20, 1]
    assert frenetic("drive", path, "3").refuses("none of which is 3", "from 1 to 2")
    assert frenetic("drive", path, "1", "2").refuses("name one ID")
    single = str(CASES / "11-nodes.json")
    assert frenetic("drive", single, "1").refuses("holds no list of tests: leave out the ID 1")
    assert frenetic("drive", str(CASES / "07-level.xodr"), "1").refuses("no list of tests")
    out = tmp_path / "one.json"
    assert frenetic("export", path, "2", "--format", "json", "--out", str(out)).code == 0
    assert read_road(out).road().points == pytest.approx(roads[1].points)


def test_points_of_up_to_50_km_are_a_road(frenetic: Frenetic, tmp_path: Path) -> None:
    out = tmp_path / "o.xodr"
    path = str(CASES / "04-points-6km.json")
    answer = frenetic("export", path, "--format", "opendrive", "--out", str(out))
    assert answer.code == 0, answer.err
    assert read_road(out).road().length == pytest.approx(6003.2, abs=0.1)
    angles = np.linspace(0.0, 40.0, 10_000)  # of waves 7.8 km long, R = 390 m at least
    points = np.column_stack([1230.0 * angles, 300.0 * np.sin(angles)])
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    assert 49_500.0 < length < 50_000.0
    road = read_road(write(tmp_path, points.tolist())).road()
    assert road.length == pytest.approx(length, abs=0.1)
    assert np.abs(road.track(points)[:, 1]).max() < 0.001
    with pytest.raises(RoadError, match=r"a road of 5\d+ m: at most 50000 m"):
        read_road(write(tmp_path, (1.05 * points).tolist())).road()


def test_a_long_road_of_points_can_be_driven_on_a_larger_map(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    path = str(write(tmp_path, {"curvatures": [0.0] * 50}))
    answer = frenetic("drive", path, "--dry")
    assert (answer.code, "--map-size 400 has room for it" in answer.out) == (1, True)
    assert frenetic("drive", path, "--dry", "--map-size", "400").code == 0
    assert frenetic("drive", path, "--dry", "--map-size", "nan").refuses("map")
