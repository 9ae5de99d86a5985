"""The embedded car on banked and sloping roads, against closed forms and a mass on a surface."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from one_car import advance_period
from scipy.integrate import solve_ivp

from frenetic import (
    Controls,
    DriveSetup,
    EmbeddedSimulator,
    Observation,
    Planner,
    Road,
    Rules,
    SteppedSimulator,
    Vehicle,
)
from frenetic.campaign import RoadTester
from frenetic.drivers import Delayed, Driver, Stanley
from frenetic.drivers.driver import DRAG_FADE_SPEED
from frenetic.drivers.loading import load_driver
from frenetic.errors import RoadError
from frenetic.oracle import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.beamng import BeamngSimulator
from frenetic.plugins.metadrive import MetaDriveSimulator
from frenetic.road import Pose, profile
from frenetic.road.classes import GRAVITY
from frenetic.road.geometry import project_near
from frenetic.search import Candidate, Origin
from frenetic.simulators import Simulator
from frenetic.simulators.embedded import single_track
from frenetic.simulators.embedded.single_track import (
    HEADING,
    LATERAL_SPEED,
    SPEED,
    STEERING,
    YAW_RATE,
    X,
    Y,
    axle_forces,
    motion,
    on_map,
)
from frenetic.simulators.embedded.slopes import on_slopes
from frenetic.simulators.embedded.vehicle import (
    ACROSS,
    MOST_ACCELERATION,
    PULL_LEFT,
    TURN,
    TWIST,
)
from frenetic.testing import DummyDriver, DummySimulator

FloatArray = npt.NDArray[np.float64]
FREE = Vehicle(drag_area=0.0, rolling_resistance=0.0)
"""A car without air drag and rolling drag."""
PATIENT = Rules(stuck_time=60.0, timeout_base=120.0)
"""Rules under which a car may stand or creep for a minute."""
WINDING = Road(
    [0.0, 0.0, 0.02, 0.04, 0.0, -0.03, -0.05, -0.02, 0.0, 0.0],
    superelevation=[(20.0, 0.0), (40.0, -0.06), (60.0, 0.05), (80.0, 0.05)],
    grade=[(0.0, 0.08), (30.0, -0.08), (60.0, 0.04)],
)


def straight(length: float = 300.0, **slopes: Any) -> Road:
    return Road([0.0] * (round(length / 10.0) + 1), pose=Pose(0.0, 0.0, 0.0), **slopes)


def driven(road: Road, car: Vehicle = FREE, **controls: float) -> Trajectory:
    """Return the trajectory of a drive with constant controls."""
    drive = EmbeddedSimulator(vehicle=car, rules=PATIENT).drive(road, DummyDriver(**controls))
    assert drive.trouble is None
    return drive.trajectory


def placed(road: Road, speed: float, *, s: float = 0.0, left: float = 0.0) -> FloatArray:
    """Return the state of a car that drives along the centre line, or so many m left of it."""
    x, y, heading = road.pose_at(s)
    state = np.zeros(single_track.STATE_SIZE)
    state[[X, Y, HEADING, SPEED]] = (
        x - left * math.sin(heading),
        y + left * math.cos(heading),
        heading,
        speed,
    )
    return state


def place_of(road: Road, state: FloatArray) -> float:
    """Return the distance of a car along its road, in m."""
    return float(road.track(state[[X, Y]])[0, 0])


def ground(road: Road, state: FloatArray, car: Vehicle = FREE) -> FloatArray:
    """Return the parameters of a car on the slopes below it."""
    s = place_of(road, state)
    p: FloatArray = on_slopes(
        car.to_array(), road.table, road.sub_step, road.slopes, state, s, 0.0
    )[0]
    return p


def periods(road: Road, car: Vehicle, state: FloatArray, count: int, **inputs: float) -> FloatArray:
    """Return the states, (count + 1, 7), of a car with constant controls."""
    p, s, states = car.to_array(), place_of(road, state), [state.copy()]
    steering, throttle, brake = (
        inputs.get(name, 0.0) for name in ("steering", "throttle", "brake")
    )
    for _ in range(count):
        s = advance_period(state, (steering, throttle, brake), p, road, s)
        states.append(state.copy())
    return np.array(states)


# A car without grip moves as a point mass on a surface


@pytest.mark.parametrize(("spin", "within"), [(0.0, 0.001), (0.7, 0.001), (-1.5, 0.01)])
def test_a_car_without_grip_is_a_mass_on_a_surface(spin: float, within: float) -> None:
    """The reference is Lagrange's equations in x and y; the spin of the car does not matter."""
    road = Road(
        [0.0, 0.0, 0.01, 0.02, 0.02, 0.02, 0.01, 0.0, 0.0, -0.01, -0.02, -0.02],
        pose=Pose(0.0, 0.0, 1.2),
        superelevation=[(-50.0, -0.25), (150.0, 0.25)],
        grade=[(0.0, -0.1), (40.0, -0.06), (80.0, 0.08)],
    )
    near = 0.0

    def height(x: float, y: float) -> float:
        nonlocal near
        near, d = project_near(road.table, road.sub_step, x, y, near, 8.0)
        return float(road.heights(near) + profile.value_at(road.superelevation, near) * d)

    def rate(_: float, w: FloatArray) -> list[float]:
        x, y, v_x, v_y = w
        h = 0.02
        z = np.array([[height(x + i * h, y + j * h) for j in (-1, 0, 1)] for i in (-1, 0, 1)])
        z_x, z_y = (z[2, 1] - z[0, 1]) / (2.0 * h), (z[1, 2] - z[1, 0]) / (2.0 * h)
        z_xx, z_yy = ((line[2] - 2.0 * line[1] + line[0]) / h**2 for line in (z[:, 1], z[1]))
        z_xy = (z[2, 2] - z[2, 0] - z[0, 2] + z[0, 0]) / (2.0 * h) ** 2
        bend = z_xx * v_x * v_x + 2.0 * z_xy * v_x * v_y + z_yy * v_y * v_y
        k = (GRAVITY + bend) / (1.0 + z_x * z_x + z_y * z_y)
        return [v_x, v_y, -z_x * k, -z_y * k]

    slippery = replace(FREE, friction=1e-9)
    state = placed(road, 18.0, s=2.0, left=-2.0)
    state[LATERAL_SPEED], state[YAW_RATE] = 0.5, spin
    ahead, left, _ = on_map(18.0, 0.5, 0.0, ground(road, state, slippery))
    c, w = math.cos(state[HEADING]), math.sin(state[HEADING])
    start = [*state[[X, Y]], ahead * c - left * w, ahead * w + left * c]
    times = 0.05 * np.arange(81, dtype=np.float64)
    expected = solve_ivp(rate, (0.0, times[-1]), start, max_step=0.02, t_eval=times).y[:2]
    path = periods(road, slippery, state, 80)[:, [X, Y]].T
    assert np.abs(path - expected).max() < within
    assert np.abs(expected[:, -1] - start[:2] - times[-1] * np.array(start[2:])).max() > 3.0


