"""The result of a simulator's check, and two drives that every simulator must pass."""

from __future__ import annotations

import logging
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

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SimulatorCheck:
    """Result of one check of a simulator."""

    name: str
    """Name of what was checked, such as ``licence``."""
    is_ok: bool
    """Whether the simulator passed the check."""
    state: str
    """What the check found, in words."""
    remedy: str = ""
    """Advice for the user; empty if the simulator passed."""


def failed_by_error(name: str, error: Exception) -> SimulatorCheck:
    """Return the result of a check that raised an error, and log the error with its traceback."""
    logger.debug("the check %r failed", name, exc_info=error)
    remedy = "see the message; 'frenetic --debug doctor' says more"
    return SimulatorCheck(name, is_ok=False, state=reason_of(error), remedy=remedy)


# Roads that every driver can follow

STRAIGHT: Final = Road(np.zeros(13), pose=Pose(40.0, 100.0, 0.0))
"""A straight road of 120 m."""
CURVE: Final = Road(
    np.array([0.0] * 4 + [0.01, 0.025, 0.025, 0.025, 0.01] + [0.0] * 4), pose=Pose(60.0, 60.0, 0.0)
)
"""A left-hand bend of 40 m radius between straights."""


def drive_checks(
    simulator: Simulator, driver: Driver | None = None, *, driver_name: str = "Stanley"
) -> Iterator[SimulatorCheck]:
    """Check that a driver stays in its lane on a straight road and in a curve.

    Args:
        simulator: An entered simulator.
        driver: Driver that drives; None for `Stanley`.
        driver_name: Name of the driver in the names of the checks.

    Yields:
        Result of the drive on each road.
    """
    for road_name, road in (("straight road", STRAIGHT), ("curve", CURVE)):
        name = f"{road_name}, {driver_name}"
        try:
            drive = simulator.drive(road, driver or Stanley())
        except Exception as error:
            yield failed_by_error(name, error)
            continue
        result = judge(road, drive)
        if result.outcome is not Outcome.PASS or result.moobd is None or result.moobd <= 0.0:
            remedy = "draw it; is the car or the road as it should be?"
            yield SimulatorCheck(name, is_ok=False, state=result.reason, remedy=remedy)
        else:
            state = f"{road.length:.0f} m in {result.duration:.1f} s, MOOBD {result.moobd:.2f} m"
            yield SimulatorCheck(name, is_ok=True, state=state)
