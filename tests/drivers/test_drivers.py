"""Built-in drivers: laws, speed plan, wrappers, compiled forms and controls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic import EmbeddedSimulator, Road
from frenetic._support.interpreted import end_interpretation
from frenetic.drivers import (
    BeamngAi,
    Controls,
    Delayed,
    Driver,
    DriveSetup,
    LimitedView,
    Noisy,
    Observation,
    Planner,
    SpeedPlan,
    Stanley,
    laws,
)
from frenetic.drivers.calls import checked_controls
from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.driver import AHEAD_POINTS, AHEAD_SPACING
from frenetic.errors import DriverError

FloatArray = npt.NDArray[np.float64]

SETUP = DriveSetup(
    speed_limit=20.0,
    lane_width=4.0,
    period=0.05,
    front_axle=1.2,
    rear_axle=1.4,
    car_length=4.5,
    car_width=1.6,
    max_steering=1.0,
    max_acceleration=4.5,
    max_deceleration=9.0,
)
WHEELBASE = 2.6  # m
BUILT_IN: list[Callable[..., Planner | Stanley]] = [Planner, Stanley]


def arc(kappa: float, start: float = 0.0, n: int = AHEAD_POINTS) -> FloatArray:
    """Return points every 2 m of a circle that starts at x = ``start`` along +x."""
    s = AHEAD_SPACING * np.arange(n)
    if kappa == 0.0:
        return np.column_stack([start + s, np.zeros(n)])
    return np.column_stack([start + np.sin(kappa * s) / kappa, (1.0 - np.cos(kappa * s)) / kappa])


def observation(**changes: Any) -> Observation:
    """Return what a car sees at 10 m/s in the middle of a straight lane, with changes."""
    return replace(
        Observation(
            time=0.0,
            speed=10.0,
            yaw_rate=0.0,
            steering=0.0,
            lateral_offset=0.0,
            heading_error=0.0,
            ahead=arc(0.0),
            curvature_ahead=np.zeros(AHEAD_POINTS),
        ),
        **changes,
    )


def random_observation(seed: int) -> Observation:
    """Return what a car sees anywhere on a random road."""
    rng = np.random.default_rng(seed)
    kappa = np.convolve(rng.normal(0.0, 0.05, AHEAD_POINTS + 4), np.ones(5) / 5.0, "valid")
    heading = rng.normal(0.0, 0.1) + np.cumsum(AHEAD_SPACING * kappa)
    steps = AHEAD_SPACING * np.column_stack([np.cos(heading), np.sin(heading)])
    start = rng.normal(0.0, 0.7, 2)
    return observation(
        speed=float(rng.uniform(0.0, 30.0)),
        yaw_rate=float(rng.normal(0.0, 0.3)),
        lateral_offset=float(rng.normal(0.0, 1.0)),
        heading_error=float(rng.normal(0.0, 0.3)),
        ahead=start + np.cumsum(steps, axis=0) - steps[0],
        curvature_ahead=kappa,
    )


def controls_of(driver: Driver, *observations: Observation) -> Controls:
    """Return the driver's last controls in a drive with these observations."""
    driver.reset(SETUP)
    answers = [driver.act(observation) for observation in observations]
    return answers[-1]


def test_laws_are_compiled_once_for_all_kinds_of_arrays() -> None:
    """A law takes seconds to compile."""
    fixed, plain = random_observation(1), random_observation(1)
    fixed.ahead.setflags(write=False)
    fixed.curvature_ahead.setflags(write=False)
    strided = replace(plain, curvature_ahead=np.repeat(plain.curvature_ahead, 2)[::2])
    end_interpretation()  # first calls would not compile
    with EmbeddedSimulator() as simulator:
        simulator.drive(Road([0.0, 0.0]), Planner())  # the rollout
    assert len({controls_of(Planner(), view) for view in (plain, fixed, strided)}) == 1
    signatures: list[Any] = laws.decide.signatures  # type: ignore[attr-defined]
    # A law with a memory, the elastic band, is compiled for itself.
    assert len([types for types in signatures if str(types[-1]) == "none"]) == 1


def speed_wanted(curvature_ahead: FloatArray, driver: Planner | Stanley) -> float:
    """Return the speed that a driver plans for these curvatures, in m/s."""
    lateral, braking, _, smoothing = driver.parameters()[:4]
    limits = np.full(len(curvature_ahead), SETUP.speed_limit)
    wanted: float = laws.planned_speed(
        curvature_ahead, limits, len(curvature_ahead), lateral, braking, int(smoothing)
    )
    return wanted