# Closed forms along the road


def test_coasting_turns_height_into_speed() -> None:
    grade = [(0.0, -0.08), (60.0, -0.08), (120.0, 0.06), (160.0, -0.03)]
    road = straight(grade=grade)
    t = driven(road)
    assert t.x[-1] > 280.0
    heights = road.heights(t.x)
    assert 0.5 * t.speed**2 == pytest.approx(-GRAVITY * heights, rel=2e-4, abs=0.01)
    assert np.ptp(t.y) == 0.0


@pytest.mark.parametrize("grade", [0.1, 0.0, -0.1])
@pytest.mark.parametrize("friction", [1.0, 0.4])
def test_braking_distance(grade: float, friction: float) -> None:
    car = replace(FREE, friction=friction)
    road, slope = straight(grade=grade or 1e-12), math.atan(grade)
    brakes = min(car.brake_deceleration, car.slip_control * car.grip * GRAVITY * math.cos(slope))
    deceleration = brakes + GRAVITY * math.sin(slope)
    states = periods(road, car, placed(road, 20.0), 200, brake=1.0)
    assert abs(states[-1, SPEED]) < 1e-6
    # Below the speed at which fading brakes are weaker than the tyres, the way doubles.
    fading = DRAG_FADE_SPEED * brakes / car.brake_deceleration
    distance = (20.0**2 + fading**2) / (2.0 * deceleration)
    assert states[-1, X] / math.cos(slope) == pytest.approx(distance, rel=2e-3)


@pytest.mark.parametrize("slopes", [{"grade": 0.3}, {"grade": -0.3}, {"superelevation": 0.2}])
def test_brakes_hold_a_car_that_stands(slopes: dict[str, float]) -> None:
    t = driven(straight(**slopes), brake=1.0)
    assert t.time[-1] >= 60.0
    assert np.ptp(t.x) == np.ptp(t.y) == np.ptp(t.speed) == 0.0


