"""Manoeuvres measure what a linear car with a proportional driver does in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from linear_car import Proportional, car_at

from frenetic import BeamngAi, Controls, DriveSetup, EmbeddedSimulator, Observation, Planner
from frenetic.errors import FreneticError
from frenetic.manoeuvres import LaneOffset, drive_manoeuvre
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import MANOEUVRES
from frenetic.road.road_values import USUAL_CHANGE
from frenetic.road.validity import MIN_RADIUS

BoolArray = npt.NDArray[np.bool_]
SPEED = 20.0  # m/s
TIME = np.linspace(0.0, 20.0, 200_001)  # s
DRIVERS = [
    Proportional(1.5, 0.5, SPEED),
    Proportional(2.0, 0.7, SPEED),
    Proportional(1.2, 0.3, SPEED),
]
NAMES = ("step", "lane-offset", "constant-radius", "sine", "slalom")


def first_time(is_reached: BoolArray) -> float:
    return float(TIME[np.argmax(is_reached)])


def last_time(is_outside: BoolArray) -> float:
    return float(TIME[np.flatnonzero(is_outside)[-1]])


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: f"zeta {driver.zeta}")
@pytest.mark.parametrize("offset", [0.3, -0.2])
def test_the_response_to_an_offset_is_that_of_a_second_order_system(
    driver: Proportional, offset: float
) -> None:
    result = drive_manoeuvre("lane-offset", driver, car_at(SPEED), offset=offset, hold=16.0)
    left = driver.offset_after(TIME)
    overshoot = 100.0 * math.exp(-math.pi * driver.zeta / math.sqrt(1.0 - driver.zeta**2))
    assert result.result.outcome is Outcome.PASS
    assert result["overshoot"] == pytest.approx(overshoot, abs=0.5)
    rise_time = first_time(left <= 0.1) - first_time(left <= 0.9)
    assert result["rise_time"] == pytest.approx(rise_time, abs=0.02)
    assert result["delay"] == pytest.approx(first_time(left <= 0.5), abs=0.02)
    assert result["settling_time"] == pytest.approx(last_time(abs(left) > 0.05), rel=0.02)
    assert result["steady_offset"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: f"zeta {driver.zeta}")
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_response_to_a_step_is_that_of_a_second_order_system(
    driver: Proportional, side: str
) -> None:
    options: dict[str, Any] = {"radius": 800.0, "transition": 1.0, "hold": 16.0, "side": side}
    result = drive_manoeuvre("step", driver, car_at(SPEED), **options)
    share = driver.curvature_after(TIME)
    sign = 1.0 if side == "left" else -1.0
    curvature = 1.0 / (800.0 + sign * 2.0)  # of the lane's centre, half a lane further right
    assert result["speed"] == pytest.approx(3.6 * SPEED)
    assert result["overshoot"] == pytest.approx(100.0 * (share.max() - 1.0), abs=0.5)
    rise_time = first_time(share >= 0.9) - first_time(share >= 0.1)
    assert result["rise_time"] == pytest.approx(rise_time, abs=0.03)
    assert result["delay"] == pytest.approx(first_time(share >= 0.5), abs=0.03)
    assert result["settling_time"] == pytest.approx(last_time(abs(share - 1.0) > 0.05), rel=0.02)
    # The steering of the bend needs an offset to its outside.
    steady_offset = -sign * curvature / driver.per_offset
    assert result["steady_offset"] == pytest.approx(steady_offset, rel=0.01)


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: f"zeta {driver.zeta}")
def test_gain_lag_and_bandwidth_are_those_of_a_second_order_system(driver: Proportional) -> None:
    result = drive_manoeuvre("sine", driver, car_at(SPEED), acceleration=0.3, shortest=1.0)
    rows = result.measures.tables["frequencies"]
    assert [row["frequency"] for row in rows] == pytest.approx(
        [1.0 / period for period in np.geomspace(8.0, 1.0, 12)], rel=0.01
    )
    for row in rows:
        transfer = driver.transfer(row["frequency"])
        assert row["gain"] == pytest.approx(abs(transfer), rel=0.02)
        assert row["lag"] == pytest.approx(-math.degrees(np.angle(transfer)), abs=2.0)
        assert row["delay"] == pytest.approx(row["lag"] / 360.0 / row["frequency"])
    assert result["bandwidth"] == pytest.approx(driver.bandwidth, rel=0.03)
    gains = [abs(driver.transfer(row["frequency"])) for row in rows]
    assert result["largest_gain"] == pytest.approx(max(gains), rel=0.03)
    assert result["largest_gain_at"] == rows[int(np.argmax(gains))]["frequency"]


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: f"zeta {driver.zeta}")
def test_a_slalom_has_the_gain_and_delay_of_its_period(driver: Proportional) -> None:
    options: dict[str, Any] = {"period": 5.0, "acceleration": 0.3, "periods": 6}
    result = drive_manoeuvre("slalom", driver, car_at(SPEED), **options)
    transfer = driver.transfer(1.0 / 5.0)
    assert result["gain"] == pytest.approx(abs(transfer), rel=0.04)
    delay = -float(np.angle(transfer)) / math.tau * 5.0
    assert result["phase_delay"] == pytest.approx(delay, abs=0.03)
    # e = -v² κ / (s² + 2 ζ ω s + ω²): at least in the last periods the offset is so large.
    s = 2j * math.pi / 5.0
    steady = 0.3 / abs(s**2 + 2.0 * driver.zeta * driver.omega * s + driver.omega**2)
    assert 0.97 * steady <= abs(result["largest_offset"]) <= 1.6 * steady


def test_a_kinematic_car_steers_the_geometric_angle() -> None:
    result = drive_manoeuvre("constant-radius", DRIVERS[1], car_at(SPEED), radius=400.0, hold=15.0)
    assert result["steering"] == pytest.approx(math.degrees(math.atan(2.6 / 402.0)), rel=0.01)
    assert result["geometric_steering"] == pytest.approx(result["steering"], rel=1e-3)
    assert result["understeer"] == pytest.approx(0.0, abs=1e-3)
    assert result["lateral_acceleration"] == pytest.approx(SPEED**2 / 402.0, rel=0.01)


@pytest.mark.parametrize("side", ["left", "right"])
def test_understeer_follows_from_the_axles_stiffness(side: str) -> None:
    simulator = EmbeddedSimulator(vehicle="etk800")
    options: dict[str, Any] = {"acceleration": 0.5, "side": side}
    result = drive_manoeuvre("constant-radius", Planner(), simulator, **options)
    setup = simulator.setup(result.road)
    assert setup.mass is not None
    assert setup.front_cornering_stiffness is not None
    assert setup.rear_cornering_stiffness is not None
    # The linear single-track model: each axle slips by its share of the load over its stiffness.
    front = setup.rear_axle / setup.front_cornering_stiffness
    rear = setup.front_axle / setup.rear_cornering_stiffness
    gradient = math.degrees(setup.mass / setup.wheelbase * (front - rear))
    assert abs(gradient) > 0.1
    assert result["understeer_gradient"] == pytest.approx(gradient, rel=0.05)


class Straight:
    """Never steers."""

    def reset(self, setup: DriveSetup) -> None: ...

    def act(self, observation: Observation) -> Controls:
        return Controls(0.0, throttle=0.5 if observation.speed < 15.0 else 0.0)


class Parallel(Proportional):
    """Keeps the heading of the lane, wherever it is in the lane."""

    def act(self, observation: Observation) -> Controls:
        return Controls(-0.1 * observation.heading_error)


class Restless(Proportional):
    """Steers by the same angle to the side of the lane's centre, and never comes to rest."""

    def act(self, observation: Observation) -> Controls:
        side = observation.lateral_offset + 0.2 * math.sin(4.0 * observation.time)
        return Controls(-math.copysign(0.01, side))


