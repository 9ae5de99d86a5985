"""Conditions reach a drive, and the simulator is unchanged afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.conditions.condition import known_conditions
from frenetic.drivers import Delayed, Driver, LimitedView, Noisy, Planner
from frenetic.drivers.compiled_form import compiled_form
from frenetic.errors import FreneticError
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Rules, Simulator
from frenetic.simulators.conditions import Conditions, in_conditions
from frenetic.testing import DummySimulator

ROAD = Road([0.0, 0.0, 0.01, 0.03, 0.05, 0.05, 0.02, -0.02, -0.04, -0.04, 0.0, 0.0])


def rows(simulator: Simulator, driver: Driver) -> list[list[float]]:
    """Return the records of a drive on `ROAD`."""
    rows: list[list[float]] = simulator.drive(ROAD, driver).trajectory.to_rows().tolist()
    return rows


SHORT = Road([0.0, 0.0, 0.02, 0.0])


def rows_in(conditions: Conditions, simulator: Simulator, driver: Driver) -> list[list[float]]:
    """Return the records of a drive on `ROAD` in conditions."""
    with in_conditions(conditions, simulator, driver) as driver_there:
        return rows(simulator, driver_there)


@pytest.mark.parametrize(
    ("conditions", "simulator", "driver"),
    [
        ({"friction": 0.6}, EmbeddedSimulator(friction=0.6), Planner()),
        ({"lag": 0.3}, EmbeddedSimulator(steering_lag=0.3), Planner()),
        ({"speed": 40.0}, EmbeddedSimulator(rules=Rules(speed_limit=40.0)), Planner()),
        ({"start": 0.4}, EmbeddedSimulator(start_offset=0.4), Planner()),
        ({"heading": -0.1}, EmbeddedSimulator(start_heading=-0.1), Planner()),
        ({"start_speed": 50.0}, EmbeddedSimulator(start_speed=50.0), Planner()),
        ({"delay": 0.2}, EmbeddedSimulator(), Delayed(Planner(), seconds=0.2)),
        (
            {"noise": 0.3, "noise_seed": 5},
            EmbeddedSimulator(),
            Noisy(Planner(), offset=0.3, heading=0.03, seed=5),
        ),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_conditions_act_as_options_of_simulator_and_driver(
    conditions: Conditions, simulator: Simulator, driver: Driver
) -> None:
    with_conditions = rows_in(conditions, EmbeddedSimulator(), Planner())
    assert with_conditions == rows(simulator, driver)
    assert with_conditions != rows(EmbeddedSimulator(), Planner())


def test_the_simulator_is_restored_even_after_an_error() -> None:
    simulator = EmbeddedSimulator(rules=Rules(stuck_time=7.0), friction=0.9, start_offset=0.1)
    before = rows(simulator, Planner())
    conditions = {"friction": 0.5, "lag": 0.3, "speed": 30.0, "start": -0.5, "heading": 0.2}

    def break_there() -> None:
        with in_conditions(conditions, simulator, Planner()):
            assert simulator.friction == 0.5
            assert simulator.rules == Rules(
                stuck_time=7.0, speed_limit=30.0, road_limits="scaled", scaled_from=70.0
            )
            raise RuntimeError

    with pytest.raises(RuntimeError):
        break_there()
    assert (simulator.friction, simulator.start_offset) == (0.9, 0.1)
    assert simulator.steering_lag is None
    assert simulator.rules == Rules(stuck_time=7.0)
    assert rows(simulator, Planner()) == before


def test_a_wrapper_takes_the_place_of_one_of_its_kind_and_leaves_the_others() -> None:
    driver = Noisy(LimitedView(Delayed(Planner(), seconds=0.3), distance=20.0), offset=0.1, seed=1)
    with in_conditions({"delay": 0.1}, EmbeddedSimulator(), driver) as driver_there:
        form = compiled_form(driver_there, 0.05)
    assert form is not None, "two wrappers of a kind are driven in Python, slowly"
    assert (form.delay, form.rows) == (2, 11)
    assert form.errors is not None
    assert driver.driver.driver.seconds == 0.3, "the driver itself was changed"  # type: ignore[attr-defined]


def test_a_condition_that_a_simulator_cannot_vary_is_refused() -> None:
    simulator = DummySimulator()
    with in_conditions({"speed": 30.0, "delay": 0.1}, simulator, Planner()) as driver:
        assert simulator.drive(ROAD, driver).rules.speed_limit == 30.0
    for name in ("friction", "start", "heading"):
        with (
            pytest.raises(FreneticError, match=f"DummySimulator cannot vary {name}"),
            in_conditions({name: 0.5}, simulator, Planner()),
        ):
            pass


def test_a_value_that_a_simulator_refuses_is_a_one_line_error() -> None:
    class AlwaysDry(DummySimulator):
        @property
        def friction(self) -> float:
            return 1.0

        @friction.setter
        def friction(self, friction: float) -> None:
            if friction != 1.0:
                raise ValueError("this road is always dry")

    conditions = {"friction": 0.5}
    with (
        pytest.raises(FreneticError, match=r"AlwaysDry cannot have friction = 0\.5: this road"),
        in_conditions(conditions, AlwaysDry(), Planner()),
    ):
        pass


def test_every_condition_can_be_driven_in() -> None:
    """A drive succeeds at both ends of every range."""
    for name, condition in known_conditions().items():
        for value in (condition.low, condition.high):
            driver = MarkingFollower() if name in appearance.ALL else Planner()
            simulator = EmbeddedSimulator()
            with in_conditions({name: value}, simulator, driver) as driver_there:
                drive = simulator.drive(SHORT, driver_there)
            assert drive.trouble is None
            assert np.isfinite(drive.trajectory.to_rows()).all()
