"""A user's own simulator by its name, which drives in other processes only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, Self

from frenetic._support.bounds import Count, Positive
from frenetic.drive import CarBody, Drive, Rules
from frenetic.drivers.driver import Driver
from frenetic.recipe import Guest, Named, Recipe, Told
from frenetic.road import Road
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.simulator import Ready, Simulator

_VALUES: Final = (
    *("place_options", "preloads", "usual_wall_limit", "usual_workers"),
    *("wall_limit", "workers_at_most", "period_step", "draws", "lays_slopes"),
)
_METHODS: Final = ("prepare", "check_driver")


@dataclass(frozen=True)
class SimulatorAttributes:
    """A simulator's rules, its car, what may vary, and its capabilities that are values."""

    rules: Rules
    car: CarBody
    declared: frozenset[str]
    """Methods of `Capabilities` that the simulator has."""
    amounts: dict[str, bool | int | float | str | None]
    """Attributes that may vary beside the rules."""
    place_options: tuple[str, ...]
    preloads: tuple[str, ...]
    usual_wall_limit: Positive
    usual_workers: Count | None
    wall_limit: Positive
    workers_at_most: Count | None
    period_step: Positive | None
    draws: bool
    lays_slopes: bool


class NamedSimulator(Named, Ready):
    """A user's own simulator by its name; what `frenetic.quantities` names may be set here."""

    attributes_type: ClassVar[type] = SimulatorAttributes
    rules: Rules
    car: CarBody
    declared: frozenset[str]
    """The methods of `Capabilities` that it has."""
    amounts: Mapping[str, Any]
    """Attributes that may vary beside the rules, as they were when the simulator was made."""

    def __init__(self, recipe: Recipe, told: Told[SimulatorAttributes]) -> None:
        super().__init__(recipe, told)
        vars(self).update(self.amounts)

    @staticmethod
    def attributes_of(part: Simulator) -> SimulatorAttributes:
        """Its rules, its car, what may vary, and its capabilities that are values."""
        able = capabilities(part)
        return SimulatorAttributes(
            rules=part.rules,
            car=part.car,
            declared=frozenset(name for name in _METHODS if hasattr(part, name)),
            amounts={name: getattr(part, name) for name in able.variable - {"rules"}},
            **{name: getattr(able, name) for name in _VALUES},
        )

    @property
    def varies(self) -> frozenset[str]:
        """Names of its attributes that may vary."""
        return frozenset({*self.amounts, "rules"})

    @property
    def maker(self) -> Callable[[], Any]:
        """Makes it as it is set here."""
        return partial(_set, super().maker, {name: getattr(self, name) for name in self.varies})

    def prepare(self) -> None:
        """Finds out its `car` where that takes starting it."""
        if "prepare" in self.declared:
            self.car = self.recipe.ask(_prepared, answer=CarBody)

    def check_driver(self, driver: Driver) -> None:
        """Raises an error if a driver cannot drive in it."""
        if "check_driver" in self.declared:
            self.recipe.ask(_check_driver, driver)

    def __enter__(self) -> Self:
        """Raises an error: it starts in another process."""
        self.refuse()

    def drive(self, road: Road, driver: Driver) -> Drive:  # noqa: ARG002
        """Raises an error: it drives in another process."""
        self.refuse()


def _set(maker: Callable[[], Any], values: Mapping[str, Any]) -> Simulator:
    simulator: Simulator = maker()
    for name, value in values.items():
        if getattr(simulator, name) != value:
            setattr(simulator, name, value)
    return simulator


def _prepared(guest: Guest) -> CarBody:
    guest.part.prepare()
    car: CarBody = guest.part.car
    return car


def _check_driver(guest: Guest, driver: Driver) -> None:
    guest.part.check_driver(driver)
