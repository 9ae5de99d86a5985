"""Widening lanes: their edge against wider lanes, and the verdict on drives there."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic import Road
from frenetic.errors import RoadError
from frenetic.oracle import Trajectory
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.oracle.lane_share import share_outside
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road.files import entries_of, read_road

CAR = CarBody(4.5, 1.8, 0.1)
WIDENING = np.array([(0.0, 0.0), (20.0, 0.0), (40.0, 1.0), (60.0, 1.0), (80.0, 0.0)])
ONE_METRE = np.array([(0.0, 1.0)])


def along(road: Road, offset: float) -> Drive:
    """Return a drive with the car's centre so many m left of the centre line."""
    places = np.arange(0.0, road.length - 4.0, 1.0)
    poses = np.array([road.pose_at(s) for s in places])
    x = poses[:, 0] - offset * np.sin(poses[:, 2])
    y = poses[:, 1] + offset * np.cos(poses[:, 2])
    n = len(places)
    columns = [0.1 * np.arange(n), x, y, poses[:, 2], np.full(n, 10.0), *np.zeros((6, n))]
    return Drive(Trajectory(*columns), CAR, Rules(oob_tolerance=0.5))


@given(
    st.floats(0.0, 1.0),
    st.floats(5.0, 90.0),
    st.floats(-6.0, 1.0),
    st.floats(-0.6, 0.6),
)
def test_a_widened_lane_has_the_edge_of_a_wider_lane(
    wider: float, s: float, offset: float, error: float
) -> None:
    road = Road(np.linspace(-0.02, 0.02, 11))
    pose = road.pose_at(s)
    x, y = pose.x - offset * np.sin(pose.heading), pose.y + offset * np.cos(pose.heading)
    place = (s, offset, pose.heading, x, y, pose.heading + error, 4.5, 1.8, 0.1)
    widened = replace(road, widening=wider * ONE_METRE)
    share = share_outside(widened.table, road.sub_step, 0.0, -4.0, *place)
    other = share_outside(road.table, road.sub_step, 0.0, -4.0 - wider, *place)
    assert share == pytest.approx(other, abs=1e-12)


def test_the_widened_part_of_a_lane_belongs_to_it() -> None:
    road = Road([0.0] * 11)
    # The car's centre is 0.2 m beyond the usual edge, and inside the lane only from 40 to 60 m.
    beside = along(road, -4.2)
    assert judge(road, beside).outcome is Outcome.FAIL
    wide = replace(road, widening=ONE_METRE)
    assert judge(wide, beside).outcome is not Outcome.FAIL
    assert assess(wide, beside).oob_distance == pytest.approx(0.8)
    assessment = assess(
        replace(road, widening=WIDENING), replace(beside, rules=Rules(oob_tolerance=1.0))
    )
    at = np.searchsorted(assessment.distance, [10.0, 30.0, 50.0])
    assert assessment.oob_distance[at] == pytest.approx([-0.2, 0.3, 0.8])
    # The nearest edge counts: the left edge, though the car is right of the usual centre.
    middle = assess(wide, along(road, -2.2))
    assert middle.oob_distance == pytest.approx(2.2)
    # 1.1 m of the car are outside a lane of usual width, 0.1 m outside a lane 1 m wider.
    assert assessment.oob_share[at] == pytest.approx([1.1 / 1.8, 0.6 / 1.8, 0.1 / 1.8], abs=0.01)


def test_widening_is_kept_in_files_pieces_and_processes(tmp_path: Path) -> None:
    road = Road(np.linspace(-0.01, 0.01, 11), widening=WIDENING)
    path = tmp_path / "road.json"
    path.write_text(json.dumps(entries_of(road)))
    for same in (read_road(path).road(), pickle.loads(pickle.dumps(road)), road.piece(0)):
        assert np.array_equal(same.widening, road.widening)
        assert np.array_equal(same.table, road.table)
    assert road.piece(5).widening.tolist() == [[0.0, 1.0], [10.0, 1.0], [30.0, 0.0]]


def test_widening_does_not_change_the_other_columns_of_the_table() -> None:
    road = Road(np.linspace(-0.01, 0.01, 11))
    assert road.table.shape[1] == 6
    assert np.array_equal(replace(road, widening=WIDENING).table[:, :6], road.table)


def test_a_lane_that_narrows_is_refused() -> None:
    with pytest.raises(RoadError, match=r"widening is -0.5 m: at least 0 is needed"):
        Road([0.0] * 5, widening=-0.5)
