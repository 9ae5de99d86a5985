"""How cars drive in MetaDrive: its physics, its map, its own drivers; one engine for all tests.

No part of MetaDrive is replaced.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from metadrive.engine.engine_utils import get_engine
from metadrive.obs.state_obs import LidarStateObservation
from metadrive_drives import STRAIGHT, WINDING, Fixed, digest, random_roads, run

from frenetic.drivers import (
    Controls,
    Delayed,
    Driver,
    DriveSetup,
    Observation,
    Planner,
    Stanley,
)
from frenetic.metadrive import MetaDriveExpert, MetaDriveSimulator
from frenetic.metadrive.car import Decision
from frenetic.metadrive.expert import state_of
from frenetic.metadrive.world import EGO_LANE
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.testing import DriverContract


@pytest.fixture(scope="module")
def simulator() -> Iterator[MetaDriveSimulator]:
    with MetaDriveSimulator() as simulator:
        yield simulator


@pytest.mark.parametrize("pedal", [0.25, 1.0])
def test_brake_slows_as_drivers_are_told(simulator: MetaDriveSimulator, pedal: float) -> None:
    driver = Fixed(Controls(0.0, brake=pedal), 4.0, Controls(0.0, throttle=1.0))
    t = simulator.drive(STRAIGHT, driver).trajectory
    deceleration = (t.speed[82] - t.speed[86]) / 0.2
    assert deceleration == pytest.approx(pedal * driver.setup.max_deceleration, rel=0.03)


def test_wheels_turn_the_car_as_geometry_has_it(simulator: MetaDriveSimulator) -> None:
    # At 3 m/s the tyres do not slide: the yaw rate is v tan(angle) / wheelbase.
    driver = Fixed(Controls(0.2), 1.0, Controls(0.0, throttle=1.0))
    t = simulator.drive(STRAIGHT, driver).trajectory
    assert np.array_equal(t.steering[1:], t.steering_input[:-1])  # at once, as drivers are told:
    assert (driver.setup.steering_rate, driver.setup.steering_lag) == (math.inf, 0.0)
    assert driver.setup.front_cornering_stiffness is None
    expected = t.speed[28] * math.tan(0.2) / driver.setup.wheelbase
    assert t.yaw_rate[28] == pytest.approx(expected, rel=0.03)
    assert t.lateral_speed[28] == pytest.approx(expected * driver.setup.rear_axle, rel=0.1)
    assert np.diff(t.heading[22:30]) / 0.05 == pytest.approx(t.yaw_rate[22:29], abs=0.05)


def test_start_can_be_moved_and_turned(simulator: MetaDriveSimulator) -> None:
    simulator.start_offset, simulator.start_heading = 0.5, -0.2
    try:
        start = simulator.drive(STRAIGHT, Stanley()).trajectory
    finally:
        simulator.start_offset = simulator.start_heading = 0.0
    ((_, d),) = STRAIGHT.track([[start.x[0], start.y[0]]])
    assert d + 2.0 == pytest.approx(0.5, abs=0.01)
    assert start.heading[0] - STRAIGHT.pose.heading == pytest.approx(-0.2, abs=1e-3)


def test_road_becomes_a_map_with_two_opposite_lanes(simulator: MetaDriveSimulator) -> None:
    road = Road(WINDING.curvatures, pose=(-40.0, 3.0, 0.3), lane_width=3.0)
    simulator.drive(road, Stanley())
    network = get_engine().current_map.road_network
    assert len(network.get_all_lanes()) == 2
    ego, other = network.get_lane(EGO_LANE), network.get_lane("other")
    origin = np.array(road.pose[:2])
    for lane, centre in ((ego, road.sample(1.0, -1.5)), (other, road.sample(1.0, 1.5)[::-1])):
        places = np.array([lane.local_coordinates(point - origin) for point in centre])
        assert np.abs(places[:, 1]).max() < 0.02
        assert np.all(np.diff(places[:, 0]) > 0.0), "points in the lane's direction"
        widths = np.linalg.norm(
            lane.polygon[: len(lane.polygon) // 2] - lane.polygon[::-1][: len(lane.polygon) // 2],
            axis=1,
        )
        assert widths == pytest.approx(np.full(len(widths), 3.0), abs=1e-6)


def test_same_drive_after_others_and_in_another_process(simulator: MetaDriveSimulator) -> None:
    drivers: list[Driver] = [Stanley(), Planner(), MetaDriveExpert()]
    roads = [WINDING, *random_roads(2)]
    first = [digest(simulator.drive(roads[0], driver)) for driver in drivers]
    for road in roads[1:]:
        for driver in drivers:
            simulator.drive(road, driver)
    assert [digest(simulator.drive(roads[0], driver)) for driver in reversed(drivers)] == first[
        ::-1
    ]
    code = (
        "from frenetic.drivers import Planner, Stanley\n"
        "from frenetic.metadrive import *\n"
        "from metadrive_drives import WINDING, digest\n"
        "with MetaDriveSimulator() as simulator:\n"
        "    for driver in (Stanley(), Planner(), MetaDriveExpert()):\n"
        "        print(digest(simulator.drive(WINDING, driver)))\n"
    )
    assert run(code, PYTHONHASHSEED="123").split() == first


def test_expert_drives_gentle_roads(simulator: MetaDriveSimulator) -> None:
    for road in (STRAIGHT, WINDING):
        result = judge(road, simulator.drive(road, MetaDriveExpert()))
        assert result.outcome is Outcome.PASS, result.reason
        assert result.moobd is not None
        assert result.moobd > 0.0


class Compared:
    """Drives by its observations, and keeps what the expert would see by them and in MetaDrive."""

    def __init__(self, simulator: MetaDriveSimulator) -> None:
        self.simulator = simulator
        assert simulator._world is not None
        self.sensor = LidarStateObservation(simulator._world.engine.global_config)

    def reset(self, setup: DriveSetup) -> None:
        self.setup, self.action, self.heading = setup, (0.0, 0.0), math.nan
        self.pairs: list[tuple[float, Any, Any]] = []

    def act(self, observation: Observation) -> Controls:
        assert self.simulator._world is not None
        vehicle = self.simulator._world.vehicle
        vehicle.after_step()
        turned = 0.0 if math.isnan(self.heading) else observation.heading - self.heading
        ours = state_of(observation, self.setup, self.action, turned)
        self.pairs.append((observation.distance, self.sensor.observe(vehicle), ours))
        back = -0.8 * observation.heading_error - 0.2 * observation.lateral_offset
        self.action = (back, 0.3 if observation.speed < 9.0 else 0.0)
        self.heading = observation.heading
        return Controls(*Decision.of_action(*self.action))


def test_an_observation_has_what_the_expert_sees_in_metadrive(
    simulator: MetaDriveSimulator,
) -> None:
    winding = [0.0, 0.0, 0.01, 0.02, 0.02, 0.0, -0.02, -0.03, -0.01, 0.0, 0.0, 0.03, 0.05, 0.03]
    road = Road([*winding, 0.0, 0.0, 0.0])
    driver = Compared(simulator)
    drive = simulator.drive(road, driver)
    assert drive.error is None, drive.error
    # The last piece of 40 m is described twice in MetaDrive: our road goes on.
    pairs = [(there, here) for distance, there, here in driver.pairs if distance < 115.0]
    assert len(pairs) > 200
    differences = np.abs([there - here for there, here in pairs]).max(axis=0)
    # The heading of MetaDrive's lane jumps from point to point of a line.
    assert differences[2] < 0.02
    assert np.delete(differences, 2).max() < 0.003


def test_under_layers_the_expert_drives_by_observations(simulator: MetaDriveSimulator) -> None:
    bends = [0.0, 0.0, 0.01, 0.02, 0.02, 0.0, -0.02, -0.03, -0.01, 0.0]
    road = Road([*bends, *bends, *bends, 0.0, 0.0, 0.0])  # 320 m
    own, layered = (
        simulator.drive(road, driver).trajectory
        for driver in (MetaDriveExpert(), Delayed(MetaDriveExpert(), seconds=0.0))
    )
    # Then it brakes harder than a driver of ours can.
    apart = np.hypot(*(np.array([own.x[:285], own.y[:285]]) - [layered.x[:285], layered.y[:285]]))
    assert 0.0 < apart.max() < 0.3


class TestExpert(DriverContract):
    def make(self) -> Driver:
        return MetaDriveExpert()
