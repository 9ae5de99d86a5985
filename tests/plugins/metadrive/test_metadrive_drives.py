"""Drives in MetaDrive: physics, map and MetaDrive's drivers, with one engine for all tests.

No part of MetaDrive is replaced.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import psutil
import pytest
from metadrive.engine.engine_utils import get_engine
from metadrive.examples.ppo_expert import numpy_expert
from metadrive.obs.state_obs import LidarStateObservation
from metadrive_drives import STRAIGHT, WINDING, Fixed, digest, random_roads, run

from frenetic.drivers import (
    Controls,
    Driver,
    DriveSetup,
    Noisy,
    Observation,
    Planner,
    Stanley,
)
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.metadrive import MetaDriveExpert, MetaDriveIdm, MetaDriveSimulator
from frenetic.plugins.metadrive.car import Decision
from frenetic.plugins.metadrive.expert import state_of
from frenetic.plugins.metadrive.navigation import EGO_LANE, pieces_of
from frenetic.plugins.metadrive.policies import make_policy
from frenetic.road import Pose, Road
from frenetic.simulators import EmbeddedSimulator, Rules, Vehicle
from frenetic.testing import DriverContract

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def simulator() -> Iterator[MetaDriveSimulator]:
    with MetaDriveSimulator() as simulator:
        yield simulator


def test_full_throttle_gives_the_setups_acceleration(simulator: MetaDriveSimulator) -> None:
    driver = Fixed(Controls(0.0, throttle=1.0))
    t = simulator.drive(STRAIGHT, driver).trajectory
    acceleration = (t.speed[60] - t.speed[20]) / 2.0
    assert acceleration == pytest.approx(driver.setup.max_acceleration, rel=0.01)


class Accelerating:
    """Demands several accelerations in turn."""

    DEMANDS = (2.0, 2.8, -2.0, 1.0, -5.0, 2.5, -0.5)

    def reset(self, setup: DriveSetup) -> None:
        self.setup, self.demands = setup, list[float]()

    def act(self, observation: Observation) -> Controls:
        self.demands.append(self.DEMANDS[int(observation.time / 1.5) % len(self.DEMANDS)])
        return Controls.from_acceleration(
            self.demands[-1], 0.0, speed=observation.speed, setup=self.setup
        )


def test_a_demanded_acceleration_is_reached(simulator: MetaDriveSimulator) -> None:
    driver = Accelerating()
    t = simulator.drive(STRAIGHT, driver).trajectory
    rolling = t.speed[:-1] > 0.5
    reached, demanded = np.diff(t.speed) / 0.05, np.array(driver.demands[: len(t) - 1])
    np.testing.assert_allclose(reached[rolling], demanded[rolling], rtol=0.02, atol=0.01)
    assert len(set(demanded[rolling])) == len(driver.DEMANDS)


@pytest.mark.parametrize("pedal", [0.25, 1.0])
def test_the_brake_gives_the_setups_deceleration(
    simulator: MetaDriveSimulator, pedal: float
) -> None:
    driver = Fixed(Controls(0.0, brake=pedal), 4.0, Controls(0.0, throttle=1.0))
    t = simulator.drive(STRAIGHT, driver).trajectory
    deceleration = (t.speed[82] - t.speed[86]) / 0.2
    assert deceleration == pytest.approx(pedal * driver.setup.max_deceleration, rel=0.03)


def test_wheels_turn_the_car_as_geometry_demands(simulator: MetaDriveSimulator) -> None:
    # At 3 m/s the tyres do not slide: the yaw rate is v tan(angle) / wheelbase.
    driver = Fixed(Controls(0.2), 1.0, Controls(0.0, throttle=1.0))
    t = simulator.drive(STRAIGHT, driver).trajectory
    assert np.array_equal(t.steering[1:], t.steering_input[:-1])  # at once, as the setup says
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
        assert np.all(np.diff(places[:, 0]) > 0.0), "distances grow in the lane's direction"
        widths = np.linalg.norm(
            lane.polygon[: len(lane.polygon) // 2] - lane.polygon[::-1][: len(lane.polygon) // 2],
            axis=1,
        )
        assert widths == pytest.approx(np.full(len(widths), 3.0), abs=1e-6)


def test_the_roads_position_does_not_change_a_drive(simulator: MetaDriveSimulator) -> None:
    here = simulator.drive(WINDING, Planner()).trajectory
    pose = Pose(WINDING.pose.x + 40_000.0, WINDING.pose.y - 7_000.0, WINDING.pose.heading)
    there = simulator.drive(Road(WINDING.curvatures, pose=pose), Planner()).trajectory
    assert there.x - 40_000.0 == pytest.approx(here.x, abs=1e-3)
    assert there.y + 7_000.0 == pytest.approx(here.y, abs=1e-3)


def test_a_drive_repeats_after_other_drives_and_in_another_process(
    simulator: MetaDriveSimulator,
) -> None:
    drivers: list[Driver] = [Stanley(), Planner(), MetaDriveIdm(), MetaDriveExpert()]
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
        "from frenetic.plugins.metadrive import *\n"
        "from metadrive_drives import WINDING, digest\n"
        "with MetaDriveSimulator() as simulator:\n"
        "    for driver in (Stanley(), Planner(), MetaDriveIdm(), MetaDriveExpert()):\n"
        "        print(digest(simulator.drive(WINDING, driver)))\n"
    )
    assert run(code, PYTHONHASHSEED="123").split() == first


def test_a_hundred_roads_need_no_more_memory(simulator: MetaDriveSimulator) -> None:
    roads = random_roads(20)
    process = psutil.Process()

    def drive_all() -> int:
        for road in roads:
            simulator.drive(road, Fixed(Controls(0.3, throttle=1.0)))  # soon out of the lane
        return int(process.memory_info().rss)

    before = drive_all()
    for _ in range(5):
        after = drive_all()
    # Measured: 0.2 MB.
    assert after - before < 10e6


def test_idm_keeps_the_lane_and_its_target_speed(simulator: MetaDriveSimulator) -> None:
    drive = simulator.drive(WINDING, MetaDriveIdm())
    result = judge(WINDING, drive)
    assert result.outcome is Outcome.PASS
    assert result.moobd is not None
    assert result.moobd > 1.0
    assert drive.trajectory.speed.max() * 3.6 == pytest.approx(30.0, abs=1.0)
    faster = simulator.drive(WINDING, MetaDriveIdm(target_speed=45.0)).trajectory
    assert faster.speed.max() * 3.6 == pytest.approx(45.0, abs=3.0)
    simulator.rules = Rules(speed_limit=20.0)
    capped = simulator.drive(WINDING, MetaDriveIdm()).trajectory
    simulator.rules = Rules()
    assert capped.speed.max() * 3.6 == pytest.approx(20.0, abs=1.0)
    road = replace(STRAIGHT, speed_limits=np.array([[0.0, 40.0], [0.6 * STRAIGHT.length, 20.0]]))
    slower = simulator.drive(road, MetaDriveIdm(target_speed=60.0)).trajectory
    place = road.track(np.column_stack([slower.x, slower.y]))[:, 0]
    assert slower.speed.max() * 3.6 == pytest.approx(40.0, abs=3.0)
    assert slower.speed[place > 0.7 * road.length].max() * 3.6 == pytest.approx(20.0, abs=3.0)


def test_expert_drives_gentle_roads(simulator: MetaDriveSimulator) -> None:
    for road in (STRAIGHT, WINDING):
        result = judge(road, simulator.drive(road, MetaDriveExpert()))
        assert result.outcome is Outcome.PASS, result.reason
        assert result.moobd is not None
        assert result.moobd > 0.0


def test_the_expert_decides_like_metadrives_function(simulator: MetaDriveSimulator) -> None:
    # MetaDrive's function reads the state of a drive. Without weights it makes a new observer.
    numpy_expert._expert_weights = None
    simulator.drive(WINDING, Fixed(Controls(0.05, throttle=0.5)))
    world = simulator._world
    assert world is not None
    policy = make_policy(MetaDriveExpert(), world)
    for _ in range(5):
        decision = policy.act(70.0)
        steering, throttle_brake = numpy_expert.expert(world.vehicle, deterministic=True)
        assert decision.action == pytest.approx(
            np.clip((steering, throttle_brake), -1.0, 1.0), abs=1e-5
        )
        world.steer(*decision.action)
        world.advance(6)
    policy.close()


def test_pieces_of_a_road_are_its_arcs() -> None:
    # A circle of radius 50 m to the left: the ego lane's radius is 52 m.
    road = Road(np.full(13, 1.0 / 50.0), pose=Pose(7.0, 8.0, 0.0))
    pieces = pieces_of(road)
    assert [piece.radius for piece in pieces] == pytest.approx([52.0] * 3)
    assert [piece.turn for piece in pieces] == pytest.approx([0.8] * 3)
    assert pieces[-1].end == pytest.approx(120.0 * 52.0 / 50.0)
    end = np.array([pieces[-1].x, pieces[-1].y]) + road.pose[:2]
    assert end == pytest.approx(road.sample(1.0, -2.0)[-1], abs=1e-6)
    assert all(piece.radius == piece.turn == 0.0 for piece in pieces_of(STRAIGHT))


def test_idm_refuses_other_simulators() -> None:
    drive = EmbeddedSimulator().drive(WINDING, MetaDriveIdm())
    assert drive.trouble is not None
    assert (
        drive.trouble.reason
        == "metadrive-idm drives in MetaDrive only: choose the simulator metadrive"
    )


class Compared:
    """Stores the expert's input, computed from observations and read from MetaDrive."""

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
        state = state_of(observation, self.setup, self.action, turned)
        self.pairs.append((observation.distance, self.sensor.observe(vehicle), state))
        back = -0.8 * observation.heading_error - 0.2 * observation.lateral_offset
        self.action = (back, 0.3 if observation.speed < 9.0 else 0.0)
        self.heading = observation.heading
        return Controls(*Decision.of_action(*self.action))


