from __future__ import annotations

import numpy as np
import pytest

from frenetic.drivers import Driver, Planner, Stanley
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Observer

ROAD = Road([0.0, 0.02, 0.05, 0.05, 0.0, -0.04, -0.06, -0.02, 0.0])


@pytest.mark.parametrize("driver", [Stanley(), Planner(aggression=3.0)])
def test_drive_ends_where_the_oracle_says(driver: Driver) -> None:
    drive = EmbeddedSimulator().drive(ROAD, driver)
    t = drive.trajectory
    observer = Observer(ROAD, drive.rules, drive.car, len(t))
    goes_on = [observer.see(t.time[i], t.x[i], t.y[i], t.heading[i]) for i in range(len(t))]
    assert goes_on == [True] * (len(t) - 1) + [False]
    wanted = Outcome.PASS if isinstance(driver, Stanley) else Outcome.FAIL
    assert judge(ROAD, drive).outcome is wanted


def test_observation_is_what_a_driver_of_the_embedded_simulator_sees() -> None:
    seen = []

    class Watched(Stanley):
        def act(self, observation):  # type: ignore[no-untyped-def]
            seen.append(observation)
            return super().act(observation)

    drive = EmbeddedSimulator().drive(ROAD, Watched())
    t = drive.trajectory
    observer = Observer(ROAD, drive.rules, drive.car, len(t))
    for i, theirs in enumerate(seen):
        observer.see(t.time[i], t.x[i], t.y[i], t.heading[i])
        ours = observer.observation(t.speed[i], t.yaw_rate[i], t.steering[i])
        assert ours.time == theirs.time
        assert ours.lateral_offset == theirs.lateral_offset
        assert ours.heading_error == theirs.heading_error
        assert np.array_equal(ours.ahead, theirs.ahead)
        assert np.array_equal(ours.curvature_ahead, theirs.curvature_ahead)
