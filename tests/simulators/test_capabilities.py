"""Capabilities that simulators and drivers declare beyond the methods of their protocols."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

from frenetic.conditions.condition import known_conditions
from frenetic.drivers import Delayed, Driver, Planner
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.plugins.beamng import BeamngSimulator
from frenetic.plugins.commonroad import CommonRoadSimulator
from frenetic.plugins.metadrive import MetaDriveSimulator
from frenetic.simulators import EmbeddedSimulator, Rules, Simulator
from frenetic.simulators.capabilities import Capabilities, capabilities, check_pair, defaults_of
from frenetic.simulators.conditions import check_can_vary
from frenetic.spec.part_record import describe
from frenetic.testing import DummyDriver, DummySimulator


class Declaring(DummySimulator):
    """A simulator that declares capabilities."""

    needs = ("a_module",)
    usual_wall_limit = 600.0
    usual_workers = 2
    wall_limit = 500
    prepared = False

    @property
    def workers_at_most(self) -> int:
        return 3

    def prepare(self) -> None:
        self.prepared = True

    def check_driver(self, driver: Driver) -> None:
        raise DriverError(f"not {type(driver).__name__}")


def test_a_simulator_that_declares_nothing_has_the_defaults() -> None:
    simulator = DummySimulator()
    declared = capabilities(simulator)
    assert declared == Capabilities(prepare=declared.prepare, variable=frozenset({"rules"}))
    assert declared.drive_limit == 100.0
    declared.prepare()
    check_pair(simulator, DummyDriver())


def test_declared_capabilities_are_read() -> None:
    simulator = Declaring()
    declared = capabilities(simulator)
    assert (declared.needs, declared.usual_workers, declared.workers_at_most) == (
        ("a_module",),
        2,
        3,
    )
    assert (declared.wall_limit, declared.usual_wall_limit, declared.drive_limit) == (
        500,
        600.0,
        760.0,
    )
    declared.prepare()
    assert simulator.prepared
    with pytest.raises(DriverError, match="not DummyDriver"):
        check_pair(simulator, DummyDriver())


def test_a_class_declares_capabilities_without_an_instance() -> None:
    assert (defaults_of(Declaring).usual_workers, defaults_of(Declaring).needs) == (
        2,
        ("a_module",),
    )
    assert defaults_of(BeamngSimulator).usual_wall_limit == 600.0
    assert "home" in defaults_of(BeamngSimulator).place_options
    assert defaults_of(lambda: DummySimulator()).usual_wall_limit == 60.0


@pytest.mark.parametrize("simulator", [BeamngSimulator, MetaDriveSimulator])
def test_preloaded_modules_exist(simulator: Any) -> None:
    assert defaults_of(simulator).preloads
    for name in defaults_of(simulator).preloads:  # the process server skips missing modules
        assert find_spec(name) is not None


@pytest.mark.parametrize(
    "kind", [EmbeddedSimulator, MetaDriveSimulator, CommonRoadSimulator, DummySimulator]
)
def test_a_class_says_which_conditions_its_simulators_lay(kind: type) -> None:
    of_class, of_instance = defaults_of(kind), capabilities(kind())
    assert of_class.variable == of_instance.variable
    laid = [row.name for row in known_conditions().values() if of_class.can_apply(row)]
    simulator, names = kind(), {row.name: row for row in known_conditions().values()}
    for name, row in names.items():
        if name in laid:
            check_can_vary(simulator, [name])
        else:
            with pytest.raises(FreneticError, match=f"cannot vary {name}: .* {row.attribute!r}"):
                check_can_vary(simulator, [name])
    assert {"speed", "delay", "noise", "fog"} <= {*laid}


def test_every_condition_that_our_simulators_lay_is_an_option() -> None:
    kinds: tuple[Any, ...] = (EmbeddedSimulator, MetaDriveSimulator, CommonRoadSimulator)
    for kind in kinds:
        for row in known_conditions().values():
            if row.attribute != "rules" and row.attribute in defaults_of(kind).variable:
                amount = 0.25 * row.usual[0] + 0.75 * row.usual[1]
                simulator: Any = kind(**{row.attribute: amount})
                assert getattr(simulator, row.attribute) == amount
                assert describe(simulator) != describe(kind()), "the option is recorded"


def test_conditions_that_can_vary_are_attributes_that_can_be_set() -> None:
    everything = {"rules", "friction", "steering_lag", "start_offset", "start_heading"}
    everything |= {"start_speed", "load", "wet", "wet_at", "gust", "gust_at"}
    assert capabilities(EmbeddedSimulator()).variable == everything


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("wall_limit", 0.0, r"Dummy.*\.wall_limit is 0.0: a number > 0 is needed"),
        ("usual_workers", "two", "a whole number is needed"),
        ("workers_at_most", True, "a whole number is needed"),
        ("preloads", ["json", 1], "a text"),
        ("needs", "beamngpy", "a list is needed"),
        ("prepare", True, "is needed"),
    ],
)
def test_an_invalid_capability_is_refused(name: str, value: Any, message: str) -> None:
    simulator: Any = DummySimulator()
    setattr(simulator, name, value)
    with pytest.raises(FreneticError, match=message):
        capabilities(simulator)


def test_the_driver_under_a_wrapper_is_asked_too() -> None:
    class Particular(Planner):
        def check_simulator(self, simulator: Simulator) -> None:
            if not isinstance(simulator, EmbeddedSimulator):
                raise DriverError("elsewhere only")

    driver = Delayed(Particular(), seconds=0.1)
    check_pair(EmbeddedSimulator(), driver)
    with pytest.raises(DriverError, match="elsewhere only"):
        check_pair(DummySimulator(rules=Rules()), driver)


def test_a_driver_with_a_camera_needs_a_simulator_that_draws() -> None:
    driver = load_driver("marking-follower", fog=50.0)
    check_pair(EmbeddedSimulator(), driver)
    with pytest.raises(DriverError, match=r"^DummySimulator draws nothing, and the driver has a"):
        check_pair(DummySimulator(), driver)