def test_ice_holds_no_car_on_a_slope() -> None:
    icy = replace(FREE, friction=0.05, slip_control=1.0, tyre_shape=1.0)
    for slopes, axis in (({"grade": -0.1}, X), ({"superelevation": 0.1}, Y)):
        road = straight(**slopes)
        states = periods(road, icy, placed(road, 0.0), 60, brake=1.0)
        slid = abs(states[-1, axis] - states[20, axis])
        start = abs(states[20, SPEED if axis == X else LATERAL_SPEED]) * 2.0
        assert slid - start == pytest.approx(0.5 * GRAVITY * (0.1 - icy.grip) * 4.0, rel=0.02)


def test_a_car_that_nothing_holds_rolls_back() -> None:
    """There is no parking brake. Rolling drag holds a car on less than 1.2 %."""
    assert np.ptp(driven(straight(grade=0.01), Vehicle()).x) == 0.0
    states = periods(straight(grade=0.1), Vehicle(), placed(straight(), 0.0), 60)
    assert states[-1, SPEED] == pytest.approx(-GRAVITY * (0.1 - 0.012) * 3.0, rel=0.02)
    assert states[-1, X] < -3.5
    assert states[-1, HEADING] == 0.0
    climbing = driven(straight(grade=0.2), throttle=1.0)
    assert climbing.x.min() == climbing.x[0]
    expected = (FREE.engine_acceleration - GRAVITY * math.sin(math.atan(0.2))) * 2.0
    assert climbing.speed[40] == pytest.approx(expected, rel=1e-3)


def test_a_crest_unloads_and_a_dip_loads() -> None:
    radius, speed = 120.0, 15.0
    for sign in (-1.0, 1.0):  # crest, dip
        steepest = sign * 50.0 / radius
        road = straight(100.0, grade=[(0.0, -steepest), (100.0, steepest)])
        across = ground(road, placed(road, speed, s=50.0))[ACROSS]
        assert across == pytest.approx(GRAVITY + sign * speed**2 / radius, rel=1e-9)


def test_axle_loads_and_rolling_drag_grow_with_the_weight() -> None:
    """A crest halves the weight: this halves axle loads, for any pedals, and rolling drag."""
    speed = math.sqrt(0.5 * GRAVITY / 0.008)
    road = straight(100.0, grade=[(0.0, 0.4), (100.0, -0.4)])
    car = Vehicle(drag_area=0.0)
    p = ground(road, placed(road, speed, s=50.0), car)
    for throttle, brake in ((0.0, 1.0), (1.0, 0.0)):
        _, _, front, _, _, rear = axle_forces(speed, 0.0, 0.0, 1.0, 0.0, throttle, brake, p)
        assert front + rear == pytest.approx(0.5 * car.mass * GRAVITY, rel=1e-6)
        shift = throttle * car.engine_acceleration * 15.0 / speed
        shift -= brake * car.slip_control * car.grip * 0.5 * GRAVITY
        share = car.rear_axle / car.wheelbase - shift * car.cg_height / (
            0.5 * GRAVITY * car.wheelbase
        )
        assert front / (front + rear) == pytest.approx(share, rel=1e-6)
    slippery = replace(car, friction=0.3)
    p = ground(road, placed(road, speed, s=50.0), slippery)
    full = ground(straight(grade=1e-12), placed(road, speed), slippery)
    assert p[MOST_ACCELERATION] == pytest.approx(0.5 * full[MOST_ACCELERATION], rel=1e-6)
    coasting = motion(speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, p)[0]
    assert coasting == pytest.approx(-0.5 * 0.012 * GRAVITY, rel=1e-4)


def test_slopes_continue_beyond_the_ends_of_a_road() -> None:
    road = Road([0.02] * 5, pose=Pose(0.0, 0.0, 0.0), grade=[(-50.0, 0.2), (50.0, 0.05)])
    before = placed(road, 20.0, s=-1.0, left=-2.0)
    after = placed(road, 20.0, s=41.0, left=-2.0)
    for state, slope in ((before, 0.125), (after, 0.065)):
        assert ground(road, state)[ACROSS] == pytest.approx(GRAVITY / math.hypot(1.0, slope))


def test_a_car_that_would_take_off_cannot_be_steered() -> None:
    road = straight(100.0, grade=[(0.0, 0.4), (100.0, -0.4)])
    flying = math.sqrt(1.05 * GRAVITY / 0.008)
    for speed, turns in ((flying, False), (0.8 * flying, True)):
        states = periods(road, FREE, placed(road, speed, s=48.0), 2, steering=0.1)
        assert np.isfinite(states).all()
        assert (abs(states[-1, YAW_RATE]) > 1e-3) == turns


