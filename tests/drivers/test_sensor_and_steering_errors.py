"""Errors of sensors and steering: contracts of all wrappers, and what each changes."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation, Road
from frenetic.conditions.condition import SEED, known_conditions
from frenetic.conditions.declaration import Condition
from frenetic.conditions.sensors_and_steering import SENSOR_CONDITIONS, STEERING_CONDITIONS
from frenetic.drivers import Driver, Planner, Stanley
from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.loading import with_wrappers
from frenetic.drivers.sensor_errors import (
    DROPOUT_MS,
    HEADING,
    LATERAL,
    SPEED,
    YAW_RATE,
    Dropouts,
    LateralBias,
    LateralDropout,
    SpeedBias,
    SpeedDropout,
)
from frenetic.drivers.stack import stack_of
from frenetic.drivers.steering_errors import (
    SteeringDeadBand,
    SteeringGain,
    SteeringOffset,
    SteeringRate,
    SteeringResolution,
)
from frenetic.drivers.wrappers import Delayed, Noisy
from frenetic.errors import FreneticError

FloatArray = npt.NDArray[np.float64]

ALL = STEERING_CONDITIONS + SENSOR_CONDITIONS
NAMES = [condition.name for condition in ALL]
BY_NAME = known_conditions()
BENDS = Road([0.0, 0.0, 0.01, 0.03, 0.05, 0.05, 0.02, -0.02, -0.04, -0.04, 0.0, 0.0])
STRAIGHT = Road([0.0] * 30)
SETUP = DriveSetup(20.0, 4.0, 0.05, 1.2, 1.4, 4.5, 1.6, 1.0, 4.5, 9.0)


class Recorder:
    """A driver that records its observations and answers with prescribed steering."""

    def __init__(self, commands: Sequence[float] = ()) -> None:
        self.commands = commands
        self.observations: list[Observation] = []

    def reset(self, setup: DriveSetup) -> None:
        self.observations = []

    def act(self, observation: Observation) -> Controls:
        n = len(self.observations)
        self.observations.append(observation)
        return Controls(self.commands[n] if n < len(self.commands) else 0.1, 0.3, 0.2)


class StanleyInPython(Stanley): ...


def observation(time: float = 0.0, **changes: Any) -> Observation:
    """Return an observation of a car anywhere in its lane."""
    ahead = np.column_stack([np.arange(0.0, 80.0, 2.0), np.sin(0.05 * np.arange(40))])
    values: dict[str, Any] = {
        "time": time,
        "speed": 10.0 + math.sin(time),
        "yaw_rate": 0.2 * math.cos(time),
        "steering": 0.02,
        "lateral_offset": 0.5 * math.sin(2.0 * time) - 0.2,
        "heading_error": 0.1 * math.cos(3.0 * time),
        "ahead": ahead,
        "curvature_ahead": np.full(40, 0.01),
        "x": 3.0,
        "y": 4.0,
        "heading": 0.7,
    }
    return Observation(**values | changes)


def amount_with_effect(condition: Condition) -> float:
    """Return an amount that changes a drive."""
    return condition.low * 3.0 if math.isinf(condition.no_effect or 0.0) else condition.usual[1]


def drive(road: Road, driver: Driver, **options: Any) -> FloatArray:
    """Return the records of a drive in the embedded simulator."""
    rows: FloatArray = EmbeddedSimulator(**options).drive(road, driver).trajectory.to_rows()
    return rows


def answers(driver: Driver, observations: Sequence[Observation]) -> list[Controls]:
    """Return the controls of a drive with these observations."""
    driver.reset(SETUP)
    return [driver.act(view) for view in observations]


def steering(driver: Driver, count: int) -> FloatArray:
    """Return the steering of the first answers of a drive."""
    views = [observation(0.05 * i) for i in range(count)]
    return np.array([controls.steering for controls in answers(driver, views)])


# --- Contracts of all ----------------------------------------------------------------------------


@pytest.mark.parametrize("make", [Stanley, StanleyInPython])
@pytest.mark.parametrize("name", NAMES)
def test_an_amount_without_effect_changes_no_bit(name: str, make: type[Stanley]) -> None:
    condition = BY_NAME[name]
    assert condition.no_effect is not None
    amount = min(condition.no_effect, condition.high)
    wrapped = with_wrappers(make(), {name: amount})
    assert type(wrapped) is condition.wrapper_class()
    assert drive(BENDS, wrapped).tobytes() == drive(BENDS, make()).tobytes()


@pytest.mark.parametrize("condition", ALL, ids=NAMES)
def test_drives_repeat_and_differ_from_those_without(condition: Condition) -> None:
    driver = with_wrappers(StanleyInPython(), {condition.name: amount_with_effect(condition)})
    first = drive(BENDS, driver)
    assert drive(BENDS, driver).tobytes() == first.tobytes(), "a drive leaves nothing behind"
    assert drive(BENDS, copy.deepcopy(driver)).tobytes() == first.tobytes()
    assert not np.array_equal(first, drive(BENDS, Stanley()))


@pytest.mark.parametrize("condition", STEERING_CONDITIONS, ids=lambda c: c.name)
def test_an_erring_steering_changes_the_steering_alone(condition: Condition) -> None:
    recorder = Recorder(commands=[0.0, 0.123, -0.2, 0.05, 0.3] * 4)
    driver = with_wrappers(recorder, {condition.name: amount_with_effect(condition)})
    views = [observation(0.05 * i) for i in range(20)]
    controls = answers(driver, views)
    assert all(view is seen for view, seen in zip(views, recorder.observations, strict=True))
    assert {(c.throttle, c.brake) for c in controls} == {(0.3, 0.2)}
    assert [c.steering for c in controls] != recorder.commands


READ_WITH: dict[str, set[str]] = {
    "lateral": {"lateral_offset", "ahead", "x", "y"},
    "heading": {"heading_error", "ahead", "heading"},
    "yaw_rate": {"yaw_rate"},
    "speed": {"speed"},
}
"""Signal -> attributes of an observation that err with it."""


@pytest.mark.parametrize("condition", SENSOR_CONDITIONS, ids=lambda c: c.name)
def test_an_erring_sensor_changes_its_signal_alone(condition: Condition) -> None:
    recorder = Recorder()
    amount = 1.0 if condition.is_seeded else amount_with_effect(condition)
    driver = with_wrappers(recorder, {condition.name: amount})
    views = [observation(0.05 * i, x=3.0 + i) for i in range(40)]
    controls = answers(driver, views)
    assert controls == answers(Recorder(), views)
    signal = condition.name.removesuffix("_bias").removesuffix("_dropout")
    changed = {
        name
        for true, seen in zip(views, recorder.observations, strict=True)
        for name, value in vars(true).items()
        if not np.array_equal(value, vars(seen)[name])
    }
    assert changed == READ_WITH[signal]


@pytest.mark.parametrize("name", ["lateral_bias", "heading_bias", "lateral_dropout"])
def test_the_view_moves_with_the_believed_place(name: str) -> None:
    """Seen from the believed place of the car, every point of the view is at its true place."""
    recorder = Recorder()
    driver = with_wrappers(recorder, {name: 0.5})
    views = [observation(0.05 * i) for i in range(80)]
    answers(driver, views)
    errors = []
    for true, seen in zip(views, recorder.observations, strict=True):
        offset = seen.lateral_offset - true.lateral_offset
        turn = seen.heading_error - true.heading_error
        c, s = math.cos(turn), math.sin(turn)
        x = c * seen.ahead[:, 0] - s * seen.ahead[:, 1]
        y = s * seen.ahead[:, 0] + c * seen.ahead[:, 1] + offset
        np.testing.assert_allclose(np.column_stack([x, y]), true.ahead, rtol=0, atol=1e-9)
        left = true.heading - true.heading_error + 0.5 * math.pi  # to the left of the lane
        position = [true.x + offset * math.cos(left), true.y + offset * math.sin(left)]
        np.testing.assert_allclose([seen.x, seen.y], position, rtol=0, atol=1e-9)
        assert seen.heading == pytest.approx(true.heading + turn, abs=1e-9)
        errors.append(abs(offset) + abs(turn))
    assert max(errors) > 0.1


def test_drives_side_by_side_share_no_state() -> None:
    roads = [BENDS, STRAIGHT, Road([0.0, 0.02, 0.04, 0.0, -0.03, 0.0])] * 3
    amounts = {"steering_dead_band": 0.02, "steering_rate": 0.2, "lateral_dropout": 0.5}
    driver, simulator = with_wrappers(Planner(), amounts), EmbeddedSimulator()
    alone = [simulator.drive(road, driver).trajectory.to_rows() for road in roads]
    for threads in (1, 2):
        together = simulator.drive_many(roads, driver, threads=threads)
        for drive_together, rows in zip(together, alone, strict=True):
            np.testing.assert_array_equal(drive_together.trajectory.to_rows(), rows)


def test_wrappers_lie_in_the_declared_order_however_they_are_named() -> None:
    amounts = {condition.name: amount_with_effect(condition) for condition in ALL}
    amounts |= {"noise": 0.1, "delay": 0.1}
    stacks = []
    for names in (list(amounts), list(reversed(amounts))):
        driver = with_wrappers(Planner(), {name: amounts[name] for name in names})
        stacks.append([type(part) for part in stack_of(driver)])
    assert stacks[0] == stacks[1]
    expected = [
        *(Delayed, Noisy),
        *(condition.wrapper_class() for condition in SENSOR_CONDITIONS),
        *(condition.wrapper_class() for condition in reversed(STEERING_CONDITIONS)),
        Planner,
    ]
    assert stacks[0] == expected


@pytest.mark.parametrize(
    "driver",
    [
        SteeringGain(SteeringRate(Planner(), 0.3), 0.9),
        SteeringRate(Delayed(Planner()), 0.3),
        LateralBias(Noisy(Planner()), 0.1),
        LateralDropout(LateralBias(Planner(), 0.1), 0.2),
        SteeringGain(SteeringGain(Planner(), 0.9), 0.9),
    ],
    ids=lambda driver: "-".join(type(part).__name__ for part in stack_of(driver)),
)
def test_an_order_of_the_users_own_is_driven_in_python(driver: Driver) -> None:
    assert compiled_form(driver, 0.05) is None
    assert len(drive(BENDS, driver)) > 100


@pytest.mark.parametrize("condition", ALL, ids=NAMES)
def test_an_amount_out_of_range_is_refused_in_one_line(condition: Condition) -> None:
    for amount in (condition.low - 0.1, condition.high * 1.1, math.nan):
        message = f"{condition.name} is {amount:g}: {condition.allowed} is needed"
        with pytest.raises(FreneticError) as caught:
            with_wrappers(Planner(), {condition.name: amount})
        assert str(caught.value) == message
        with pytest.raises(ValueError) as raised:
            condition.wrapper_class()(Planner(), amount)
        assert str(raised.value) == message


def test_a_wrong_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed is -1: a whole number >= 0 is needed"):
        SpeedDropout(Planner(), 0.1, seed=-1)


@pytest.mark.parametrize("condition", STEERING_CONDITIONS, ids=lambda c: c.name)
def test_unusable_controls_stay_the_drivers_fault(condition: Condition) -> None:
    driver = with_wrappers(Recorder([math.nan]), {condition.name: amount_with_effect(condition)})
    trouble = EmbeddedSimulator().drive(BENDS, driver).trouble
    assert trouble is not None
    assert "the driver returned steering = nan, not a finite number" in str(trouble)
    largest = with_wrappers(Recorder([1e9] * 9), {condition.name: amount_with_effect(condition)})
    assert EmbeddedSimulator().drive(STRAIGHT, largest).trouble is None


# --- Steering ------------------------------------------------------------------------------------

COMMANDS = 0.3 * np.sin(0.17 * np.arange(200)) + 0.05


def test_a_resolution_rounds_to_its_multiples() -> None:
    angles = steering(SteeringResolution(Recorder(COMMANDS.tolist()), 0.04), 200)
    np.testing.assert_allclose(angles / 0.04, np.round(angles / 0.04), atol=1e-9)
    assert np.abs(angles - COMMANDS).max() <= 0.02 + 1e-12
    assert len(set(angles.tolist())) > 10


def test_a_gain_multiplies_and_an_offset_adds() -> None:
    angles = steering(SteeringGain(Recorder(COMMANDS.tolist()), 0.8), 200)
    np.testing.assert_allclose(angles, 0.8 * COMMANDS, rtol=1e-15)
    angles = steering(SteeringOffset(Recorder(COMMANDS.tolist()), -0.03), 200)
    np.testing.assert_allclose(angles, COMMANDS - 0.03, rtol=0, atol=1e-15)


def test_a_dead_band_follows_at_its_distance_and_stands_while_the_command_turns_round() -> None:
    """A triangle of amplitude a leaves play of width 2b: the angle follows it b behind."""
    band, step, top = 0.05, 0.01, 30
    up = step * np.arange(1, top + 1)
    triangle = np.concatenate([up, up[-1] - up, -up, up - up[-1]])
    angles = steering(SteeringDeadBand(Recorder(triangle.tolist()), band), 4 * top)
    expected = np.concatenate(
        [
            np.maximum(up - band, 0.0),
            np.minimum(up[-1] - up + band, up[-1] - band),  # stands for 2b, then follows
            -up + band,
            np.maximum(up - up[-1] - band, -up[-1] + band),
        ]
    )
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-12)
    # A command within the band around the wheels is not carried out.
    assert not steering(SteeringDeadBand(Recorder([0.05, -0.04, 0.03] * 9), band), 27).any()


def test_a_rate_limits_the_change_per_time() -> None:
    angles = steering(SteeringRate(Recorder([0.1] * 9 + [-0.1] * 9), 0.5), 18)
    times = 0.05 * np.arange(1, 10)
    expected = [*np.minimum(0.5 * times, 0.1), *np.maximum(0.1 - 0.5 * times, -0.1)]
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-12)
    driver = SteeringRate(Recorder([1.0] * 9), 0.5)
    driver.reset(replace(SETUP, period=0.2))
    assert driver.act(observation()).steering == pytest.approx(0.1), "a fifth of a second"


def test_a_command_passes_resolution_gain_offset_dead_band_rate_and_delay() -> None:
    amounts = {
        "steering_resolution": 0.03,
        "steering_gain": 0.7,
        "steering_offset": 0.02,
        "steering_dead_band": 0.04,
        "steering_rate": 0.5,
        "delay": 0.1,
    }
    angles = steering(with_wrappers(Recorder(COMMANDS.tolist()), amounts), 200)
    behind_band = behind_rate = 0.0
    expected = [0.0, 0.0]
    for command in COMMANDS[:-2].tolist():
        angle = round(command / 0.03) * 0.03 * 0.7 + 0.02
        if abs(angle - behind_band) > 0.04:
            behind_band = angle - math.copysign(0.04, angle - behind_band)
        change = behind_band - behind_rate
        behind_rate += math.copysign(min(abs(change), 0.025), change)
        expected.append(behind_rate)
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-12)


# --- Readings ------------------------------------------------------------------------------------


def readings(driver: Driver, recorder: Recorder, name: str, count: int = 400) -> FloatArray:
    """Return what a recorder under wrappers reads of a signal."""
    answers(driver, [observation(0.05 * i) for i in range(count)])
    return np.array([getattr(view, name) for view in recorder.observations])


def true_values(name: str, count: int = 400) -> FloatArray:
    """Return the true values of a signal."""
    return np.array([getattr(observation(0.05 * i), name) for i in range(count)])


@pytest.mark.parametrize(
    ("name", "attribute", "amount", "error"),
    [
        ("lateral_bias", "lateral_offset", -0.4, -0.4),
        ("heading_bias", "heading_error", 0.05, 0.05),
        ("yaw_rate_bias", "yaw_rate", 0.1, 0.1),
        ("speed_bias", "speed", 18.0, 5.0),
    ],
)
def test_a_bias_is_a_constant_error(name: str, attribute: str, amount: float, error: float) -> None:
    recorder = Recorder()
    driver = with_wrappers(recorder, {name: amount})
    errors = readings(driver, recorder, attribute) - true_values(attribute)
    np.testing.assert_allclose(errors, error, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("speed", "reading"), [(9.0, 4.0), (5.0, 0.0), (2.0, 0.0), (-1.0, -1.0)])
def test_a_car_that_rolls_forward_never_seems_to_roll_back(speed: float, reading: float) -> None:
    recorder = Recorder()
    answers(SpeedBias(recorder, -18.0), [observation(speed=speed)])
    assert recorder.observations[0].speed == pytest.approx(reading)


@pytest.mark.parametrize(
    ("name", "attribute"),
    [
        ("lateral_dropout", "lateral_offset"),
        ("heading_dropout", "heading_error"),
        ("yaw_rate_dropout", "yaw_rate"),
        ("speed_dropout", "speed"),
    ],
)
def test_a_dropout_holds_the_last_reading_for_stretches(name: str, attribute: str) -> None:
    recorder = Recorder()
    driver = with_wrappers(recorder, {name: 0.4, SEED: 3})
    read, true = readings(driver, recorder, attribute), true_values(attribute)
    per_stretch = DROPOUT_MS // 50
    is_held = (read != true).reshape(-1, per_stretch)
    assert (is_held.all(axis=1) == is_held.any(axis=1))[1:].all(), "stretches are whole"
    assert 0.2 < is_held.mean() < 0.6
    last = true[0]
    for value, actual, held in zip(read, true, is_held.ravel(), strict=True):
        last = last if held else actual
        assert value == last
    other = with_wrappers(recorder, {name: 0.4, SEED: 4})
    assert not np.array_equal(readings(other, recorder, attribute), read)
    always = with_wrappers(recorder, {name: 1.0})
    assert set(readings(always, recorder, attribute).tolist()) == {true[0]}


def test_dropouts_take_their_share_and_grow_with_it() -> None:
    times = np.arange(0, 2_000_000, 50)
    dropped = [Dropouts(share, 5, LATERAL).at(times) for share in (0.0, 0.1, 0.3, 1.0)]
    np.testing.assert_allclose([d.mean() for d in dropped], [0.0, 0.1, 0.3, 1.0], atol=0.02)
    assert all((more >= less).all() for less, more in itertools.pairwise(dropped))


def test_signals_drop_out_independently_of_each_other_and_of_the_time_of_asking() -> None:
    times = np.arange(0, 500_000, DROPOUT_MS)
    dropped = [Dropouts(0.5, 9, k).at(times) for k in (LATERAL, HEADING, YAW_RATE, SPEED)]
    assert np.abs(np.corrcoef(dropped) - np.eye(4)).max() < 0.15
    of_noise = np.random.default_rng(9).random(len(times)) < 0.5
    assert all(not np.array_equal(draws, of_noise) for draws in dropped)
    later = Dropouts(0.5, 9, LATERAL)
    later.at(times[:3])
    np.testing.assert_array_equal(later.at(times), dropped[0])


def test_a_reading_passes_noise_then_bias_then_dropouts() -> None:
    recorder = Recorder()
    amounts = {"noise": 0.3, "lateral_bias": 0.2, "lateral_dropout": 0.5, SEED: 2}
    read = readings(with_wrappers(recorder, amounts), recorder, "lateral_offset")
    del amounts["lateral_dropout"]
    fresh = readings(with_wrappers(recorder, amounts), recorder, "lateral_offset")
    noise = Noisy(Planner(), offset=0.3, seed=2).errors(0.05).upto(400)[:400, 0]
    np.testing.assert_allclose(fresh, true_values("lateral_offset") + noise + 0.2, atol=1e-12)
    assert set(read.tolist()) < set(fresh.tolist()), "a dropout holds the noisy reading"
