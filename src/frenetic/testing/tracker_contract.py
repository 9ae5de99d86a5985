"""The conformance suite of the glue around another package's path tracker."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Rules
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.simulator import Simulator
from frenetic.testing.driver_contract import DriverContract

ROADS = {
    "straight": Road(np.zeros(16)),
    "left-hand circle": Road(np.r_[np.linspace(0.0, 0.02, 4), np.full(14, 0.02)]),
    "right-hand clothoid": Road(-np.linspace(0.0, 0.02, 21)),
}
"""Name -> road on which a fault of the glue shows; the least radius is 50 m."""


class TrackerContract(DriverContract):
    """The contract of glue around another package's tracker: subclass it and override `make`.

    ::

        from frenetic.testing import TrackerContract

        class TestMine(TrackerContract):
            def make(self):
                return MyTracker()

    A wrong sign, degrees in place of radians and a car that stops fail here; a wrong axle may pass.
    The wheels of this suite's car follow nearly at once: a tracker that passes here and fails
    elsewhere may ignore the lag of the steering.
    """

    keeps = 0.4
    """Largest allowed distance from the lane's centre, in m; our choice."""

    def simulator(self) -> Simulator:
        """Return the simulator of the tests; override it if the package has a car of its own."""
        return EmbeddedSimulator(rules=Rules(speed_limit=36.0), steering_lag=0.03)

    @pytest.mark.parametrize("name", ROADS)
    def test_keeps_to_its_lanes_centre(self, name: str) -> None:
        """The tracker gets to the road's end, near the middle of its lane."""
        road = ROADS[name]
        with self.simulator() as simulator:
            drive = simulator.drive(road, self.make())
        assert drive.trouble is None, drive.trouble
        assessment, path = assess(road, drive), drive.trajectory
        worst = int(np.abs(assessment.lateral_offset).argmax())
        offset, steering = assessment.lateral_offset[worst], path.steering[worst]
        assert abs(offset) < self.keeps, (
            f"{name}: {abs(offset):.2f} m {'left' if offset > 0 else 'right'} of its lane's centre "
            f"after {assessment.distance[worst]:.0f} m, where its wheels point "
            f"{abs(steering):.3f} rad to the {'left' if steering > 0 else 'right'}"
        )
        assert assessment.distance[-1] > road.length - 10.0, (
            f"{name}: it ends after {assessment.distance[-1]:.0f} of {road.length:.0f} m"
        )
