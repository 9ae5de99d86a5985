"""Worlds: what is varied reaches the drive, and nothing is left behind."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.conditions.condition import known_conditions
from frenetic.drivers import Delayed, Driver, LimitedView, Noisy, Planner
from frenetic.drivers.wrappers import compiled_form
from frenetic.errors import FreneticError
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Rules, Simulator
from frenetic.simulators.conditions import Conditions, in_conditions
from frenetic.testing import DummySimulator

ROAD = Road([0.0, 0.0, 0.01, 0.03, 0.05, 0.05, 0.02, -0.02, -0.04, -0.04, 0.0, 0.0])


def rows(simulator: Simulator, driver: Driver) -> list[list[float]]:
    rows: list[list[float]] = simulator.drive(ROAD, driver).trajectory.to_rows().tolist()
    return rows


SHORT = Road([0.0, 0.0, 0.02, 0.0])


def in_that(world: Conditions, simulator: Simulator, driver: Driver) -> list[list[float]]:
    with in_conditions(world, simulator, driver) as there:
        return rows(simulator, there)


@pytest.mark.parametrize(
    ("world", "simulator", "driver"),
    [
        ({"friction": 0.6}, EmbeddedSimulator(friction=0.6), Planner()),
        ({"lag": 0.3}, EmbeddedSimulator(steering_lag=0.3), Planner()),
        ({"speed": 40.0}, EmbeddedSimulator(rules=Rules(speed_limit=40.0)), Planner()),
        ({"start": 0.4}, EmbeddedSimulator(start_offset=0.4), Planner()),
        ({"heading": -0.1}, EmbeddedSimulator(start_heading=-0.1), Planner()),
        ({"delay": 0.2}, EmbeddedSimulator(), Delayed(Planner(), seconds=0.2)),
        (
            {"noise": 0.3, "noise_seed": 5},
            EmbeddedSimulator(),
            Noisy(Planner(), offset=0.3, heading=0.03, seed=5),
        ),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_a_drive_in_conditions_equals_one_with_parts_made_for_them(
    world: Conditions, simulator: Simulator, driver: Driver
) -> None:
    there = in_that(world, EmbeddedSimulator(), Planner())
    assert there == rows(simulator, driver)
    assert there != rows(EmbeddedSimulator(), Planner())


def test_the_simulator_is_as_before_afterwards_even_if_the_drive_broke() -> None:
    simulator = EmbeddedSimulator(rules=Rules(stuck_time=7.0), friction=0.9, start_offset=0.1)
    before = rows(simulator, Planner())
    world = {"friction": 0.5, "lag": 0.3, "speed": 30.0, "start": -0.5, "heading": 0.2}

    def break_there() -> None:
        with in_conditions(world, simulator, Planner()):
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
    with in_conditions({"delay": 0.1}, EmbeddedSimulator(), driver) as there:
        form = compiled_form(there, 0.05)
    assert form is not None, "two wrappers of a kind are driven in Python, slowly"
    assert (form.delay, form.rows) == (2, 11)
    assert form.errors is not None
    assert driver.driver.driver.seconds == 0.3, "the driver itself was changed"  # type: ignore[attr-defined]


def test_what_a_simulator_cannot_vary_is_refused_in_one_line() -> None:
    simulator = DummySimulator()
    with in_conditions({"speed": 30.0, "delay": 0.1}, simulator, Planner()) as driver:
        assert simulator.drive(ROAD, driver).rules.speed_limit == 30.0
    for name in ("friction", "start", "heading"):
        with (
            pytest.raises(FreneticError, match=f"DummySimulator cannot vary {name}"),
            in_conditions({name: 0.5}, simulator, Planner()),
        ):
            pass


def test_a_value_that_a_simulator_refuses_is_one_line() -> None:
    class Picky(DummySimulator):
        @property
        def friction(self) -> float:
            return 1.0

        @friction.setter
        def friction(self, friction: float) -> None:
            if friction != 1.0:
                raise ValueError("this road is always dry")

    world = {"friction": 0.5}
    with (
        pytest.raises(FreneticError, match=r"Picky cannot have friction = 0\.5: this road"),
        in_conditions(world, Picky(), Planner()),
    ):
        pass


def test_every_condition_can_be_driven_in() -> None:
    """Both ends of every condition's range can be driven in."""
    for name, condition in known_conditions().items():
        for value in (condition.low, condition.high):
            driver = MarkingFollower() if name in appearance.ALL else Planner()
            simulator = EmbeddedSimulator()
            with in_conditions({name: value}, simulator, driver) as there:
                drive = simulator.drive(SHORT, there)
            assert drive.trouble is None
            assert np.isfinite(drive.trajectory.to_rows()).all()