class Recorder:
    """A driver that records its observations and answers with its number of calls."""

    def __init__(self) -> None:
        self.observations: list[Observation] = []
        self.resets: list[DriveSetup] = []

    def reset(self, setup: DriveSetup) -> None:
        self.resets.append(setup)
        self.observations = []

    def act(self, observation: Observation) -> Controls:
        self.observations.append(observation)
        n = len(self.observations)
        return Controls(0.01 * n, n / 1000.0, n / 2000.0)


# --- Laws ----------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), make=st.sampled_from(BUILT_IN))
@settings(max_examples=80)
def test_a_mirrored_observation_gives_mirrored_steering(
    seed: int, make: Callable[..., Driver]
) -> None:
    view = random_observation(seed)
    mirrored = replace(
        view,
        yaw_rate=-view.yaw_rate,
        lateral_offset=-view.lateral_offset,
        heading_error=-view.heading_error,
        ahead=view.ahead * [1.0, -1.0],
        curvature_ahead=-view.curvature_ahead,
    )
    straight_answer, mirrored_answer = controls_of(make(), view), controls_of(make(), mirrored)
    assert mirrored_answer.steering == -straight_answer.steering
    assert (mirrored_answer.throttle, mirrored_answer.brake) == (
        straight_answer.throttle,
        straight_answer.brake,
    )


@given(seed=st.integers(0, 2**32 - 1), make=st.sampled_from(BUILT_IN))
@settings(max_examples=80)
def test_controls_are_within_bounds_and_never_both_pedals(
    seed: int, make: Callable[..., Driver]
) -> None:
    controls = controls_of(make(), random_observation(seed))
    assert abs(controls.steering) <= SETUP.max_steering
    assert 0.0 <= controls.throttle <= 1.0
    assert 0.0 <= controls.brake <= 1.0
    assert controls.throttle == 0.0 or controls.brake == 0.0


@pytest.mark.parametrize("kappa", [0.05, -0.05, 0.01, 0.15])
@pytest.mark.parametrize("row", [1, 3, 6])
def test_pure_pursuit_takes_the_arc_through_the_lookahead_point(kappa: float, row: int) -> None:
    """With the rear axle on a circle, the wheels take the angle that keeps the axle there."""
    driver = Planner(lookahead_time=0.0, lookahead_min=AHEAD_SPACING * row)
    # Measured from the rear axle the circle starts there; row 0 is abreast of the centre of mass.
    view = observation(ahead=arc(kappa, start=-SETUP.rear_axle))
    steering = controls_of(driver, view).steering
    assert steering == pytest.approx(math.atan(WHEELBASE * kappa), abs=1e-12)


def test_pure_pursuit_interpolates_the_lookahead_point() -> None:
    driver = Planner(lookahead_time=0.1, lookahead_min=4.0)  # at 10 m/s 5 m
    ahead = arc(0.0)
    ahead[2] = [4.0, 1.0]
    ahead[3] = [6.0, 2.0]
    x, y = 5.0 + SETUP.rear_axle, 1.5
    expected = math.atan(2.0 * WHEELBASE * y / (x * x + y * y))
    assert controls_of(driver, observation(ahead=ahead)).steering == pytest.approx(expected)


def test_each_term_of_stanleys_law_is_exact() -> None:
    driver = Stanley(offset_gain=2.0, softening=1.0, yaw_damping=0.1)
    offset = -math.atan(2.0 * 0.3 / (1.0 + 10.0))
    assert controls_of(driver, observation(lateral_offset=0.3)).steering == pytest.approx(offset)
    error = -0.1 - math.atan(2.0 * SETUP.front_axle * math.sin(0.1) / 11.0)
    assert controls_of(driver, observation(heading_error=0.1)).steering == pytest.approx(error)
    assert controls_of(driver, observation(yaw_rate=0.5)).steering == pytest.approx(-0.05)
    bend = observation(curvature_ahead=np.full(AHEAD_POINTS, 0.05))
    expected = math.atan(WHEELBASE * 0.05) + 0.1 * 10.0 * 0.05
    assert controls_of(driver, bend).steering == pytest.approx(expected, abs=1e-12)