def test_an_observation_gives_the_experts_input(
    simulator: MetaDriveSimulator,
) -> None:
    winding = [0.0, 0.0, 0.01, 0.02, 0.02, 0.0, -0.02, -0.03, -0.01, 0.0, 0.0, 0.03, 0.05, 0.03]
    road = Road([*winding, 0.0, 0.0, 0.0])
    driver = Compared(simulator)
    drive = simulator.drive(road, driver)
    assert drive.trouble is None, drive.trouble
    # MetaDrive describes the last piece of 40 m twice, our observation describes the road ahead.
    pairs = [(sensed, state) for distance, sensed, state in driver.pairs if distance < 115.0]
    assert len(pairs) > 200
    differences = np.abs([sensed - state for sensed, state in pairs]).max(axis=0)
    # The heading of MetaDrive's lane jumps from point to point of a line.
    assert differences[2] < 0.02
    assert np.delete(differences, 2).max() < 0.003


class ObservingExpert:
    """The expert, unrecognised by the simulator, so that it gets observations."""

    def __init__(self, driver: MetaDriveExpert) -> None:
        self.reset, self.act, self.period = driver.reset, driver.act, driver.period


def test_the_expert_drives_alike_by_observations(
    simulator: MetaDriveSimulator,
) -> None:
    bends = [0.0, 0.0, 0.01, 0.02, 0.02, 0.0, -0.02, -0.03, -0.01, 0.0]
    road = Road([*bends, *bends, *bends, 0.0, 0.0, 0.0])  # 320 m
    direct, observing = (
        simulator.drive(road, driver).trajectory
        for driver in (MetaDriveExpert(), ObservingExpert(MetaDriveExpert()))
    )
    # From step 285 on the expert brakes harder than our controls allow.
    path = np.array([direct.x[:285], direct.y[:285]])
    apart = np.hypot(*(path - [observing.x[:285], observing.y[:285]]))
    assert apart.max() < 0.3


