"""BeamNG.tech's simulator: BeamNGpy itself against a stand-in that speaks its protocol."""

from __future__ import annotations

import math
import os
import pickle
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import beamngpy
import beamngpy.connection
import numpy as np
import pytest
from beamng_stand_in import DROP, HANG, StandIn, Trouble, World, program
from beamngpy.connection.prefixed_length_socket import PrefixedLengthSocket

from frenetic.beamng import BeamngError, BeamngSimulator
from frenetic.beamng.link import end_process
from frenetic.beamng.scene import ego_start
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.doctor import Health, examine
from frenetic.drivers import BeamngAi, Controls, Delayed, Driver, DriveSetup, Observation, Stanley
from frenetic.drivers.camera import Camera
from frenetic.drivers.driver import AHEAD_POINTS
from frenetic.drivers.loading import load_driver
from frenetic.errors import CampaignError, DriverError
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.search import RandomSearch
from frenetic.simulators import CarBody, Rules
from frenetic.testing import DummyDriver, SimulatorContract
from frenetic.vision.marking_follower import MarkingFollower
from frenetic.vision.rendering import Renderer

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


class TestContractOfBeamngAi(SimulatorContract):
    @pytest.fixture(autouse=True)
    def serve(self, stand_in: StandIn) -> None:
        self.server = stand_in

    def make(self, rules: Rules) -> BeamngSimulator:
        return connected(self.server, rules=rules)

    def driver(self) -> Driver:
        return BeamngAi()


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


def test_driver_sees_and_steers_in_our_frame(stand_in: StandIn) -> None:
    seen: list[Observation] = []

    class Left:
        def reset(self, setup: DriveSetup) -> None:
            self.most = setup.max_steering

        def act(self, observation: Observation) -> Controls:
            seen.append(observation)
            return Controls(0.1, throttle=0.3)

    with connected(stand_in) as simulator:
        drive = simulator.drive(ROAD, Left())
    assert judge(ROAD, drive).outcome is Outcome.FAIL
    departure = judge(ROAD, drive).departure
    assert departure is not None
    assert departure.side == "left"
    assert seen[0].ahead.shape == (AHEAD_POINTS, 2)
    assert abs(seen[0].lateral_offset) < 0.01
    assert seen[-1].steering == pytest.approx(0.1, rel=0.05)
    assert seen[-1].yaw_rate > 0.0
    assert drive.trajectory.steering_input[0] == 0.1


def test_brake_at_rest_is_left_to_the_parking_brake(stand_in: StandIn) -> None:
    with connected(stand_in) as simulator:
        drive = simulator.drive(ROAD, DummyDriver(brake=1.0))
    assert not stand_in.world.was_reversing
    assert "moved less than" in judge(ROAD, drive).reason


def test_driver_sees_through_a_camera_on_the_car(stand_in: StandIn) -> None:
    seen: list[np.ndarray] = []

    class Seeing(MarkingFollower):
        def act(self, observation: Observation) -> Controls:
            assert observation.image is not None
            seen.append(observation.image)
            return super().act(observation)

    road = Road([0.0, 0.01, 0.02, 0.02, 0.0], pose=Pose(50.0, 50.0, 0.5))
    with connected(stand_in) as simulator:
        result = judge(road, simulator.drive(road, Seeing()))
    assert result.outcome is Outcome.PASS, result.reason
    # What the embedded simulator draws from the same place: the camera is where it should be.
    own = Renderer(road, Camera()).draw(*(ego_start(road)))
    assert seen[0].shape == own.shape
    assert np.abs(seen[0].astype(float) - own).mean() < 1.0
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
        assert judge(ROAD, simulator.drive(ROAD, BeamngAi())).outcome is Outcome.PASS


# Trouble


def on(kind: str, number: int, trouble: str) -> Trouble:
    """Makes the number-th message of a kind go wrong, that one only."""
    return lambda k, n: trouble if (k, n) == (kind, number) else None


def drive_often(simulator: BeamngSimulator) -> None:
    for _ in range(5):
        simulator.drive(ROAD, Stanley())


