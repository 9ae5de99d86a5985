"""The twin's model: a driver and a car, and the parameters that are fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Literal, Self, TypeAlias

from msgspec import structs

from frenetic._support.files import require_list
from frenetic._support.option_text import part_word
from frenetic.drivers.driver import Driver
from frenetic.drivers.loading import load_driver
from frenetic.drivers.stack import unwrapped
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.parts.construction import options_of
from frenetic.parts.registry import DRIVERS, hint
from frenetic.plugins.twin.profile import Fitted, TwinProfile
from frenetic.plugins.twin.unit_values import unit_value_of, value_at
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.spec import Spec

ParameterOwner: TypeAlias = Literal["driver", "vehicle", "condition"]

BOUNDS_FACTOR: Final = 4.0
"""Factor between a parameter's value and its bounds if none are stated; our choice."""
_HALVINGS: Final = 20  # of the distance to an allowed bound: a millionth remains
_FITTED_CONDITIONS: Final = ("delay",)
"""Conditions that can be fitted: noise differs from drive to drive, and a view may be endless."""


@dataclass(frozen=True)
class Parameter:
    """A parameter to be fitted, with its bounds.

    A *unit value* says where a value lies between the bounds, from 0 at ``low`` to 1 at ``high``;
    the scale is logarithmic if both bounds are positive.
    """

    owner: ParameterOwner
    name: str
    """Name of the option or condition, without the owner."""
    low: float
    high: float
    start: float
    """Value before the fit."""

    @classmethod
    def of(cls, fitted: Fitted) -> Self:
        """Return the parameter of a profile; it starts at the value that was fitted."""
        owner, _, name = fitted.name.partition(".")
        low, high = min(fitted.low, fitted.value), max(fitted.high, fitted.value)
        return cls(owner, name, low, high, fitted.value)  # type: ignore[arg-type]  # a ParameterOwner

    def __str__(self) -> str:
        return f"{self.owner}.{self.name}"

    def value_at(self, unit_value: float) -> float:
        """Return the value of a unit value, which is cut to 0..1."""
        return value_at(unit_value, self.low, self.high)

    @property
    def unit_start(self) -> float:
        """Unit value of the start."""
        return unit_value_of(self.start, self.low, self.high)


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
        """Return the model of a driver, with the parameters that are to be fitted.

        Args:
            driver: the driver, as `frenetic.drivers.loading.load_driver` takes it.
            fit: one or more parameters, with or without owner and bounds: ``braking``,
                ``vehicle.friction=0.5:1.2``.
            driver_options: options of the driver, with which the fit begins.
            vehicle: the car with which the fit begins, as `Vehicle.of` takes it.

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
        # A driver may be made for a car, such as BeamNG.AI's.
        if driver_car := getattr(unwrapped(default_driver), "VEHICLE", None):
            model = replace(model, vehicle={"name": driver_car, **model.vehicle})
        start_values = model._start_values(default_driver)
        parameters: dict[str, Parameter] = {}
        for text in fit:
            parameter = model._parameter(text, start_values)
            if str(parameter) in parameters:
                raise FreneticError(f"{parameter} is to be fitted twice: once is enough")
            parameters[str(parameter)] = parameter
        return replace(model, parameters=tuple(parameters.values()))

    @classmethod
    def of_profile(cls, profile: TwinProfile) -> TwinModel:
        """Return the model of a twin's profile, with the parameters that were fitted.

        Raises:
            FreneticError: the profile is out of range, or has conditions that were not fitted.
        """
        spec = profile.spec()
        fitted = [Parameter.of(parameter) for parameter in profile.fitted]
        known = {(parameter.owner, parameter.name) for parameter in fitted}
        if unfitted := [name for name in spec.conditions if ("condition", name) not in known]:
            raise FreneticError(
                f"the profile {profile.name!r} has the condition {unfitted[0]}, which nobody"
                " fitted: a twin drives as a driver and a car alone do"
            )
        vehicle = spec.part("simulator").options.get("vehicle") or {}
        if isinstance(vehicle, str):
            vehicle = {"name": vehicle}
        return cls(*spec.part("driver"), vehicle, tuple(fitted))

    def _start_values(self, driver: Driver) -> dict[str, float]:
        """Return the full name of each parameter that can be fitted -> its value before the fit.

        Args:
            driver: the model's driver, made with its options.
        """
        car = Vehicle.of(self.vehicle)
        arguments = DRIVERS.construction(self.driver, self.driver_options, {}).arguments
        options = {**(options_of(driver) or {}), **arguments}
        values = {
            f"driver.{name}": float(value)
            for name, value in options.items()
            if isinstance(value, (int, float)) and not isinstance(value, bool)
            if math.isfinite(value)
        }
        values |= {f"vehicle.{item.name}": getattr(car, item.name) for item in fields(car)}
        values |= {f"condition.{name}": 0.0 for name in _FITTED_CONDITIONS}
        return values

    def _parameter(self, text: str, start_values: Mapping[str, float]) -> Parameter:
        """Return the parameter that a text names, with its bounds.

        Args:
            text: the parameter as `of` takes it.
            start_values: full name of each parameter -> its value before the fit.
        """
        asked, equals, bounds = (part.strip() for part in text.partition("="))
        matches = [name for name in start_values if asked in (name, name.partition(".")[2])]
        if not matches:
            raise self._unknown_parameter_error(asked, list(start_values))
        if len(matches) > 1:
            raise FreneticError(f"{asked!r} may be {' or '.join(matches)}: say which one")
        full_name = matches[0]
        start = start_values[full_name]
        low, high = (
            self._stated_bounds(full_name, bounds)
            if equals
            else self._usual_bounds(full_name, start)
        )
        owner, _, name = full_name.partition(".")
        start = min(max(start, low), high)
        return Parameter(owner, name, low, high, start)  # type: ignore[arg-type]  # a ParameterOwner

    def _unknown_parameter_error(self, asked: str, full_names: list[str]) -> FreneticError:
        """Return the error about a parameter that does not exist, which lists those that do."""
        names = [name.partition(".")[2] for name in full_names]
        driver_parameters = [name for name in full_names if name.startswith("driver.")]
        return FreneticError(
            f"there is no parameter {asked!r} to fit{hint(asked, [*names, *full_names])}"
            f" {self.driver} has:"
            f" {', '.join(driver_parameters) or 'none that is a number'}; beside:"
            " condition.delay, and vehicle. followed by"
            f" {', '.join(item.name for item in fields(Vehicle))}"
        )

    def _usual_bounds(self, full_name: str, start: float) -> tuple[float, float]:
        """Return bounds of a parameter from its value before the fit."""
        if start <= 0.0:
            raise FreneticError(
                f"{full_name} is {start:g}, so it has no usual bounds: state them, as in"
                f" {full_name.partition('.')[2]}=LOW:HIGH"
            )
        low = self._nearest_allowed(full_name, start, start * (1.0 / BOUNDS_FACTOR))
        high = self._nearest_allowed(full_name, start, start * BOUNDS_FACTOR)
        return low, high

    def _stated_bounds(self, full_name: str, text: str) -> tuple[float, float]:
        """Return the bounds of a parameter that a text LOW:HIGH states."""
        try:
            low, high = map(float, text.split(":"))
        except ValueError:
            low = high = math.nan  # refused below
        if not low < high:
            raise FreneticError(
                f"the bounds of {full_name} are {text}: LOW:HIGH with LOW below HIGH is"
                " needed, as in braking=1:4"
            )
        for value in (low, high):
            if refusal := self._refusal(full_name, value):
                raise FreneticError(f"{full_name} cannot be {value:g}: {refusal}")
        return low, high

    def _nearest_allowed(self, full_name: str, start: float, wanted: float) -> float:
        """Return the allowed value of a parameter nearest to a wanted one, between it and start."""
        if not self._refusal(full_name, wanted):
            return wanted
        allowed, refused = start, wanted
        for _ in range(_HALVINGS):
            middle = 0.5 * (allowed + refused)
            if self._refusal(full_name, middle):
                refused = middle
            else:
                allowed = middle
        return allowed

    def _refusal(self, full_name: str, value: float) -> str:
        """Return why driver or car refuse a parameter's value; empty if they take it."""
        try:
            self.make({full_name: value}, Rules())
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
        for full_name, value in values.items():
            owner, _, name = full_name.partition(".")
            options[owner][name] = value
        return options

    def make(self, values: Mapping[str, float], rules: Rules) -> tuple[Driver, EmbeddedSimulator]:
        """Return driver and simulator with these values.

        Args:
            values: full name, such as ``driver.braking`` -> value; others stay as in the model.
            rules: rules of the simulator.

        Raises:
            FreneticError: the driver refuses the values.
            ValueError: the car refuses the values.
        """
        options = self._options(values)
        driver = load_driver(self.driver, options["driver"], **options["condition"])
        return driver, EmbeddedSimulator(vehicle=Vehicle.of(options["vehicle"]), rules=rules)

    def spec(self, values: Mapping[str, float], terms: Spec) -> Spec:
        """Return the spec of the twin with these values of its parameters.

        Args:
            values: full name of a parameter -> value.
            terms: spec whose rules, map and lanes the twin's spec takes.
        """
        options = self._options(values)
        vehicle = options["vehicle"]
        simulator = part_word("embedded", {"vehicle": vehicle} if vehicle else {})
        return structs.replace(
            terms,
            driver=part_word(self.driver, options["driver"]),
            conditions=options["condition"],
            simulator=simulator,
        )

    def values(self, unit_values: Sequence[float]) -> dict[str, float]:
        """Return full name -> value of the parameters that have these unit values."""
        return {
            str(parameter): parameter.value_at(float(unit_value))
            for parameter, unit_value in zip(self.parameters, unit_values, strict=True)
        }
