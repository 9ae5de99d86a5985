"""Profiles along a road: values, integrals and pieces, against plain sums."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic import Road
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.files import entries_of, read_road
from frenetic.road.road_values import MAX_GRADE, Pose

CREST = np.array([(20.0, 0.06), (80.0, -0.06)])


@st.composite
def profiles(draw: st.DrawFn) -> np.ndarray:
    """Draw a profile of grades."""
    count = draw(st.integers(0, 6))
    gaps = draw(st.lists(st.floats(1.0, 90.0), min_size=count, max_size=count))
    values = draw(st.lists(st.floats(-0.1, 0.1), min_size=count, max_size=count))
    return profile.checked(np.column_stack([np.cumsum(gaps) - 50.0, values]), "grade", MAX_GRADE)


def test_a_crest_rises_and_falls() -> None:
    assert profile.value_at(CREST, [-5.0, 20.0, 50.0, 65.0, 200.0]) == pytest.approx(
        [0.06, 0.06, 0.0, -0.03, -0.06]
    )
    # 20 m at 6 %, then 30 m at 3 % on average; the way down mirrors the way up.
    heights = profile.integral_at(CREST, [0.0, 20.0, 50.0, 80.0, 100.0])
    assert heights == pytest.approx([0.0, 1.2, 2.1, 1.2, 0.0])


@given(profiles(), st.floats(-100.0, 400.0))
def test_an_integral_is_the_sum_of_the_values(pairs: np.ndarray, end: float) -> None:
    places = np.linspace(0.0, end, 20_001)
    values = profile.value_at(pairs, places)
    summed = float(np.sum(0.5 * (values[1:] + values[:-1])) * end / 20_000)
    assert profile.integral_at(pairs, end) == pytest.approx(summed, abs=1e-4)


@given(profiles(), st.floats(-20.0, 150.0), st.floats(1.0, 200.0))
def test_a_piece_has_the_same_values(pairs: np.ndarray, start: float, length: float) -> None:
    places = np.linspace(0.0, length, 101)
    whole = profile.value_at(pairs, start + places)
    for piece in (profile.cut(pairs, start), profile.cut(pairs, start, start + length)):
        assert profile.value_at(piece, places) == pytest.approx(whole, abs=1e-12)


def test_stations_on_a_straight_line_are_left_out() -> None:
    straight = np.column_stack([np.arange(5) * 10.0, [0.0, 0.01, 0.02, 0.02, 0.02]])
    assert profile.thinned(straight).tolist() == [[0.0, 0.0], [20.0, 0.02]]


@pytest.mark.parametrize(
    ("grade", "message"),
    [
        ([[0.0, 0.1], [0.0, 0.2]], "stations of grade are not numbers of metres that ascend"),
        ([[0.0, 0.6]], "grade is 0.6 at 0 m: a finite number of at most 0.5"),
        ([[0.0, np.nan]], "grade is nan at 0 m"),
        ([[np.inf, 0.1]], "stations of grade are not"),
        ([0.1, 0.2, 0.3], r"grade has shape \(3,\): pairs of a station"),
        ("steep", "grade is not a list of pairs"),
    ],
)
def test_an_invalid_profile_is_refused(grade: object, message: str) -> None:
    with pytest.raises(RoadError, match=message):
        Road([0.0, 0.01], grade=grade)  # type: ignore[arg-type]


def test_a_road_keeps_its_profiles_when_moved_copied_or_written(tmp_path: Path) -> None:
    road = Road([0.0, 0.01, 0.02, 0.02, 0.0] * 3, grade=CREST, superelevation=-0.04)
    assert not road.is_flat
    assert Road([0.0, 0.01], grade=0.0, superelevation=[]).is_flat
    assert road.heights(50.0) == pytest.approx(2.1)
    assert road.slopes.shape == (len(road.table), 2)
    assert road.slopes[35].tolist() == pytest.approx([-0.04, 0.03])
    path = tmp_path / "road.json"
    path.write_text(json.dumps(entries_of(road)))
    moved = road.fitted()
    assert moved is not None
    assert moved.pose != road.pose
    for other in (moved, pickle.loads(pickle.dumps(road)), read_road(path).road()):
        assert other.grade.tolist() == road.grade.tolist()
        assert other.superelevation.tolist() == [[0.0, -0.04]]


def test_a_piece_of_a_road_lies_at_its_place() -> None:
    road = Road([0.0, 0.01, 0.03, 0.02, -0.02, 0.0], pose=Pose(5.0, 6.0, 1.0), grade=CREST)
    piece = road.piece(2, 4)
    assert piece.points == pytest.approx(road.points[2:5], abs=1e-9)
    assert piece.headings == pytest.approx(road.headings[2:5], abs=1e-9)
    assert piece.heights(15.0) == pytest.approx(road.heights(35.0) - road.heights(20.0))
    assert road.piece(0).curvatures.tolist() == road.curvatures.tolist()