@pytest.mark.parametrize(
    ("trouble", "text"),
    [
        (on("Step", 300, DROP), "connection to BeamNG.tech was lost, driving"),
        (on("SensorRequest", 300, DROP), "lost, asking for the car's state"),
        (on("Step", 300, HANG), "did not answer in time, driving"),
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
            drive_often(simulator)
        with simulator:
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


@pytest.mark.parametrize("trouble", [on("Hello", 2, HANG), on("LoadScenario", 1, HANG)])
def test_hang_while_loading_is_noticed(trouble: Trouble, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("frenetic.beamng.link.LOAD_LIMIT", 0.5)
    with (
        StandIn(trouble=trouble) as server,
        pytest.raises(BeamngError, match="in time, loading the road and etk800"),
        connected(server),
    ):
        pass


def test_silent_car_is_noticed_outside_the_main_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("frenetic.beamng.link.LOAD_LIMIT", 0.5)
    raised: list[BaseException] = []
    with StandIn(trouble=on("Hello", 2, HANG)) as server:

        def enter() -> None:
            try:
                with connected(server):
                    pass
            except BaseException as error:
                raised.append(error)

        thread = threading.Thread(target=enter, daemon=True)
        thread.start()
        thread.join(60.0)
        assert not thread.is_alive()
    assert isinstance(raised[0], BeamngError)
    assert "did not answer in time, loading the road and etk800" in str(raised[0])


def test_port_that_is_silent_is_asked_once() -> None:
    with (
        StandIn(trouble=on("Hello", 1, HANG)) as server,
        pytest.raises(BeamngError, match=r"in time, connecting to 127\.0\.0\.1"),
        connected(server, reply_limit=0.2),
    ):
        pass
    assert server.connections == 1


def test_port_of_the_car_that_cannot_be_reached_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with StandIn() as server:
        port = free_port()
        monkeypatch.setattr(
            server, "_ge_StartVehicleConnection", lambda _: {"vid": "ego", "result": port}
        )
        monkeypatch.setattr("beamngpy.connection.connection.sleep", lambda _: None)
        with (
            pytest.raises(BeamngError, match=rf"the car's port {port} .*: BeamNG.tech opens one"),
            connected(server),
        ):
            pass


@pytest.mark.parametrize(
    "trouble",
    [
        on("StopScenario", 2, "it is stuck"),
        on("StopScenario", 2, DROP),
        on("StopScenario", 2, HANG),
        on("DeleteScenario", 2, "there is no such file"),
    ],
)
def test_drive_counts_whatever_becomes_of_its_road(trouble: Trouble, tmp_path: Path) -> None:
    with StandIn(trouble=trouble) as server:
        summary = campaign(connected(server, reply_limit=3.0), tmp_path).run()
        assert server.types().count("GetSystemInfo") == 3, "measured, driven once, the rest"
    assert summary.errors == 0
    with CampaignStore.open(tmp_path) as store:
        assert {record.attempts for record in store.tests() if record.outcome.is_driven} == {1}


def test_error_of_the_simulator_is_told_in_its_words(stand_in: StandIn) -> None:
    with (
        pytest.raises(BeamngError, match=r"Vehicle not found: tank"),
        connected(stand_in, vehicle="tank"),
    ):
        pass


def test_other_version_is_told_with_what_to_do() -> None:
    with (
        StandIn(protocol="v1.22") as server,
        pytest.raises(BeamngError, match=r"v1\.27 .*v1\.22: install the version of beamngpy"),
        connected(server),
    ):
        pass


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

    with connected(stand_in, wall_limit=0.2) as simulator:
        drive = simulator.drive(ROAD, Asleep())
        assert "the driver did not finish its drive within 0.2 s" in str(drive.error)
        simulator.wall_limit = 60.0
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


def test_given_box_has_to_be_the_true_one(stand_in: StandIn) -> None:
    with (
        pytest.raises(BeamngError, match=r"4\.508 by 1\.61 m, .* give car_length=4\.508"),
        connected(stand_in, car_length=4.0, car_width=1.6),
    ):
        pass
    given = connected(stand_in, car_length=4.51, car_width=1.61)
    given.prepare()
    assert given.car == CarBody(4.51, 1.61)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"steps_per_second": 50}, "steps_per_second is 50: a multiple of 20 is needed"),
        ({"aggression": 0.0}, "aggression is 0.0: a number above 0 and up to 2 is needed"),
        ({"aggression": True}, "aggression is True: a number above 0 and up to 2 is needed"),
        ({"level": "italy"}, "give its height with ground"),
        ({"level": None}, "level is None: a name is needed"),
        ({"ground": math.nan}, "ground is nan: a number of m is needed"),
        ({"ground": "abc"}, "ground is 'abc': a number of m is needed"),
        ({"port": 0}, "port is 0: a whole number from 1 to 65535 is needed"),
        ({"port": "abc"}, "port is 'abc': a whole number from 1 to 65535 is needed"),
        ({"host": 5}, "host is 5: a name is needed"),
        ({"vehicle": 5}, "vehicle is 5: a name is needed"),
        ({"headless": "yes"}, "headless is 'yes': true or false is needed"),
        ({"wall_limit": 0.0}, "wall_limit is 0.0: a positive number of seconds is needed"),
        ({"reply_limit": "abc"}, "reply_limit is 'abc': a positive number of seconds is needed"),
        ({"car_length": 4.0}, "have to be given together"),
        (
            {"car_length": -3, "car_width": 2},
            "car_length is -3: a number of m above 1 and below 30 is needed",
        ),
        ({"headless": True}, "give home, too"),
        ({"restart_every": 5}, "give home, too"),
        ({"restart_every": 0}, "restart_every is 0: a whole number of at least 1 is needed"),
        ({"home": ""}, "home is '': the name of a folder is needed"),
        ({"home": "/opt/b", "host": "10.0.0.1"}, "exclude each other"),
        ({"home": "/opt/b", "user": "/a b"}, "no folder with a space"),
    ],
)
def test_options_are_checked(options: dict[str, object], text: str) -> None:
    with pytest.raises((ValueError, BeamngError)) as raised:
        BeamngSimulator(**({"port": 25252} | options if "home" not in options else options))  # type: ignore[arg-type]
    assert text in str(raised.value)


