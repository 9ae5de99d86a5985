"""BeamNG.tech's simulator: BeamNGpy itself against a stand-in that speaks its protocol."""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import beamngpy
import beamngpy.connection
import numpy as np
import pytest
from beamng_stand_in import DROP, HANG, StandIn, Trouble, World, program

from frenetic.beamng import BeamngError, BeamngSimulator
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.doctor import examine
from frenetic.drivers import BeamngAi, Controls, Delayed, Driver, DriveSetup, Observation, Stanley
from frenetic.drivers.camera import Camera
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.search import RandomSearch
from frenetic.simulators import CarBody, Rules
from frenetic.testing import DummyDriver, SimulatorContract
from frenetic.vision.marking_follower import MarkingFollower

ROAD = Road([0.0, 0.0, 0.01, 0.02, 0.01, 0.0, 0.0], pose=Pose(80.0, 50.0, 1.0))


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def connected(server: StandIn, **options: object) -> BeamngSimulator:
    return BeamngSimulator(port=server.port, **options)  # type: ignore[arg-type]


class TestContract(SimulatorContract):
    @pytest.fixture(autouse=True)
    def serve(self, stand_in: StandIn) -> None:
        self.server = stand_in

    def make(self, rules: Rules) -> BeamngSimulator:
        return connected(self.server, rules=rules)


# What is said to BeamNG.tech


def test_road_is_built_with_markings_that_are_no_roads(stand_in: StandIn) -> None:
    seen = []

    class Looking(Stanley):
        def reset(self, setup: DriveSetup) -> None:
            super().reset(setup)
            assert stand_in.world.loaded is not None
            seen.append(stand_in.world.loaded)

    with connected(stand_in) as simulator:
        simulator.drive(ROAD, Looking())
    (scenario,) = seen
    assert scenario.level == "tech_ground"
    *markings, road = scenario.roads
    assert [one["drivability"] for one in markings] == [-1, -1]
    assert road["drivability"] == 1
    nodes = np.array(road["nodes"])
    assert np.allclose(nodes[:, :2], ROAD.road_points, atol=1e-6)
    assert np.all(nodes[:, 2] == 0.0)
    assert np.all(nodes[:, 3] == 8.0)
    for marking, side in zip(markings, (1.0, -1.0), strict=True):
        offsets = ROAD.track(np.array(marking["nodes"])[:, :2])[:, 1]
        assert np.allclose(offsets, side * 3.85, atol=1e-3)
    assert scenario.spawned == "false", "BeamNG.tech may move and turn a car that it puts safely"


def test_car_is_measured_and_judged_by_its_true_box(stand_in: StandIn) -> None:
    body = stand_in.world.vehicle.body()
    with connected(stand_in) as simulator:
        assert simulator.car == CarBody(body.length, body.width, 0.0)
        # Its steering counts to the right, and its position is not the middle of its box.
        assert simulator.measured.steering < -0.9
        assert (simulator.measured.ahead, simulator.measured.left) == (-0.35, 0.12)
        drive = simulator.drive(ROAD, Stanley())
    start = ROAD.track([[drive.trajectory.x[0], drive.trajectory.y[0]]])[0]
    assert np.allclose(start, [0.0, -2.0], atol=2e-3)


def test_time_is_cut_into_the_steps_that_were_asked_for(stand_in: StandIn) -> None:
    with connected(stand_in, steps_per_second=100) as simulator:
        drive = simulator.drive(ROAD, Stanley())
    assert ("FPSLimit", {"type": "FPSLimit", "fps": 100}) in stand_in.said
    assert (
        "SetPhysicsDeterministic",
        {"type": "SetPhysicsDeterministic", "speedFactor": None},
    ) in (stand_in.said)
    assert np.allclose(np.diff(drive.trajectory.time), 0.05)
    assert all(message["ack"] for kind, message in stand_in.said if kind == "Step")


