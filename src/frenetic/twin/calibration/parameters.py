"""The twin's model: a driver and a car, and those of their parameters that are fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Literal, TypeAlias

from frenetic.drive import Rules
from frenetic.drivers.driver import Driver, under_layers
from frenetic.errors import FreneticError
from frenetic.registry import arguments_of, hint, options_of
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.spec import driver_of

Owner: TypeAlias = Literal["driver", "vehicle", "layer"]

SPAN: Final = 4.0
"""A parameter without stated bounds is searched from its value over this to its value times it."""
_HALVINGS: Final = 20
_FITTED_LAYERS: Final = ("delay",)  # noise differs from drive to drive, and a view may be endless


@dataclass(frozen=True)
class Asked:
    """A parameter to be fitted, as a user names it."""

    name: str
    """With or without its owner: ``braking`` or ``driver.braking``."""
    low: float | None = None
    """Lower bound, None for the usual one."""
    high: float | None = None


@dataclass(frozen=True)
class Parameter:
    """A parameter to be fitted, with its bounds."""

    owner: Owner
    name: str
    low: float
    high: float
    start: float
    """Its value before the fit."""

    def __str__(self) -> str:
        return f"{self.owner}.{self.name}"

    @property
    def is_log(self) -> bool:
        """Whether it is searched by its logarithm."""
        return self.low > 0.0

    def at(self, place: float) -> float:
        """The value at a place 0..1 between the bounds."""
        place = min(max(place, 0.0), 1.0)
        if self.is_log:
            found = math.exp(math.log(self.low) + place * math.log(self.high / self.low))
        else:
            found = self.low + place * (self.high - self.low)
        return min(max(found, self.low), self.high)

    def place(self, value: float) -> float:
        """The place 0..1 of a value between the bounds."""
        if self.is_log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Model:
    """A driver and a car before the fit."""

    driver: str
    """A registered name, ``package.module:Class`` or ``file.py:Class``."""
    driver_options: Mapping[str, Any]
    vehicle: Mapping[str, float | str]
    """As `Vehicle.of` takes it."""
    layers: Mapping[str, float]
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(
        cls,
        driver: str,
        asked: Sequence[Asked],
        *,
        driver_options: Mapping[str, Any] | None = None,
        vehicle: Mapping[str, float | str] | None = None,
        layers: Mapping[str, float] | None = None,
    ) -> Model:
        """The model of a driver, with the parameters that are asked for.

        Args:
            driver: as for `frenetic.drivers.loading.load_driver`.
            asked: one or more parameters.
            driver_options: of the driver; what is fitted begins there.
            vehicle: as `Vehicle.of` takes it, likewise.
            layers: name of a layer -> its amount, likewise.

        Raises:
            FreneticError: the driver or car cannot be made, there is no such parameter, or its
                bounds do not suit.
        """
        model = cls(driver, dict(driver_options or {}), dict(vehicle or {}), dict(layers or {}), ())
        if not asked:
            raise FreneticError("nothing is to be fitted: name parameters, such as braking")
        made, _ = model.make({}, Rules())
        if brought := getattr(under_layers(made), "VEHICLE", None):
            model = replace(model, vehicle={"name": brought, **model.vehicle})
        starts = _starts(made if not model.layers else driver_of(driver, model.driver_options, {}))
        car = Vehicle.of(model.vehicle)
        known: dict[str, float] = {f"driver.{name}": value for name, value in starts.items()}
        known |= {f"vehicle.{item.name}": getattr(car, item.name) for item in fields(car)}
        known |= {f"layer.{name}": model.layers.get(name, 0.0) for name in _FITTED_LAYERS}
        parameters: list[Parameter] = []
        for one in asked:
            parameter = model._parameter(one, known)
            if str(parameter) in map(str, parameters):
                raise FreneticError(f"{parameter} is to be fitted twice: once is enough")
            parameters.append(parameter)
        return replace(model, parameters=tuple(parameters))

    def _parameter(self, asked: Asked, known: Mapping[str, float]) -> Parameter:
        found = [name for name in known if asked.name in (name, name.partition(".")[2])]
        if not found:
            plain = [name.partition(".")[2] for name in known]
            own = [name for name in known if name.startswith("driver.")]
            raise FreneticError(
                f"there is no parameter {asked.name!r} to fit{hint(asked.name, [*plain, *known])}"
                f" {self.driver} has:"
                f" {', '.join(own) or 'none that is a number'}; beside: layer.delay, and vehicle."
                f" followed by {', '.join(item.name for item in fields(Vehicle))}"
            )
        if len(found) > 1:
            raise FreneticError(f"{asked.name!r} may be {' or '.join(found)}: say which one")
        owner, _, name = found[0].partition(".")
        start = known[found[0]]
        whole = Parameter(owner, name, start, start, start)  # type: ignore[arg-type]  # an Owner
        if asked.low is None or asked.high is None:
            if start <= 0.0:
                raise FreneticError(
                    f"{found[0]} is {start:g}, so it has no usual bounds: state them, as in"
                    f" {name}=LOW:HIGH"
                )
            low, high = (self._nearest(whole, start, start * by) for by in (1.0 / SPAN, SPAN))
        else:
            low, high = asked.low, asked.high
            if not low < high:
                raise FreneticError(
                    f"the bounds of {found[0]} are {low:g}:{high:g}: LOW:HIGH with LOW below HIGH"
                    " is needed"
                )
            for value in (low, high):
                if trouble := self._trouble(whole, value):
                    raise FreneticError(f"{found[0]} cannot be {value:g}: {trouble}")
        return replace(whole, low=low, high=high, start=min(max(start, low), high))

    def _nearest(self, parameter: Parameter, start: float, wanted: float) -> float:
        """The allowed value nearest to a wanted one, on the way there from the start."""
        if not self._trouble(parameter, wanted):
            return wanted
        good, bad = start, wanted
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            if self._trouble(parameter, middle):
                bad = middle
            else:
                good = middle
        return good

    def _trouble(self, parameter: Parameter, value: float) -> str:
        """Why a parameter cannot have a value, the others being as they are; empty if it can."""
        alone = replace(self, parameters=(parameter,))
        try:
            alone.make({str(parameter): value}, Rules())
        except (FreneticError, ValueError) as error:
            return str(error)
        return ""

    def options(
        self, values: Mapping[str, float]
    ) -> tuple[dict[str, Any], dict[str, float | str], dict[str, float]]:
        """Options of the driver, parameters of the car, and layers with these values.

        Args:
            values: name with its owner -> value.
        """
        driver, vehicle, layers = dict(self.driver_options), dict(self.vehicle), dict(self.layers)
        for name, value in values.items():
            owner, _, own = name.partition(".")
            into: dict[str, Any] = {"driver": driver, "vehicle": vehicle, "layer": layers}[owner]
            into[own] = value
        return driver, vehicle, layers

    def make(self, values: Mapping[str, float], rules: Rules) -> tuple[Driver, EmbeddedSimulator]:
        """Driver and simulator with these values.

        Raises:
            FreneticError: the driver refuses them.
            ValueError: the car does.
        """
        options, vehicle, layers = self.options(values)
        driver = driver_of(self.driver, options, layers)
        return driver, EmbeddedSimulator(vehicle=Vehicle.of(vehicle), rules=rules)

    def values(self, places: Sequence[float]) -> dict[str, float]:
        """Name -> value of the parameters at places 0..1 between their bounds."""
        found = zip(self.parameters, places, strict=True)
        return {str(parameter): parameter.at(float(place)) for parameter, place in found}


def _starts(driver: Driver) -> dict[str, float]:
    """Name -> value of the driver's options that are numbers."""
    given = {**(options_of(driver) or {}), **arguments_of(driver)}
    return {
        name: float(value)
        for name, value in given.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    }
