"""The embedded vehicle model, against the CommonRoad models, energy and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_car import advance
from scipy.integrate import solve_ivp
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.utils.tire_model import formula_lateral
from vehiclemodels.vehicle_dynamics_ks import vehicle_dynamics_ks
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

from frenetic._support.arrays import FloatArray
from frenetic.drivers.driver import DRAG_FADE_SPEED
from frenetic.oracle.drive import CarBody
from frenetic.road.classes import GRAVITY
from frenetic.simulators.embedded import single_track
from frenetic.simulators.embedded.single_track import (
    HEADING,
    LATERAL_SPEED,
    SPEED,
    STATE_SIZE,
    STEERING,
    YAW_RATE,
    X,
    Y,
    motion,
)
from frenetic.simulators.embedded.vehicle import Vehicle

DT = 0.01  # s
CAR = Vehicle()
FREE = Vehicle(drag_area=0.0, rolling_resistance=0.0)
"""The car of the CommonRoad models, which have no drag."""
LIMIT = CAR.grip * GRAVITY
"""Largest acceleration that the tyres allow, in m/s²."""

Inputs = Callable[[float], tuple[float, float, float]]
"""Time [s] to steering [rad], throttle and brake."""


@pytest.fixture(scope="module")
def bmw() -> Any:
    """The parameters of CommonRoad's vehicle 2, a BMW 320i."""
    return parameters_vehicle2()


def at(speed: float, **values: float) -> FloatArray:
    """Return a state with a speed in m/s and some other values; the rest is 0."""
    index = {"vy": LATERAL_SPEED, "r": YAW_RATE, "delta": STEERING, "heading": HEADING}
    state = np.zeros(STATE_SIZE)
    state[SPEED] = speed
    for name, value in values.items():
        state[index[name]] = value
    return state


def rates(
    car: Vehicle,
    state: FloatArray,
    *,
    steering: float = 0.0,
    throttle: float = 0.0,
    brake: float = 0.0,
) -> FloatArray:
    """Return the time derivative of a state."""
    _, _, heading, v_x, v_y, r, delta = state
    pedals = min(max(throttle, 0.0), 1.0), min(max(brake, 0.0), 1.0)
    slopes = motion(v_x, v_y, r, delta, steering, *pedals, car.to_array())
    c, s = math.cos(heading), math.sin(heading)
    return np.array([v_x * c - v_y * s, v_x * s + v_y * c, r, *slopes])


