"""Drivers that choose their own period."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from frenetic import Controls, Driver, DriveSetup, EmbeddedSimulator, Observation, Road, Stanley
from frenetic.drivers import Noisy
from frenetic.errors import DriverError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.simulators.capabilities import check_pair
from frenetic.testing import DummySimulator

WINDING = Road([0.0, 0.01, 0.03, 0.0, -0.03, -0.02, 0.0, 0.02, 0.0], pose=(40.0, 60.0, 0.7))


class AtPeriod(Stanley):
    """Stanley with a period; it records its observations and answers."""

    def __init__(self, period: Any) -> None:
        super().__init__()
        self.period = period

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.period_of_setup = setup.period
        self.observations: list[Observation] = []
        self.answers: list[Controls] = []

    def act(self, observation: Observation) -> Controls:
        self.observations.append(observation)
        self.answers.append(super().act(observation))
        return self.answers[-1]


@pytest.mark.parametrize("period", [0.01, 0.02, 0.04, 0.05, 0.07, 0.1, 0.2])
def test_a_driver_is_asked_at_its_period_and_recorded_at_20_hz(period: float) -> None:
    driver = AtPeriod(period)
    drive = EmbeddedSimulator().drive(WINDING, driver)
    assert judge(WINDING, drive).outcome is Outcome.PASS
    t = drive.trajectory
    assert driver.period_of_setup == period
    np.testing.assert_allclose(t.time, 0.05 * np.arange(len(t)), rtol=0.0, atol=1e-9)
    times = [observation.time for observation in driver.observations]
    np.testing.assert_allclose(times, period * np.arange(len(times)), rtol=0.0, atol=1e-9)
    assert t.time[-1] - period <= times[-1] + 1e-9
    assert times[-1] <= t.time[-1]
    # A record holds the driver's latest answer.
    for i in range(len(t) - 1):
        answer = driver.answers[int(t.time[i] / period + 1e-6)]
        assert t.steering_input[i] == answer.steering
    # The driver sees its place between two records, too.
    for observation in driver.observations:
        for name in ("x", "y", "heading", "speed", "yaw_rate"):
            expected = np.interp(observation.time, t.time, getattr(t, name))
            assert getattr(observation, name) == pytest.approx(expected, abs=0.02), name
        ((s, d),) = WINDING.track([[observation.x, observation.y]])
        assert (observation.distance, observation.lateral_offset) == pytest.approx(
            (s, d + 2.0), abs=1e-6
        )
        error = observation.heading - WINDING.pose_at(s).heading
        assert observation.heading_error == pytest.approx(error, abs=1e-6)
        assert observation.ahead[0] == pytest.approx(observation.lane().points[0], abs=2e-3)


def test_choosing_the_simulators_period_changes_nothing() -> None:
    plain, with_period = (
        EmbeddedSimulator().drive(WINDING, driver).trajectory.to_rows()
        for driver in (Stanley(), AtPeriod(0.05))
    )
    np.testing.assert_array_equal(plain, with_period)
    assert EmbeddedSimulator().drives_compiled(Stanley())
    assert not EmbeddedSimulator().drives_compiled(AtPeriod(0.05))


def test_a_wrapper_has_the_period_of_its_driver() -> None:
    driver = AtPeriod(0.02)
    drive = EmbeddedSimulator().drive(WINDING, Noisy(driver, offset=0.2))
    assert drive.trouble is None
    assert (driver.period_of_setup, driver.observations[1].time) == pytest.approx((0.02, 0.02))


@pytest.mark.parametrize(
    ("simulator", "period", "message"),
    [
        (
            EmbeddedSimulator(),
            0.015,
            "period is 0.015 s: this simulator allows multiples of 0.01 s",
        ),
        (EmbeddedSimulator(), 0.5, "period is 0.5: 0.01 to 0.2 s are needed"),
        (EmbeddedSimulator(), "fast", "period is 'fast': 0.01 to 0.2 s are needed"),
        (DummySimulator(), 0.1, "this simulator cannot change its own"),
    ],
)
def test_a_period_that_a_simulator_cannot_keep_is_refused_before_a_drive(
    simulator: Any, period: Any, message: str
) -> None:
    driver: Driver = AtPeriod(period)
    with pytest.raises(DriverError, match=message):
        check_pair(simulator, driver)
    if isinstance(simulator, EmbeddedSimulator):
        trouble = simulator.drive(WINDING, driver).trouble
        assert trouble is not None
        assert message in trouble.reason
