from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.errors import RoadError
from frenetic.road import Road
from frenetic.road.files import MAX_BYTES, read_road
from frenetic.road.opendrive import to_opendrive

POINTS = [[40.0, 40.0], [90.0, 45.0], [120.0, 90.0], [120.0, 150.0]]


def write(folder: Path, content: object) -> Path:
    path = folder / "road.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_curvatures_with_defaults_and_everything_given(tmp_path: Path) -> None:
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
    ],
)
def test_points_as_a_bare_list_a_competition_file_or_objects(
    tmp_path: Path, content: object
) -> None:
    loaded = read_road(write(tmp_path, content))
    assert loaded.check_validity().valid
    expected = Road.from_points(POINTS).curvatures
    assert loaded.road().curvatures.tolist() == expected.tolist()


@pytest.mark.parametrize("name", ["road.xodr", "ROAD.XODR", "road.xml", "road"])
def test_opendrive_is_known_by_its_suffix_or_its_content(tmp_path: Path, name: str) -> None:
    road = Road([0.0, 0.01, -0.02], 5.0, (1.0, 2.0, 3.0), lane_width=3.5)
    path = tmp_path / name
    path.write_text(to_opendrive(road), encoding="utf-8")
    read = read_road(path).road()
    assert read.curvatures.tolist() == [0.0, 0.01, -0.02]
    assert (read.step, tuple(read.pose), read.lane_width) == (5.0, (1.0, 2.0, 3.0), 3.5)


def test_points_are_judged_where_they_lie_and_curvatures_where_they_fit(tmp_path: Path) -> None:
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
    ("content", "complaint"),
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
        ({"road_points": [[0, 0], [1]]}, r"length 2, got 1 - at `\$.road_points\[1\]`"),
        ({"road_points": [[0, 0], {"x": 1}]}, r"missing required field `y` - at `\$.road_points"),
        ({"road_points": [[0, 0], [0, 0]]}, "are the same"),
        ({"road_points": [[0, 0], [1e308, 0], [-1e308, 0]]}, "from the origin"),
    ],
)
def test_every_bad_file_gets_one_line_that_names_it(
    tmp_path: Path, content: object, complaint: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(RoadError, match=complaint) as caught:
        read_road(path).road()
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < len(str(path)) + 150


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
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
def test_a_damaged_file_gives_a_verdict_or_one_line(content: object) -> None:
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