def test_space_in_the_folder_around_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a b").mkdir()
    monkeypatch.chdir(tmp_path / "a b")
    with pytest.raises(BeamngError, match=r"a b/user': BeamNG\.tech takes no folder with a space"):
        BeamngSimulator(home="/opt/b", user="user")


@pytest.mark.parametrize(
    ("number", "is_known"), [("1.35", False), ("1.36", True), ("2.0.dev1", True)]
)
def test_beamngpy_that_is_too_old_is_told(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch, number: str, is_known: bool
) -> None:
    monkeypatch.setattr("frenetic.beamng.link.version", lambda _: number)
    if is_known:
        with connected(stand_in):
            return
    with (
        pytest.raises(BeamngError, match=rf"beamngpy {number} is too old: 1\.36 or newer"),
        connected(stand_in),
    ):
        pass


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (beamngpy.BeamNGpy, "_start_beamng"),
        (beamngpy.connection.Connection, "hello"),
        (PrefixedLengthSocket, "reconnect"),
    ],
)
def test_beamngpy_that_lacks_what_is_used_is_told(
    stand_in: StandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: type, name: str
) -> None:
    monkeypatch.delattr(owner, name)
    simulator = connected(stand_in)
    if name == "_start_beamng":
        program(tmp_path)
        simulator = BeamngSimulator(home=str(tmp_path))
    text = rf"is not as Frenetic knows it: its {owner.__name__} has no {name}: use beamngpy"
    with pytest.raises(BeamngError, match=text), simulator:
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


def test_campaign_goes_on_after_a_lost_connection(tmp_path: Path) -> None:
    with StandIn(trouble=on("Step", 400, DROP)) as server:
        summary = campaign(connected(server), tmp_path).run()
    assert summary.simulations == 3
    assert summary.errors == 0
    with CampaignStore.open(tmp_path) as store:
        assert sorted(record.attempts for record in store.tests() if record.outcome.is_driven) == [
            1,
            1,
            2,
        ]
        assert store.config["car"] == {"length": 4.508, "width": 1.61, "centre_ahead": 0.0}


def test_one_that_runs_serves_one_worker(stand_in: StandIn, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="2 workers are too many"):
        campaign(connected(stand_in), tmp_path, workers=2).run()


def test_simulator_can_be_sent_to_a_worker(stand_in: StandIn) -> None:
    with connected(stand_in) as simulator:
        copy = pickle.loads(pickle.dumps(simulator))
    assert copy.car == simulator.car
    with pytest.raises(BeamngError, match="is not started"):
        _ = copy.link


# Starting it: the stand-in as a program

linux = pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


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


def interrupted_process(simulator: BeamngSimulator) -> int:
    with suppress(KeyboardInterrupt), simulator:
        started = started_process(simulator)
        assert is_alive(started)
        raise KeyboardInterrupt
    return started


@linux
def test_it_is_started_and_ended(tmp_path: Path) -> None:
    program(tmp_path / "home")
    simulator = BeamngSimulator(home=str(tmp_path / "home"), headless=True)
    with simulator:
        started = started_process(simulator)
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
    assert not is_alive(started)
    started = interrupted_process(simulator)
    assert not is_alive(started)


