"""The driver of benchmarks/steady.py: the one of README with a chosen speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from frenetic import EmbeddedSimulator, Outcome, Road, judge
from frenetic.parts.registry import DRIVERS

SPEC = f"{Path(__file__).parents[2] / 'benchmarks' / 'steady.py'}:Steady"


def test_it_keeps_its_speed_and_lane_on_a_gentle_road() -> None:
    road = Road(np.array([0.0, 0.0, 0.005, 0.01, 0.005, 0.0, 0.0] * 2), step=10.0).fitted()
    assert road is not None
    for speed in (30.0, 48.0):
        driver = DRIVERS.make_from(SPEC, {"speed": speed}, {})
        drive = EmbeddedSimulator().drive(road, driver)
        assert judge(road, drive).outcome is Outcome.PASS
        assert np.isclose(3.6 * drive.trajectory.speed[-20:].mean(), speed, atol=2.0)