# --- Speed plan ----------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 2**32 - 1),
    make=st.sampled_from(BUILT_IN),
    aggression=st.floats(0.3, 3.0),
    smoothing=st.sampled_from([0.0, 2.0, 4.0, 10.0, 200.0]),
    n=st.integers(2, AHEAD_POINTS),
)
@settings(max_examples=80)
def test_the_planned_speed_is_the_largest_that_keeps_every_budget(
    seed: int, make: Callable[..., Planner], aggression: float, smoothing: float, n: int
) -> None:
    """The plan is the largest speed that keeps every budget if the car brakes steadily."""
    driver = make(aggression=aggression, smoothing=smoothing)
    rng = np.random.default_rng(seed)
    curvature = rng.normal(0.0, 0.04, n)
    lateral, braking = aggression * driver.lateral_acceleration, aggression * driver.braking
    reach = round(smoothing / AHEAD_SPACING)
    bounds = [SETUP.speed_limit**2]
    for i in range(n):
        kappa = abs(curvature[max(i - reach, 0) : i + reach + 1].mean())
        bounds.append(lateral / kappa + 2.0 * braking * AHEAD_SPACING * i)
    assert speed_wanted(curvature, driver) == pytest.approx(math.sqrt(min(bounds)), rel=1e-9)


@pytest.mark.parametrize("make", BUILT_IN)
def test_pedals_bring_the_speed_to_the_limit(make: Callable[..., Planner]) -> None:
    driver = make(speed_gain=1.5)
    limit = SETUP.speed_limit
    slow = controls_of(driver, observation(speed=limit - 1.0))
    assert (slow.throttle, slow.brake) == pytest.approx((1.5 / 4.5, 0.0))
    fast = controls_of(driver, observation(speed=limit + 2.0))
    assert (fast.throttle, fast.brake) == pytest.approx((0.0, 3.0 / 9.0))
    even = controls_of(driver, observation(speed=limit))
    assert (even.throttle, even.brake) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert controls_of(driver, observation(speed=0.0)).throttle == 1.0
    assert controls_of(driver, observation(speed=3.0 * limit)).brake == 1.0


@pytest.mark.parametrize("make", [*BUILT_IN, BeamngAi])
def test_bad_parameters_are_refused_by_name(make: Callable[..., Planner]) -> None:
    may_be_zero = {
        *("smoothing", "lookahead_time", "yaw_damping", "band_strength", "band_recoil"),
        *("forgiveness", "speed_slack"),
    }
    for item in fields(make()):
        for value in (-1.0, math.nan, math.inf, "x"):
            with pytest.raises(ValueError, match=f"{item.name} is {value!r}: a number"):
                make(**{item.name: value})
        if item.name in may_be_zero:
            assert getattr(make(**{item.name: 0.0}), item.name) == 0.0
        else:
            with pytest.raises(ValueError, match=rf"{item.name} is 0.0: a number > 0 is"):
                make(**{item.name: 0.0})


@given(seed=st.integers(0, 2**32 - 1), make=st.sampled_from(BUILT_IN))
@settings(max_examples=40)
def test_a_speed_plan_adds_built_in_pedals_to_any_steering(
    seed: int, make: Callable[..., Planner]
) -> None:
    driver, view = make(aggression=0.7), random_observation(seed)
    plan, controls = SpeedPlan(SETUP, driver), controls_of(driver, view)
    assert plan.controls(view, steering=0.123) == replace(controls, steering=0.123)
    assert plan.speed(view) == speed_wanted(view.curvature_ahead, driver)
    assert SpeedPlan(SETUP).controls(view, controls.steering) == replace(
        controls_of(Planner(), view), steering=controls.steering
    )


# --- Noise ---------------------------------------------------------------------------------------


def errors_seen(driver: Noisy, recorder: Recorder, n: int) -> FloatArray:
    """(n, 2) errors in offset and heading that a recorder under the wrapper sees."""
    driver.reset(SETUP)
    for _ in range(n):
        driver.act(observation(lateral_offset=0.7, heading_error=-0.2))
    return np.array(
        [(o.lateral_offset - 0.7, o.heading_error + 0.2) for o in recorder.observations]
    )


def test_noise_depends_on_the_seed_only() -> None:
    recorder = Recorder()
    driver = Noisy(recorder, seed=3)
    first = errors_seen(driver, recorder, 600)
    np.testing.assert_array_equal(errors_seen(driver, recorder, 600), first)
    np.testing.assert_array_equal(errors_seen(Noisy(recorder, seed=3), recorder, 600), first)
    assert np.abs(errors_seen(Noisy(recorder, seed=4), recorder, 600) - first).max() > 0.01


