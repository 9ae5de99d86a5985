"""What a driver does in its passing drives, and mistakes compared with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_drivers as planted
import pytest

from frenetic import EmbeddedSimulator, Road
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.segments.causes import Kind, mistake_of
from frenetic.segments.departure import Departure
from frenetic.segments.evidence import evidence_of_result
from frenetic.segments.passing import PassingDrives, UsualRange
from frenetic.segments.segment import Segment, segment_of


def drive(curvatures: list[float]) -> tuple[Segment, Outcome]:
    """Drive a road with a driver that cannot steer by more than 0.08 rad."""
    road = Road(curvatures, 10.0)
    driven = EmbeddedSimulator().drive(road, planted.Limited())
    result = judge(road, driven)
    return segment_of(road, driven, result.finding), result.outcome


PASSES = [drive([0.0] * 4 + [bend] * 6 + [0.0] * 2) for bend in (0.02, -0.022, 0.02, -0.02, 0.021)]
FAILURE, _ = drive([0.0] * 4 + [0.045] * 10)


@pytest.fixture(scope="module")
def passing() -> PassingDrives:
    assert {outcome for _, outcome in PASSES} == {Outcome.PASS}
    drives = PassingDrives.of(segment for segment, _ in PASSES)
    assert drives is not None
    return drives


def test_demand_and_steering_are_those_of_bends_alike_to_either_side(
    passing: PassingDrives,
) -> None:
    demand, steering = passing.usual_demand(0.021), passing.usual_steering(-0.021)
    assert isinstance(demand, UsualRange)
    assert isinstance(steering, UsualRange)
    largest, into = [], []
    for segment, _ in PASSES:
        n = len(segment.assessment.distance)
        curvature = segment.road.curvature_at(segment.assessment.distance)
        path = segment.drive.trajectory
        largest.append((path.speed[:n] ** 2 * np.abs(curvature)).max())  # each road has one bend
        is_alike = np.abs(np.abs(curvature) - 0.021) <= 0.15 * 0.021
        into.append((path.steering_input[:n] * np.sign(curvature))[is_alike])
    np.testing.assert_allclose((demand.low, demand.high), np.quantile(largest, [0.25, 0.75]))
    np.testing.assert_allclose(
        (steering.low, steering.high), np.quantile(np.concatenate(into), [0.25, 0.75])
    )
    assert (demand.drives, steering.drives) == (len(PASSES), len(PASSES))
    assert 0.0 < steering.low < 0.021 * 3.5
    rounded = f"{demand.low:.0f}", f"{demand.high:.0f}"
    text = " to ".join(dict.fromkeys(rounded))
    assert demand.text == f"usually has {text} m/s² in such bends"


def test_bends_unlike_those_of_passing_drives_and_straights_are_not_compared(
    passing: PassingDrives,
) -> None:
    assert passing.usual_demand(0.06) is None
    assert passing.usual_steering(0.0005) is None
    assert PassingDrives.of(segment for segment, _ in PASSES[:2]) is None


def test_a_mistake_says_what_the_driver_does_in_its_passing_drives(passing: PassingDrives) -> None:
    result = judge(FAILURE.road, FAILURE.drive)
    alone = evidence_of_result(FAILURE, result)
    # Drives that know this bend: the passing drives, as if their bends were as sharp.
    sharp = replace(passing, curvature=passing.curvature * (0.045 / 0.02))
    compared = evidence_of_result(FAILURE, result, sharp)
    assert alone is not None
    assert compared is not None
    assert (alone.cause.kind, alone.usual) == (Kind.HELD, None)
    assert compared.usual is not None
    assert compared.text == f"{alone.text} (in its passing drives it {compared.usual.text})"
    assert compared.as_json()["passing_drives"] == compared.usual.as_json()
    assert compared.usual.quantity == "steering_into_bend"


def test_a_car_is_sound_up_to_the_offset_of_its_passing_drives() -> None:
    road = Road([0.0] * 4 + [0.02] * 3 + [-0.02] * 3 + [0.03] * 6, 10.0)
    driven = EmbeddedSimulator().drive(road, planted.Lagging())
    segment = segment_of(road, driven, judge(road, driven).finding)
    narrow, wide = (Departure.of(segment, usual_offset) for usual_offset in (0.5, 1.1))
    assert narrow.last_sound < wide.last_sound
    assert np.abs(narrow.offset[narrow.last_sound]) <= 0.5
    # A driver that swings a lot is not sound outside its lane, whatever it usually does.
    assert Departure.of(segment, 5.0).last_sound == Departure.of(segment, 1.2).last_sound


def test_the_cause_stays_the_stored_one(passing: PassingDrives) -> None:
    result = judge(FAILURE.road, FAILURE.drive)
    for offset in (0.1, 0.7, 3.0):
        evidence = evidence_of_result(FAILURE, result, replace(passing, offset=offset))
        assert evidence is not None
        assert evidence.cause == mistake_of(FAILURE).cause
