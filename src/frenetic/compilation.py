"""Compiling what is compiled, ahead of its first use."""

from __future__ import annotations

import numpy as np

from frenetic.drivers import Planner
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.simulators import EmbeddedSimulator


def compile_kernels() -> None:
    """Fits, validates, drives and judges one road, so that every kernel is ready afterwards.

    The first time on a machine this compiles for some seconds; the result is cached on disk, and
    then it takes a fraction of a second.
    """
    road = Road(np.array([0.0, 0.02, 0.0, -0.02]), pose=Pose(-500.0, 0.0, 0.0)).fitted()
    assert road is not None
    assert road.check_validity().valid
    simulator = EmbeddedSimulator()
    result = judge(road, simulator.drive(road, Planner()))
    assert result.outcome is Outcome.PASS, result.reason
