"""The competition's document of a test: keys, their order, and values."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.export import SimulationRecord
from frenetic.export.official_format import competition_document, simulation_records
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road, Verdict
from frenetic.road.files import read_road
from frenetic.road.validity import interpolate
from frenetic.testing import DummyDriver, DummySimulator

ROAD = Road([0.0, 0.01, 0.03, 0.0, -0.02, -0.02], pose=(60.0, 60.0, 1.0))
VALID = Verdict(True, "")


def drive_with(offsets: FloatArray, *, tolerance: float = 0.5) -> Drive:
    """Return a drive at 10 m/s along a straight road to the north, at offsets to the left in m."""
    n = len(offsets)
    time, zeros = 0.1 * np.arange(n, dtype=np.float64), np.zeros(n)
    return Drive(
        Trajectory(
            time=time,
            x=2.0 - offsets,
            y=10.0 * time,
            heading=np.full(n, math.pi / 2),
            speed=np.full(n, 10.0),
            lateral_speed=np.full(n, 0.5),
            yaw_rate=zeros,
            steering=np.full(n, 0.1),
            steering_input=np.full(n, -0.2),
            throttle=np.full(n, 0.25),
            brake=np.full(n, 0.75),
        ),
        CarBody(length=4.0, width=2.0),
        Rules(oob_tolerance=tolerance),
    )


def test_a_record_has_the_competitions_fields_in_order() -> None:
    names = (
        "timer pos dir vel steering steering_input brake brake_input throttle throttle_input"
        " wheelspeed vel_kmh is_oob oob_counter max_oob_percentage oob_distance oob_percentage"
    )
    assert SimulationRecord._fields == tuple(names.split())


def test_a_simulation_record_has_the_values_of_the_drive() -> None:
    record = simulation_records(Road([0.0] * 12), drive_with(np.array([0.0, 0.5])))[1]
    assert record.timer == 0.1
    assert record.pos == (1.5, 1.0, -28.0)
    assert record.dir == (0.0, 1.0, 0.0)
    assert record.vel == (-0.5, 10.0, 0.0)
    assert (record.steering, record.steering_input) == pytest.approx((5.729578, -11.459156))
    assert (record.brake, record.brake_input) == (0.75, 0.75)
    assert (record.throttle, record.throttle_input) == (0.25, 0.25)
    assert (record.wheelspeed, record.vel_kmh) == (10.0, 36)
    assert record.oob_distance == 1.5
    assert (record.is_oob, record.oob_counter, record.max_oob_percentage) == (False, 0, 0.0)
    assert record.oob_percentage == 0.0


def test_departures_are_counted_with_their_largest_share() -> None:
    # The car is 2 m wide, the lane 4 m: 1 + 2 s m off the lane's centre, a share s of the car is
    # outside. The record above the tolerance is the last: it fails the drive.
    offsets = np.array([0.0, 1.2, 0.0, 1.8, 2.4, 0.0])
    records = simulation_records(Road([0.0] * 12), drive_with(offsets, tolerance=0.5))
    assert [r.oob_percentage for r in records] == pytest.approx([0.0, 0.1, 0.0, 0.4, 0.7])
    assert [r.is_oob for r in records] == [False, False, False, False, True]
    assert [r.oob_counter for r in records] == [0, 0, 0, 0, 1]
    assert [r.max_oob_percentage for r in records] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.7])


@pytest.mark.parametrize("drift", [0.5, 6.0])
def test_the_records_agree_with_the_oracle(drift: float) -> None:
    simulator = DummySimulator(lambda road: drift)
    drive = simulator.drive(ROAD, DummyDriver())
    result, records = judge(ROAD, drive), simulation_records(ROAD, drive)
    assert min(r.oob_distance for r in records) == pytest.approx(result.moobd, abs=1e-6)
    assert max(r.oob_percentage for r in records) == pytest.approx(result.max_oob_share, abs=1e-6)
    assert records[-1].timer == pytest.approx(result.duration)
    assert records[-1].is_oob == (result.outcome is Outcome.FAIL)


def test_a_drive_without_records_has_none() -> None:
    assert simulation_records(ROAD, Drive(Trajectory.empty())) == []


def test_the_document_of_a_driven_test() -> None:
    drive = DummySimulator().drive(ROAD, DummyDriver())
    document = competition_document(
        ROAD, 7, VALID, outcome=Outcome.PASS, description="Arrived", drive=drive
    )
    keys = "id is_valid validation_message road_points interpolated_points test_outcome description"
    assert list(document) == [*keys.split(), "execution_data"]
    stored = json.loads(json.dumps(document))
    assert (stored["id"], stored["is_valid"], stored["validation_message"]) == (7, True, "")
    assert (stored["test_outcome"], stored["description"]) == ("PASS", "Arrived")
    assert np.allclose(stored["road_points"], ROAD.road_points, atol=1e-6)
    interpolated = interpolate(ROAD.road_points).tolist()
    assert stored["interpolated_points"] == [[x, y, -28.0, 8.0] for x, y in interpolated]
    records = simulation_records(ROAD, drive)
    assert stored["execution_data"] == json.loads(json.dumps(records))
    assert all(len(record) == 17 for record in stored["execution_data"])


def test_the_documents_of_refused_and_undriven_roads() -> None:
    verdict = Verdict(False, "The road is too sharp")
    refused = competition_document(
        ROAD, 1, verdict, outcome=Outcome.INVALID, description="The road is too sharp"
    )
    assert (refused["is_valid"], refused["validation_message"]) == (False, verdict.message)
    assert (refused["test_outcome"], refused["execution_data"]) == ("INVALID", [])
    for outcome in (None, Outcome.DROPPED):
        document = competition_document(ROAD, 1, None, outcome=outcome)
        assert document["is_valid"] is None
        assert "test_outcome" not in document
        assert "execution_data" not in document


def test_the_document_is_a_road_file_of_the_same_road(tmp_path: Path) -> None:
    path = tmp_path / "test.json"
    path.write_text(json.dumps(competition_document(ROAD, 1, VALID)))
    road = read_road(path).road()
    assert road.length == pytest.approx(ROAD.length, abs=1e-4)
    assert np.abs(ROAD.track(road.sample(1.0))[:, 1]).max() < 1e-4
    assert read_road(path).check_validity().valid
