from __future__ import annotations

import math
import re
import signal
import threading
import time
from collections.abc import Callable
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
from frenetic.errors import DriverError
from frenetic.oracle import assess, judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Simulator, Vehicle

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
"""250 m."""
SHARP_LEFT = Road(np.array([0.0] * 16 + [0.05] + [0.07] * 8))
"""150 m straight, then the sharpest bend of a valid road."""
SHARP_RIGHT = Road(-SHARP_LEFT.curvatures)
ROADS = [*(random_road(seed) for seed in range(8)), SHARP_LEFT, random_road(9, lane_width=5.0)]


class PythonPlanner(Planner):
    """The planner, called from Python: a subclass may do anything."""


class PythonStanley(Stanley):
    """Stanley, called from Python."""


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    """Compiles what is compiled, so that no wall limit is spent on it."""
    for driver in (Planner(), PythonPlanner()):
        EmbeddedSimulator(wall_limit=600.0).drive(ROADS[0], driver)


def rows(drive: Drive) -> FloatArray:
    assert drive.error is None
    return drive.trajectory.to_rows()


class Watching:
    """Remembers every observation and answer of the driver underneath."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver
        self.setups: list[DriveSetup] = []
        self.seen: list[Observation] = []
        self.answers: list[Controls] = []

    def reset(self, setup: DriveSetup) -> None:
        self.setups.append(setup)
        self.seen, self.answers = [], []
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        self.seen.append(observation)
        self.answers.append(self.driver.act(observation))
        return self.answers[-1]


class Doing:
    """A driver that does the same at every call, from the third on something else."""

    def __init__(self, then: Callable[[], Any], controls: Controls | None = None) -> None:
        self.then = then
        self.controls = controls or Controls(0.0, 0.5)
        self.calls = 0

    def reset(self, setup: DriveSetup) -> None:
        self.calls = 0

    def act(self, observation: Observation) -> Controls:
        self.calls += 1
        if self.calls < 3:
            return self.controls
        answer: Controls = self.then()
        return answer


# --- Compiled and called from Python -------------------------------------------------------------


LAYERS: dict[str, Callable[[Driver], Driver]] = {
    "bare": lambda driver: driver,
    "noisy": lambda driver: Noisy(driver, offset=0.2, heading=0.02, seed=1),
    "delayed": lambda driver: Delayed(driver, seconds=0.15),
    "limited": lambda driver: LimitedView(driver, distance=25.0),
    "all": lambda driver: Noisy(
        Delayed(LimitedView(driver, distance=40.0), seconds=0.1), offset=0.1, seed=2
    ),
    "all, the other way round": lambda driver: LimitedView(
        Delayed(Noisy(driver, offset=0.1, seed=2), seconds=0.1), distance=40.0
    ),
}


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize(
    ("built_in", "python"),
    [
        (Planner(), PythonPlanner()),
        (Stanley(), PythonStanley()),
        (Planner(aggression=1.6), PythonPlanner(aggression=1.6)),
    ],
    ids=["planner", "stanley", "bold"],
)
def test_a_driver_drives_alike_bit_for_bit_compiled_or_called_from_python(
    built_in: Driver, python: Driver, layer: str
) -> None:
    simulator = EmbeddedSimulator()
    for road in ROADS:
        compiled = rows(simulator.drive(road, LAYERS[layer](built_in)))
        stepped = rows(simulator.drive(road, LAYERS[layer](python)))
        np.testing.assert_array_equal(compiled, stepped)
        assert len(compiled) > 40


def test_layers_in_any_order_drive_alike() -> None:
    simulator = EmbeddedSimulator()
    for road in ROADS[:4]:
        one = simulator.drive(road, LAYERS["all"](Planner()))
        other = simulator.drive(road, LAYERS["all, the other way round"](Planner()))
        np.testing.assert_array_equal(rows(one), rows(other))


def test_layers_and_drivers_make_a_difference() -> None:
    """Else the tests above would hold nothing against nothing."""
    simulator = EmbeddedSimulator()
    drivers = [*(layer(Planner()) for layer in list(LAYERS.values())[:5]), Stanley()]
    ends = [rows(simulator.drive(ROADS[0], driver))[-1, 1:4] for driver in drivers]
    assert len({tuple(end) for end in ends}) == len(drivers)


@pytest.mark.parametrize("driver", [Planner(), Stanley(), PythonPlanner(), Noisy(Planner())])
def test_the_same_drive_twice_is_identical(driver: Driver) -> None:
    simulator = EmbeddedSimulator()
    first = simulator.drive(ROADS[0], driver)
    before = rows(first).copy()
    simulator.drive(ROADS[1], driver)
    np.testing.assert_array_equal(rows(simulator.drive(ROADS[0], driver)), before)
    np.testing.assert_array_equal(rows(EmbeddedSimulator().drive(ROADS[0], driver)), before)
    # A drive keeps its records when the simulator goes on.
    np.testing.assert_array_equal(rows(first), before)


@pytest.mark.parametrize("driver", [Planner(), Stanley()])
@pytest.mark.parametrize("seed", range(4))
def test_a_moved_and_turned_road_is_driven_the_same_way(driver: Driver, seed: int) -> None:
    here = Road(random_road(seed).curvatures)
    there = replace(here, pose=Pose(70.0, -40.0, 2.5))
    simulator = EmbeddedSimulator()
    one, other = simulator.drive(here, driver), simulator.drive(there, driver)
    assert len(one.trajectory) == len(other.trajectory)
    angle = 2.5 - math.pi / 2
    c, s = math.cos(angle), math.sin(angle)
    x = 70.0 + c * one.trajectory.x - s * one.trajectory.y
    y = -40.0 + s * one.trajectory.x + c * one.trajectory.y
    np.testing.assert_allclose(other.trajectory.x, x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(other.trajectory.y, y, rtol=0, atol=1e-5)
    np.testing.assert_allclose(other.trajectory.speed, one.trajectory.speed, rtol=0, atol=1e-5)


# --- Start, rate and what is handed on -----------------------------------------------------------


@pytest.mark.parametrize("road", [ROADS[2], ROADS[9]], ids=["4-m-lanes", "5-m-lanes"])
@pytest.mark.parametrize("driver", [Planner(), PythonPlanner()], ids=["compiled", "python"])
def test_the_car_starts_at_rest_on_the_ego_lanes_centre_along_the_road(
    road: Road, driver: Driver
) -> None:
    t = EmbeddedSimulator().drive(road, driver).trajectory
    start = road.sample(2.0, -0.5 * road.lane_width)[0]
    assert (t.x[0], t.y[0]) == pytest.approx(tuple(start), abs=1e-9)
    assert t.heading[0] == pytest.approx(road.pose.heading)
    for column in (t.time, t.speed, t.lateral_speed, t.yaw_rate, t.steering):
        assert column[0] == 0.0


@pytest.mark.parametrize("driver", [Planner(), PythonPlanner()], ids=["compiled", "python"])
def test_records_come_20_times_a_second(driver: Driver) -> None:
    t = EmbeddedSimulator().drive(ROADS[0], driver).trajectory
    np.testing.assert_allclose(t.time, np.arange(len(t)) / 20.0, rtol=0, atol=1e-9)
    # The positions are where the speeds lead to.
    along = np.hypot(np.diff(t.x), np.diff(t.y))
    speed = np.hypot(t.speed, t.lateral_speed)
    np.testing.assert_allclose(along, 0.05 * 0.5 * (speed[1:] + speed[:-1]), rtol=0, atol=5e-3)
    assert np.abs(np.diff(t.heading)).max() < 0.2  # unwrapped


@pytest.mark.parametrize("driver", [Planner(), PythonPlanner()], ids=["compiled", "python"])
def test_a_drive_hands_on_its_rules_and_car(driver: Driver) -> None:
    rules = Rules(speed_limit=40.0, oob_tolerance=0.4)
    vehicle = Vehicle(length=5.0, width=1.9)
    drive = EmbeddedSimulator(rules=rules, vehicle=vehicle).drive(ROADS[0], driver)
    assert drive.rules == rules
    assert drive.car == vehicle.body()
    assert drive.error is None


def test_the_simulator_is_a_simulator_and_a_context_manager() -> None:
    simulator = EmbeddedSimulator()
    assert isinstance(simulator, Simulator)
    assert simulator.rules == Rules()
    with simulator as entered:
        assert entered is simulator
        assert entered.drive(STRAIGHT, Planner()).error is None


@pytest.mark.parametrize("wall_limit", [0.0, -1.0, math.nan, math.inf])
def test_a_wall_limit_is_a_positive_number_of_seconds(wall_limit: float) -> None:
    with pytest.raises(ValueError, match=f"wall_limit is {wall_limit}: a positive number"):
        EmbeddedSimulator(wall_limit=wall_limit)


def test_a_drive_ends_with_the_record_that_the_oracle_ends_it_with() -> None:
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


# --- What a driver sees --------------------------------------------------------------------------


@pytest.mark.parametrize("driver", [Planner(), Stanley(offset_gain=0.5)])
@pytest.mark.parametrize("road", ROADS)
def test_observations_are_what_the_road_and_the_trajectory_say(road: Road, driver: Driver) -> None:
    watching = Watching(driver)
    t = EmbeddedSimulator().drive(road, watching).trajectory
    half = 0.5 * road.lane_width
    assert len(watching.seen) == len(t) - 1
    tracked = road.track(np.column_stack([t.x, t.y]))
    for i, seen in enumerate(watching.seen):
        s, d = (float(v) for v in tracked[i])
        assert seen.time == t.time[i]
        assert (seen.speed, seen.yaw_rate, seen.steering) == (
            t.speed[i],
            t.yaw_rate[i],
            t.steering[i],
        )
        assert seen.lateral_offset == pytest.approx(d + half, abs=1e-7)
        error = (t.heading[i] - road.pose_at(s).heading + math.pi) % (2.0 * math.pi) - math.pi
        assert seen.heading_error == pytest.approx(error, abs=1e-7)
        # The view: the lane's centre every 2 m of road, straight beyond the road's end.
        assert seen.ahead.shape == (40, 2)
        c, n = math.cos(t.heading[i]), math.sin(t.heading[i])
        world = [t.x[i], t.y[i]] + seen.ahead @ np.array([[c, n], [-n, c]])
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
        np.testing.assert_allclose(seen.curvature_ahead[bent], 1.0 / radius, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(seen.curvature_ahead[decided & ~bent], 0.0)
        for array in (seen.ahead, seen.curvature_ahead):
            assert not array.flags.writeable


def test_the_first_point_of_the_view_is_abreast_of_the_car() -> None:
    watching = Watching(Noisy(Stanley(), offset=0.5))
    EmbeddedSimulator().drive(STRAIGHT, watching)
    offsets = np.array([seen.lateral_offset for seen in watching.seen])
    errors = np.array([seen.heading_error for seen in watching.seen])
    assert np.abs(offsets).max() > 0.1
    first = np.array([seen.ahead[0] for seen in watching.seen])
    expected = -offsets[:, None] * np.column_stack([np.sin(errors), np.cos(errors)])
    np.testing.assert_allclose(first, expected, rtol=0, atol=1e-9)


def test_earlier_observations_stay_as_they_were() -> None:
    class Comparing(Watching):
        def act(self, observation: Observation) -> Controls:
            copies.append(observation.ahead.copy())
            return super().act(observation)

    copies: list[FloatArray] = []
    watching = Comparing(Planner())
    EmbeddedSimulator().drive(ROADS[0], watching)
    for seen, copy in zip(watching.seen, copies, strict=True):
        np.testing.assert_array_equal(seen.ahead, copy)


def test_a_driver_is_told_the_car_the_lane_and_the_limits_before_every_drive() -> None:
    vehicle = Vehicle()
    watching = Watching(Planner())
    simulator = EmbeddedSimulator(rules=Rules(speed_limit=36.0))
    road = random_road(9, lane_width=5.0)
    for _ in range(2):
        simulator.drive(road, watching)
    expected = DriveSetup(
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
    )
    assert watching.setups == [expected, expected]


def test_records_hold_the_controls_that_the_driver_chose() -> None:
    watching = Watching(Planner())
    t = EmbeddedSimulator().drive(ROADS[0], watching).trajectory
    answers = watching.answers
    np.testing.assert_array_equal(t.steering_input[:-1], [each.steering for each in answers])
    np.testing.assert_array_equal(t.throttle[:-1], [each.throttle for each in answers])
    np.testing.assert_array_equal(t.brake[:-1], [each.brake for each in answers])
    wild = Watching(Doing(lambda: Controls(0.0, 7.0, -3.0), Controls(0.0, 7.0, -3.0)))
    t = EmbeddedSimulator().drive(STRAIGHT, wild).trajectory
    assert (t.throttle.max(), t.brake.max(), t.brake.min()) == (1.0, 0.0, 0.0)


# --- Driving -------------------------------------------------------------------------------------


@pytest.mark.parametrize("driver", [Planner(), Stanley(), PythonStanley()])
@pytest.mark.parametrize("speed_limit", [30.0, 70.0, 120.0])
def test_a_straight_road_is_driven_in_the_middle_at_the_limit(
    driver: Driver, speed_limit: float
) -> None:
    drive = EmbeddedSimulator(rules=Rules(speed_limit=speed_limit)).drive(STRAIGHT, driver)
    result = judge(STRAIGHT, drive)
    assert result.outcome is Outcome.PASS
    assert result.moobd == pytest.approx(2.0, abs=1e-6)
    t = drive.trajectory
    assert t.speed.max() <= speed_limit / 3.6 + 0.1
    if speed_limit < 100.0:
        assert t.speed[-1] == pytest.approx(speed_limit / 3.6, abs=0.5)
    np.testing.assert_allclose(t.steering, 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("driver", [Planner(), Stanley()])
def test_sensible_drivers_pass_gentle_roads_within_the_limit(driver: Driver) -> None:
    simulator = EmbeddedSimulator()
    for seed in range(10):
        road = Road(0.25 * random_road(seed).curvatures)
        drive = simulator.drive(road, driver)
        result = judge(road, drive)
        assert result.outcome is Outcome.PASS
        assert result.moobd is not None
        assert result.moobd > 1.0
        assert drive.trajectory.speed.max() <= 70.0 / 3.6 + 0.1


@pytest.mark.parametrize(
    ("road", "outside"), [(SHARP_LEFT, "right"), (SHARP_RIGHT, "left")], ids=["left", "right"]
)
@pytest.mark.parametrize("driver", [Planner, Stanley, PythonPlanner])
def test_a_far_too_fast_driver_leaves_a_sharp_bend_to_the_outside(
    road: Road, outside: str, driver: Callable[..., Driver]
) -> None:
    simulator = EmbeddedSimulator(rules=Rules(speed_limit=130.0))
    result = judge(road, simulator.drive(road, driver(aggression=50.0)))
    assert result.outcome is Outcome.FAIL
    assert result.departure is not None
    assert result.departure.side == outside
    assert 150.0 < result.departure.distance < 220.0
    calm = judge(road, simulator.drive(road, driver(aggression=0.3)))
    assert calm.outcome is Outcome.PASS


def test_the_tolerance_ends_a_drive_sooner_and_changes_nothing_before() -> None:
    durations: list[float] = []
    paths: list[FloatArray] = []
    for tolerance in (0.1, 0.5, 0.95):
        simulator = EmbeddedSimulator(rules=Rules(oob_tolerance=tolerance, speed_limit=130.0))
        drive = simulator.drive(SHARP_LEFT, Planner(aggression=50.0))
        durations.append(judge(SHARP_LEFT, drive).duration or 0.0)
        paths.append(rows(drive))
    for one, more in ((0, 1), (1, 2)):
        assert 0.0 < durations[one] < durations[more]
        # The last record has no controls any more.
        np.testing.assert_array_equal(paths[one][:-1], paths[more][: len(paths[one]) - 1])
        np.testing.assert_array_equal(paths[one][-1, :8], paths[more][len(paths[one]) - 1, :8])


def test_a_driver_that_never_starts_is_stuck_and_a_slow_one_times_out() -> None:
    simulator = EmbeddedSimulator()
    still = judge(STRAIGHT, simulator.drive(STRAIGHT, Doing(lambda: Controls(0.0), Controls(0.0))))
    assert still.outcome is Outcome.FAIL
    assert still.reason.startswith("Car moved less than 1 m in 10 s")
    assert still.duration == pytest.approx(10.0)
    slow = EmbeddedSimulator(rules=Rules(speed_limit=3.6))
    result = judge(STRAIGHT, slow.drive(STRAIGHT, Planner()))
    assert result.reason.startswith("Car took longer than 120 s")
    assert result.duration == pytest.approx(120.0, abs=0.06)


def test_a_wet_road_is_harder() -> None:
    dry, wet = EmbeddedSimulator(), EmbeddedSimulator(vehicle=Vehicle(friction=0.5))
    roads = [random_road(seed) for seed in range(10)]
    moobd = [
        [judge(road, simulator.drive(road, Planner())).moobd or 0.0 for road in roads]
        for simulator in (dry, wet)
    ]
    assert np.mean(moobd[1]) < np.mean(moobd[0]) - 0.3


# --- Drivers that break --------------------------------------------------------------------------


def fail(error: BaseException) -> Callable[[], NoReturn]:
    def raise_it() -> NoReturn:
        raise error

    return raise_it


RAISED = f"({Path(__file__).name}:{fail.__code__.co_firstlineno + 2}: raise error)"
"""End of the message about what it raises."""


def spin() -> NoReturn:
    while True:
        pass


def spin_stubbornly() -> NoReturn:
    while True:
        try:
            while True:
                pass
        except Exception:
            pass


def swallow_once() -> NoReturn:
    try:
        spin()
    except BaseException:
        spin()
    raise AssertionError


def nothing() -> None:
    return None


def recurse() -> NoReturn:
    recurse()
    raise AssertionError


def assert_clean(simulator: EmbeddedSimulator) -> None:
    """The next drives are as if nothing had happened, and no timer is left behind."""
    expected = rows(EmbeddedSimulator().drive(ROADS[0], Planner()))
    np.testing.assert_array_equal(rows(simulator.drive(ROADS[0], Planner())), expected)
    np.testing.assert_array_equal(rows(simulator.drive(ROADS[0], PythonPlanner())), expected)
    if hasattr(signal, "getitimer"):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


BROKEN = {
    "raises": (
        fail(ValueError("no such lane")),
        f"the driver raised ValueError: no such lane {RAISED}",
    ),
    "two lines": (
        fail(ValueError("no\n such  lane")),
        f"the driver raised ValueError: no such lane {RAISED}",
    ),
    "key": (fail(KeyError("lane")), f"the driver raised KeyError: 'lane' {RAISED}"),
    "exits": (fail(SystemExit(3)), f"the driver raised SystemExit: 3 {RAISED}"),
    "contract": (fail(DriverError("no model was found")), "no model was found"),
    "returns None": (nothing, "the driver returned NoneType instead of frenetic.Controls"),
    "returns a tuple": (
        lambda: (0.0, 0.0, 0.0),
        "the driver returned tuple instead of frenetic.Controls",
    ),
    "nan": (
        lambda: Controls(math.nan),
        "the driver returned steering = nan, not a finite number",
    ),
    "inf": (
        lambda: Controls(0.0, math.inf),
        "the driver returned throttle = inf, not a finite number",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_driver_that_breaks_is_an_error_of_its_drive_only(kind: str) -> None:
    then, text = BROKEN[kind]
    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, Doing(then))
    assert drive.error == text
    # What was recorded until then: two answers were given, the third record was written.
    assert len(drive.trajectory) == 3
    np.testing.assert_array_equal(drive.trajectory.throttle[:2], [0.5, 0.5])
    result = judge(STRAIGHT, drive)
    assert result.outcome is Outcome.ERROR
    assert result.reason == text
    assert_clean(simulator)


def test_a_driver_that_breaks_in_reset_is_an_error() -> None:
    class Broken(Planner):
        def reset(self, setup: DriveSetup) -> None:
            raise OSError("no connection")

    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, Broken())
    assert drive.error is not None
    assert drive.error.startswith("the driver raised OSError: no connection (test_embedded.py:")
    assert drive.error.endswith(': raise OSError("no connection"))')
    assert len(drive.trajectory) == 0
    assert judge(STRAIGHT, drive).outcome is Outcome.ERROR
    assert_clean(simulator)


def test_a_driver_that_recurses_without_end_is_an_error() -> None:
    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, Doing(recurse))
    assert drive.error is not None
    assert drive.error.startswith("the driver raised RecursionError: ")
    assert_clean(simulator)


def test_a_driver_that_writes_into_its_observation_is_an_error() -> None:
    class Writing(Planner):
        def act(self, observation: Observation) -> Controls:
            observation.ahead[0] = 0.0
            return super().act(observation)

    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, Writing())
    assert drive.error is not None
    assert "read-only" in drive.error
    assert_clean(simulator)


def test_an_endless_text_is_cut() -> None:
    drive = EmbeddedSimulator().drive(STRAIGHT, Doing(fail(ValueError("x" * 100_000))))
    assert drive.error is not None
    assert drive.error.startswith("the driver raised ValueError: xxx")
    assert len(drive.error) <= 500


def test_an_error_that_cannot_even_be_printed_is_an_error_of_its_drive() -> None:
    class UnspeakableError(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no text")

    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, Doing(fail(UnspeakableError())))
    assert drive.error is not None
    assert drive.error.startswith("the driver raised UnspeakableError")
    assert_clean(simulator)


def test_something_else_than_a_driver_is_an_error_of_its_drive() -> None:
    simulator = EmbeddedSimulator()
    drive = simulator.drive(STRAIGHT, object())  # type: ignore[arg-type]
    assert drive.error is not None
    assert "AttributeError" in drive.error
    assert_clean(simulator)


@pytest.mark.parametrize("where", ["main thread", "another thread"])
@pytest.mark.parametrize("then", [spin, spin_stubbornly, swallow_once])
def test_a_driver_that_loops_for_ever_is_ended(then: Callable[[], NoReturn], where: str) -> None:
    simulator = EmbeddedSimulator(wall_limit=0.3)
    drives: list[Drive] = []

    def drive() -> None:
        drives.append(simulator.drive(STRAIGHT, Doing(then)))
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
    assert broken.error is not None
    assert broken.error.startswith(
        "the driver did not finish its drive within 0.3 s of wall time (it had driven 0."
    )
    assert judge(STRAIGHT, broken).outcome is Outcome.ERROR
    assert following.error is None
    assert_clean(EmbeddedSimulator())


def test_a_driver_that_loops_for_ever_in_reset_is_ended() -> None:
    class Endless(Planner):
        def reset(self, setup: DriveSetup) -> None:
            spin()

    simulator = EmbeddedSimulator(wall_limit=0.3)
    drive = simulator.drive(STRAIGHT, Endless())
    assert drive.error is not None
    assert "within 0.3 s of wall time (it had driven 0.0 s, and was at " in drive.error
    assert re.search(rf" at {Path(__file__).name}:[0-9]+: (while True:|pass)\)$", drive.error)
    assert "in spin\n" in drive.traceback
    assert len(drive.trajectory) == 0
    assert judge(STRAIGHT, drive).reason == drive.error


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs POSIX timers")
def test_a_driver_that_blocks_is_ended() -> None:
    simulator = EmbeddedSimulator(wall_limit=0.3)
    drive = simulator.drive(STRAIGHT, Doing(lambda: time.sleep(3600.0)))
    assert drive.error is not None
    assert drive.error.startswith("the driver did not finish its drive within 0.3 s")
    assert_clean(EmbeddedSimulator())


def test_in_another_thread_a_driver_that_blocks_is_ended_when_its_call_returns() -> None:
    drives: list[Drive] = []

    def drive() -> None:
        simulator = EmbeddedSimulator(wall_limit=0.1)
        drives.append(simulator.drive(STRAIGHT, Doing(lambda: time.sleep(0.5))))

    thread = threading.Thread(target=drive)
    thread.start()
    thread.join()
    (broken,) = drives
    assert broken.error is not None
    assert broken.error.startswith("the driver did not finish its drive within 0.1 s")


def test_a_built_in_driver_knows_no_wall_limit() -> None:
    drive = EmbeddedSimulator(wall_limit=1e-9).drive(STRAIGHT, Planner())
    assert judge(STRAIGHT, drive).outcome is Outcome.PASS


def test_an_interrupt_by_the_user_is_not_the_drivers_error() -> None:
    simulator = EmbeddedSimulator()
    with pytest.raises(KeyboardInterrupt):
        simulator.drive(STRAIGHT, Doing(fail(KeyboardInterrupt())))
    assert_clean(simulator)


# Where the car starts, and what may be set between two drives


@pytest.mark.parametrize("driver", [Planner(), PythonPlanner()], ids=["compiled", "python"])
@pytest.mark.parametrize(("offset", "heading"), [(0.7, 0.0), (-1.5, 0.2), (0.0, -0.4)])
def test_starts_beside_the_lane_centre_and_turned(
    driver: Driver, offset: float, heading: float
) -> None:
    simulator = EmbeddedSimulator(start_offset=offset, start_heading=heading)
    for road in ROADS[:4]:
        start = simulator.drive(road, driver).trajectory
        ((s, d),) = road.track([[start.x[0], start.y[0]]])
        assert s == pytest.approx(0.0, abs=1e-9)
        assert d == pytest.approx(offset - 0.5 * road.lane_width, abs=1e-9)
        assert start.heading[0] == pytest.approx(road.pose.heading + heading, abs=1e-12)
        assert start.speed[0] == 0.0


def test_a_start_elsewhere_is_driven_alike_compiled_and_in_python() -> None:
    simulator = EmbeddedSimulator(start_offset=-0.6, start_heading=0.1)
    compiled, python = (simulator.drive(ROADS[1], d) for d in (Planner(), PythonPlanner()))
    assert np.array_equal(rows(compiled), rows(python))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"start_offset": 2.1}, "start_offset is 2.1: a number from -2 to 2 m"),
        ({"start_offset": math.nan}, "start_offset is nan"),
        ({"start_heading": -1.0}, "start_heading is -1.0: a number from -0.785 to 0.785 rad"),
        ({"start_heading": math.inf}, "start_heading is inf"),
    ],
)
def test_a_start_outside_the_lane_is_refused(options: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        EmbeddedSimulator(**options)  # type: ignore[arg-type]


def test_options_say_where_the_car_starts_if_that_is_unusual() -> None:
    assert set(EmbeddedSimulator().options) == {"vehicle", "wall_limit"}
    assert EmbeddedSimulator(start_offset=0.5).options["start_offset"] == 0.5
    assert EmbeddedSimulator(start_heading=0.1).options["start_heading"] == 0.1


def test_what_is_set_between_two_drives_counts_for_the_next() -> None:
    simulator = EmbeddedSimulator()
    first = rows(simulator.drive(ROADS[0], Planner()))
    simulator.friction, simulator.start_offset, simulator.start_heading = 0.5, 0.3, 0.05
    made = EmbeddedSimulator(friction=0.5, start_offset=0.3, start_heading=0.05)
    assert simulator.vehicle == made.vehicle
    assert np.array_equal(
        rows(simulator.drive(ROADS[0], Planner())), rows(made.drive(ROADS[0], Planner()))
    )
    simulator.vehicle, simulator.start_offset, simulator.start_heading = Vehicle(), 0.0, 0.0
    assert np.array_equal(rows(simulator.drive(ROADS[0], Planner())), first)
    simulator.vehicle = Vehicle(length=5.0)
    assert simulator.drive(ROADS[0], Planner()).car.length == 5.0