def test_beamng_ai_is_told_lane_limit_and_aggression_before_its_goal(stand_in: StandIn) -> None:
    rules = Rules(speed_limit=54.0)
    with connected(stand_in, rules=rules, aggression=0.4) as simulator:
        drive = simulator.drive(ROAD, BeamngAi())
    told = [(kind, message) for kind, message in stand_in.said if kind.startswith("Set")]
    told = [(k, m) for k, m in told if "Ai" in k or k == "SetDriveInLane"]
    assert [kind for kind, _ in told] == [
        "SetAiSpeed",
        "SetAiAggression",
        "SetDriveInLane",
        "SetAiMode",
        "SetAiWaypoint",
    ]
    assert told[0][1] == {"type": "SetAiSpeed", "speed": 15.0, "mode": "limit"}
    assert told[1][1]["aggression"] == 0.4
    assert told[2][1]["lane"] == "on"
    assert judge(ROAD, drive).outcome is Outcome.PASS
    assert drive.trajectory.speed.max() < 15.5
    assert drive.trajectory.throttle.max() > 0.1, "what BeamNG.AI did is recorded"


def test_brake_at_rest_is_left_to_the_parking_brake(stand_in: StandIn) -> None:
    with connected(stand_in) as simulator:
        drive = simulator.drive(ROAD, DummyDriver(brake=1.0))
    assert not stand_in.world.was_reversing
    assert "moved less than" in judge(ROAD, drive).reason


def test_driver_sees_through_a_camera_on_the_car(stand_in: StandIn) -> None:
    seen: list[np.ndarray] = []

    class Seeing(Stanley):
        camera = Camera(width=6, height=4, forward=1.0, left=0.2, up=1.5, pitch=30.0)

        def act(self, observation: Observation) -> Controls:
            assert observation.image is not None
            seen.append(observation.image)
            return super().act(observation)

    with connected(stand_in) as simulator:
        simulator.drive(ROAD, Seeing())
    assert seen[0].shape == (4, 6, 3)
    assert seen[0][0, 0].tolist() == [0, 1, 2], "without the transparency"
    (camera,) = [message for kind, message in stand_in.said if kind == "OpenCamera"]
    # In the car's own frame its nose points to -y, x to the left; from a node 0.3 m high, 0.35 m
    # ahead and 0.12 m to the right of the box's middle.
    assert camera["pos"] == pytest.approx([0.32, -0.65, 1.2])
    assert camera["dir"] == pytest.approx([0.0, -math.cos(math.pi / 6.0), -0.5])
    assert camera["up"] == pytest.approx([0.0, -0.5, math.cos(math.pi / 6.0)])
    assert camera["fovY"] == pytest.approx(Seeing.camera.vertical_field_of_view)
    told = stand_in.types()
    last_stop = len(told) - 1 - told[::-1].index("StopScenario")
    assert told.index("OpenCamera") < told.index("CloseCamera") < last_stop


def test_camera_without_pictures_and_what_it_lacks_are_told(stand_in: StandIn) -> None:
    driver = load_driver("marking-follower", wear=0.5)
    with pytest.raises(DriverError, match="draws its own world: leave out scene and wear"):
        BeamngSimulator(host="127.0.0.1", port=stand_in.port).check_driver(driver)
    bent = MarkingFollower()
    bent.camera = Camera(distortion=-0.05)
    with pytest.raises(DriverError, match=r"no distortion: the driver's has -0\.05"):
        BeamngSimulator(host="127.0.0.1", port=stand_in.port).check_driver(bent)
    stand_in.world.draws = False
    road = Road([0.0] * 4, pose=Pose(50.0, 50.0, 0.5))
    with (
        connected(stand_in) as simulator,
        pytest.raises(BeamngError, match=r"the camera gives no picture: BeamNG\.tech draws"),
    ):
        simulator.drive(road, MarkingFollower())


def test_next_road_needs_no_restart(stand_in: StandIn) -> None:
    other = Road([0.0, -0.01, -0.02, -0.01, 0.0, 0.0], pose=Pose(20.0, 20.0, 0.5))
    with connected(stand_in) as simulator:
        for road in (ROAD, other):
            assert judge(road, simulator.drive(road, Stanley())).outcome is Outcome.PASS
    assert stand_in.types().count("GetSystemInfo") == 1
    assert not stand_in.world.scenarios, "what was built is deleted"
    assert "Quit" not in stand_in.types(), "what we did not start goes on"


# What BeamNG.AI is not


@pytest.mark.parametrize(
    ("driver", "road", "text"),
    [
        (Delayed(BeamngAi(), seconds=0.2), ROAD, "takes no noise, delay or view"),
        (BeamngAi(aggression=1.2), ROAD, "use aggression of the simulator"),
        (BeamngAi(), Road([0.0] * 6, lane_width=6.5), "less than 6.3 m"),
    ],
)
def test_what_beamng_ai_cannot_do_is_said(
    stand_in: StandIn, driver: Driver, road: Road, text: str
) -> None:
    with connected(stand_in) as simulator:
        drive = simulator.drive(road, driver)
    assert judge(road, drive).outcome is Outcome.ERROR
    assert text in str(drive.error)


