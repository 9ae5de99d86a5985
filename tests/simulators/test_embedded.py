"""The embedded simulator beyond its contract: compiled drivers, exact views, broken drivers."""

from __future__ import annotations

import math
import re
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import pytest

from frenetic.drivers import (
    Controls,
    Delayed,
    Driver,
    DriveSetup,
    LimitedView,
    Noisy,
    Observation,
    Planner,
    Stanley,
)
from frenetic.errors import GIVES_NO_CONTROLS, HANGS, DriverError, Fault
from frenetic.oracle.assessment import assess
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Pose, Road
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Vehicle
from frenetic.simulators.embedded.single_track import axle_forces

FloatArray = npt.NDArray[np.float64]


def random_road(seed: int, n: int = 25, lane_width: float = 4.0) -> Road:
    """A walk within the curvatures of valid roads, in any pose."""
    rng = np.random.default_rng(seed)
    values: list[float] = [0.0]
    for _ in range(n):
        low, high = max(values[-1] - 0.05, -0.07), min(values[-1] + 0.05, 0.07)
        values.append(float(rng.uniform(low, high)))
    x, y = rng.uniform(-200.0, 200.0, 2)
    pose = Pose(float(x), float(y), float(rng.uniform(-7.0, 7.0)))
    return Road(np.array(values[1:]), pose=pose, lane_width=lane_width)


STRAIGHT = Road(np.zeros(26))
"""A straight road of 250 m."""
SHARP_LEFT = Road(np.array([0.0] * 16 + [0.05] + [0.07] * 8))
"""150 m straight, then the sharpest bend of a valid road."""
ROADS = [*(random_road(seed) for seed in range(4)), SHARP_LEFT, random_road(9, lane_width=5.0)]


class PythonPlanner(Planner):
    """The planner, called from Python: a subclass may do anything."""


class PythonStanley(Stanley):
    """Stanley, called from Python."""


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    """Compile the kernels first, so that compiling does not count against a wall limit."""
    for driver in (Planner(), PythonPlanner()):
        EmbeddedSimulator(wall_limit=600.0).drive(ROADS[0], driver)


def rows(drive: Drive) -> FloatArray:
    """Return the records of a drive that ended without an error."""
    assert drive.trouble is None
    return drive.trajectory.to_rows()


# Compiled and called from Python

WRAPPERS: dict[str, Callable[[Driver], Driver]] = {
    "bare": lambda driver: driver,
    "noisy": lambda driver: Noisy(driver, offset=0.2, heading=0.02, seed=1),
    "delayed": lambda driver: Delayed(driver, seconds=0.15),
    "limited": lambda driver: LimitedView(driver, distance=25.0),
    "all": lambda driver: Noisy(
        Delayed(LimitedView(driver, distance=40.0), seconds=0.1), offset=0.1, seed=2
    ),
}


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize(
    ("built_in", "python"),
    [(Planner(aggression=1.3), PythonPlanner(aggression=1.3)), (Stanley(), PythonStanley())],
    ids=["planner", "stanley"],
)
def test_compiled_and_python_drivers_drive_alike_bit_for_bit(
    built_in: Driver, python: Driver, wrapper: str
) -> None:
    for simulator in (EmbeddedSimulator(), EmbeddedSimulator(start_offset=-0.6, start_heading=0.1)):
        for road in ROADS:
            compiled = rows(simulator.drive(road, WRAPPERS[wrapper](built_in)))
            stepped = rows(simulator.drive(road, WRAPPERS[wrapper](python)))
            np.testing.assert_array_equal(compiled, stepped)
            assert len(compiled) > 40


def test_wrappers_and_drivers_make_a_difference() -> None:
    """Otherwise the test above would compare equal drives."""
    simulator = EmbeddedSimulator()
    drivers = [*(wrapper(Planner()) for wrapper in WRAPPERS.values()), Stanley()]
    ends = [rows(simulator.drive(ROADS[0], driver))[-1, 1:4] for driver in drivers]
    assert len({tuple(end) for end in ends}) == len(drivers)