@pytest.mark.parametrize(
    ("offset", "heading", "correlation_time"), [(0.3, 0.02, 1.0), (0.0, 0.05, 0.2)]
)
def test_errors_have_their_standard_deviations_and_correlation(
    offset: float, heading: float, correlation_time: float
) -> None:
    driver = Noisy(
        Planner(), offset=offset, heading=heading, correlation_time=correlation_time, seed=1
    )
    errors = driver.errors(0.05).upto(200_000)
    lag = round(correlation_time / 0.05)
    for column, deviation in zip(errors.T, (offset, heading), strict=True):
        assert column.std() == pytest.approx(deviation, rel=0.05)
        assert column.mean() == pytest.approx(0.0, abs=0.05 * deviation)
        if deviation:
            correlation = float(np.corrcoef(column[lag:], column[:-lag])[0, 1])
            assert correlation == pytest.approx(math.exp(-1.0), abs=0.03)
    if offset and heading:
        assert abs(float(np.corrcoef(errors[:, 0], errors[:, 1])[0, 1])) < 0.05


def test_the_first_error_of_a_drive_is_no_larger_than_the_others() -> None:
    first = np.array(
        [Noisy(Planner(), offset=1.0, seed=seed).errors(0.05).upto(1)[0, 0] for seed in range(1000)]
    )
    assert first.std() == pytest.approx(1.0, rel=0.1)


def test_noise_moves_the_view_with_the_place() -> None:
    """Seen from the believed place of the car, every point of the view is at its true place."""
    recorder = Recorder()
    driver = Noisy(recorder, offset=0.5, heading=0.1, seed=2)
    driver.reset(SETUP)
    real = random_observation(8)
    before = real.ahead.copy()
    for _ in range(20):
        driver.act(real)
    np.testing.assert_array_equal(real.ahead, before)
    for view in recorder.observations:
        offset = view.lateral_offset - real.lateral_offset
        turn = view.heading_error - real.heading_error
        c, s = math.cos(turn), math.sin(turn)
        x = c * view.ahead[:, 0] - s * view.ahead[:, 1]
        y = s * view.ahead[:, 0] + c * view.ahead[:, 1] + offset
        np.testing.assert_allclose(np.column_stack([x, y]), real.ahead, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(view.curvature_ahead, real.curvature_ahead)
        assert (view.speed, view.yaw_rate) == (real.speed, real.yaw_rate)


# --- Delay and view ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "periods"),
    [(0.0, 0), (0.01, 0), (0.05, 1), (0.1, 2), (0.12, 2), (0.15, 3), (1.0, 20)],
)
def test_delayed_controls_arrive_whole_periods_later(seconds: float, periods: int) -> None:
    recorder = Recorder()
    driver = Delayed(recorder, seconds=seconds)
    for _ in range(2):  # delayed controls of a drive do not reach the next drive
        driver.reset(SETUP)
        arrived = [driver.act(observation()) for _ in range(40)]
        fresh = [Controls(0.01 * n, n / 1000.0, n / 2000.0) for n in range(1, 41)]
        assert arrived == [Controls(0.0, 0.0, 0.0)] * periods + fresh[: 40 - periods]
    assert recorder.resets == [SETUP, SETUP]


@pytest.mark.parametrize(
    ("distance", "rows"),
    [(0.1, 2), (2.0, 2), (3.9, 2), (4.0, 3), (30.0, 16), (78.0, 40), (1e6, 40)],
)
def test_a_limited_view_has_the_next_points_only(distance: float, rows: int) -> None:
    recorder = Recorder()
    driver = LimitedView(recorder, distance=distance)
    driver.reset(SETUP)
    real = random_observation(10)
    driver.act(real)
    (view,) = recorder.observations
    np.testing.assert_array_equal(view.ahead, real.ahead[:rows])
    np.testing.assert_array_equal(view.curvature_ahead, real.curvature_ahead[:rows])
    assert (view.speed, view.lateral_offset) == (real.speed, real.lateral_offset)


def test_wrappers_tell_their_options() -> None:
    noisy = Noisy(Planner(), offset=0.2, heading=0.02, correlation_time=2.0, seed=3)
    noisy.reset(SETUP)
    assert noisy.options == {"offset": 0.2, "heading": 0.02, "correlation_time": 2.0, "seed": 3}


@pytest.mark.parametrize("make", BUILT_IN)
def test_wrappers_commute(make: Callable[..., Driver]) -> None:
    wrappers: list[Callable[[Driver], Driver]] = [
        lambda driver: Noisy(driver, offset=0.3, heading=0.05, seed=6),
        lambda driver: Delayed(driver, seconds=0.15),
        lambda driver: LimitedView(driver, distance=14.0),
    ]
    observations = [random_observation(seed) for seed in range(20)]
    answers = []
    for order in itertools.permutations(wrappers):
        driver: Driver = make()
        for wrapper in order:
            driver = wrapper(driver)
        driver.reset(SETUP)
        answers.append([driver.act(observation) for observation in observations])
    assert all(answer == answers[0] for answer in answers)
    assert len(set(answers[0])) > 10