# Trouble


def on(kind: str, number: int, trouble: str) -> Trouble:
    """Makes the number-th message of a kind go wrong, that one only."""
    return lambda k, n: trouble if (k, n) == (kind, number) else None


@pytest.mark.parametrize(
    ("trouble", "text"),
    [
        (on("Step", 300, DROP), "connection to BeamNG.tech was lost, driving"),
        (on("SensorRequest", 300, HANG), "did not answer in time, asking for the car's state"),
        (on("Control", 300, "Lua: attempt to index a nil"), "reported an error, steering the car"),
    ],
)
def test_trouble_in_mid_drive_is_raised_and_gone_after_entering_again(
    trouble: Trouble, text: str
) -> None:
    with StandIn(trouble=trouble) as server:
        simulator = connected(server, reply_limit=0.5)
        with simulator, pytest.raises(BeamngError, match=text):
            [simulator.drive(ROAD, Stanley()) for _ in range(5)]
        with simulator:
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


ENTERING: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "silent port": (
        {"trouble": on("Hello", 1, HANG)},
        {"reply_limit": 0.2},
        r"in time, connecting to 127\.0\.0\.1",
    ),
    "silent car": ({"trouble": on("Hello", 2, HANG)}, {}, "in time, loading the road and etk800"),
    "hangs": ({"trouble": on("LoadScenario", 1, HANG)}, {}, "in time, loading the road and etk800"),
    "vehicle": ({}, {"vehicle": "tank"}, "no vehicle tank: choose one of etk800, pickup"),
    "level": ({}, {"level": "moon", "ground": 0.0}, "no level moon: choose one of gridmap_v2"),
    "protocol": (
        {"protocol": "v1.22"},
        {},
        r"v1\.27 .*v1\.22: install the version of beamngpy",
    ),
}


@pytest.mark.parametrize("name", ENTERING)
def test_it_says_why_it_cannot_be_entered(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("frenetic.beamng.link.LOAD_LIMIT", 0.5)
    world, options, text = ENTERING[name]
    with (
        StandIn(**world) as server,
        pytest.raises(BeamngError, match=text),
        connected(server, **options),
    ):
        pass
    if name == "silent port":
        assert server.connections == 1, "it is asked once"


def test_drive_counts_whatever_becomes_of_its_road(tmp_path: Path) -> None:
    with StandIn(trouble=on("StopScenario", 2, DROP)) as server:
        summary = campaign(connected(server, reply_limit=3.0), tmp_path).run()
        assert server.types().count("GetSystemInfo") == 3, "measured, driven once, the rest"
    assert summary.errors == 0
    with CampaignStore.open(tmp_path) as store:
        assert {record.attempts for record in store.tests() if record.outcome.is_driven} == {1}


def test_nobody_listens(stand_in: StandIn) -> None:
    stand_in.close()
    with pytest.raises(BeamngError, match=r"nothing answers at 127\.0\.0\.1"), connected(stand_in):
        pass


def test_clock_that_does_not_keep_the_steps_is_an_error() -> None:
    with (
        StandIn(world=World(clock_error=0.1)) as server,
        connected(server) as simulator,
        pytest.raises(BeamngError, match="does not keep 60 steps per second"),
    ):
        simulator.drive(ROAD, Stanley())


def test_drive_that_takes_too_long_is_the_fault_of_who_is_slow(stand_in: StandIn) -> None:
    class Asleep(Stanley):
        def act(self, observation: Observation) -> Controls:
            time.sleep(60.0)
            raise AssertionError

    with connected(stand_in, wall_limit=0.2, reply_limit=2.0) as simulator:
        drive = simulator.drive(ROAD, Asleep())
        assert "the driver did not finish its drive within 0.2 s" in str(drive.error)
        simulator.wall_limit = 60.0
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
        simulator.wall_limit = 0.5
        world = stand_in.world
        stand_in.trouble = lambda kind, _: HANG if kind == "Step" and world.car.ai_target else None
        with pytest.raises(FreneticError, match=r"the simulator did not finish .* within 0\.5 s"):
            simulator.drive(ROAD, BeamngAi())


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"steps_per_second": 50}, "steps_per_second is 50: a whole number that's a multiple of"),
        ({"aggression": 2.5}, "aggression is 2.5: a number <= 2 is needed"),
        ({"level": "italy"}, "give its height with ground"),
        ({"headless": True}, "give home, too"),
        ({"restart_every": 5}, "give home, too"),
        ({"home": "/opt/b", "host": "10.0.0.1"}, "home excludes host and port"),
        ({"home": "/opt/b", "user": "/a b"}, "no folder with a space"),
    ],
)
def test_options_are_checked(options: dict[str, object], text: str) -> None:
    with pytest.raises((ValueError, BeamngError)) as raised:
        BeamngSimulator(**({"port": 25252} | options if "home" not in options else options))  # type: ignore[arg-type]
    assert text in str(raised.value)


