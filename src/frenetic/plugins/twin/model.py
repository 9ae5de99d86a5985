"""The twin's model: a driver and a car, and the parameters that are fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Literal, Self, TypeAlias

from msgspec import structs

from frenetic._support.files import require_list
from frenetic._support.words import part_word
from frenetic.drivers.driver import Driver, unwrapped
from frenetic.drivers.loading import load_driver
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.parts.registry import DRIVERS, hint, options_of
from frenetic.plugins.twin.profile import Fitted, TwinProfile
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.spec import Spec

ParameterOwner: TypeAlias = Literal["driver", "vehicle", "condition"]

SPAN: Final = 4.0
"""A parameter without stated bounds is searched from its value over this to its value times it."""
_HALVINGS: Final = 20
_FITTED_CONDITIONS: Final = ("delay",)
"""Conditions to fit: noise differs from drive to drive, and a view may be endless."""


@dataclass(frozen=True)
class Parameter:
    """A parameter to be fitted, with its bounds."""

    owner: ParameterOwner
    name: str
    low: float
    high: float
    start: float
    """Value before the fit."""

    @classmethod
    def of(cls, fitted: Fitted) -> Self:
        """Return the parameter of a profile, which starts where it was fitted to."""
        owner, _, name = fitted.name.partition(".")
        low, high = min(fitted.low, fitted.value), max(fitted.high, fitted.value)
        return cls(owner, name, low, high, fitted.value)  # type: ignore[arg-type]  # a ParameterOwner

    def __str__(self) -> str:
        return f"{self.owner}.{self.name}"

    def at(self, place: float) -> float:
        """Return the value at a place 0..1 between the bounds; logarithmic if both are positive."""
        place = min(max(place, 0.0), 1.0)
        if self.low > 0.0:
            value = math.exp(math.log(self.low) + place * math.log(self.high / self.low))
        else:
            value = self.low + place * (self.high - self.low)
        return min(max(value, self.low), self.high)

    @property
    def place(self) -> float:
        """Place 0..1 of the start between the bounds."""
        if self.low > 0.0:
            return math.log(self.start / self.low) / math.log(self.high / self.low)
        return (self.start - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class TwinModel:
    """A driver and a car before the fit."""

    driver: str
    """A registered name, ``package.module:Class`` or ``file.py:Class``."""
    driver_options: Mapping[str, Any]
    vehicle: Mapping[str, float | str]
    """As `Vehicle.of` takes it."""
    parameters: tuple[Parameter, ...] = ()

    @classmethod
    def of(
        cls,
        driver: str,
        fit: Sequence[str],
        *,
        driver_options: Mapping[str, Any] | None = None,
        vehicle: Mapping[str, float | str] | None = None,
    ) -> TwinModel:
        """Return the model of a driver, with the parameters that are asked for.

        Args:
            driver: as for `frenetic.drivers.loading.load_driver`.
            fit: one or more parameters, with or without owner and bounds: ``braking``,
                ``vehicle.friction=0.5:1.2``.
            driver_options: options of the driver; the fit begins at them.
            vehicle: the car, as `Vehicle.of` takes it; the fit begins at it.

        Raises:
            FreneticError: the driver or car cannot be made, there is no such parameter, or its
                bounds do not suit.
        """
        model = cls(driver, dict(driver_options or {}), dict(vehicle or {}))
        fit = require_list("fit", fit, "parameters")
        if not fit:
            raise FreneticError("nothing is to be fitted: name parameters, such as braking")
        try:
            default_driver, _ = model.make({}, Rules())
        except ValueError as error:
            raise FreneticError(str(error)) from None
        if vehicle := getattr(unwrapped(default_driver), "VEHICLE", None):
            model = replace(model, vehicle={"name": vehicle, **model.vehicle})
        car = Vehicle.of(model.vehicle)
        arguments = DRIVERS.construction(driver, driver_options or {}, {}).arguments
        options = {**(options_of(default_driver) or {}), **arguments}
        known = {
            f"driver.{name}": float(value)
            for name, value in options.items()
            if isinstance(value, (int, float)) and not isinstance(value, bool)
            if math.isfinite(value)
        }
        known |= {f"vehicle.{item.name}": getattr(car, item.name) for item in fields(car)}
        known |= {f"condition.{name}": 0.0 for name in _FITTED_CONDITIONS}
        parameters: dict[str, Parameter] = {}
        for text in fit:
            parameter = model._parameter(text, known)
            if str(parameter) in parameters:
                raise FreneticError(f"{parameter} is to be fitted twice: once is enough")
            parameters[str(parameter)] = parameter
        return replace(model, parameters=tuple(parameters.values()))

    @classmethod
    def of_profile(cls, profile: TwinProfile) -> TwinModel:
        """Return the model of a twin's profile, with the parameters that it says were fitted.

        Raises:
            FreneticError: the profile is out of range, or has conditions that were not fitted.
        """
        spec = profile.spec()
        fitted = [Parameter.of(parameter) for parameter in profile.fitted]
        known = {(parameter.owner, parameter.name) for parameter in fitted}
        if left := [name for name in spec.conditions if ("condition", name) not in known]:
            raise FreneticError(
                f"the profile {profile.name!r} has the condition {left[0]}, which nobody fitted: a"
                " twin drives as a driver and a car alone do"
            )
        vehicle = spec.part("simulator").options.get("vehicle") or {}
        if isinstance(vehicle, str):
            vehicle = {"name": vehicle}
        return cls(*spec.part("driver"), vehicle, tuple(fitted))

    def _parameter(self, text: str, known: Mapping[str, float]) -> Parameter:
        asked, equals, bounds = (part.strip() for part in text.partition("="))
        matches = [name for name in known if asked in (name, name.partition(".")[2])]
        if not matches:
            plain = [name.partition(".")[2] for name in known]
            driver_parameters = [name for name in known if name.startswith("driver.")]
            raise FreneticError(
                f"there is no parameter {asked!r} to fit{hint(asked, [*plain, *known])}"
                f" {self.driver} has:"
                f" {', '.join(driver_parameters) or 'none that is a number'}; beside:"
                " condition.delay, and vehicle. followed by"
                f" {', '.join(item.name for item in fields(Vehicle))}"
            )
        if len(matches) > 1:
            raise FreneticError(f"{asked!r} may be {' or '.join(matches)}: say which one")
        owner, _, name = matches[0].partition(".")
        start = known[matches[0]]
        whole = Parameter(owner, name, start, start, start)  # type: ignore[arg-type]  # a ParameterOwner
        if not equals:
            if start <= 0.0:
                raise FreneticError(
                    f"{matches[0]} is {start:g}, so it has no usual bounds: state them, as in"
                    f" {name}=LOW:HIGH"
                )
            low, high = (self._nearest(whole, start, start * by) for by in (1.0 / SPAN, SPAN))
        else:
            try:
                low, high = map(float, bounds.split(":"))
            except ValueError:
                low = high = math.nan
            if not low < high:
                raise FreneticError(
                    f"the bounds of {matches[0]} are {bounds}: LOW:HIGH with LOW below HIGH is"
                    " needed, as in braking=1:4"
                )
            for value in (low, high):
                if trouble := self._trouble(whole, value):
                    raise FreneticError(f"{matches[0]} cannot be {value:g}: {trouble}")
        return replace(whole, low=low, high=high, start=min(max(start, low), high))

    def _nearest(self, parameter: Parameter, start: float, wanted: float) -> float:
        """Return the allowed value nearest to a wanted one, on the way there from the start."""
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
        """Return why a parameter cannot have a value beside the others'; empty if it can."""
        try:
            self.make({str(parameter): value}, Rules())
        except (FreneticError, ValueError) as error:
            return str(error)
        return ""

    def _options(self, values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
        """Return the options of driver, vehicle and conditions with these values."""
        options: dict[str, dict[str, Any]] = {
            "driver": dict(self.driver_options),
            "vehicle": dict(self.vehicle),
            "condition": {},
        }
        for name, value in values.items():
            owner, _, parameter = name.partition(".")
            options[owner][parameter] = value
        return options

    def make(self, values: Mapping[str, float], rules: Rules) -> tuple[Driver, EmbeddedSimulator]:
        """Return driver and simulator with these values.

        Args:
            values: name with its owner -> value.
            rules: rules of the simulator.

        Raises:
            FreneticError: the driver refuses the values.
            ValueError: the car refuses the values.
        """
        options = self._options(values)
        driver = load_driver(self.driver, options["driver"], **options["condition"])
        return driver, EmbeddedSimulator(vehicle=Vehicle.of(options["vehicle"]), rules=rules)

    def spec(self, values: Mapping[str, float], terms: Spec) -> Spec:
        """Return a spec with this driver and car, and with rules, map and lanes of another."""
        options = self._options(values)
        vehicle = options["vehicle"]
        simulator = part_word("embedded", {"vehicle": vehicle} if vehicle else {})
        return structs.replace(
            terms,
            driver=part_word(self.driver, options["driver"]),
            conditions=options["condition"],
            simulator=simulator,
        )

    def values(self, places: Sequence[float]) -> dict[str, float]:
        """Return the values by name of the parameters at places 0..1 between their bounds."""
        located = zip(self.parameters, places, strict=True)
        return {str(parameter): parameter.at(float(place)) for parameter, place in located}
