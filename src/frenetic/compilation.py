"""Compiling what is compiled, ahead of its first use."""

from __future__ import annotations

from functools import cache

from frenetic.drivers import Planner
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator


@cache
def compile_kernels() -> None:
    """Fits, validates, drives and judges one road, so that every kernel is ready afterwards.

    The first time on a machine this compiles for some seconds; the result is cached on disk, and
    then it takes a fraction of a second.
    """
    # Too long for the map unless it is turned, and not quite straight.
    road, verdict = Road([0.0] * 10 + [0.005] + [0.0] * 11).placed()
    assert road is not None
    assert verdict.valid, verdict.message
    simulator = EmbeddedSimulator()
    result = judge(road, simulator.drive(road, Planner()))
    assert result.outcome is Outcome.PASS, result.reason