def test_beamngpy_that_is_too_old_or_unknown_is_told(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("frenetic.beamng.link.version", lambda _: "1.35")
        with (
            pytest.raises(BeamngError, match=r"beamngpy 1\.35 is too old: 1\.36 or newer"),
            connected(stand_in),
        ):
            pass
    monkeypatch.delattr(beamngpy.connection.Connection, "hello")
    with pytest.raises(BeamngError, match="as Frenetic knows it, connecting"), connected(stand_in):
        pass


def test_somebody_has_to_say_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BNG_HOME", raising=False)
    with pytest.raises(
        BeamngError, match=r"nothing says where BeamNG\.tech is: give its folder as home"
    ):
        BeamngSimulator()


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


def test_simulator_can_be_sent_to_a_worker(stand_in: StandIn) -> None:
    assert connected(stand_in).workers_at_most == 1
    with connected(stand_in) as simulator:
        copy = pickle.loads(pickle.dumps(simulator))
    assert copy.car == simulator.car
    with pytest.raises(BeamngError, match="is not started"):
        _ = copy.link


# Starting it: the stand-in as a program

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
def test_it_is_ended_however_it_is_left(tmp_path: Path) -> None:
    program(tmp_path / "home")
    simulator = BeamngSimulator(home=str(tmp_path / "home"), headless=True)
    with suppress(KeyboardInterrupt), simulator:
        started = started_process(simulator)
        raise KeyboardInterrupt
    assert not is_alive(started)


@linux
def test_campaign_goes_on_after_a_crash(tmp_path: Path) -> None:
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
def test_it_is_started_anew_after_so_many_drives(tmp_path: Path) -> None:
    program(tmp_path / "home")
    processes = []
    with BeamngSimulator(home=str(tmp_path / "home"), restart_every=2) as simulator:
        for _ in range(3):
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
            processes.append(started_process(simulator))
    a, b, c = processes
    assert a == b != c
    assert not any(is_alive(one) for one in processes)


@linux
def test_program_that_ends_at_once_is_told(tmp_path: Path) -> None:
    program(tmp_path).write_text("#!/bin/sh\nexit 3\n")
    with (
        pytest.raises(BeamngError, match=r"ended while it started, with exit code 3: start it by"),
        BeamngSimulator(home=str(tmp_path)),
    ):
        pass


@linux
def test_launch_says_what_the_options_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_home_without_a_program(tmp_path: Path) -> None:
    with pytest.raises(BeamngError, match="starting it"), BeamngSimulator(home=str(tmp_path)):
        pass


# Its own checks


def test_doctor_finds_nothing_wrong_but_a_missing_licence(stand_in: StandIn) -> None:
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
    assert "BeamNG.tech 0.39" in examination.checks[2].found


def test_steering_passes_the_filter_where_there_is_no_other_way() -> None:
    drives = []
    for takes_lua in (True, False):
        with StandIn(world=World(takes_lua=takes_lua)) as running, connected(running) as simulator:
            assert simulator.measured.steers_directly is takes_lua
            drives.append(simulator.drive(ROAD, Stanley()).trajectory.to_rows())
    direct, filtered = drives
    np.testing.assert_array_equal(direct, filtered)


def test_a_sign_that_differs_is_allowed_for() -> None:
    records = []
    for sign in (1.0, -1.0, 0.0):
        with StandIn(world=World(sign_shown=sign)) as running, connected(running) as simulator:
            assert simulator.measured.sign_shown == sign
            records.append(simulator.drive(ROAD, Stanley()).trajectory)
    as_told, opposite, unknown = records
    np.testing.assert_allclose(as_told.to_rows(), opposite.to_rows(), atol=1e-9)
    assert not unknown.steering.any()
