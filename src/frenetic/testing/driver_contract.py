"""The conformance suite that every driver passes."""

from __future__ import annotations

import numpy as np

from frenetic.drivers import Driver
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator


class DriverContract:
    """The duties of every driver; subclass it and override `make`.

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
        """It has the protocol's methods."""
        assert isinstance(self.make(), Driver), "it needs the methods reset and act"

    def test_keeps_a_straight_lane(self) -> None:
        """A straight road is no challenge."""
        road = Road(np.zeros(11))
        drive = EmbeddedSimulator().drive(road, self.make())
        assert drive.trouble is None, drive.trouble
        result = judge(road, drive)
        assert result.outcome is Outcome.PASS, result.reason

    def test_behaves_the_same_after_reset(self) -> None:
        """A drive does not depend on the drives before: failing roads can be reproduced."""
        first = Road(np.array([0.0, 0.01, 0.02, 0.0, -0.02, 0.0]))
        other = Road(np.array([0.0, -0.02, -0.02, 0.02, 0.02, 0.0]))
        simulator = EmbeddedSimulator()
        driver = self.make()
        once = simulator.drive(first, driver).trajectory.to_rows()
        simulator.drive(other, driver)
        again = simulator.drive(first, driver).trajectory.to_rows()
        fresh = simulator.drive(first, self.make()).trajectory.to_rows()
        assert np.array_equal(once, again), (
            "the same road is driven differently after another one: reset has to forget all"
        )
        assert np.array_equal(once, fresh), "another driver of this class drives differently"

    def test_controls_are_numbers(self) -> None:
        """Every answer is `Controls` of finite numbers; simulators cut pedals to 0..1."""
        road = Road(np.array([0.0, 0.03, 0.0, -0.03, 0.0]))
        drive = EmbeddedSimulator().drive(road, self.make())
        assert drive.trouble is None, drive.trouble