@linux
def test_it_is_started_again_after_it_was_killed(tmp_path: Path) -> None:
    program(tmp_path / "home")
    simulator = BeamngSimulator(home=str(tmp_path / "home"))
    with simulator:
        os.kill(started_process(simulator), 9)
        with pytest.raises(BeamngError, match=r"connection to BeamNG\.tech was lost"):
            simulator.drive(ROAD, Stanley())
    with simulator:
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


@linux
def test_campaign_has_a_port_of_its_own(tmp_path: Path) -> None:
    program(tmp_path / "home")
    simulator = BeamngSimulator(home=str(tmp_path / "home"), port=free_port())
    summary = campaign(simulator, tmp_path / "c").run()
    assert (summary.simulations, summary.errors) == (3, 0)


@linux
@pytest.mark.parametrize("has_port", [False, True])
def test_campaign_goes_on_after_a_crash(tmp_path: Path, has_port: bool) -> None:
    program(tmp_path / "home")
    port = free_port() if has_port else None
    simulator = BeamngSimulator(home=str(tmp_path / "home"), port=port)

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
    with BeamngSimulator(
        home=str(tmp_path / "home"), port=free_port(), restart_every=2
    ) as simulator:
        for _ in range(5):
            assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS
            processes.append(started_process(simulator))
    a, b, c, d, e = processes
    assert a == b != c == d != e
    assert not any(is_alive(one) for one in processes)


@linux
def test_port_of_connections_that_have_ended_is_not_taken(tmp_path: Path) -> None:
    program(tmp_path / "home")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as client:
            served, _ = listener.accept()
            served.close()  # first, so that the port is kept on this side
            assert not client.recv(1)
    with socket.socket() as plain, pytest.raises(OSError, match="in use"):
        plain.bind(("127.0.0.1", port))
    with BeamngSimulator(home=str(tmp_path / "home"), port=port) as simulator:
        assert judge(ROAD, simulator.drive(ROAD, Stanley())).outcome is Outcome.PASS


@linux
def test_program_that_ends_at_once_is_told(tmp_path: Path) -> None:
    program(tmp_path).write_text("#!/bin/sh\nexit 3\n")
    with (
        pytest.raises(BeamngError, match=r"ended while it started, with exit code 3: start it by"),
        BeamngSimulator(home=str(tmp_path)),
    ):
        pass


@linux
def test_port_in_use_is_told_before_anything_is_started(stand_in: StandIn, tmp_path: Path) -> None:
    program(tmp_path)
    with (
        pytest.raises(BeamngError, match=f"port {stand_in.port} is taken"),
        BeamngSimulator(home=str(tmp_path), port=stand_in.port),
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
    simulator = BeamngSimulator(
        home=str(tmp_path), user=str(tmp_path / "user"), no_gpu=True, port=25999
    )
    with pytest.raises(BeamngError, match="starting it"), simulator:
        pass
    (call,) = calls
    assert call[0].endswith("BinLinux/BeamNG.tech.x64")
    assert "-tport 25999 -tcom-listen-ip 127.0.0.1 -headless -gfx null" in " ".join(call)
    assert call[-2:] == ["-userpath", str(tmp_path / "user")]


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda home: home / "nowhere", "there is no folder"),
        (lambda home: home, r"there is no program of BeamNG\.tech in .*: give the folder"),
    ],
)
def test_home_without_a_program(tmp_path: Path, make: Callable[[Path], Path], text: str) -> None:
    with pytest.raises(BeamngError, match=text), BeamngSimulator(home=str(make(tmp_path))):
        pass


class Stubborn:
    """A process that ends only when its tree is killed."""

    pid = 4711
    stdin = None

    def __init__(self) -> None:
        self.is_killed = False

    def wait(self, timeout: float) -> int:
        if not self.is_killed:
            raise subprocess.TimeoutExpired("BeamNG.tech", timeout)
        return 1


def test_windows_ends_the_whole_tree_of_beamng(monkeypatch: pytest.MonkeyPatch) -> None:
    """There a process that was started by another outlives it."""
    process = Stubborn()
    calls: list[list[str]] = []

    def run(command: list[str], **_: object) -> None:
        calls.append(command)
        process.is_killed = True

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("SYSTEMROOT", "/windows")
    end_process(process)  # type: ignore[arg-type]
    assert calls == [["/windows/System32/taskkill.exe", "/F", "/T", "/PID", "4711"]]