@pytest.mark.parametrize("name", ["step", "constant-radius", "sine", "slalom"])
def test_a_car_that_leaves_its_lane_has_no_numbers_but_a_reason(name: str) -> None:
    options: dict[str, Any] = {"acceleration": 2.0}
    if name == "sine":
        options["longest"] = 20.0
    result = drive_manoeuvre(name, Straight(), EmbeddedSimulator(), **options)
    assert result.result.outcome is Outcome.FAIL
    departure = result.result.departure
    assert departure is not None
    end = f"the drive ended at {departure.distance:.0f} m"
    assert result.measures.quantities
    assert {quantity.reason for quantity in result.measures.quantities} == {f"not measured: {end}"}
    with pytest.raises(KeyError, match=end):
        result[result.measures.quantities[0].name]


def test_a_response_that_never_settles_says_so() -> None:
    driver = Restless(1.5, 0.5, SPEED)
    result = drive_manoeuvre("lane-offset", driver, car_at(SPEED), offset=0.3)
    for name in ("settling_time", "steady_offset"):
        quantity = result.quantity(name)
        assert quantity.value is None
        assert quantity.reason.startswith("never settles: it still moves by")
        assert quantity.text == quantity.reason
    with pytest.raises(KeyError, match="there are start_speed, rise_time, delay"):
        result["nothing"]


