"""Causes of unusual drives; `tests/test_planted.py` tests causes of ordinary faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation, Planner, Road
from frenetic._support.arrays import FloatArray
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.verdict import judge
from frenetic.segments.causes import Cause, Kind, as_text, cause_of, kind_number
from frenetic.segments.segment import segment_of

BEND = Road([0.0] * 6 + [0.066] * 12, 10.0)
"""A straight of 50 m and a left-hand bend that the driver below takes too fast."""


def cause(drive: Drive) -> Cause:
    result = judge(BEND, drive)
    assert result.departure is not None
    return cause_of(segment_of(BEND, drive, result.finding))


def drive_with(**columns: FloatArray) -> Drive:
    """Return a drive that takes the bend too fast, with some columns replaced."""
    drive = EmbeddedSimulator().drive(BEND, Planner(lateral_acceleration=30.0))
    path = drive.trajectory
    rows = {name: columns.get(name, getattr(path, name)) for name in Trajectory.names()}
    return replace(drive, trajectory=Trajectory(**rows))


def test_a_cause_names_the_side_of_its_bends() -> None:
    assert cause(drive_with()) == Cause(Kind.TOO_FAST, "left")
    assert as_text(*cause(drive_with())) == "takes left-hand bends too fast"
    assert as_text(Kind.TOO_FAST) == "takes bends too fast"
    assert as_text(Kind.OSCILLATES) == "oscillates from side to side"
    assert kind_number(BEND, drive_with()) == 1.0 + list(Kind).index(Kind.TOO_FAST)
    passed = EmbeddedSimulator().drive(BEND, Planner(lateral_acceleration=3.0))
    assert kind_number(BEND, passed) == 0.0


def test_a_driver_that_never_steers_steers_too_little() -> None:
    class Idle:
        def reset(self, setup: DriveSetup) -> None:
            pass

        def act(self, observation: Observation) -> Controls:
            return Controls(0.0, throttle=0.2)

    drive = EmbeddedSimulator().drive(BEND, Idle())
    assert cause(drive) == Cause(Kind.TOO_LITTLE, "left")


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_a_failure_with_unknown_columns_has_a_cause(value: float) -> None:
    n = len(drive_with().trajectory)
    names = set(Trajectory.names()) - {"time", "x", "y", "heading"}
    assert cause(drive_with(**{name: np.full(n, value) for name in names})).kind in Kind