def test_a_later_drive_does_not_change_the_records_of_an_earlier_drive() -> None:
    simulator = EmbeddedSimulator()
    first = simulator.drive(ROADS[0], Planner())
    before = rows(first).copy()
    simulator.drive(ROADS[1], Planner())
    np.testing.assert_array_equal(rows(first), before)


def test_a_moved_and_turned_road_is_driven_the_same_way() -> None:
    here = Road(random_road(1).curvatures)
    there = replace(here, pose=Pose(70.0, -40.0, 2.5))
    simulator = EmbeddedSimulator()
    drive_here, drive_there = (
        simulator.drive(road, Planner()).trajectory for road in (here, there)
    )
    assert len(drive_here) == len(drive_there)
    angle = 2.5 - math.pi / 2
    c, s = math.cos(angle), math.sin(angle)
    np.testing.assert_allclose(
        drive_there.x, 70.0 + c * drive_here.x - s * drive_here.y, rtol=0, atol=1e-5
    )
    np.testing.assert_allclose(
        drive_there.y, -40.0 + s * drive_here.x + c * drive_here.y, rtol=0, atol=1e-5
    )
    np.testing.assert_allclose(drive_there.speed, drive_here.speed, rtol=0, atol=1e-5)


def test_a_drive_ends_at_the_record_at_which_the_oracle_ends_it() -> None:
    simulator = EmbeddedSimulator(rules=Rules(oob_tolerance=0.3))
    outcomes = set()
    for seed in range(20):
        road = random_road(seed)
        drive = simulator.drive(road, Planner(aggression=0.4 if seed % 2 else 3.0))
        result = judge(road, drive)
        outcomes.add(result.outcome)
        assert result.duration == drive.trajectory.time[-1]
        assert len(assess(road, drive).distance) == len(drive.trajectory)
    assert outcomes == {Outcome.PASS, Outcome.FAIL}


# What a driver sees