@pytest.mark.parametrize(
    ("wrapper", "options", "message"),
    [
        (Noisy, {"offset": -0.1}, "offset is -0.1: a number >= 0 is needed"),
        (Noisy, {"heading": math.nan}, "heading is nan: a number >= 0 is needed"),
        (Noisy, {"correlation_time": 0.0}, "correlation_time is 0.0: a number > 0 is needed"),
        (Noisy, {"seed": 0.5}, "seed is 0.5: a whole number is needed"),
        (Noisy, {"offset": 1e308}, "offset is 1e+308: a number <= 100 is needed"),
        (Noisy, {"heading": 101.0}, "heading is 101.0: a number <= 100 is needed"),
        (Delayed, {"seconds": -0.1}, "seconds is -0.1: a number >= 0 is needed"),
        (Delayed, {"seconds": 11.0}, "seconds is 11.0: a number <= 10 is needed"),
        (LimitedView, {"distance": 0.0}, "distance is 0.0: a number > 0 is needed"),
    ],
)
def test_bad_amounts_are_refused_by_name(
    wrapper: Callable[..., Driver], options: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError) as caught:
        wrapper(Planner(), **options)
    assert str(caught.value) == message


# --- Compiled forms -----------------------------------------------------------------------------


class MyPlanner(Planner):
    pass


class MyWrapper(Delayed):
    pass


def test_one_wrapper_of_each_kind_is_compiled_in() -> None:
    noisy = Noisy(LimitedView(Delayed(Stanley(), seconds=0.2), distance=20.0), seed=7)
    form = compiled_form(noisy, 0.05)
    assert form is not None
    assert form.law == Stanley.law
    assert form.rows == 11
    assert form.delay == 4
    assert form.errors is not None
    np.testing.assert_array_equal(form.errors.upto(300), noisy.errors(0.05).upto(300))


@pytest.mark.parametrize(
    "driver",
    [
        Recorder(),
        MyPlanner(),
        Noisy(MyPlanner()),
        Noisy(Recorder()),
        MyWrapper(Planner()),
        Noisy(MyWrapper(Planner())),
        Noisy(Noisy(Planner())),
        Delayed(Noisy(Delayed(Planner()))),
        LimitedView(LimitedView(Planner())),
    ],
    ids=lambda driver: type(driver).__name__,
)
def test_any_other_driver_is_called_from_python(driver: Driver) -> None:
    assert compiled_form(driver, 0.05) is None


# --- Controls ------------------------------------------------------------------------------------


def test_only_pedals_are_cut_to_their_range() -> None:
    assert checked_controls(Controls(5.0, 1.5, -0.5)) == (5.0, 1.0, 0.0)
    assert checked_controls(Controls(-0.2, 0.3, 0.4)) == (-0.2, 0.3, 0.4)
    assert checked_controls(Controls(np.float32(0.5), 1, True)) == (0.5, 1.0, 1.0)  # type: ignore[arg-type]
    assert checked_controls(Controls(0.1)) == (0.1, 0.0, 0.0)


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        (None, "the driver returned NoneType instead of frenetic.Controls"),
        ((0.0, 0.0, 0.0), "the driver returned tuple instead of frenetic.Controls"),
        (Controls(math.nan), "the driver returned steering = nan, not a finite number"),
        (Controls(0.0, math.nan), "the driver returned throttle = nan, not a finite number"),
        (Controls(0.0, 0.0, math.inf), "the driver returned brake = inf, not a finite number"),
        (Controls(None), "the driver returned steering = None, not a finite number"),  # type: ignore[arg-type]
        (Controls("left"), "the driver returned steering = 'left', not a finite number"),  # type: ignore[arg-type]
        (Controls(0.0, 1j), "the driver returned throttle = 1j, not a finite number"),  # type: ignore[arg-type]
        (Controls(0.0, 0.0, []), "the driver returned brake = [], not a finite number"),  # type: ignore[arg-type]
    ],
)
def test_an_answer_that_is_no_controls_is_refused(controls: Any, message: str) -> None:
    with pytest.raises(DriverError) as caught:
        checked_controls(controls)
    assert str(caught.value) == message
