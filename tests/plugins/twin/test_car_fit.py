"""The fit of a twin's car to recorded motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from frenetic import EmbeddedSimulator, Planner
from frenetic.oracle.drive import Trajectory
from frenetic.plugins.twin.car_fit import RecordedMotion, fit_car, residuals_of
from frenetic.plugins.twin.car_model import PARAMETERS, CarModel
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.simulators.conditions import in_conditions
from frenetic.simulators.embedded.vehicle import Vehicle

HIDDEN = replace(
    Vehicle(),
    tyre_peak=0.85,
    steering_lag=0.2,
    engine_acceleration=3.2,
    brake_deceleration=6.0,
    drive_front_share=0.3,
    along_weight=0.6,
)
"""A car that the fit has to find from the default car."""


def drive(
    car: Vehicle, count: int, conditions: Mapping[str, float] | None = None, seed: int = 3
) -> list[RecordedMotion]:
    """Return the motion of a car with a planner along random roads."""
    simulator, search = EmbeddedSimulator(vehicle=car), RandomSearch(seed=seed)
    motions = []
    for _ in range(count):
        with in_conditions(conditions or {}, simulator, Planner()) as driver:
            path = simulator.drive(search.ask().road(4.0), driver).trajectory
        motions.append(RecordedMotion.of(path, len(path), conditions or {}))
    return motions


def loss(model: CarModel, values: np.ndarray, motions: Sequence[RecordedMotion]) -> float:
    residuals = residuals_of(model, values, motions)
    return float(residuals @ residuals)


def test_the_fit_finds_a_hidden_car() -> None:
    model = CarModel.of(Vehicle(), None)
    motions = drive(HIDDEN, 20)
    fitted = fit_car(model, model.start_values, motions)
    assert loss(model, fitted, motions) < 0.01 * loss(model, model.start_values, motions)
    values = model.values(fitted)
    for name in ("tyre_peak", "steering_lag", "engine_acceleration", "brake_deceleration"):
        assert values[name] == pytest.approx(getattr(HIDDEN, name), rel=0.05), name
    # It predicts motion that it has not seen, too.
    others = drive(HIDDEN, 5, seed=4)
    assert loss(model, fitted, others) < 0.03 * loss(model, model.start_values, others)


def test_what_the_drives_do_not_show_stays_as_it_was() -> None:
    simulator = EmbeddedSimulator(vehicle=HIDDEN)
    path = simulator.drive(Road([0.0] * 20, 10.0), Planner()).trajectory
    model = CarModel.of(Vehicle(), None)
    start = model.start_values
    fitted = fit_car(model, start, [RecordedMotion.of(path, len(path), {})])
    for number, parameter in enumerate(PARAMETERS):
        if parameter.name in ("tyre_stiffness", "yaw_inertia", "steering_lag"):
            assert fitted[number] == pytest.approx(start[number], abs=1e-3)
    engine = model.values(fitted)["engine_acceleration"]
    assert engine == pytest.approx(HIDDEN.engine_acceleration, rel=0.05)


def test_the_friction_of_a_drive_is_no_property_of_the_car() -> None:
    model = CarModel.of(Vehicle(), None)
    motions = [*drive(HIDDEN, 10), *drive(HIDDEN, 10, {"friction": 0.6})]
    fitted = model.values(fit_car(model, model.start_values, motions))
    assert fitted["tyre_peak"] == pytest.approx(HIDDEN.tyre_peak, rel=0.05)


def test_a_drive_without_a_whole_window_changes_nothing() -> None:
    model = CarModel.of(Vehicle(), None)
    motion = RecordedMotion.of(Trajectory.empty(), 0, {})
    assert len(motion) == 0
    np.testing.assert_array_equal(fit_car(model, model.start_values, [motion]), model.start_values)


def test_the_fit_begins_with_the_car_that_the_simulator_tells() -> None:
    simulator = EmbeddedSimulator(vehicle=replace(HIDDEN, front_stiffness=0.8, mass=1500.0))
    setup = simulator.setup(Road([0.0] * 4, 10.0))
    start = CarModel.of(Vehicle(), setup).start
    for name in ("mass", "steering_lag", "engine_acceleration", "brake_deceleration"):
        assert getattr(start, name) == getattr(simulator.vehicle, name)
    for name in ("tyre_stiffness", "front_stiffness"):
        assert getattr(start, name) == pytest.approx(getattr(simulator.vehicle, name))


def test_every_unit_value_makes_a_car() -> None:
    model, rng = CarModel.of(Vehicle.named("metadrive"), None), np.random.default_rng(1)
    for _ in range(200):
        corner = rng.choice([0.0, 0.5, 1.0], len(PARAMETERS))
        car = model.car(corner)
        assert EmbeddedSimulator(vehicle=car).vehicle == car