def test_a_car_that_does_not_move_in_its_lane_has_no_response() -> None:
    result = drive_manoeuvre("lane-offset", Parallel(1.5, 0.5, SPEED), car_at(SPEED), offset=0.3)
    for name in ("rise_time", "delay", "overshoot", "settling_time"):
        assert result.quantity(name).text == "does not move"
    assert result["steady_offset"] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("speed", [5.0, 30.0, 130.0])
@pytest.mark.parametrize("name", NAMES)
def test_roads_bend_as_far_as_roads_may_at_any_speed(name: str, speed: float) -> None:
    options = {} if name == "lane-offset" else {"acceleration": 50.0}
    road = MANOEUVRES.make(name, **options).road(speed / 3.6, 4.0)
    sharpest = float(np.abs(road.curvatures).max())
    assert sharpest <= 1.0 / MIN_RADIUS + 1e-12
    change = np.abs(np.diff(road.curvatures)).max() / road.step * 10.0
    assert change <= USUAL_CHANGE + 1e-9


def test_a_driver_that_breaks_has_no_numbers() -> None:
    class Broken(Straight):
        def act(self, observation: Observation) -> Controls:
            raise ValueError("no idea")

    result = drive_manoeuvre("step", Broken(), EmbeddedSimulator())
    assert result.result.fault is not None
    assert all(quantity.value is None for quantity in result.measures.quantities)