def axle_forces(
    state: FloatArray, throttle: float, brake: float, p: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return F_x, F_y and F_z in N of the front axle, then of the rear axle."""
    delta = state[STEERING]
    v_x, v_y, r = state[SPEED:STEERING]
    forces: tuple[float, float, float, float, float, float] = single_track.axle_forces(
        v_x, v_y, r, math.cos(delta), math.sin(delta), throttle, brake, p
    )
    return forces


def simulate(
    car: Vehicle, state: FloatArray, inputs: Inputs, duration: float, dt: float = DT
) -> FloatArray:
    """Return the states, (n + 1, 7), from the start to the end."""
    p = car.to_array()
    state = state.copy()
    states = [state.copy()]
    for k in range(round(duration / dt)):
        advance(state, *inputs(k * dt), p, dt)
        states.append(state.copy())
    return np.array(states)


def constant_inputs(steering: float = 0.0, throttle: float = 0.0, brake: float = 0.0) -> Inputs:
    return lambda _: (steering, throttle, brake)


def kinetic_energy(car: Vehicle, states: FloatArray) -> FloatArray:
    speeds = states[..., SPEED] ** 2 + states[..., LATERAL_SPEED] ** 2
    energy: FloatArray = 0.5 * (car.mass * speeds + car.yaw_inertia * states[..., YAW_RATE] ** 2)
    return energy


def power(car: Vehicle, state: FloatArray, rate: FloatArray) -> float:
    """Return the time derivative of the kinetic energy, in W."""
    along = state[SPEED] * rate[SPEED] + state[LATERAL_SPEED] * rate[LATERAL_SPEED]
    return float(car.mass * along + car.yaw_inertia * state[YAW_RATE] * rate[YAW_RATE])


def finite(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


SHARE = finite(0.0, 1.0)


@st.composite
def states(draw: st.DrawFn) -> FloatArray:
    """Draw a state of a car, which may spin or slide backwards."""
    return np.array(
        [
            0.0,
            0.0,
            draw(finite(-4.0, 4.0)),
            draw(finite(-15.0, 40.0)),
            draw(finite(-15.0, 15.0)),
            draw(finite(-3.0, 3.0)),
            draw(finite(-CAR.steering_limit, CAR.steering_limit)),
        ]
    )


class TestParameters:
    def test_parameters_equal_the_reference(self, bmw: Any) -> None:
        assert CAR.mass == bmw.m
        assert CAR.yaw_inertia == bmw.I_z
        assert (CAR.front_axle, CAR.rear_axle, CAR.cg_height) == (bmw.a, bmw.b, bmw.h_s)
        assert (CAR.length, CAR.width) == (bmw.l, bmw.w)
        assert (CAR.tyre_shape, CAR.tyre_peak) == (bmw.tire.p_cy1, bmw.tire.p_dy1)
        assert CAR.tyre_stiffness == -bmw.tire.p_ky1
        assert (CAR.steering_limit, CAR.steering_rate) == (bmw.steering.max, bmw.steering.v_max)
        assert CAR.brake_front_share == bmw.T_sb

    def test_front_and_rear_overhang_are_equal(self) -> None:
        body = CAR.body()
        assert isinstance(body, CarBody)
        front_overhang = body.centre_ahead + body.length / 2 - CAR.front_axle
        rear_overhang = -body.centre_ahead + body.length / 2 - CAR.rear_axle
        assert front_overhang == pytest.approx(rear_overhang)
        assert body.centre_ahead == pytest.approx(-0.133, abs=5e-4)
        shifted = replace(CAR, body_shift=0.1).body().centre_ahead
        assert shifted == pytest.approx(body.centre_ahead + 0.1)

    @pytest.mark.parametrize("name", [item.name for item in fields(Vehicle)])
    def test_a_value_that_is_no_valid_number_is_refused(self, name: str) -> None:
        for value in (-1.0, math.nan, math.inf, "x"):
            with pytest.raises(ValueError, match=f"^{name} is {value!r}: a number.* is needed"):
                replace(CAR, **{name: value})  # type: ignore[arg-type]

    @pytest.mark.parametrize(
        ("name", "value", "message"),
        [
            ("mass", 0.0, "mass is 0.0: a number > 0 is needed"),
            ("slip_control", 1.1, "slip_control is 1.1: a number <= 1 is needed"),
            ("tyre_shape", 2.1, "tyre_shape is 2.1: a number <= 2 is needed"),
            ("steering_limit", 1.6, "steering_limit is 1.6: a number < 1.57"),
            ("friction", 2.0, "such grip lifts an axle off the ground"),
            ("crawl_speed", 0.5, r"crawl_speed is 0.5 m/s: .* at least 1.08 m/s are needed"),
            ("tyre_stiffness", 60.0, "crawl_speed is 2.0 m/s: with this tyre_stiffness"),
            ("steering_lag", 0.001, "steering_lag is 0.001 s: at least 0.005 s are needed"),
        ],
    )
    def test_a_value_out_of_range_is_refused(self, name: str, value: float, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            replace(CAR, **{name: value})

    def test_a_named_car_can_be_changed(self) -> None:
        assert Vehicle.of({"name": "etk800", "mass": 1600.0}) == replace(
            Vehicle.named("etk800"), mass=1600.0
        )
        for description, message in (
            ({"name": "truck"}, "vehicle is 'truck': default, metadrive or etk800 is needed"),
            ({"wheels": 4.0}, "vehicle has no 'wheels'; it has: mass, "),
            ({"mass": True}, "mass is True: a number is needed"),
        ):
            with pytest.raises(ValueError, match=message):
                Vehicle.of(description)


class TestAgainstSingleTrack:
    """Comparison with CommonRoad's single-track model, whose tyres are linear.

    Slip stays below 0.5 degrees. There, the Magic Formula is up to 1.2 % below its tangent.
    """

    @pytest.mark.parametrize("acceleration", [-0.5, 0.0, 0.5])
    def test_derivatives_agree_with_the_single_track_model(
        self, bmw: Any, acceleration: float
    ) -> None:
        rng = np.random.default_rng(1)
        throttle = max(acceleration, 0.0) / FREE.engine_acceleration
        brake = max(-acceleration, 0.0) / FREE.brake_deceleration
        car = replace(FREE, switch_speed=50.0)
        for _ in range(300):
            v = rng.uniform(8.0, 30.0)
            r = rng.uniform(-0.15, 0.15)
            slip_f, slip_r = np.radians(rng.uniform(-0.5, 0.5, 2))
            v_y = car.rear_axle * r - v * math.tan(slip_r)
            delta = slip_f + math.atan((v_y + car.front_axle * r) / v)
            state = at(v, vy=v_y, r=r, delta=delta)

            derivatives = rates(car, state, steering=delta, throttle=throttle, brake=brake)
            speed = math.hypot(v, v_y)
            slip_rate = (v * derivatives[LATERAL_SPEED] - v_y * derivatives[SPEED]) / speed**2
            reference_rates = vehicle_dynamics_st(
                [0.0, 0.0, delta, speed, 0.0, r, math.atan2(v_y, v)], [0.0, acceleration], bmw
            )

            # The reference leaves out the front brake's force across the car, and the change of the
            # slip angle with the speed along the car.
            brake_across = axle_forces(state, throttle, brake, car.to_array())[0]
            brake_across *= math.sin(delta)
            yaw_rate = reference_rates[5] + car.front_axle * brake_across / car.yaw_inertia
            slip = (
                reference_rates[6] + (brake_across / car.mass - acceleration * v_y / speed) / speed
            )

            # Both rates are differences between the axles: the tolerance is a share of their sum.
            stiffness = car.tyre_stiffness * car.mass * GRAVITY / car.wheelbase
            front = stiffness * car.rear_axle * abs(slip_f)
            rear = stiffness * car.front_axle * abs(slip_r)
            turning = (car.front_axle * front + car.rear_axle * rear) / car.yaw_inertia
            sliding = (front + rear) / (car.mass * speed)
            assert derivatives[YAW_RATE] == pytest.approx(yaw_rate, abs=0.025 * turning + 1e-3)
            assert slip_rate == pytest.approx(slip, abs=0.025 * sliding + 1e-4)


class TestAgainstKinematicModel:
    def test_a_slow_car_follows_its_wheels(self, bmw: Any) -> None:
        def steering_at(t: float) -> float:
            return 0.3 * math.sin(0.8 * t)

        def reference_motion(t: float, x: FloatArray) -> list[float]:
            wanted = (steering_at(t) - x[2]) / FREE.steering_lag
            v = float(np.interp(t, times, states_of_car[:, SPEED]))
            rate: list[float] = vehicle_dynamics_ks([*x[:3], v, x[4]], [wanted, 0.0], bmw)
            return rate

        speed = 2.0
        states_of_car = simulate(
            FREE, at(speed), lambda t: (steering_at(t + DT / 2), 0.0, 0.0), 10.0
        )
        times = np.arange(len(states_of_car)) * DT
        start = [-FREE.rear_axle, 0.0, 0.0, 0.0, 0.0]  # the reference model moves its rear axle
        reference = solve_ivp(reference_motion, (0.0, 10.0), start, rtol=1e-8, atol=1e-8).y[:, -1]

        x, y, heading = states_of_car[-1, :3]
        rear_x = x - FREE.rear_axle * math.cos(heading)
        rear_y = y - FREE.rear_axle * math.sin(heading)
        assert math.hypot(rear_x - reference[0], rear_y - reference[1]) < 0.02 * speed
        assert heading == pytest.approx(reference[4], abs=0.003 * speed)


class TestTyres:
    def test_lateral_force_is_the_magic_formula(self, bmw: Any) -> None:
        speed = 20.0
        for slip in np.linspace(-1.3, 1.3, 131):
            state = at(speed, vy=-speed * math.tan(slip))
            _, front_y, front_z, _, rear_y, rear_z = axle_forces(state, 0.0, 0.0, CAR.to_array())
            # The reference counts slip to the left, our model to the right.
            front = formula_lateral(slip, 0.0, front_z, bmw.tire)[0]
            rear = formula_lateral(slip, 0.0, rear_z, bmw.tire)[0]
            share = 0.001 if abs(slip) < 0.1 else 0.026
            assert front_y == pytest.approx(-front, abs=share * CAR.grip * front_z)
            assert rear_y == pytest.approx(-rear, abs=share * CAR.grip * rear_z)
            assert front_y * slip >= 0.0

    def test_friction_lowers_the_peak_and_leaves_the_stiffness(self) -> None:
        def force(car: Vehicle, slip: float) -> float:
            front_y: float = axle_forces(at(20.0, vy=-20.0 * slip), 0.0, 0.0, car.to_array())[1]
            return front_y

        wet = replace(CAR, friction=0.5)
        assert force(wet, 1e-4) == pytest.approx(force(CAR, 1e-4), rel=1e-4)
        slips = np.linspace(0.0, 0.5, 501)
        peak = max(force(CAR, slip) for slip in slips)
        assert max(force(wet, slip) for slip in slips) == pytest.approx(0.5 * peak, rel=1e-4)

    @given(states(), SHARE, SHARE, finite(0.2, 1.5))
    @settings(max_examples=150)
    def test_no_axle_leaves_its_friction_circle(
        self, state: FloatArray, throttle: float, brake: float, friction: float
    ) -> None:
        car = replace(CAR, friction=friction)
        front_x, front_y, front_z, rear_x, rear_y, rear_z = axle_forces(
            state, throttle, brake, car.to_array()
        )
        assert math.hypot(front_x, front_y) <= car.grip * front_z * (1.0 + 1e-12)
        assert math.hypot(rear_x, rear_y) <= car.grip * rear_z * (1.0 + 1e-12)
        assert min(front_z, rear_z) > 0.0
        assert front_z + rear_z == pytest.approx(car.mass * GRAVITY)
        assert abs(front_x) <= car.slip_control * car.grip * front_z * (1.0 + 1e-12)

    def test_braking_shifts_load_to_the_front_and_driving_to_the_rear(self) -> None:
        p = CAR.to_array()
        coasting = axle_forces(at(10.0), 0.0, 0.0, p)[2]
        shift = CAR.mass * CAR.cg_height / CAR.wheelbase
        braking = axle_forces(at(10.0), 0.0, 1.0, p)[2]
        driving = axle_forces(at(10.0), 1.0, 0.0, p)[2]
        assert coasting == pytest.approx(CAR.mass * GRAVITY * CAR.rear_axle / CAR.wheelbase)
        assert braking - coasting == pytest.approx(shift * CAR.brake_deceleration)
        assert coasting - driving == pytest.approx(shift * CAR.engine_acceleration)
        snow = replace(CAR, friction=0.3)
        limit = snow.slip_control * snow.grip * GRAVITY
        braking = axle_forces(at(10.0), 0.0, 1.0, snow.to_array())[2]
        assert braking - coasting == pytest.approx(shift * limit)

    def test_softer_front_tyres_give_less_force_for_a_small_slip(self) -> None:
        car = replace(CAR, front_stiffness=0.4)
        _, front_y, front_z, _, rear_y, rear_z = axle_forces(
            at(20.0, vy=-0.002), 0.0, 0.0, car.to_array()
        )
        assert front_y / front_z == pytest.approx(0.4 * rear_y / rear_z, rel=1e-4)

    def test_the_engine_drives_the_axles_by_their_shares(self) -> None:
        for share in (0.0, 0.4, 1.0):
            car = replace(CAR, drive_front_share=share, engine_acceleration=2.0)
            front_x, _, _, rear_x, _, _ = axle_forces(at(10.0), 1.0, 0.0, car.to_array())
            assert front_x == pytest.approx(share * CAR.mass * 2.0)
            assert rear_x == pytest.approx((1.0 - share) * CAR.mass * 2.0)

    @pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
    def test_the_driven_tyres_limit_how_a_strong_engine_moves_the_load(self, share: float) -> None:
        car = replace(CAR, drive_front_share=share, engine_acceleration=30.0)
        front_x, _, front_z, rear_x, _, rear_z = axle_forces(at(10.0), 1.0, 0.0, car.to_array())
        usable = car.slip_control * car.grip
        assert front_x == pytest.approx(usable * front_z if share else 0.0)
        assert rear_x == pytest.approx(usable * rear_z if share < 1.0 else 0.0)
        # The load that moves back belongs to the acceleration of these forces.
        at_rest = CAR.mass * GRAVITY * CAR.rear_axle / CAR.wheelbase
        moved = (front_x + rear_x) * CAR.cg_height / CAR.wheelbase
        assert at_rest - front_z == pytest.approx(moved)

    def test_a_lower_weight_of_the_force_along_a_wheel_leaves_more_grip_across(self) -> None:
        state = at(20.0, vy=-20.0)  # a slip at which the tyres slide
        for weight in (0.0, 0.5, 1.0):
            car = replace(CAR, along_weight=weight)
            front_x, front_y, front_z, *_ = axle_forces(state, 0.0, 1.0, car.to_array())
            free = replace(CAR, slip_control=1e-9)
            _, free_y, free_z, *_ = axle_forces(state, 0.0, 1.0, free.to_array())
            left = math.sqrt((car.grip * front_z) ** 2 - (weight * front_x) ** 2)
            assert front_y / free_y == pytest.approx(left / (car.grip * free_z))

    def test_a_sharp_turn_reaches_the_grip_limit(self) -> None:
        driven = simulate(FREE, at(20.0), constant_inputs(0.12), 2.0)
        lateral = [rates(FREE, s)[LATERAL_SPEED] + s[SPEED] * s[YAW_RATE] for s in driven]
        assert max(lateral) > 0.95 * LIMIT


class TestEnergy:
    def test_drag_is_air_drag_plus_rolling_drag(self) -> None:
        expected = (0.5 * 1.2 * 0.65 * 20.0**2 + 0.012 * CAR.mass * GRAVITY) / CAR.mass
        assert rates(CAR, at(20.0))[SPEED] == pytest.approx(-expected)

    @given(states(), finite(-1.2, 1.2), SHARE)
    @settings(max_examples=50)
    def test_a_slide_ends_at_rest(self, state: FloatArray, steering: float, brake: float) -> None:
        driven = simulate(CAR, state, constant_inputs(steering, 0.0, max(brake, 0.2)), 30.0)
        energy = kinetic_energy(CAR, driven)
        assert (np.diff(energy) <= 1e-9 * energy[:-1] + 1e-12).all()
        assert energy[-1] < 1e-6

    @given(states(), finite(-1.2, 1.2), SHARE, SHARE)
    @settings(max_examples=100)
    def test_the_engine_gives_no_more_than_its_power(
        self, state: FloatArray, steering: float, throttle: float, brake: float
    ) -> None:
        rate = rates(CAR, state, steering=steering, throttle=throttle, brake=brake)
        limit = throttle * CAR.mass * CAR.engine_acceleration * CAR.switch_speed
        assert power(CAR, state, rate) <= limit * (1.0 + 1e-9) + 1e-6

    @pytest.mark.parametrize("throttle", [0.3, 1.0])
    def test_the_energy_gained_is_the_work_of_the_engine(self, throttle: float) -> None:
        acceleration = throttle * FREE.engine_acceleration
        switched = FREE.switch_speed / acceleration
        driven = simulate(FREE, at(0.0), constant_inputs(throttle=throttle), 15.0)
        for t in (2.0, 15.0):
            slow = min(t, switched)
            gained = 0.5 * (acceleration * slow) ** 2
            gained += acceleration * FREE.switch_speed * (t - slow)
            energy = kinetic_energy(FREE, driven[round(t / DT)])
            assert energy / FREE.mass == pytest.approx(gained, rel=1e-5)

    def test_traction_limits_the_start_on_snow(self) -> None:
        car = replace(FREE, friction=0.3)
        usable = car.slip_control * car.grip
        limit = usable * GRAVITY * car.front_axle / (car.wheelbase - usable * car.cg_height)
        assert rates(car, at(3.0), throttle=1.0)[SPEED] == pytest.approx(limit)

    @pytest.mark.parametrize(("speed", "friction"), [(5.0, 1.0), (20.0, 0.4), (40.0, 0.7)])
    def test_braking_distance(self, speed: float, friction: float) -> None:
        car = replace(FREE, friction=friction)
        deceleration = min(car.brake_deceleration, car.slip_control * car.grip * GRAVITY)
        end = simulate(car, at(speed), constant_inputs(brake=1.0), speed / deceleration + 2.0)[-1]
        assert 0.0 <= end[SPEED] < 1e-6
        # Below the speed at which fading brakes are weaker than the tyres, the way doubles.
        fading = DRAG_FADE_SPEED * deceleration / car.brake_deceleration
        squares = speed**2 + fading**2
        assert end[X] == pytest.approx(squares / (2.0 * deceleration), rel=1e-3)
        assert end[X] > speed**2 / (2.0 * car.grip * GRAVITY)


class TestActuator:
    def test_steering_moves_at_its_rate_limit_then_lags(self) -> None:
        """Steering moves at 0.4 rad/s until 0.4 rad/s times the lag is left; the rest decays."""
        wanted = 0.3
        lag, rate = CAR.steering_lag, CAR.steering_rate
        angles = simulate(CAR, at(5.0), constant_inputs(wanted), 1.5)[:, STEERING]
        turn = (wanted - rate * lag) / rate
        for k, angle in enumerate(angles):
            t = k * DT
            left = rate * lag * math.exp(-(t - turn) / lag)
            expected = rate * t if t <= turn else wanted - left
            assert angle == pytest.approx(expected, abs=1e-4)

    def test_pedals_are_cut_to_0_to_1(self) -> None:
        assert np.array_equal(
            rates(CAR, at(10.0), throttle=2.0, brake=-1.0), rates(CAR, at(10.0), throttle=1.0)
        )
        assert np.array_equal(
            rates(CAR, at(10.0), throttle=-1.0, brake=2.0), rates(CAR, at(10.0), brake=1.0)
        )


class TestStandstill:
    @pytest.mark.parametrize("brake", [0.0, 1.0])
    def test_a_car_at_rest_stays(self, brake: float) -> None:
        start = at(0.0, delta=0.3, heading=1.0)
        end = simulate(CAR, start, constant_inputs(0.3, 0.0, brake), 5.0)[-1]
        assert np.array_equal(end, start)

    @pytest.mark.parametrize("speed", [0.3, 2.0, 10.0])
    @pytest.mark.parametrize("delta", [0.0, 0.2, 0.5])
    def test_braking_never_moves_a_car_backwards(self, speed: float, delta: float) -> None:
        driven = simulate(CAR, at(speed, delta=delta), constant_inputs(delta, brake=1.0), 4.0)
        assert (driven[:, SPEED] >= 0.0).all()
        assert np.abs(driven[-1, SPEED : YAW_RATE + 1]).max() < 1e-6

    def test_brakes_stop_a_backward_slide(self) -> None:
        """The way is longer than forwards: the load is at the rear, the brakes are in front."""
        end = simulate(CAR, at(-10.0), constant_inputs(brake=1.0), 4.0)[-1]
        assert abs(end[SPEED]) < 1e-6
        best = 10.0**2 / (2.0 * CAR.brake_deceleration)
        assert -1.5 * best < end[X] < -best


def schedule(seed: int) -> Inputs:
    """Return random inputs that change every 50 ms."""
    rng = np.random.default_rng(seed)
    steering = rng.uniform(-0.3, 0.3, 200)
    throttle = rng.uniform(0.0, 1.0, 200)
    brake = np.where(rng.uniform(0.0, 1.0, 200) < 0.2, 0.6, 0.0)

    def inputs(t: float) -> tuple[float, float, float]:
        k = int(t / 0.05 + 1e-6)
        return float(steering[k]), float(throttle[k]), float(brake[k])

    return inputs


class TestIntegration:
    def test_mirrored_steering_mirrors_the_path(self) -> None:
        def mirrored(t: float) -> tuple[float, float, float]:
            steering, throttle, brake = inputs(t)
            return -steering, throttle, brake

        inputs = schedule(1)
        left = simulate(CAR, at(12.0), inputs, 5.0)
        right = simulate(CAR, at(12.0), mirrored, 5.0)
        assert np.array_equal(left[:, [X, SPEED]], right[:, [X, SPEED]])
        odd = [Y, HEADING, LATERAL_SPEED, YAW_RATE, STEERING]
        assert np.array_equal(left[:, odd], -right[:, odd])

    @given(states(), finite(-1.2, 1.2), SHARE, SHARE)
    @settings(max_examples=80)
    def test_a_step_is_rk4_of_the_derivative(
        self, state: FloatArray, steering: float, throttle: float, brake: float
    ) -> None:
        def rate(x: FloatArray) -> FloatArray:
            return rates(CAR, x, steering=steering, throttle=throttle, brake=brake)

        k1 = rate(state)
        k2 = rate(state + DT / 2 * k1)
        k3 = rate(state + DT / 2 * k2)
        k4 = rate(state + DT * k3)
        expected = state + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        advance(state, steering, throttle, brake, CAR.to_array(), DT)
        assert state == pytest.approx(expected, abs=1e-9)

    @given(
        states(),
        st.lists(st.tuples(finite(-3.0, 3.0), SHARE, SHARE), min_size=1, max_size=20),
        finite(0.1, 1.5),
    )
    @settings(max_examples=100)
    def test_any_inputs_leave_the_state_finite(
        self, state: FloatArray, inputs: list[tuple[float, float, float]], friction: float
    ) -> None:
        car = replace(CAR, friction=friction)
        p = car.to_array()
        energy = kinetic_energy(car, state)
        engine = car.mass * car.engine_acceleration * car.switch_speed
        for controls in inputs:
            for _ in range(20):
                advance(state, *controls, p, DT)
            energy += engine * 20 * DT
            assert np.isfinite(state).all()
            assert abs(state[STEERING]) <= car.steering_limit + 1e-12
            assert kinetic_energy(car, state) <= energy * (1.0 + 1e-9)