# Closed forms in a circle

RADIUS = 50.0


def circle(bank: float, turns: float = 1.5) -> Road:
    """A left-hand circle whose lane has a radius of `RADIUS`, banked to its inside."""
    radius = RADIUS - 2.0
    count = round(turns * 2.0 * math.pi * radius / 2.0)
    return Road([1.0 / radius] * count, 2.0, superelevation=-bank or 1e-12)


@pytest.mark.parametrize("bank", [0.12, 0.04, -0.08])
@pytest.mark.parametrize("speed", [6.0, 16.0])
def test_load_and_demand_in_a_steady_circle(bank: float, speed: float) -> None:
    road, b = circle(bank), math.atan(bank)
    p = ground(road, placed(road, speed, s=100.0, left=-2.0))
    yaw_rate = (speed / RADIUS - p[TWIST]) / p[TURN]  # in the plane
    assert yaw_rate == pytest.approx(speed / RADIUS * math.cos(b), rel=1e-6)
    across = speed * yaw_rate - p[PULL_LEFT]
    square = speed**2 / RADIUS
    assert p[ACROSS] == pytest.approx(GRAVITY * math.cos(b) + square * math.sin(b), rel=1e-6)
    assert across == pytest.approx(square * math.cos(b) - GRAVITY * math.sin(b), abs=1e-5)
    demand = (square / GRAVITY - bank) / (1.0 + bank * square / GRAVITY)
    assert across / p[ACROSS] == pytest.approx(demand, abs=1e-6)


def test_no_grip_is_needed_at_the_hands_off_speed() -> None:
    bank, icy = 0.12, replace(FREE, friction=0.002)
    road = circle(bank)
    for share, leaves in ((1.0, False), (1.15, True), (0.85, True)):
        speed = share * math.sqrt(bank * GRAVITY * RADIUS)
        state = placed(road, speed, left=-2.0)
        # A motion in which no wheel slides.
        state[YAW_RATE] = speed / RADIUS * math.cos(math.atan(bank))
        state[LATERAL_SPEED] = icy.rear_axle * state[YAW_RATE]
        state[HEADING] -= icy.rear_axle / RADIUS
        angle = math.atan(icy.wheelbase * state[YAW_RATE] / speed)
        state[STEERING] = angle
        states = periods(road, icy, state, 200, steering=angle)
        off = np.abs(road.track(states[:, [X, Y]])[:, 1] + 2.0).max()
        assert (off > 2.0) if leaves else (off < 0.5), (share, off)


