"""The conformance suite that every driver passes."""

from __future__ import annotations

import numpy as np

from frenetic.drivers import Driver
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator


class DriverContract:
    """The contract of drivers as a pytest class: subclass it, override `make`, run pytest.

    ::

        from frenetic.testing import DriverContract

        class TestMine(DriverContract):
            def make(self):
                return MyDriver()
    """

    def make(self) -> Driver:
        """Return a fresh driver; to be overridden."""
        raise NotImplementedError

    def test_is_a_driver(self) -> None:
        """The driver has the methods of the protocol `Driver`."""
        assert isinstance(self.make(), Driver), "it needs the methods reset and act"

    def test_keeps_a_straight_lane(self) -> None:
        """The driver passes a straight road."""
        road = Road(np.zeros(11))
        drive = EmbeddedSimulator().drive(road, self.make())
        assert drive.trouble is None, drive.trouble
        result = judge(road, drive)
        assert result.outcome is Outcome.PASS, result.reason

    def test_behaves_the_same_after_reset(self) -> None:
        """A drive does not depend on earlier drives, so failing roads can be reproduced."""
        road = Road(np.array([0.0, 0.01, 0.02, 0.0, -0.02, 0.0]))
        other_road = Road(np.array([0.0, -0.02, -0.02, 0.02, 0.02, 0.0]))
        simulator = EmbeddedSimulator()
        driver = self.make()
        first = simulator.drive(road, driver).trajectory.to_rows()
        simulator.drive(other_road, driver)
        repeated = simulator.drive(road, driver).trajectory.to_rows()
        by_other = simulator.drive(road, self.make()).trajectory.to_rows()
        assert np.array_equal(first, repeated), (
            "the same road is driven differently after another one: reset has to forget all"
        )
        assert np.array_equal(first, by_other), "another driver of this class drives differently"

    def test_controls_are_numbers(self) -> None:
        """Each answer is `Controls` of finite numbers; simulators cut pedals to the range 0..1."""
        road = Road(np.array([0.0, 0.03, 0.0, -0.03, 0.0]))
        drive = EmbeddedSimulator().drive(road, self.make())
        assert drive.trouble is None, drive.trouble
