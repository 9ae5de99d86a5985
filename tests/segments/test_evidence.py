"""Evidence of causes: the first mistake, with its numbers, place and time."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import planted_drivers as planted
import pytest

from frenetic import EmbeddedSimulator, Planner, Road
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.segments.causes import Kind, mistake_of
from frenetic.segments.evidence import Evidence, evidence_of_result
from frenetic.segments.segment import segment_of

BEND = Road([0.0] * 6 + [0.045] * 10, 10.0)
"""A straight of 55 m and a left-hand bend of 22 m radius."""
LEFT = Road(
    [0.043, 0.04, 0.042, 0.045, 0.056, 0.031, 0.03, 0.009, 0.057, 0.031, 0.06, 0.049, 0.064], 10.0
)
"""Left-hand bends."""
WAVES = Road(
    [
        *[-0.039, -0.003, 0.047, -0.003, -0.037, 0.013, 0.055],
        *[0.005, -0.018, 0.023, 0.012, -0.028],
    ],
    10.0,
)
"""Bends to both sides."""
GENTLE_WAVES = Road(
    [-0.016, -0.035, -0.011, -0.033, -0.028, 0.022, 0.0, 0.0, 0.0, 0.0, 0.005], 10.0
)
"""Gentle bends to both sides."""
SHARP = Road([-0.046, -0.013, 0.032, 0.013, 0.063, 0.07, 0.056, 0.006, 0.045], 10.0)
"""A sharp bend after gentle ones."""


def failure(driver: planted.Sound, road: Road = BEND) -> tuple[Kind, Evidence]:
    """Return kind and evidence of the driver's failure on a road."""
    drive = EmbeddedSimulator().drive(road, driver)
    result = judge(road, drive)
    assert result.outcome is Outcome.FAIL
    segment = segment_of(road, drive, result.finding)
    evidence = evidence_of_result(segment, result)
    assert evidence is not None
    return mistake_of(segment).cause.kind, evidence


def test_a_wrong_sign_is_told_at_the_entry_of_the_bend() -> None:
    kind, evidence = failure(planted.WrongFeedForward(), LEFT)
    assert kind is Kind.WRONG_WAY
    assert re.match(
        r"steers \d+° to the right where the road needs \d+° to the left, .* a left-hand bend of"
        r" \d+ m radius.*, \d\.\d s before it leaves",
        evidence.text,
    )
    assert evidence.steering_input < 0.0 < evidence.needed_steering
    assert 0.0 < evidence.before < 6.0


def test_degrees_are_beyond_the_car() -> None:
    kind, evidence = failure(planted.Degrees())
    assert kind is Kind.BEYOND
    assert "° of steering" in evidence.text
    assert abs(evidence.steering_input) > 0.5


def test_a_limit_of_the_rate_is_told_with_the_rate() -> None:
    kind, evidence = failure(planted.RateLimited(), WAVES)
    assert kind is Kind.SLOW_STEERING
    assert evidence.text.startswith("turns its steering by 9° a second at most")


def test_both_pedals_are_told() -> None:
    kind, evidence = failure(planted.BothPedals())
    assert kind is Kind.BOTH_PEDALS
    assert evidence.text.startswith("presses throttle 0.6 and brake 0.3 at once")


def test_a_driver_that_winds_up_swings_further_and_further() -> None:
    kind, evidence = failure(planted.WindUp(), GENTLE_WAVES)
    assert kind is Kind.OSCILLATES
    swings = [float(text) for text in re.findall(r"([\d.]+) m (?:left|right)", evidence.text)]
    assert len(swings) >= 2
    assert swings[-1] > swings[0]


def test_a_slide_is_told_with_speed_and_demand() -> None:
    kind, evidence = failure(planted.TooFast())
    assert kind in (Kind.TOO_FAST, Kind.BRAKES_LATE, Kind.ACCELERATES)
    km_h, across = map(float, re.findall(r"drives (\d+) km/h, (\d+) m/s²", evidence.text)[0])
    assert km_h == pytest.approx(evidence.speed * 3.6, abs=0.51)
    assert across == pytest.approx(evidence.lateral_acceleration, abs=0.51)


def test_evidence_without_a_departure_is_none_or_says_where_the_car_stood() -> None:
    drive = EmbeddedSimulator().drive(BEND, Planner(lateral_acceleration=3.0))
    result = judge(BEND, drive)
    assert evidence_of_result(segment_of(BEND, drive, None), result) is None
    assert evidence_of_result(None, replace(result, outcome=Outcome.FAIL)) is None
    kind, evidence = failure(planted.Stops(), SHARP)
    assert kind is Kind.STANDS
    assert evidence.text.startswith("stands from ")


def test_records_that_are_not_numbers_have_evidence() -> None:
    drive = EmbeddedSimulator().drive(BEND, planted.TooFast())
    result = judge(BEND, drive)
    path = drive.trajectory
    names = ("steering_input", "steering", "throttle", "brake", "yaw_rate", "lateral_speed")
    rows = {name: getattr(path, name) for name in type(path).names()}
    rows |= {name: np.full(len(path), np.nan) for name in names}
    broken = replace(drive, trajectory=type(path)(**rows))
    evidence = evidence_of_result(segment_of(BEND, broken, result.finding), result)
    assert evidence is not None
    assert math.isfinite(evidence.steering_input)