class CircleDriver:
    """A driver that keeps the lane of a circle and reaches its speed slowly."""

    def __init__(self, speed: float) -> None:
        self.speed = speed

    def reset(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.sum = 0.0

    def act(self, observation: Observation) -> Controls:
        self.sum = min(max(self.sum + 0.05 * observation.lateral_offset, -1.0), 1.0)
        angle = self.setup.wheelbase / RADIUS
        angle -= (
            0.1 * observation.lateral_offset + 0.05 * self.sum + 0.6 * observation.heading_error
        )
        gap = min(self.speed, 3.0 + 0.6 * observation.time) - observation.speed
        return Controls.from_acceleration(
            2.0 * gap, angle, speed=observation.speed, setup=self.setup
        )


@pytest.mark.parametrize("bank", [0.12, 0.0, -0.08])
def test_the_grip_limit_of_a_banked_circle(bank: float) -> None:
    car = replace(FREE, friction=0.4)
    limit = (car.grip + bank) / (1.0 - car.grip * bank)
    simulator = EmbeddedSimulator(vehicle=car, rules=Rules(oob_tolerance=0.99))
    road = circle(bank, turns=3.0)
    for share, leaves in ((0.92, False), (1.03, True)):
        speed = share * math.sqrt(limit * GRAVITY * RADIUS)
        drive = simulator.drive(road, CircleDriver(speed))
        assert drive.trouble is None
        t = drive.trajectory
        off = np.abs(road.track(np.column_stack([t.x, t.y]))[:, 1] + 2.0).max()
        assert (off > 2.0) == leaves, (share, off, t.speed.max(), speed)
        if leaves:
            continue
        # The last records are steady: the tyres' demand there.
        state = np.array([getattr(t, name)[-1] for name in Trajectory.names()[1:8]])
        p = on_slopes(
            car.to_array(), road.table, road.sub_step, road.slopes, state, road.length, 0.0
        )[0]
        delta = state[STEERING]
        v_x, v_y, r = state[SPEED:STEERING]
        _, front, front_load, _, rear, rear_load = axle_forces(
            v_x, v_y, r, math.cos(delta), math.sin(delta), 0.0, 0.0, p
        )
        square = t.speed[-1] ** 2 / RADIUS / GRAVITY
        demand = (square - bank) / (1.0 + bank * square)
        assert (front + rear) / (front_load + rear_load) == pytest.approx(demand, rel=0.03)


# All loops


class PythonPlanner(Planner):
    """The planner, called from Python."""


class PythonStanley(Stanley):
    """Stanley, called from Python."""


@pytest.mark.parametrize(
    ("built_in", "python"), [(Planner(), PythonPlanner()), (Stanley(), PythonStanley())]
)
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_compiled_and_python_drivers_drive_alike_on_slopes(
    built_in: Driver, python: Driver, delay: float
) -> None:
    simulator = EmbeddedSimulator(start_offset=0.3)
    compiled, called = (
        simulator.drive(WINDING, Delayed(driver, seconds=delay) if delay else driver).trajectory
        for driver in (built_in, python)
    )
    np.testing.assert_array_equal(compiled.to_rows(), called.to_rows())
    level = Road(WINDING.curvatures, WINDING.step, WINDING.pose)
    flat = simulator.drive(level, built_in).trajectory
    assert np.abs(compiled.speed[20:60] - flat.speed[20:60]).max() > 0.1


@pytest.mark.parametrize("period", [0.01, 0.07, 0.2])
def test_the_period_of_a_driver_does_not_change_how_its_car_rolls(period: float) -> None:
    road = straight(grade=[(0.0, -0.08), (60.0, 0.06)])
    driver = DummyDriver()
    simulator = EmbeddedSimulator(vehicle=FREE, rules=PATIENT)
    default = simulator.drive(road, driver).trajectory
    driver.period = period  # type: ignore[attr-defined]
    with_period = simulator.drive(road, driver).trajectory
    n = min(len(default), len(with_period), 200)
    assert with_period.x[:n] == pytest.approx(default.x[:n], abs=0.02)


# What a driver sees, and what cannot be driven


def test_a_driver_sees_the_slopes_ahead() -> None:
    class Looking(Stanley):
        def act(self, observation: Observation) -> Controls:
            self.lane = observation.lane(spacing=5.0, ahead=40.0, behind=5.0)
            self.at = observation.distance
            return super().act(observation)

    for road in (WINDING, Road([0.0] * 6)):
        driver = Looking()
        assert EmbeddedSimulator().drive(road, driver).trouble is None
        places = driver.at + driver.lane.distances
        for values, slope in (
            (driver.lane.grades, road.grade),
            (driver.lane.superelevations, road.superelevation),
        ):
            assert values == pytest.approx(profile.value_at(slope, places), abs=1e-12)
            assert values.shape == (10,)
            assert values.any() == (road is WINDING)


class Sledge(SteppedSimulator):
    """A simulator that does not declare slopes."""


def test_a_sloping_road_is_refused_where_slopes_are_not_supported() -> None:
    candidate = Candidate(1, np.zeros(8), 10.0, Origin("random"), grade=np.array([[0.0, 0.05]]))
    assert RoadTester(EmbeddedSimulator(), Planner()).test(candidate).result.outcome is Outcome.PASS
    with_camera = load_driver("marking-follower")
    undriven: tuple[tuple[Simulator, Driver, str], ...] = (
        (DummySimulator(), DummyDriver(), "DummySimulator drives"),
        (Sledge(), DummyDriver(), "Sledge drives"),
        (EmbeddedSimulator(), with_camera, "A camera sees"),
    )
    for simulator, driver, who in undriven:
        result = RoadTester(simulator, driver).test(candidate).result
        assert result.outcome is Outcome.INVALID
        refusal = "flat roads of one width only: leave superelevation, grade and widening out"
        assert result.reason == f"{who} {refusal}"
    drives: tuple[tuple[Simulator, Driver], ...] = (
        (Sledge(), DummyDriver()),
        (MetaDriveSimulator(), DummyDriver()),
        (BeamngSimulator(port=1), DummyDriver()),
        (EmbeddedSimulator(), with_camera),
    )
    for simulator, driver in drives:
        with pytest.raises(RoadError, match="flat roads"):
            simulator.drive(WINDING, driver)
