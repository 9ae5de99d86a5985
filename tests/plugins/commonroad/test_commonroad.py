"""The simulator `commonroad`, with CommonRoad's multi-body car."""

from __future__ import annotations

import math
import pickle
import sys

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

from frenetic import Controls, DriveSetup, Observation, Planner, Road, Rules, Stanley
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.commonroad import CommonRoadSimulator
from frenetic.plugins.commonroad.car import CommonRoadCar
from frenetic.road import Pose
from frenetic.simulators import EmbeddedSimulator, Simulator, Vehicle
from frenetic.testing import SimulatorContract

STRAIGHT = Road([0.0] * 61)
WINDING = Road([0.0, 0.0, 0.02, 0.03, 0.0, -0.02, -0.03, -0.01, 0.02, 0.03, 0.0, 0.0])
SHARP = Road([0.0] * 12 + [0.06] * 5 + [0.0] * 4)


class TestContract(SimulatorContract):
    def make(self, rules: Rules) -> Simulator:
        return CommonRoadSimulator(rules=rules)


def test_an_error_names_the_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "frenetic.plugins.commonroad.car")
    for name in [name for name in sys.modules if name.startswith("vehiclemodels")]:
        monkeypatch.setitem(sys.modules, name, None)
    with (
        pytest.raises(FreneticError, match=r"needs the package vehiclemodels.*\[commonroad\]"),
        CommonRoadSimulator(),
    ):
        pass


@pytest.mark.heavy
def test_a_simulator_can_be_pickled_after_a_drive() -> None:
    simulator = CommonRoadSimulator(rules=Rules(timeout_base=3.0, timeout_speed=1e3))
    first = simulator.drive(STRAIGHT, Stanley())
    copied = pickle.loads(pickle.dumps(simulator)).drive(STRAIGHT, Stanley())
    np.testing.assert_array_equal(first.trajectory.to_rows(), copied.trajectory.to_rows())


@pytest.mark.heavy
@pytest.mark.parametrize("speed", [3.5, 20.0])
def test_the_car_drives_like_the_package(speed: float) -> None:
    """A sine steer, compared with an implicit method of SciPy and the package's tyres."""
    p, vehicle = parameters_vehicle2(), Vehicle()

    def demanded(time: float) -> float:
        return 0.03 * math.sin(3.0 * math.floor(time / 0.01 + 1e-6) * 0.01)

    def slope(time: float, x: npt.NDArray[np.float64]) -> list[float]:
        rate = (demanded(time) - x[2]) / vehicle.steering_lag
        slopes: list[float] = vehicle_dynamics_mb(x.tolist(), [rate, 0.0], p)
        return slopes

    start = init_mb([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0], p)
    solution = solve_ivp(slope, (0.0, 3.0), start, "LSODA", rtol=1e-7, atol=1e-9, max_step=0.01)
    car = CommonRoadCar(Pose(0.0, 0.0, 0.0), vehicle, speed)
    for i in range(300):
        car.advance(demanded(0.01 * i), 0.0, 0.0)
    x, y, steering, along, heading, yaw_rate, *others = solution.y[:, -1]
    assert (car.motion.x, car.motion.y) == pytest.approx((x, y), abs=0.01)
    assert car.motion[2:] == pytest.approx(
        (heading, along, others[4], yaw_rate, steering), abs=0.005
    )


class Accelerating:
    """Demands several accelerations in turn, then brakes to a stop."""

    DEMANDS = (3.0, 1.0, -1.0, 4.0, 0.0, -5.0, 4.0, -6.0, -6.0, -6.0)

    def reset(self, setup: DriveSetup) -> None:
        self.setup, self.demands = setup, list[float]()

    def act(self, observation: Observation) -> Controls:
        demand = self.DEMANDS[min(int(observation.time / 2.0), len(self.DEMANDS) - 1)]
        self.demands.append(demand)
        return Controls.from_acceleration(demand, 0.0, speed=observation.speed, setup=self.setup)


@pytest.mark.heavy
def test_the_car_reaches_demanded_accelerations_and_stops() -> None:
    driver = Accelerating()
    t = CommonRoadSimulator().drive(STRAIGHT, driver).trajectory
    reached, demanded = np.diff(t.speed) / 0.05, np.array(driver.demands)
    steady = np.flatnonzero((t.time[:-1] % 2.0 > 0.5) & (t.speed[:-1] > 1.0))
    np.testing.assert_allclose(reached[steady], demanded[steady], rtol=0.03, atol=0.05)
    assert t.speed.max() > 13.9
    assert not t.speed[-100:].any()
    assert np.abs(t.lateral_speed).max() < 0.05


def test_the_car_follows_a_road_like_the_embedded_car() -> None:
    paths = []
    for simulator in (CommonRoadSimulator(), EmbeddedSimulator()):
        drive = simulator.drive(WINDING, Stanley())
        assert judge(WINDING, drive).outcome is Outcome.PASS
        paths.append(WINDING.track(np.column_stack([drive.trajectory.x, drive.trajectory.y])))
    along = np.linspace(5.0, 100.0, 50)
    offsets, embedded_offsets = (np.interp(along, *path.T) for path in paths)
    assert 0.01 < np.abs(offsets - embedded_offsets).max() < 0.3


@pytest.mark.heavy
def test_a_car_that_slides_spins_or_rolls_over_fails() -> None:
    simulator = CommonRoadSimulator(rules=Rules(speed_limit=120.0))
    mirrored = Road(-SHARP.curvatures)
    for road, driver in ((SHARP, Planner(aggression=3.0)), (mirrored, Stanley(aggression=3.0))):
        assert judge(road, simulator.drive(road, driver)).outcome is Outcome.FAIL
