"""The simulator `beamng`, with BeamNGpy, against a stand-in for BeamNG.tech."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import beamngpy
import beamngpy.connection
import numpy as np
import pytest
from beamng_stand_in import DROP, HANG, Fault, StandIn, World, program

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import BeamngAi, Controls, Delayed, Driver, DriveSetup, Observation, Stanley
from frenetic.drivers.camera import Camera
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.beamng import BeamngError, BeamngSimulator
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.road import Pose, Road
from frenetic.search import RandomSearch
from frenetic.simulators import CarBody, Rules
from frenetic.simulators.doctor import examine
from frenetic.testing import DummyDriver, SimulatorContract

pytestmark = pytest.mark.heavy

ROAD = Road([0.0, 0.0, 0.01, 0.02, 0.01, 0.0, 0.0], pose=Pose(80.0, 50.0, 1.0))


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def simulator_at(server: StandIn, **options: object) -> BeamngSimulator:
    return BeamngSimulator(port=server.port, **options)  # type: ignore[arg-type]


class TestContract(SimulatorContract):
    @pytest.fixture(autouse=True)
    def serve(self, stand_in: StandIn) -> None:
        self.server = stand_in

    def make(self, rules: Rules) -> BeamngSimulator:
        return simulator_at(self.server, rules=rules)


# Messages to BeamNG.tech


def test_a_scenario_has_a_road_and_markings_that_cannot_be_driven(stand_in: StandIn) -> None:
    scenarios = []

    class Looking(Stanley):
        def reset(self, setup: DriveSetup) -> None:
            super().reset(setup)
            assert stand_in.world.loaded is not None
            scenarios.append(stand_in.world.loaded)

    with simulator_at(stand_in) as simulator:
        simulator.drive(ROAD, Looking())
    (scenario,) = scenarios
    assert scenario.level == "tech_ground"
    *markings, road = scenario.roads
    assert [marking["drivability"] for marking in markings] == [-1, -1]
    assert road["drivability"] == 1
    nodes = np.array(road["nodes"])
    assert np.allclose(nodes[:, :2], ROAD.road_points, atol=1e-6)
    assert np.all(nodes[:, 2] == 0.0)
    assert np.all(nodes[:, 3] == 8.0)
    for marking, side in zip(markings, (1.0, -1.0), strict=True):
        offsets = ROAD.track(np.array(marking["nodes"])[:, :2])[:, 1]
        assert np.allclose(offsets, side * 3.85, atol=1e-3)
    assert scenario.spawned == "false", "BeamNG.tech may move and turn a car that it puts safely"


def test_the_car_is_measured_and_judged_by_its_true_box(stand_in: StandIn) -> None:
    body = stand_in.world.vehicle.body()
    with simulator_at(stand_in) as simulator:
        assert simulator.car == CarBody(body.length, body.width, 0.0)
        # The car counts steering to the right, and its position is not the middle of its box.
        assert simulator.measured.steering < -0.9
        assert (simulator.measured.ahead, simulator.measured.left) == (-0.35, 0.12)
        drive = simulator.drive(ROAD, Stanley())
        second = simulator.drive(ROAD, Stanley())
    assert ("FPSLimit", {"type": "FPSLimit", "fps": 60}) in stand_in.received
    assert all(message["ack"] for kind, message in stand_in.received if kind == "Step")
    np.testing.assert_allclose(drive.trajectory.x, second.trajectory.x, atol=0.01)
    assert stand_in.types().count("GetSystemInfo") == 1, "the next road needs no restart"
    assert not stand_in.world.scenarios, "the scenarios are deleted"
    assert "Quit" not in stand_in.types(), "a program that we did not start goes on"
    start = ROAD.track([[drive.trajectory.x[0], drive.trajectory.y[0]]])[0]
    assert np.allclose(start, [0.0, -2.0], atol=2e-3)


def test_beamng_ai_gets_lane_limit_and_aggression_before_its_goal(stand_in: StandIn) -> None:
    rules = Rules(speed_limit=54.0)
    with simulator_at(stand_in, rules=rules, aggression=0.4) as simulator:
        drive = simulator.drive(ROAD, BeamngAi())
    settings = [(kind, m) for kind, m in stand_in.received if kind.startswith("Set")]
    settings = [(kind, m) for kind, m in settings if "Ai" in kind or kind == "SetDriveInLane"]
    assert [kind for kind, _ in settings] == [
        "SetAiSpeed",
        "SetAiAggression",
        "SetDriveInLane",
        "SetAiMode",
        "SetAiWaypoint",
    ]
    assert settings[0][1] == {"type": "SetAiSpeed", "speed": 15.0, "mode": "limit"}
    assert settings[1][1]["aggression"] == 0.4
    assert settings[2][1]["lane"] == "on"
    assert judge(ROAD, drive).outcome is Outcome.PASS
    assert drive.trajectory.speed.max() < 15.5
    assert drive.trajectory.throttle.max() > 0.1, "the controls of BeamNG.AI are recorded"


def test_beamng_ai_brakes_before_a_lower_limit_and_accelerates_behind_a_higher_one(
    stand_in: StandIn,
) -> None:
    road = Road(np.zeros(13), pose=ROAD.pose, speed_limits=[(0, 36), (60, 18), (90, 36)])
    with simulator_at(stand_in) as simulator:
        drive = simulator.drive(road, BeamngAi())
    speeds = [message["speed"] for kind, message in stand_in.received if kind == "SetAiSpeed"]
    assert speeds[0] == 10.0
    assert min(speeds) == pytest.approx(5.0)
    assert speeds[-1] == 10.0
    place = road.track(np.column_stack([drive.trajectory.x, drive.trajectory.y]))[:, 0]
    within = (place > 62.0) & (place < 90.0)
    assert drive.trajectory.speed[within].max() < 6.0
    assert drive.trajectory.speed[place < 40.0].max() > 8.0


def test_the_parking_brake_replaces_the_brake_at_rest(stand_in: StandIn) -> None:
    with simulator_at(stand_in) as simulator:
        drive = simulator.drive(ROAD, DummyDriver(brake=1.0))
    assert not stand_in.world.was_reversing
    assert "moved less than" in judge(ROAD, drive).reason


def test_a_driver_sees_through_a_camera_on_the_car(stand_in: StandIn) -> None:
    images: list[np.ndarray] = []

    class Seeing(Stanley):
        camera = Camera(width=6, height=4, forward=1.0, left=0.2, up=1.5, pitch=30.0)

        def act(self, observation: Observation) -> Controls:
            assert observation.image is not None
            images.append(observation.image)
            return super().act(observation)

    with simulator_at(stand_in) as simulator:
        simulator.drive(ROAD, Seeing())
    assert images[0].shape == (4, 6, 3)
    assert images[0][0, 0].tolist() == [0, 1, 2], "red, green and blue, without transparency"
    (camera,) = [message for kind, message in stand_in.received if kind == "OpenCamera"]
    # In the car's frame, y points to the rear and x to the left. The origin is a node 0.3 m high,
    # 0.35 m ahead and 0.12 m to the right of the box's middle.
    assert camera["pos"] == pytest.approx([0.32, -0.65, 1.2])
    assert camera["dir"] == pytest.approx([0.0, -math.cos(math.pi / 6.0), -0.5])
    assert camera["up"] == pytest.approx([0.0, -0.5, math.cos(math.pi / 6.0)])
    assert camera["fovY"] == pytest.approx(Seeing.camera.vertical_field_of_view)
    kinds = stand_in.types()
    last_stop = len(kinds) - 1 - kinds[::-1].index("StopScenario")
    assert kinds.index("OpenCamera") < kinds.index("CloseCamera") < last_stop


@pytest.mark.parametrize("sign", [-1.0, 0.0])
def test_the_sign_of_the_steering_is_measured(stand_in: StandIn, sign: float) -> None:
    with simulator_at(stand_in) as simulator:
        expected = simulator.drive(ROAD, Stanley()).trajectory
    with StandIn(world=World(sign_shown=sign)) as other, simulator_at(other) as simulator:
        shown = simulator.drive(ROAD, Stanley()).trajectory
    np.testing.assert_allclose(shown.steering, expected.steering * abs(sign), atol=1e-9)


@pytest.mark.parametrize(
    ("driver", "text"),
    [
        (Delayed(BeamngAi(), seconds=0.2), "takes no noise, delay, view, or errors"),
        (BeamngAi(aggression=1.2), "use aggression of the simulator"),
        (load_driver("marking-follower"), "leave out no_gpu"),
    ],
)
def test_unsuitable_drivers_are_refused(driver: Driver, text: str) -> None:
    simulator = BeamngSimulator(home="/opt/beamng", no_gpu=True)
    with pytest.raises(DriverError, match=text):
        simulator.check_driver(driver)


def test_a_camera_without_pictures_is_an_error() -> None:
    with (
        StandIn(world=World(draws=False)) as server,
        simulator_at(server) as simulator,
        pytest.raises(BeamngError, match=r"the camera gives no picture: BeamNG\.tech draws"),
    ):
        simulator.drive(ROAD, MarkingFollower())


# Faults


def on(kind: str, number: int, fault: str) -> Fault:
    """Return a fault at the message of this kind and number only."""
    return lambda k, n: fault if (k, n) == (kind, number) else None


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (on("Step", 300, DROP), "connection to BeamNG.tech was lost, driving"),
        (on("SensorRequest", 300, HANG), "did not answer in time, asking for the car's state"),
        (on("Control", 300, "Lua: attempt to index a nil"), "reported an error, steering the car"),
    ],
)
def test_a_fault_during_a_drive_is_raised_and_the_simulator_can_be_entered_again(
    fault: Fault, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.plugins.beamng.link.REPLY_LIMIT", 0.5)
    with StandIn(fault=fault) as server:
        simulator = simulator_at(server)
        with simulator, pytest.raises(BeamngError, match=text):
            [simulator.drive(ROAD, Stanley()) for _ in range(5)]
        with simulator:
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


ENTERING: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "silent port": (
        {"fault": on("Hello", 1, HANG)},
        {},
        r"in time, connecting to 127\.0\.0\.1",
    ),
    "silent car": ({"fault": on("Hello", 2, HANG)}, {}, "in time, loading the road and etk800"),
    "hangs": ({"fault": on("LoadScenario", 1, HANG)}, {}, "in time, loading the road and etk800"),
    "vehicle": ({}, {"vehicle": "tank"}, "no vehicle tank: choose one of etk800, pickup"),
    "level": ({}, {"level": "moon", "ground": 0.0}, "no level moon: choose one of gridmap_v2"),
    "protocol": (
        {"protocol": "v1.22"},
        {},
        r"v1\.27 .*v1\.22; install the version of beamngpy",
    ),
}


@pytest.mark.parametrize("name", ENTERING)
def test_an_error_says_why_the_simulator_cannot_be_entered(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.plugins.beamng.link.LOAD_LIMIT", 0.5)
    monkeypatch.setattr("frenetic.plugins.beamng.link.REPLY_LIMIT", 0.5)
    world, options, text = ENTERING[name]
    with (
        StandIn(**world) as server,
        pytest.raises(BeamngError, match=text),
        simulator_at(server, **options),
    ):
        pass


def test_an_unknown_beamngpy_is_an_error(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(beamngpy.connection.Connection, "hello")
    with (
        pytest.raises(BeamngError, match="as Frenetic knows it, connecting"),
        simulator_at(stand_in),
    ):
        pass


def test_a_drive_counts_if_the_connection_is_lost_behind_it(tmp_path: Path) -> None:
    with StandIn(fault=on("StopScenario", 2, DROP)) as server:
        summary = campaign(simulator_at(server), tmp_path).run()
        assert server.types().count("GetSystemInfo") == 3, (
            "one start to measure the car, one until the lost connection, one for the rest"
        )
    assert summary.errors == 0
    with CampaignStore.open(tmp_path) as store:
        assert {record.attempts for record in store.tests() if record.outcome.is_driven} == {1}


def test_a_clock_that_differs_from_the_steps_is_an_error() -> None:
    with (
        StandIn(world=World(clock_error=0.1)) as server,
        simulator_at(server) as simulator,
        pytest.raises(BeamngError, match="does not keep 60 steps per second"),
    ):
        simulator.drive(ROAD, Stanley())


def test_a_slow_driver_or_a_slow_simulator_is_named(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.plugins.beamng.link.REPLY_LIMIT", 2.0)

    class Asleep(Stanley):
        def act(self, observation: Observation) -> Controls:
            time.sleep(60.0)
            raise AssertionError

    with simulator_at(stand_in, wall_limit=0.2) as simulator:
        drive = simulator.drive(ROAD, Asleep())
        assert "the driver did not finish its drive within 0.2 s" in str(drive.trouble)
        simulator.wall_limit = 60.0
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
        simulator.wall_limit = 0.5
        world = stand_in.world
        stand_in.fault = lambda kind, _: HANG if kind == "Step" and world.car.ai_target else None
        with pytest.raises(FreneticError, match=r"the simulator did not finish .* within 0\.5 s"):
            simulator.drive(ROAD, BeamngAi())


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"aggression": 2.5}, "aggression is 2.5: a number <= 2 is needed"),
        ({"level": "italy"}, "give its height with ground"),
        ({"headless": True}, "give home, too"),
        ({"restart_every": 5}, "give home, too"),
        ({"home": "/opt/b", "host": "10.0.0.1"}, "home excludes host and port"),
        ({"home": "/opt/b", "user": "/a b"}, "no folder with a space"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, object], text: str) -> None:
    with pytest.raises((ValueError, BeamngError)) as raised:
        BeamngSimulator(**({"port": 25252} | options if "home" not in options else options))  # type: ignore[arg-type]
    assert text in str(raised.value)


# Campaigns


def campaign(simulator: BeamngSimulator, folder: Path, **options: object) -> Campaign:
    return Campaign(
        **{
            "strategy": RandomSearch(seed=1),
            "simulator": simulator,
            "driver": Stanley(),
            "budget": Budget(simulations=3),
            "folder": folder,
            **options,
        },  # type: ignore[arg-type]
    )


# The simulator starts the stand-in as a program

linux = pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")


def is_alive(process_id: int) -> bool:
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    return True


def started_process(simulator: BeamngSimulator) -> int:
    process = simulator.link._process
    assert process is not None
    return process.pid


@linux
def test_a_campaign_goes_on_after_a_crash(tmp_path: Path) -> None:
    program(tmp_path / "home")
    simulator = BeamngSimulator(home=str(tmp_path / "home"))

    class Killing(Stanley):
        drives = 0

        def reset(self, setup: DriveSetup) -> None:
            super().reset(setup)
            Killing.drives += 1
            if Killing.drives == 2:
                os.kill(started_process(simulator), 9)

    summary = campaign(simulator, tmp_path / "c", driver=Killing()).run()
    assert (summary.simulations, summary.errors) == (3, 0)
    assert Killing.drives == 4


@linux
def test_restart_every_restarts_the_program(tmp_path: Path) -> None:
    program(tmp_path / "home")
    processes = []
    with BeamngSimulator(home=str(tmp_path / "home"), restart_every=2) as simulator:
        for _ in range(3):
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
            processes.append(started_process(simulator))
    first, second, third = processes
    assert first == second != third
    assert not any(is_alive(process_id) for process_id in processes), "the last has ended, too"


@linux
def test_options_become_arguments_of_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[list[str]] = []

    def refuse(call: list[str], **_: object) -> None:
        calls.append(call)
        raise OSError("not here")

    program(tmp_path)
    monkeypatch.setattr(subprocess, "Popen", refuse)
    simulator = BeamngSimulator(home=str(tmp_path), user=str(tmp_path / "user"), no_gpu=True)
    with pytest.raises(BeamngError, match="starting it"), simulator:
        pass
    (call,) = calls
    assert call[0].endswith("BinLinux/BeamNG.tech.x64")
    assert "-tcom-listen-ip 127.0.0.1 -headless -gfx null" in " ".join(call)
    assert call[-2:] == ["-userpath", str(tmp_path / "user")]


# The doctor's checks


def test_the_doctor_misses_only_a_licence(stand_in: StandIn) -> None:
    stand_in.is_licensed = False
    examination = examine("beamng", {"port": stand_in.port})
    (licence,) = examination.failed
    assert (licence.name, licence.remedy[:28]) == ("licence", "put tech.key into its user f")
    assert [check.name for check in examination.checks] == [
        "start",
        "licence",
        "car",
        "straight road, BeamNG.AI",
        "curve, BeamNG.AI",
        "straight road, Stanley",
        "curve, Stanley",
    ]
    assert "BeamNG.tech 0.39" in examination.checks[2].state