class Watching(PythonStanley):
    """A driver that records its setup and its observations."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.setup, self.observations = setup, list[Observation]()

    def act(self, observation: Observation) -> Controls:
        self.observations.append(observation)
        return super().act(observation)


@pytest.mark.parametrize("road", ROADS[2:])
def test_observations_agree_with_the_road_and_the_trajectory(road: Road) -> None:
    watching = Watching(offset_gain=0.5)
    t = EmbeddedSimulator().drive(road, watching).trajectory
    half = 0.5 * road.lane_width
    assert len(watching.observations) == len(t) - 1
    tracked = road.track(np.column_stack([t.x, t.y]))
    for i, observation in enumerate(watching.observations):
        s, d = (float(v) for v in tracked[i])
        assert observation.time == t.time[i]
        motion = (t.speed[i], t.lateral_speed[i], t.yaw_rate[i], t.steering[i])
        assert (
            observation.speed,
            observation.lateral_speed,
            observation.yaw_rate,
            observation.steering,
        ) == motion
        assert (observation.x, observation.y, observation.heading) == (t.x[i], t.y[i], t.heading[i])
        assert observation.lateral_offset == pytest.approx(d + half, abs=1e-7)
        error = (t.heading[i] - road.pose_at(s).heading + math.pi) % (2.0 * math.pi) - math.pi
        assert observation.heading_error == pytest.approx(error, abs=1e-7)
        # The view: the lane's centre every 2 m of road, straight beyond the road's end.
        assert observation.ahead.shape == (40, 2)
        c, n = math.cos(t.heading[i]), math.sin(t.heading[i])
        world = [t.x[i], t.y[i]] + observation.ahead @ np.array([[c, n], [-n, c]])
        at = s + 2.0 * np.arange(40)
        poses = np.array([road.pose_at(float(place)) for place in at])
        left = np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
        along = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        miss = world - (poses[:, :2] - half * left)
        assert np.abs((miss * left).sum(axis=1)).max() < 2e-3
        assert np.abs((miss * along).sum(axis=1)).max() < 2e-3
        kappa = road.curvature_at(at)
        # A lane to the right of a road that turns left turns about the same centre, further out.
        # At the road's very ends, where its curvature jumps to 0, rounding decides.
        decided = (np.abs(at) > 1e-6) & (np.abs(at - road.length) > 1e-6)
        bent = decided & (kappa != 0.0)
        radius = 1.0 / kappa[bent] + half
        np.testing.assert_allclose(
            observation.curvature_ahead[bent], 1.0 / radius, rtol=0, atol=1e-9
        )
        np.testing.assert_array_equal(observation.curvature_ahead[decided & ~bent], 0.0)
        for array in (observation.ahead, observation.curvature_ahead):
            assert not array.flags.writeable


def test_a_driver_is_told_the_car_the_lane_and_the_limits() -> None:
    vehicle, watching = Vehicle(), Watching()
    EmbeddedSimulator(rules=Rules(speed_limit=36.0)).drive(ROADS[-1], watching)
    assert watching.setup == DriveSetup(
        speed_limit=10.0,
        lane_width=5.0,
        period=0.05,
        front_axle=vehicle.front_axle,
        rear_axle=vehicle.rear_axle,
        car_length=vehicle.length,
        car_width=vehicle.width,
        max_steering=vehicle.steering_limit,
        max_acceleration=vehicle.engine_acceleration,
        max_deceleration=vehicle.brake_deceleration,
        switch_speed=15.0,
        rolling_drag=0.012 * 9.81,
        air_drag=0.5 * 1.2 * 0.65 / vehicle.mass,
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        front_cornering_stiffness=watching.setup.front_cornering_stiffness,  # see below
        rear_cornering_stiffness=watching.setup.rear_cornering_stiffness,
        steering_rate=vehicle.steering_rate,
        steering_lag=vehicle.steering_lag,
    )


@pytest.mark.parametrize("name", ["default", "etk800", "metadrive"])
def test_the_setup_has_the_tyres_cornering_stiffness_at_small_slip(name: str) -> None:
    simulator = EmbeddedSimulator(vehicle=name)
    setup, p = simulator.setup(STRAIGHT), simulator.vehicle.to_array()
    slip = 1e-4
    _, front, _, _, rear, _ = axle_forces(20.0, -20.0 * slip, 0.0, 1.0, 0.0, 0.0, 0.0, p)
    assert setup.front_cornering_stiffness == pytest.approx(front / slip, rel=1e-4)
    assert setup.rear_cornering_stiffness == pytest.approx(rear / slip, rel=1e-4)


class Accelerating:
    """A driver that asks for another acceleration every 1.5 s."""

    # m/s^2
    ACCELERATIONS = (1.0, 3.0, 5.0, 0.5, -2.0, 4.5, -0.05, 2.0, -5.0, 5.0, 0.0, 1.5, -7.0, 3.0, 1.0)

    def reset(self, setup: DriveSetup) -> None:
        self.setup, self.wanted = setup, list[float]()

    def act(self, observation: Observation) -> Controls:
        wanted = self.ACCELERATIONS[int(observation.time / 1.5) % len(self.ACCELERATIONS)]
        self.wanted.append(wanted)
        return Controls.from_acceleration(wanted, 0.0, speed=observation.speed, setup=self.setup)


@pytest.mark.parametrize("vehicle", ["default", "etk800", "metadrive"])
def test_the_car_reaches_a_wanted_acceleration_within_its_limits(vehicle: str) -> None:
    driver, road = Accelerating(), Road([0.0] * 121)
    t = EmbeddedSimulator(vehicle=vehicle).drive(road, driver).trajectory
    reached, wanted, speed = np.diff(t.speed) / 0.05, np.array(driver.wanted), t.speed[:-1]
    pedal = np.maximum(t.throttle, t.brake)[:-1]
    # The tyres of MetaDrive's car leave half of their grip to cornering, see `CARS`.
    is_limited = (wanted < 2.1) & (wanted > -4.4) if vehicle == "metadrive" else pedal < 1.0
    fair = is_limited & (pedal < 1.0) & (speed > 0.5)
    np.testing.assert_allclose(reached[fair], wanted[fair], rtol=0.02, atol=0.02)
    assert np.ptp(speed[fair]) > 20.0
    assert fair.mean() > 0.5
    assert np.all(reached[(pedal == 1.0) & (speed > 0.5)] < 5.0)


def test_a_wanted_acceleration_becomes_pedals_from_0_to_1() -> None:
    setup = EmbeddedSimulator().setup(STRAIGHT)
    assert Controls.from_acceleration(0.0, 0.1, speed=0.0, setup=setup) == Controls(0.1)
    full_throttle = Controls.from_acceleration(99.0, 0.0, speed=30.0, setup=setup)
    assert (full_throttle.throttle, full_throttle.brake) == (1.0, 0.0)
    full_brake = Controls.from_acceleration(-99.0, 0.0, speed=30.0, setup=setup)
    assert (full_brake.throttle, full_brake.brake) == (0.0, 1.0)


# Driving


@pytest.mark.parametrize("driver", [Planner(), Stanley()])
@pytest.mark.parametrize("speed_limit", [30.0, 70.0])
def test_a_straight_road_is_driven_in_the_middle_at_the_limit(
    driver: Driver, speed_limit: float
) -> None:
    drive = EmbeddedSimulator(rules=Rules(speed_limit=speed_limit)).drive(STRAIGHT, driver)
    result = judge(STRAIGHT, drive)
    assert result.outcome is Outcome.PASS
    assert result.moobd == pytest.approx(2.0, abs=1e-6)
    assert drive.trajectory.speed.max() <= speed_limit / 3.6 + 0.1
    assert drive.trajectory.speed[-1] == pytest.approx(speed_limit / 3.6, abs=0.5)


@pytest.mark.parametrize("driver", [Planner, Stanley])
@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_a_far_too_fast_driver_leaves_a_sharp_bend_to_the_outside(
    driver: Callable[..., Driver], side: str, sign: float
) -> None:
    road = Road(sign * SHARP_LEFT.curvatures)
    simulator = EmbeddedSimulator(rules=Rules(speed_limit=130.0))
    result = judge(road, simulator.drive(road, driver(aggression=50.0)))
    assert result.outcome is Outcome.FAIL
    assert result.departure is not None
    assert result.departure.side == side
    assert 150.0 < result.departure.distance < 220.0
    calm = judge(road, simulator.drive(road, driver(aggression=0.3)))
    assert calm.outcome is Outcome.PASS


# Drivers that break


class BreaksLater:
    """A driver that drives off, and calls `then` from its third call on."""

    def __init__(self, then: Callable[[], Any]) -> None:
        self.then = then

    def reset(self, setup: DriveSetup) -> None:
        self.calls = 0

    def act(self, observation: Observation) -> Controls:
        self.calls += 1
        if self.calls < 3:
            return Controls(0.0, 0.5)
        answer: Controls = self.then()
        return answer


class Writing(PythonPlanner):
    """A driver that changes its view, which is read-only."""

    def act(self, observation: Observation) -> Controls:
        observation.ahead[0] = 0.0
        return super().act(observation)


class Unready(PythonPlanner):
    """A driver that raises before its drive."""

    def reset(self, setup: DriveSetup) -> None:
        raise OSError("no connection")


class EndlessInReset(PythonPlanner):
    def reset(self, setup: DriveSetup) -> None:
        spin()


class UnspeakableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")


def fail(error: BaseException) -> Callable[[], NoReturn]:
    def raise_it() -> NoReturn:
        raise error

    return raise_it


def recurse() -> NoReturn:
    recurse()
    raise AssertionError


def spin() -> NoReturn:
    while True:
        pass


def spin_stubbornly() -> NoReturn:
    while True:
        with suppress(Exception):
            spin()


def assert_clean(simulator: EmbeddedSimulator) -> None:
    """Assert that a broken driver changes no later drive and leaves no timer running."""
    expected = rows(EmbeddedSimulator().drive(ROADS[0], Planner()))
    np.testing.assert_array_equal(rows(simulator.drive(ROADS[0], Planner())), expected)
    np.testing.assert_array_equal(rows(simulator.drive(ROADS[0], PythonPlanner())), expected)
    if hasattr(signal, "getitimer"):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


RAISED = rf" \({Path(__file__).name}:{fail.__code__.co_firstlineno + 2}: raise error\)"
"""Pattern of the place where `fail` raises, at the end of a message."""
BROKEN: dict[str, tuple[Any, str, int]] = {
    # Driver, pattern of its error, records until then.
    "raises": (
        BreaksLater(fail(ValueError("no\n such  lane"))),
        f"ValueError: no such lane{RAISED}",
        3,
    ),
    "key": (BreaksLater(fail(KeyError("lane"))), f"KeyError: 'lane'{RAISED}", 3),
    "exits": (BreaksLater(fail(SystemExit(3))), f"SystemExit: 3{RAISED}", 3),
    "unspeakable": (BreaksLater(fail(UnspeakableError())), "UnspeakableError.*", 3),
    "long": (BreaksLater(fail(ValueError("x" * 100_000))), "ValueError: xxx.{,460}", 3),
    "recurses": (BreaksLater(recurse), "RecursionError: .*", 3),
    "writes": (Writing(), r"ValueError: assignment destination is read-only.*", 1),
    "reset": (Unready(), r'OSError: no connection .*: raise OSError\("no connection"\)\)', 0),
    "no driver": (object(), "AttributeError: .*", 0),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_driver_fails_only_its_own_drive(kind: str) -> None:
    driver, text, records = BROKEN[kind]
    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, driver)
    assert drive.trouble is not None
    assert re.fullmatch(f"the driver raised {text}", drive.trouble.reason), drive.trouble.reason
    assert len(drive.trajectory) == records
    result = judge(STRAIGHT, drive)
    assert (result.outcome, result.reason) == (Outcome.FAIL, drive.trouble.reason)
    assert result.fault is not None
    assert (result.fault.part, result.fault.kind) == ("driver", text.split(":")[0].rstrip(".*"))
    assert_clean(simulator)


def test_an_error_or_a_wrong_answer_is_the_fault_of_the_driver() -> None:
    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, BreaksLater(fail(DriverError("no model was found"))))
    assert drive.trouble is not None
    assert drive.trouble.reason == "no model was found"
    fault = judge(STRAIGHT, drive).fault
    assert fault is not None
    assert str(fault).startswith(f"raises DriverError at {Path(__file__).name}:")
    drive = simulator.drive(STRAIGHT, BreaksLater(lambda: None))
    assert drive.trouble is not None
    assert drive.trouble.reason == "the driver returned NoneType instead of frenetic.Controls"
    assert judge(STRAIGHT, drive).fault == Fault("driver", GIVES_NO_CONTROLS)


@pytest.mark.parametrize("where", ["main thread", "another thread"])
@pytest.mark.parametrize("then", [spin, spin_stubbornly])
def test_a_driver_that_loops_forever_is_ended(then: Callable[[], NoReturn], where: str) -> None:
    simulator = EmbeddedSimulator(wall_limit=0.3)
    drives: list[Drive] = []

    def drive() -> None:
        drives.append(simulator.drive(STRAIGHT, BreaksLater(then)))
        # The same thread may go on driving.
        drives.append(EmbeddedSimulator().drive(ROADS[0], PythonPlanner()))

    if where == "main thread":
        drive()
    else:
        thread = threading.Thread(target=drive, daemon=True)
        thread.start()
        thread.join(60.0)
        assert not thread.is_alive()
    broken, following = drives
    assert broken.trouble is not None
    assert broken.trouble.reason.startswith(
        "the driver did not finish its drive within 0.3 s of wall time (it had driven 0."
    )
    result = judge(STRAIGHT, broken)
    assert (result.outcome, result.fault) == (Outcome.FAIL, Fault("driver", HANGS))
    assert following.trouble is None
    assert_clean(EmbeddedSimulator())


def test_a_driver_that_loops_forever_in_reset_is_ended() -> None:
    drive = EmbeddedSimulator(wall_limit=0.3).drive(STRAIGHT, EndlessInReset())
    assert drive.trouble is not None
    assert "within 0.3 s of wall time (it had driven 0.0 s, and was at " in drive.trouble.reason
    assert re.search(
        rf" at {Path(__file__).name}:[0-9]+: (while True:|pass)\)$", drive.trouble.reason
    )
    assert "in spin\n" in drive.trouble.traceback
    assert len(drive.trajectory) == 0


def test_the_wall_limit_does_not_apply_to_built_in_drivers() -> None:
    drive = EmbeddedSimulator(wall_limit=1e-9).drive(STRAIGHT, Planner())
    assert judge(STRAIGHT, drive).outcome is Outcome.PASS


def test_an_interrupt_by_the_user_is_not_the_drivers_error() -> None:
    simulator = EmbeddedSimulator()
    with pytest.raises(KeyboardInterrupt):
        simulator.drive(STRAIGHT, BreaksLater(fail(KeyboardInterrupt())))
    assert_clean(simulator)


# Where the car starts, and what may be set between two drives


@pytest.mark.parametrize(("offset", "heading"), [(0.0, 0.0), (-1.5, 0.2)])
def test_a_car_starts_at_the_offset_and_heading_of_the_options(
    offset: float, heading: float
) -> None:
    simulator = EmbeddedSimulator(start_offset=offset, start_heading=heading)
    for road in ROADS:
        start = simulator.drive(road, Planner()).trajectory
        ((s, d),) = road.track([[start.x[0], start.y[0]]])
        assert s == pytest.approx(0.0, abs=1e-9)
        assert d == pytest.approx(offset - 0.5 * road.lane_width, abs=1e-9)
        assert start.heading[0] == pytest.approx(road.pose.heading + heading, abs=1e-12)
        assert start.speed[0] == 0.0


def test_a_car_starts_at_the_speed_of_the_option_along_itself() -> None:
    simulator = EmbeddedSimulator(start_speed=54.0, start_heading=0.1)
    for driver in (Planner(), PythonPlanner()):
        start = simulator.drive(ROADS[0], driver).trajectory
        assert start.speed[0] == pytest.approx(15.0)
        assert (start.lateral_speed[0], start.yaw_rate[0]) == (0.0, 0.0)
        moved = math.dist((start.x[0], start.y[0]), (start.x[1], start.y[1]))
        assert moved == pytest.approx(15.0 * 0.05, rel=0.05)


def test_options_list_the_start_only_if_it_is_not_the_default() -> None:
    assert set(EmbeddedSimulator().options) == {"vehicle", "wall_limit"}
    assert EmbeddedSimulator(start_offset=0.5).options["start_offset"] == 0.5
    assert EmbeddedSimulator(start_heading=0.1).options["start_heading"] == 0.1
    assert EmbeddedSimulator(start_speed=30.0).options["start_speed"] == 30.0


def test_attributes_set_between_two_drives_hold_for_the_next() -> None:
    simulator = EmbeddedSimulator()
    first = rows(simulator.drive(ROADS[0], Planner()))
    simulator.friction, simulator.start_offset, simulator.start_heading = 0.5, 0.3, 0.05
    fresh = EmbeddedSimulator(friction=0.5, start_offset=0.3, start_heading=0.05)
    assert simulator.vehicle == fresh.vehicle
    assert np.array_equal(
        rows(simulator.drive(ROADS[0], Planner())), rows(fresh.drive(ROADS[0], Planner()))
    )
    simulator.vehicle, simulator.start_offset, simulator.start_heading = Vehicle(), 0.0, 0.0
    assert np.array_equal(rows(simulator.drive(ROADS[0], Planner())), first)
    simulator.vehicle = Vehicle(length=5.0)
    assert simulator.drive(ROADS[0], Planner()).car.length == 5.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wall_limit": 0.0}, "wall_limit is 0.0: a number > 0 is needed"),
        ({"wall_limit": math.nan}, "wall_limit is nan: a number > 0 is needed"),
        ({"start_offset": 2.1}, "start_offset is 2.1: -2 to 2 m is needed"),
        ({"start_offset": math.nan}, "start_offset is nan"),
        ({"start_speed": -1.0}, "start_speed is -1.0: 0 to 500 km/h is needed"),
        ({"start_heading": -1.0}, "start_heading is -1.0: -0.785 to 0.785 rad"),
        ({"friction": 0.0}, "friction is 0.0: a number > 0 is needed"),
        ({"vehicle": "truck"}, "vehicle is 'truck'"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EmbeddedSimulator(**options)
