"""The conformance suite that every simulator passes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from frenetic._support.arrays import FloatArray
from frenetic._support.trigonometry import wrapped
from frenetic.drivers import Driver, DriveSetup, Observation, Stanley
from frenetic.drivers.driver import AHEAD_POINTS, AHEAD_SPACING
from frenetic.oracle.assessment import LEFT_LANE, REACHED, RUNNING, STUCK, TIMED_OUT, assess
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.processes.wall_limit import WallLimitExceeded, wall_limit
from frenetic.road import Pose, Road
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.observer import Observer
from frenetic.simulators.simulator import Simulator
from frenetic.testing.dummies import DummyDriver
from frenetic.testing.watch import ERROR_TEXT, Watch, breaking, circling, weaving

RECORD_RATE = 10.0
"""Least rate of a drive's records, in Hz; our choice."""

_END_TEXTS = {
    RUNNING: "stopped before a rule ended it",
    REACHED: "reached the road's end",
    LEFT_LANE: "left the lane",
    STUCK: "was stuck",
    TIMED_OUT: "took too long",
}
"""End of a drive -> words for it."""

_TOLERANCES: dict[str, float | FloatArray] = {
    "x": 0.05,  # m
    "y": 0.05,  # m
    "heading": 0.02,  # rad
    "lateral_speed": 0.1,  # m/s
    "speed": 0.1,  # m/s
    "yaw_rate": 0.05,  # rad/s
    "steering": 0.02,  # rad
    "lateral_offset": 0.05,  # m
    "heading_error": 0.02,  # rad
    "ahead": 0.1 + 0.01 * AHEAD_SPACING * np.arange(AHEAD_POINTS, dtype=np.float64)[:, None],  # m
    "curvature_ahead": 0.005,  # 1/m
}
"""Part of an observation -> largest difference from the record, beside latency; our choice."""