class TestExpert(DriverContract):
    def make(self) -> Driver:
        return MetaDriveExpert()


def test_wrappers_over_metadrives_drivers_are_refused(simulator: MetaDriveSimulator) -> None:
    drive = simulator.drive(WINDING, Noisy(MetaDriveIdm()))
    assert drive.trouble is not None
    assert "do not reach it: leave them out" in drive.trouble.reason
    assert judge(WINDING, drive).outcome is Outcome.ERROR


def test_the_embedded_simulator_has_metadrives_car(simulator: MetaDriveSimulator) -> None:
    twin = EmbeddedSimulator(vehicle="metadrive")
    assert twin.vehicle == Vehicle.named("metadrive")
    assert twin.car.length == simulator.car.length
    assert twin.car.centre_ahead == pytest.approx(simulator.car.centre_ahead)
    assert (
        abs(simulator.car.centre_ahead) < 1e-9
    )  # Bullet's centre of mass is the middle of the box
    for road in (STRAIGHT, WINDING):
        here, there = (judge(road, s.drive(road, Stanley())) for s in (twin, simulator))
        assert here.outcome is there.outcome is Outcome.PASS
        assert here.moobd == pytest.approx(there.moobd, abs=0.1)
        # The embedded car starts more slowly, see `CARS`.
        assert here.duration == pytest.approx(there.duration, abs=1.5)