@pytest.mark.parametrize("name", NAMES)
def test_records_without_numbers_are_not_measured(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = EmbeddedSimulator.drive

    def broken(*arguments: Any) -> Drive:
        driven = drive(*arguments)
        rows = driven.trajectory.to_rows()
        rows[-20, Trajectory.names().index("yaw_rate")] = math.nan
        return replace(driven, trajectory=Trajectory.from_rows(rows))

    monkeypatch.setattr(EmbeddedSimulator, "drive", broken)
    result = drive_manoeuvre(name, Planner(), EmbeddedSimulator())
    reasons = {quantity.reason for quantity in result.measures.quantities}
    assert reasons == {"not measured: the simulator recorded values that are no numbers"}


@pytest.mark.parametrize("name", NAMES)
def test_a_car_that_crawls_has_numbers_or_reasons(name: str) -> None:
    class Crawling(Planner):
        def act(self, observation: Observation) -> Controls:
            steering = super().act(observation).steering
            return Controls(steering, throttle=0.1 if observation.speed < 2.6 else 0.0)

    result = drive_manoeuvre(name, Crawling(), EmbeddedSimulator())
    for quantity in result.measures.quantities:
        assert quantity.reason or math.isfinite(quantity.value or 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_a_manoeuvre_declares_what_it_measures(name: str) -> None:
    manoeuvre = MANOEUVRES.make(name)
    result = drive_manoeuvre(manoeuvre, Planner(), EmbeddedSimulator())
    assert manoeuvre.name == name
    measured = [(item.name, item.of, item.unit) for item in result.measures.quantities]
    assert measured == [tuple(quantity) for quantity in manoeuvre.QUANTITIES]
    assert all(quantity.value is not None for quantity in result.measures.quantities)
    document = result.as_json()
    assert document["manoeuvre"] == name
    assert document["options"] == vars(manoeuvre)


def test_options_are_for_names() -> None:
    with pytest.raises(TypeError, match="offset: options are for a manoeuvre's name"):
        drive_manoeuvre(LaneOffset(), Planner(), EmbeddedSimulator(), offset=0.2)


def test_manoeuvres_are_driven_at_the_speed_limit() -> None:
    for speed in (30.0, 100.0):
        conditions = {"speed": speed}
        result = drive_manoeuvre("step", Planner(), EmbeddedSimulator(), conditions=conditions)
        assert result["speed"] == pytest.approx(speed, rel=0.02)
        sharpest = float(np.abs(result.road.curvatures).max())
        assert (speed / 3.6) ** 2 * sharpest == pytest.approx(2.0)
        offset = drive_manoeuvre(
            "lane-offset", Planner(), EmbeddedSimulator(), conditions=conditions
        )
        assert offset["start_speed"] == pytest.approx(speed)


def test_a_simulator_without_a_start_speed_starts_at_rest_or_as_it_does() -> None:
    plan = LaneOffset().conditions(SPEED)
    assert plan == {"start": 0.5, "start_speed": 3.6 * SPEED}
    result = drive_manoeuvre("lane-offset", DRIVERS[0], car_at(SPEED))
    assert result["start_speed"] == pytest.approx(3.6 * SPEED)  # the linear car's own start


def test_the_driver_brings_its_car() -> None:
    own, other = (
        drive_manoeuvre("constant-radius", BeamngAi(), EmbeddedSimulator(vehicle=vehicle))
        for vehicle in (None, "etk800")
    )
    assert own["understeer"] == other["understeer"]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("steps", {}, "unknown manoeuvre 'steps'; did you mean 'step'"),
        ("step", {"radius": 10.0}, "a radius of 10 m: the bends of a road have at least 14.3 m"),
        ("step", {"radius": 0.0}, "radius is 0"),
        ("step", {"radius": 20.0, "transition": 5.0}, "the curvature changes by 0.1 1/m over 10 m"),
        ("step", {"side": "up"}, "'left' or 'right'"),
        ("step", {"hold": 2.0}, "hold is 2.0: a number > 2 is needed"),
        ("constant-radius", {"hold": 1e9}, "hold is 1000000000.0: a number <= 300 is needed"),
        ("lane-offset", {"offset": 0.0}, "offset is 0"),
        ("lane-offset", {"offset": 3.0}, "offset is 3"),
        ("lane-offset", {"conditions": {"start": 0.1}}, "sets start itself"),
        ("sine", {"shortest": 9.0}, "shortest is 9 s and longest 8 s"),
        ("sine", {"frequencies": 50, "shortest": 0.3}, "ask for fewer frequencies"),
        ("sine", {"frequencies": 1}, "frequencies is 1"),
        ("slalom", {"size": 1.0}, "has no option 'size'"),
        ("step", {"conditions": {"speed": 0.0}}, "positive number"),
    ],
)
def test_what_cannot_be_driven_is_refused(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises((FreneticError, ValueError), match=message):
        drive_manoeuvre(name, Planner(), EmbeddedSimulator(), **options)
