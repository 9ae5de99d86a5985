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
from frenetic.segments.passing import PassingDrives, Usual
from frenetic.segments.segment import Segment, segment_of


def drive(curvatures: list[float]) -> tuple[Segment, Outcome]:
    """Drive a road with a driver that cannot steer by more than 0.08 rad."""
    road = Road(curvatures, 10.0)
    driven = EmbeddedSimulator().drive(road, planted.Limited())
    result = judge(road, driven)
    return segment_of(road, driven, result.finding), result.outcome


PASSES = [drive([0.0] * 4 + [bend] * 6 + [0.0] * 2) for bend in (0.02, -0.022, 0.02, -0.02)]
FAILURE, _ = drive([0.0] * 4 + [0.045] * 10)


@pytest.fixture(scope="module")
def passing() -> PassingDrives:
    assert {outcome for _, outcome in PASSES} == {Outcome.PASS}
    drives = PassingDrives.of(segment for segment, _ in PASSES)
    assert drives is not None
    return drives


def test_speed_and_steering_are_those_of_bends_alike_to_either_side(
    passing: PassingDrives,
) -> None:
    speed, steering = passing.usual_speed(0.021), passing.usual_steering(-0.021)
    assert isinstance(speed, Usual)
    assert isinstance(steering, Usual)
    records = np.concatenate(
        [
            np.column_stack(
                [
                    segment.road.curvature_at(segment.assessment.distance),
                    segment.drive.trajectory.speed[: len(segment.assessment.distance)],
                    segment.drive.trajectory.steering_input[: len(segment.assessment.distance)],
                ]
            )
            for segment, _ in PASSES
        ]
    )
    alike = records[np.abs(np.abs(records[:, 0]) - 0.021) <= 0.15 * 0.021]
    np.testing.assert_allclose((speed.low, speed.high), np.quantile(alike[:, 1], [0.25, 0.75]))
    into = alike[:, 2] * np.sign(alike[:, 0])  # both sides are steered into, positively
    np.testing.assert_allclose((steering.low, steering.high), np.quantile(into, [0.25, 0.75]))
    assert (speed.drives, steering.drives) == (4, 4)
    assert 0.0 < steering.low < 0.021 * 3.5
    assert speed.text == (
        f"usually takes such bends at {speed.low * 3.6:.0f} to {speed.high * 3.6:.0f} km/h"
        if round(speed.low * 3.6) != round(speed.high * 3.6)
        else f"usually takes such bends at {speed.low * 3.6:.0f} km/h"
    )


def test_bends_unlike_those_of_passing_drives_and_straights_are_not_compared(
    passing: PassingDrives,
) -> None:
    assert passing.usual_speed(0.06) is None
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
