"""The conformance suite that every simulator passes."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.drivers import Controls, Driver, DriveSetup, Observation
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.simulators.drive import CarBody, Drive, Rules
from frenetic.simulators.simulator import Simulator

RECORD_RATE = 10.0
"""Hz, the least at which a drive has to be recorded."""


class _Broken:
    """A driver that raises in the middle of its drive."""

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002
        self.calls = 0

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        self.calls += 1
        if self.calls > 5:
            raise RuntimeError("no idea where I am")
        return Controls(0.0, throttle=0.3)


class SimulatorContract:
    """What any simulator has to do; subclass it and override `make`, and `driver` if need be.

    ::

        from frenetic.testing import SimulatorContract

        class TestMine(SimulatorContract):
            def make(self, rules):
                return MySimulator(rules=rules)
    """

    asks_driver = True
    """False for a simulator that drives by itself and never asks the driver."""

    def make(self, rules: Rules) -> Simulator:
        """A simulator with the given rules."""
        raise NotImplementedError

    def driver(self) -> Driver:
        """A driver that manages a gentle road."""
        from frenetic.drivers import Stanley

        return Stanley()

    @pytest.fixture
    def road(self) -> Road:
        """A gentle road of 100 m somewhere on the map."""
        values = np.array([0.0, 0.0, 0.01, 0.02, 0.01, 0.0, -0.01, -0.02, -0.01, 0.0, 0.0])
        return Road(values, pose=Pose(80.0, 50.0, 1.0))

    def drive(self, road: Road, rules: Rules | None = None) -> Drive:
        """One drive in a simulator of its own."""
        with self.make(rules or Rules()) as simulator:
            return simulator.drive(road, self.driver())

    def test_is_a_simulator(self) -> None:
        """It has the protocol's methods and attributes."""
        simulator = self.make(Rules(speed_limit=50.0))
        assert isinstance(simulator, Simulator)
        assert simulator.rules == Rules(speed_limit=50.0)
        assert isinstance(simulator.car, CarBody)

    def test_gentle_road_is_passed(self, road: Road) -> None:
        """A driver that knows its trade passes a gentle road."""
        drive = self.drive(road)
        assert drive.error is None
        result = judge(road, drive)
        assert result.outcome is Outcome.PASS, result.reason

    def test_starts_at_rest_in_the_ego_lane(self, road: Road) -> None:
        """The car starts on the ego lane's centre at the first point, along the road."""
        start = self.drive(road).trajectory
        ((s, d),) = road.track([[start.x[0], start.y[0]]])
        assert abs(s) < 0.5
        assert abs(d + 0.5 * road.lane_width) < 0.1
        turned = start.heading[0] - road.pose.heading
        assert abs(np.arctan2(np.sin(turned), np.cos(turned))) < 0.05

    def test_records_at_a_fixed_rate(self, road: Road) -> None:
        """Time starts at 0 and goes on in equal steps."""
        steps = np.diff(self.drive(road).trajectory.time)
        assert self.drive(road).trajectory.time[0] == 0.0
        assert np.allclose(steps, steps[0], atol=1e-6)
        assert steps[0] <= 1.0 / RECORD_RATE + 1e-9

    def test_trajectory_is_consistent(self, road: Road) -> None:
        """Positions change as speed and heading say."""
        t = self.drive(road).trajectory
        moved = np.hypot(np.diff(t.x), np.diff(t.y))
        speed = np.hypot(t.speed, t.lateral_speed)
        middle = 0.5 * (speed[1:] + speed[:-1])
        assert np.allclose(moved, middle * np.diff(t.time), atol=0.05)
        assert np.all(np.abs(np.diff(t.heading)) < 1.0), "headings have to be unwrapped"

    def test_same_road_same_drive(self, road: Road) -> None:
        """Driving the same road twice gives the same drive, also in one simulator."""
        first = self.drive(road).trajectory.to_rows()
        with self.make(Rules()) as simulator:
            again = [simulator.drive(road, self.driver()).trajectory.to_rows() for _ in range(2)]
        for rows in again:
            assert np.array_equal(rows, first)

    def test_rules_and_car_are_handed_on(self, road: Road) -> None:
        """The drive says by which rules it was driven and which box the car covers."""
        rules = Rules(oob_tolerance=0.5)
        with self.make(rules) as simulator:
            drive = simulator.drive(road, self.driver())
            assert drive.rules == rules
            assert drive.car == simulator.car

    def test_rules_may_be_set_between_drives(self, road: Road) -> None:
        """The next drive is by the new rules, as if the simulator had been made with them."""
        rules = Rules(speed_limit=25.0)
        with self.make(Rules()) as simulator:
            simulator.drive(road, self.driver())
            simulator.rules = rules
            drive = simulator.drive(road, self.driver())
        assert drive.rules == rules
        assert np.array_equal(
            drive.trajectory.to_rows(), self.drive(road, rules).trajectory.to_rows()
        )

    def test_broken_driver_leaves_the_next_drive_clean(self, road: Road) -> None:
        """A driver that raises is an error of its drive, and of no other."""
        clean = self.drive(road).trajectory.to_rows()
        with self.make(Rules()) as simulator:
            broken = simulator.drive(road, _Broken())
            if self.asks_driver:
                assert broken.error is not None
                assert "no idea where I am" in broken.error
                assert judge(road, broken).outcome is Outcome.ERROR
            else:
                assert broken.error is None
            after = simulator.drive(road, self.driver())
        assert np.array_equal(after.trajectory.to_rows(), clean)