# Its own checks


def test_doctor_finds_nothing_wrong(stand_in: StandIn) -> None:
    examination = examine("beamng", {"port": stand_in.port})
    assert examination.health is Health.OK, examination.failed
    names = [check.name for check in examination.checks]
    assert names == [
        "package",
        "port",
        "licence",
        "level",
        "vehicle",
        "car",
        "steering sign",
        "steering lag",
        "straight road, BeamNG.AI",
        "curve, BeamNG.AI",
        "straight road, Stanley",
        "curve, Stanley",
    ]
    assert "BeamNG.tech 0.39" in examination.checks[1].found


@pytest.mark.parametrize(
    ("options", "server", "name", "text"),
    [
        ({"vehicle": "tank"}, {}, "vehicle", "choose one of etk800, pickup"),
        ({"level": "moon", "ground": 0.0}, {}, "level", "choose one of gridmap_v2"),
        ({}, {"is_licensed": False}, "licence", "put tech.key into its user folder"),
        ({}, {"protocol": "v1.22"}, "port", "install the version of beamngpy"),
        ({}, {"trouble": on("Step", 5, DROP)}, "car", "the connection to BeamNG.tech was lost"),
        ({}, {"world": World(clock_error=0.1)}, "straight road, BeamNG.AI", "does not keep 60"),
        (
            {},
            {"world": World(control_filter=0.4, takes_lua=False)},
            "steering lag",
            "through the filter of the Control message: at most 0.2 s would be fine",
        ),
        ({}, {"world": World(sign_shown=0.0)}, "steering sign", "does not report the steering"),
    ],
)
def test_doctor_says_what_is_wrong(
    options: dict[str, object], server: dict[str, object], name: str, text: str
) -> None:
    with StandIn(**server) as running:  # type: ignore[arg-type]
        examination = examine("beamng", {"port": running.port, **options})
    assert examination.health is Health.BROKEN
    first = examination.failed[0]
    assert first.name == name
    assert text in f"{first.found}; {first.remedy}"
    assert first.remedy
    assert first.remedy not in first.found


def found_by_doctor(world: World, name: str) -> str:
    with StandIn(world=world) as running:
        checks = examine("beamng", {"port": running.port}).checks
    return next(check.found for check in checks if check.name == name)


def test_steering_passes_by_the_filter_where_that_is_possible() -> None:
    """The filter of the Control message would let the car steer 0.4 s late."""
    found = found_by_doctor(World(control_filter=0.4), "steering lag")
    assert re.fullmatch(r"0\.1\d s at 54 km/h, directly", found)
    world = World(control_filter=0.4, takes_lua=False)
    slow = re.search(r"takes (0\.\d\d) s", found_by_doctor(world, "steering lag"))
    assert slow is not None
    assert 0.4 < float(slow[1]) < 0.7


def test_a_filter_is_felt_on_the_road() -> None:
    offs = []
    for takes_lua in (True, False):
        with (
            StandIn(world=World(control_filter=0.4, takes_lua=takes_lua)) as running,
            connected(running) as simulator,
        ):
            assert simulator.measured.steers_directly is takes_lua
            offs.append(judge(ROAD, simulator.drive(ROAD, Stanley())).moobd or 0.0)
    direct, filtered = offs
    assert filtered < direct - 0.05


def test_a_sign_that_differs_is_said_and_allowed_for() -> None:
    records = []
    for sign in (1.0, -1.0):
        with StandIn(world=World(sign_shown=sign)) as running, connected(running) as simulator:
            assert simulator.measured.sign_shown == sign
            records.append(simulator.drive(ROAD, Stanley()).trajectory.to_rows())
    as_told, opposite = records
    np.testing.assert_allclose(as_told, opposite, atol=1e-9)
    assert found_by_doctor(World(sign_shown=-1.0), "steering sign") == (
        "BeamNG.tech reports the opposite of what it is told; records allow for that"
    )


@linux
def test_doctor_checks_the_installation(tmp_path: Path) -> None:
    examination = examine("beamng", {"home": str(tmp_path)})
    (check,) = examination.failed
    assert check.name == "installation"
    assert check.found == f"there is no program of BeamNG.tech in {tmp_path}"
    assert check.remedy == "give the folder into which BeamNG.tech was unpacked as home"
    program(tmp_path)
    examination = examine("beamng", {"home": str(tmp_path)})
    assert examination.health is Health.OK, examination.failed