class SimulatorContract:
    """The contract of simulators as a pytest class: subclass it, override `make`, run pytest.

    ::

        from frenetic.testing import SimulatorContract

        class TestMine(SimulatorContract):
            def make(self, rules):
                return MySimulator(rules=rules)

    Override `driver` for a simulator that needs a driver of its own. The attributes below declare
    what a simulator rightly cannot do.
    """

    asks_driver = True
    """Whether the simulator asks the driver for controls; false if it drives by itself."""
    start_speed = 0.0
    """Speed of the car at the start of a drive, in m/s."""
    repeats_within = 0.0
    """Largest distance between two drives of the same road at the same time, in m.

    0 means that the drives have to be the same bit for bit.
    """
    latency = 0.1
    """Largest delay of an observation, and of an answer in the record, in s."""
    ends_within = 0.5
    """Longest recording after a rule has ended the drive, in s."""
    wall_limit = 600.0
    """Limit of the wall time of one drive of this suite, in s."""
    _shared_drive: Drive
    _shared_weaving: tuple[Watch, Drive]

    def make(self, rules: Rules) -> Simulator:
        """Return a simulator with these rules; to be overridden."""
        raise NotImplementedError

    def driver(self) -> Driver:
        """Return a driver that can follow a gentle road."""
        return Stanley()

    @pytest.fixture
    def road(self) -> Road:
        """The gentle road of `gentle_road`."""
        return gentle_road()

    def drive(self, road: Road, rules: Rules | None = None, driver: Driver | None = None) -> Drive:
        """Return the drive of a road in a new simulator; a drive with trouble fails the test."""
        with self.make(rules or Rules()) as simulator:
            drive = self.drive_in(simulator, road, driver or self.driver())
        assert drive.trouble is None, drive.trouble
        assert len(drive.trajectory) > 1, "the drive has fewer than two records"
        return drive

    def usual_drive(self, road: Road) -> Drive:
        """Return the drive of a road that several tests share, since a drive may take long."""
        if "_shared_drive" not in vars(type(self)):
            type(self)._shared_drive = self.drive(road)
        return self._shared_drive

    def drive_in(self, simulator: Simulator, road: Road, driver: Driver) -> Drive:
        """Return the drive of a road; one that takes longer than `wall_limit` fails the test."""
        try:
            with wall_limit(self.wall_limit):
                return simulator.drive(road, driver)
        except WallLimitExceeded:
            pytest.fail(f"a drive did not end within {self.wall_limit:g} s of wall time")

    def test_is_a_simulator(self) -> None:
        """The simulator has the methods and attributes of the protocol `Simulator`."""
        simulator = self.make(Rules(speed_limit=50.0))
        assert isinstance(simulator, Simulator), (
            "it needs rules, car and drive, and has to be a context manager"
        )
        assert simulator.rules == Rules(speed_limit=50.0), "it has other rules than were set"
        assert isinstance(simulator.car, CarBody), "car is no CarBody"

    def test_gentle_road_is_passed(self, road: Road) -> None:
        """A sensible driver passes a gentle road."""
        result = judge(road, self.usual_drive(road))
        assert result.outcome is Outcome.PASS, result.reason

    def test_starts_at_rest_in_the_ego_lane(self, road: Road) -> None:
        """The car starts at rest on the ego lane's centre at the first point, along the road."""
        start = self.usual_drive(road).trajectory
        ((along, lateral),) = road.track([[start.x[0], start.y[0]]])
        assert abs(along) < 0.5, f"the car starts {along:.2f} m along the road"
        left = lateral + 0.5 * road.lane_width
        assert abs(left) < 0.1, f"the car starts {left:.2f} m left of the ego lane's centre"
        turned = wrapped(start.heading[0] - road.pose.heading)
        assert abs(turned) < 0.05, f"the car starts turned by {turned:.2f} rad to the left"
        assert abs(start.speed[0] - self.start_speed) < 0.2, (
            f"the car starts at {start.speed[0]:.1f} m/s instead of {self.start_speed:g}"
        )
        assert abs(start.lateral_speed[0]) < 0.2, (
            f"the car starts moving sideways at {start.lateral_speed[0]:.1f} m/s"
        )

    def test_records_at_a_fixed_rate(self, road: Road) -> None:
        """The time of the records starts at 0 and increases in equal steps."""
        time = self.usual_drive(road).trajectory.time
        steps = np.diff(time)
        assert time[0] == 0.0, f"the first record is at {time[0]} s"
        assert np.allclose(steps, steps[0], atol=1e-6), "the steps of time are not equal"
        assert steps[0] <= 1.0 / RECORD_RATE + 1e-9, f"only one record every {steps[0]:g} s"

    def test_positions_change_as_speed_and_heading_say(self, road: Road) -> None:
        """Positions agree with speed and heading, and headings are unwrapped."""
        t = self.usual_drive(road).trajectory
        cosine, sine = np.cos(t.heading), np.sin(t.heading)
        for position, rate, name in (
            (t.x, t.speed * cosine - t.lateral_speed * sine, "x"),
            (t.y, t.speed * sine + t.lateral_speed * cosine, "y"),
        ):
            expected = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t.time)
            error = np.abs(np.diff(position) - expected).max()
            assert error <= 0.05, (
                f"from one record to the next, {name} differs by up to {error:.2f} m from what"
                " speed, lateral_speed and heading say"
            )
        assert np.all(np.abs(np.diff(t.heading)) < 1.0), "headings have to be unwrapped"

    def test_heading_changes_as_the_yaw_rate_says(self, road: Road) -> None:
        """The yaw rate is the rate at which the heading changes."""
        t = self.usual_drive(road).trajectory
        expected = np.gradient(t.heading, t.time)
        error = np.abs(t.yaw_rate - expected).max()
        assert error <= 0.02 + 0.25 * np.abs(expected).max(), (
            f"yaw_rate differs by up to {error:.2f} rad/s from how fast the heading changes"
        )

    def test_same_road_same_drive(self, road: Road) -> None:
        """The same road gives the same drive, in another simulator and twice in one simulator."""
        first = self.usual_drive(road)
        with self.make(Rules()) as simulator:
            for _ in range(2):
                self._assert_alike(first, self.drive_in(simulator, road, self.driver()))

    def test_rules_and_car_are_handed_on(self, road: Road) -> None:
        """A drive has the rules and the car's box of its simulator."""
        rules = Rules(oob_tolerance=0.5)
        with self.make(rules) as simulator:
            drive = self.drive_in(simulator, road, self.driver())
            assert drive.rules == rules, "the drive has other rules than the simulator"
            assert drive.car == simulator.car, "the drive has another car than the simulator"

    def test_rules_may_be_set_between_drives(self, road: Road) -> None:
        """The next drive follows the new rules, as if the simulator had been made with them."""
        rules = Rules(speed_limit=45.0)
        with self.make(Rules()) as simulator:
            self.drive_in(simulator, road, self.driver())
            simulator.rules = rules
            drive = self.drive_in(simulator, road, self.driver())
        assert drive.rules == rules, "the drive has other rules than were set"
        self._assert_alike(self.drive(road, rules), drive)

    def test_broken_driver_leaves_the_next_drive_clean(self, road: Road) -> None:
        """A driver that raises fails its drive, and no other."""
        clean = self.usual_drive(road)
        with self.make(Rules()) as simulator:
            broken = self.drive_in(simulator, road, Watch(DummyDriver(throttle=0.3), breaking))
            if self.asks_driver:
                assert broken.trouble is not None, "a driver raised, but the drive has no trouble"
                text = broken.trouble.reason
                assert ERROR_TEXT in text, f"the trouble does not say why: {text}"
                fault = judge(road, broken).fault
                assert fault is not None, "the drive does not say whose fault its trouble is"
                assert fault.part == "driver", f"the trouble is blamed on the {fault.part}"
            else:
                assert broken.trouble is None, broken.trouble
            after = self.drive_in(simulator, road, self.driver())
        self._assert_alike(clean, after)

    def test_driver_is_told_the_car_the_lane_and_the_limits(self, road: Road) -> None:
        """Before each drive the driver is told its car, lane and speed limit."""
        self._needs_driver()
        watch = Watch(DummyDriver())
        with self.make(Rules()) as simulator:
            for lane_width, speed_limit, road_limits in (
                (4.0, 36.0, ()),
                (3.5, 54.0, ()),
                (3.5, 27.0, 27.0),
            ):
                # The short timeout ends the drive after a moment.
                simulator.rules = Rules(
                    speed_limit=70.0 if road_limits else speed_limit,
                    timeout_base=0.5,
                    timeout_speed=1e3,
                )
                driven = replace(road, lane_width=lane_width, speed_limits=np.array(road_limits))
                drive = self.drive_in(simulator, driven, watch)
                assert drive.trouble is None, drive.trouble
                setup = watch.setups[-1]
                _assert_setup(setup, "lane_width", lane_width)
                _assert_setup(setup, "speed_limit", speed_limit / 3.6)
                _assert_setup(setup, "car_length", simulator.car.length)
                _assert_setup(setup, "car_width", simulator.car.width)
            assert len(watch.setups) == 3, "the driver has to be reset once before each drive"
        assert 0.0 < setup.period <= 1.0 / RECORD_RATE + 1e-9, f"period is {setup.period} s"
        assert setup.front_axle > 0.0, f"front_axle is {setup.front_axle} m"
        assert setup.rear_axle > 0.0, f"rear_axle is {setup.rear_axle} m"
        assert setup.wheelbase <= setup.car_length, "the axles are farther apart than the bumpers"
        assert 0.1 < setup.max_steering < 1.57, f"max_steering is {setup.max_steering} rad"
        for name in ("max_acceleration", "max_deceleration"):
            value = getattr(setup, name)
            assert 0.1 < value < 50.0, f"{name} is {value} m/s^2"

    def test_driver_sees_its_car_on_the_road(self, road: Road) -> None:
        """The driver's observations agree with the recorded car's place and motion."""
        watch, drive = self._weave(road)
        t, period = drive.trajectory, watch.setups[-1].period
        asked = np.array([observation.time for observation in watch.observations])
        assert abs(asked[0]) <= self.latency, f"the driver is asked first at {asked[0]:.2f} s"
        late = round(self.latency / period)  # observations before late sensors have new values
        assert np.allclose(np.diff(asked)[late:], period, atol=1e-3), (
            f"the driver is not asked every {period:g} s, as setup.period says"
        )
        expected = _observations(road, drive)
        for observation in watch.observations:
            time = observation.time
            near = self._near(t.time, time)
            assert len(near), f"the driver is asked at {time:.2f} s, where nothing is recorded"
            for name, tolerance in _TOLERANCES.items():
                value = np.asarray(getattr(observation, name))
                wanted = np.array([getattr(expected[i], name) for i in near])
                assert value.shape == wanted.shape[1:], f"{name} has shape {value.shape}"
                assert _lies_among(value, wanted, tolerance), (
                    f"at {time:.2f} s the driver sees {name} = {_number_text(value)}, but by the"
                    f" record it is {_number_text(wanted[len(near) // 2])}"
                )

    def test_records_hold_what_the_driver_asked_for(self, road: Road) -> None:
        """The recorded steering_input, throttle and brake are the driver's answers."""
        watch, drive = self._weave(road)
        max_steering = watch.setups[-1].max_steering
        times = np.array([observation.time for observation in watch.observations])
        t = drive.trajectory
        for name, recorded, answered in (
            (
                "steering_input",
                np.clip(t.steering_input, -max_steering, max_steering),
                np.clip(
                    [controls.steering for controls in watch.answers], -max_steering, max_steering
                ),
            ),
            ("throttle", t.throttle, np.array([controls.throttle for controls in watch.answers])),
            ("brake", t.brake, np.array([controls.brake for controls in watch.answers])),
        ):
            # The last record may come after the last answer.
            for time, value in zip(t.time[:-1], recorded[:-1], strict=True):
                near = self._near(times, time)
                if len(near):
                    assert _lies_among(value, answered[near], 0.01), (
                        f"at {time:.2f} s {name} = {value:.3f} is recorded, but the driver answered"
                        f" {answered[near[len(near) // 2]]:.3f}"
                    )

    def test_controls_beyond_the_limits_are_cut(self, road: Road) -> None:
        """The wheels turn by max_steering at most, and pedals are recorded from 0 to 1."""
        self._needs_driver()
        watch = Watch(DummyDriver(steering=10.0, throttle=2.0, brake=-1.0))
        t = self.drive(road, driver=watch).trajectory
        max_steering, widest = watch.setups[-1].max_steering, np.abs(t.steering).max()
        assert widest <= max_steering + 0.02, (
            f"the wheels turn by {widest:.2f} rad, farther than max_steering = {max_steering:.2f}"
        )
        for name, pedal in (("throttle", t.throttle), ("brake", t.brake)):
            assert np.all((pedal >= 0.0) & (pedal <= 1.0)), f"{name} is recorded beyond 0 to 1"

    def test_car_turns_as_its_wheels_and_axles_say(self) -> None:
        """At low speed the car drives the circle of its front wheels' angle and its wheelbase."""
        self._needs_driver()
        watch = Watch(DummyDriver(), circling)
        road = Road(np.zeros(7), pose=Pose(80.0, 50.0, 1.0))
        t = self.drive(road, driver=watch).trajectory
        turning_time = next(
            (
                observation.time
                for observation, controls in zip(watch.observations, watch.answers, strict=True)
                if controls.steering
            ),
            np.inf,
        )
        steady = np.flatnonzero(t.time > turning_time + 1.0)
        driven_distance = float(np.hypot(np.diff(t.x[steady]), np.diff(t.y[steady])).sum())
        assert driven_distance > 2.0, (
            f"a driver that steers to the left at 3 m/s gets only {driven_distance:.1f} m far"
        )
        curvature = (t.heading[steady[-1]] - t.heading[steady[0]]) / driven_distance
        angle = float(np.mean(t.steering[steady]))
        expected = np.tan(angle) / watch.setups[-1].wheelbase
        assert curvature > 0.0, "steering above 0 turns the car to the right"
        assert 0.8 * expected <= curvature <= 1.2 * expected, (
            f"at {np.mean(t.speed[steady]):.1f} m/s the car drives a curvature of {curvature:.3f}"
            f" 1/m; the recorded steering of {angle:.3f} rad and the wheelbase of"
            f" {watch.setups[-1].wheelbase:.2f} m make {expected:.3f}"
        )

    def test_rolls_down_a_slope(self) -> None:
        """A car whose driver presses no pedal rolls down a slope, if the simulator has slopes."""
        self._needs_driver()
        if not capabilities(self.make(Rules())).lays_slopes:
            pytest.skip("this simulator drives flat roads only")
        road = Road(np.zeros(7), pose=Pose(80.0, 50.0, 1.0), grade=-0.1)
        t = self.drive(road, driver=DummyDriver()).trajectory
        record = min(int(np.searchsorted(t.time, 3.0)), len(t) - 1)
        seconds, speed = t.time[record], t.speed[record]
        free_speed = 9.81 * 0.1 / math.hypot(1.0, 0.1) * seconds  # without drag
        assert 0.5 * free_speed <= speed <= 1.05 * free_speed, (
            f"down a slope of 10 % the car does {speed:.1f} m/s after {seconds:.1f} s, where"
            f" {free_speed:.1f} m/s, less some drag, are due"
        )

    def test_ends_at_the_roads_end(self, road: Road) -> None:
        """The drive is recorded until the goal is reached, and no longer."""
        self._assert_ends(road, self.usual_drive(road), REACHED)

    def test_ends_outside_the_lane(self, road: Road) -> None:
        """The drive ends when the car has left its lane."""
        self._needs_driver()
        drive = self.drive(road, driver=DummyDriver(steering=0.3, throttle=0.5))
        self._assert_ends(road, drive, LEFT_LANE)

    def test_ends_when_the_car_is_stuck(self, road: Road) -> None:
        """A car that does not move ends the drive."""
        self._needs_driver()
        drive = self.drive(road, Rules(stuck_time=2.0), DummyDriver(brake=1.0))
        self._assert_ends(road, drive, STUCK)

    def test_ends_at_the_timeout(self, road: Road) -> None:
        """A driver that does nothing runs out of time."""
        self._needs_driver()
        rules = Rules(timeout_base=3.0, timeout_speed=road.length)
        self._assert_ends(road, self.drive(road, rules, DummyDriver()), TIMED_OUT)

    def _needs_driver(self) -> None:
        """Skip the test for a simulator that never asks the driver."""
        if not self.asks_driver:
            pytest.skip("this simulator never asks the driver")

    def _weave(self, road: Road) -> tuple[Watch, Drive]:
        """Return a driver's watch and its drive, in which all observations and controls change."""
        self._needs_driver()
        if "_shared_weaving" not in vars(type(self)):
            watch = Watch(Stanley(), weaving)
            type(self)._shared_weaving = watch, self.drive(road, driver=watch)
        watch, drive = self._shared_weaving
        count = len(watch.observations)
        assert count > 20, f"the driver was asked only {count} times"
        return watch, drive

    def _near(self, times: FloatArray, time: float) -> npt.NDArray[np.intp]:
        """Return the indices of the times that lie within the latency of a time."""
        return np.flatnonzero(np.abs(times - time) <= self.latency + 1e-6)

    def _assert_ends(self, road: Road, drive: Drive, end: int) -> None:
        """Assert that a rule ended a drive, and that the recording stopped soon afterwards."""
        assessment = assess(road, drive)
        assert assessment.end == end, (
            f"the drive {_END_TEXTS[assessment.end]}; a drive that {_END_TEXTS[end]} was due"
        )
        time = drive.trajectory.time
        late = time[-1] - time[len(assessment.distance) - 1]
        assert late <= self.ends_within, (
            f"the drive is recorded for another {late:.1f} s after the car {_END_TEXTS[end]}"
        )

    def _assert_alike(self, drive: Drive, repeated_drive: Drive) -> None:
        """Assert that two drives of one road agree, up to `repeats_within`."""
        first, repeat = drive.trajectory, repeated_drive.trajectory
        if self.repeats_within == 0.0:
            assert np.array_equal(first.to_rows(), repeat.to_rows()), (
                "the same road and driver did not give the same drive bit for bit"
            )
            return
        count = min(len(first), len(repeat))
        apart = np.hypot(
            first.x[:count] - repeat.x[:count], first.y[:count] - repeat.y[:count]
        ).max()
        assert apart <= self.repeats_within, (
            f"two drives of the same road and driver are {apart:.2f} m apart"
        )
        assert abs(first.time[-1] - repeat.time[-1]) <= 1.0, (
            "two drives of the same road and driver do not end at the same time"
        )


