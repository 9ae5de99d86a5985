"""Checks of a simulator, and two drives that every simulator must pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic.drivers import Driver, Stanley
from frenetic.errors import reason_of
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Pose, Road
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class SimulatorCheck:
    """One check of a simulator with its result."""

    name: str
    is_ok: bool
    state: str
    """State of the checked thing, or what is wrong with it."""
    remedy: str = ""
    """Advice for the user; empty if nothing is wrong."""


def broken(name: str, error: Exception, remedy: str) -> SimulatorCheck:
    """Return a check that ended in an error."""
    return SimulatorCheck(name, False, reason_of(error), remedy)


# Roads that every driver can follow

STRAIGHT: Final = Road(np.zeros(13), pose=Pose(40.0, 100.0, 0.0))
"""120 m."""
CURVE: Final = Road(
    np.array([0.0] * 4 + [0.01, 0.025, 0.025, 0.025, 0.01] + [0.0] * 4), pose=Pose(60.0, 60.0, 0.0)
)
"""A left-hand bend of 40 m radius between straights."""


def drive_checks(
    simulator: Simulator, driver: Driver | None = None, *, who: str = "Stanley"
) -> Iterator[SimulatorCheck]:
    """Check that a driver stays in its lane on a straight road and in a curve.

    Args:
        simulator: An entered simulator.
        driver: A driver; None for `Stanley`.
        who: Name of the driver.
    """
    for name, road in (("straight road", STRAIGHT), ("curve", CURVE)):
        name = f"{name}, {who}"
        try:
            drive = simulator.drive(road, driver or Stanley())
        except Exception as error:
            yield broken(name, error, "see the message; 'frenetic --debug doctor' says more")
            continue
        result = judge(road, drive)
        if result.outcome is not Outcome.PASS or result.moobd is None or result.moobd <= 0.0:
            remedy = "draw it; is the car or the road as it should be?"
            yield SimulatorCheck(name, False, result.reason, remedy)
        else:
            state = f"{road.length:.0f} m in {result.duration:.1f} s, MOOBD {result.moobd:.2f} m"
            yield SimulatorCheck(name, True, state)