def gentle_road() -> Road:
    """Return a gentle road of 100 m somewhere on the map."""
    values = np.array([0.0, 0.0, 0.01, 0.02, 0.01, 0.0, -0.01, -0.02, -0.01, 0.0, 0.0])
    return Road(values, pose=Pose(80.0, 50.0, 1.0))


def _assert_setup(setup: DriveSetup, name: str, expected: float) -> None:
    """Assert that a value of a setup is the expected one."""
    value = getattr(setup, name)
    assert abs(value - expected) <= 0.05, (
        f"the driver is told {name} = {value:.2f}, but it is {expected:.2f}"
    )


def _observations(road: Road, drive: Drive) -> list[Observation]:
    """Return the observation that follows from each record."""
    t = drive.trajectory
    observer = Observer(road, drive.rules, drive.car, len(t))
    observations = []
    for i in range(len(t)):
        observer.see(t.time[i], t.x[i], t.y[i], t.heading[i])
        motion = t.speed[i], t.yaw_rate[i], t.steering[i]
        observations.append(observer.observation(*motion, lateral_speed=t.lateral_speed[i]))
    return observations


def _lies_among(value: npt.ArrayLike, values: FloatArray, tolerance: float | FloatArray) -> bool:
    """Return whether ``value`` lies within the range of ``values``, up to the tolerance."""
    low, high = values.min(axis=0) - tolerance, values.max(axis=0) + tolerance
    return bool(np.all((value >= low) & (value <= high)))


def _number_text(value: FloatArray) -> str:
    """Return a number as text, or the first four numbers of an array."""
    return np.array2string(value.ravel()[:4], precision=3)
