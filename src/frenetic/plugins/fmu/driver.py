"""A driver that is a functional mock-up unit: a controller that another tool exported."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Any, ClassVar, Final, NamedTuple
from weakref import finalize

from frenetic._support.bounds import check
from frenetic.drivers import Planner, SpeedPlan
from frenetic.drivers.driver import Controls, DriveSetup, Observation
from frenetic.drivers.noting import LONGEST_NAME, MOST_NAMES
from frenetic.drivers.stack import PERIODS
from frenetic.errors import ControlsError
from frenetic.parts.registry import hint
from frenetic.plugins.fmu.archive import read_archive
from frenetic.plugins.fmu.description import Description, Variable
from frenetic.plugins.fmu.instance import FmuError, Instance, Values
from frenetic.plugins.fmu.links import InputLink, Links, OutputLink
from frenetic.plugins.fmu.signals import LONGITUDINAL, SETUP_SIGNALS, Moment
from frenetic.plugins.fmu.table import SignalTable

PERIOD: Final = 0.05
"""Period of an FMU whose preferred step size is no period of a driver, in s."""
_PERIOD_STEP: Final = 0.01
"""Step of the embedded simulator, of which the period of an FMU is a multiple, in s."""
_ROUNDING: Final = 1e-9
"""Time by which two times may differ that are the same, in s."""


class _Input(NamedTuple):
    """Access to some inputs of one type, and where their values come from."""

    values: Values
    links: Sequence[InputLink]
    constants: Sequence[bool | float] = ()
    """Values in place of links."""

    def numbers(self, moment: Moment) -> Sequence[float]:
        """Return the inputs' values, in their units."""
        if self.constants:
            return self.constants
        return [link.factor * number for link in self.links for number in link.source(moment)]


class _RunningInstance:
    """The running instance of a driver, which ends with the driver."""

    def __init__(self) -> None:
        self.instance: Instance | None = None

    def close(self) -> None:
        """End the instance, if there is one."""
        if self.instance is not None:
            self.instance.close()
            self.instance = None


class Fmu:
    """A driver whose controls an FMU for co-simulation computes, of FMI 2.0 or 3.0.

    Names or a table link the FMU's variables with signals. The FMU's code is loaded when a drive
    begins, not before: making the driver runs no foreign code. Each drive has a new instance.

    In each period the FMU gets its inputs and does a step; its outputs hold until the next period.
    With a longer preferred step, it does a step when one is due, and the outputs hold until then.

    Args:
        fmu: path of the file.
        signals: path of a `frenetic.plugins.fmu.table.SignalTable` in TOML; None to go by names.
        parameters: parameters of the FMU by name, in their units; they win over the table's.

    Raises:
        FreneticError: fmpy is not installed, or the table is damaged.
        ValueError: the file holds no FMU that can drive here, or a parameter or an entry of the
            table does not suit it.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, which campaigns record, see `frenetic.parts.versions`."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("fmpy",)
    """Packages whose versions campaigns record, too."""

    def __init__(self, fmu: str, /, *, signals: str | None = None, **parameters: Any) -> None:
        self._path = str(fmu)
        self._signals = None if signals is None else str(signals)
        self._given_parameters = parameters
        self._archive = read_archive(self._path)
        self._table = SignalTable() if signals is None else SignalTable.read(signals)
        self._description = Description.of(self._archive)
        self._archive.check_contents(self._description.folder)
        self._prepare()

    @property
    def options(self) -> dict[str, Any]:
        """Paths of the FMU and its table, and the parameters."""
        table = {} if self._signals is None else {"signals": self._signals}
        return {"fmu": self._path, **table, **self._given_parameters}

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments and the files' contents: the other process may have no such files.

        A running instance stays in its process.
        """
        names = ("_path", "_signals", "_given_parameters", "_archive", "_table", "_description")
        return {name: getattr(self, name) for name in names}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()

    def _prepare(self) -> None:
        """Set all that follows from the files and the arguments.

        Raises:
            ValueError: they do not suit each other.
        """
        self._links = Links.of(self._description, self._table)
        self._parameters = self._checked_parameters()
        try:
            check(self._table.speed, Planner)
            self._planner = Planner(**self._table.speed)
        except (TypeError, ValueError) as error:
            raise ValueError(f"the table's speed: {error}") from None
        self.period = _period(self._table.period, self._description.step)
        """Time between two calls of `act`, in s."""
        self._step = max(self.period, self._description.step or 0.0)
        controls = {link.control for link in self._links.outputs}
        self._has_pedals = not controls.isdisjoint(chain(*LONGITUDINAL))
        self._running = _RunningInstance()
        # At the end of the process nothing is freed: foreign code could still crash it.
        finalize(self, self._running.close).atexit = False

    def _checked_parameters(self) -> dict[str, Any]:
        """Return name -> value of the FMU's parameters; a signal's name is a text.

        Raises:
            ValueError: there is no such parameter, or its value has another type.
        """
        known = self._description.with_causality("parameter")
        values = {**self._table.parameters, **self._given_parameters}
        for name, value in values.items():
            if name not in known:
                names = ["signals", *known]
                raise ValueError(
                    f"it has no parameter {name!r}{hint(name, names)} It has:"
                    f" {', '.join([*known][:40]) or 'none'}"
                )
            _check_value(known[name], value)
        return values

    def reset(self, setup: DriveSetup) -> None:
        """Load the FMU's code and make a new instance.

        Raises:
            FmuError: the FMU cannot be loaded or instantiated, or refuses a parameter.
        """
        self._setup = setup
        self._plan = SpeedPlan(setup, self._planner)
        self._running.close()
        with self._naming_file():
            try:
                folder = self._archive.unpacked(self._description.folder)
            except (OSError, ValueError) as error:
                raise FmuError(f"it cannot be unpacked: {error}") from None
            parameters = {
                name: _parameter_value(self._description.variables[name], value, setup)
                for name, value in self._parameters.items()
            }
            self._running.instance = Instance(self._description, folder, parameters)
        self._inputs = list(self._input_accesses(self._running.instance))
        self._outputs = list(self._output_accesses(self._running.instance))
        self._noted = list(self._noted_accesses(self._running.instance))
        self._next_step: float | None = None
        self._controls = Controls(0.0)

    def act(self, observation: Observation) -> Controls:
        """Return the FMU's controls, after its step if one is due.

        Raises:
            FmuError: a function of the FMU failed.
            ControlsError: an output is no finite number.
        """
        if self._next_step is None:
            self._next_step = observation.time
        # Several steps are due after calls that a wrapper left out.
        steps = math.floor((observation.time - self._next_step + _ROUNDING) / self._step) + 1
        if steps > 0:
            self._next_step += steps * self._step
            with self._naming_file():
                self._controls = self._after_steps(observation, steps)
        if self._has_pedals:
            return self._controls
        return self._plan.controls(observation, self._controls.steering)

    @property
    def trace_notes(self) -> dict[str, float]:
        """Present outputs of the FMU in their units, for a trace: name -> number."""
        instance = self._running.instance
        if instance is None:
            return {}
        return {
            name: float(number)
            for access, names in self._noted
            for name, number in zip(names, instance.get(access), strict=True)
        }

    def _after_steps(self, observation: Observation, steps: int) -> Controls:
        """Set the inputs, do steps, and return the controls of the outputs.

        Raises:
            FmuError: a function of the FMU failed.
            ControlsError: an output is no finite number.
        """
        instance = self._running.instance
        assert instance is not None
        moment = Moment(observation, self._setup, self._plan)
        instance.set_inputs([(access.values, access.numbers(moment)) for access in self._inputs])
        for _ in range(steps):
            instance.step(self._step)
        values: dict[str, float] = {}
        for access, links in self._outputs:
            for link, value in zip(links, instance.get(access), strict=True):
                if not math.isfinite(value):
                    raise ControlsError(
                        instance.error(f"its output {link.variable.name} is {value:g}")
                    )
                values[link.control] = link.factor * float(value)
        return self._controls_of(values, observation.speed)

    def _controls_of(self, values: Mapping[str, float], speed: float) -> Controls:
        """Return the controls for the FMU's outputs; without pedals the pedals are 0.

        Args:
            values: control -> value, in our units.
            speed: speed of the car, in m/s.
        """
        setup = self._setup
        if "steering" in values:
            steering = values["steering"]
        elif "steering_share" in values:
            steering = values["steering_share"] * setup.max_steering
        else:
            steering = math.atan(values["curvature"] * setup.wheelbase)
        if "acceleration" in values:
            return Controls.from_acceleration(
                values["acceleration"], steering, speed=speed, setup=setup
            )
        pedal = values.get("pedal", 0.0)
        throttle, brake = values.get("throttle", pedal), values.get("brake", -pedal)
        return Controls(steering, throttle=max(throttle, 0.0), brake=max(brake, 0.0))

    def _input_accesses(self, instance: Instance) -> Iterator[_Input]:
        """Yield the accesses to the inputs, one for each type."""
        links: dict[str, list[InputLink]] = {}
        for link in self._links.inputs:
            links.setdefault(link.variables[0].fmi_type, []).append(link)
        for of_type in links.values():
            variables = [variable for link in of_type for variable in link.variables]
            yield _Input(instance.values(variables), of_type)
        for name, constant in self._links.constants.items():
            variable = self._description.variables[name]
            yield _Input(instance.values([variable]), (), [constant] * variable.size)

    def _output_accesses(self, instance: Instance) -> Iterator[tuple[Values, list[OutputLink]]]:
        """Yield the accesses to the outputs, one for each type."""
        links: dict[str, list[OutputLink]] = {}
        for link in self._links.outputs:
            links.setdefault(link.variable.fmi_type, []).append(link)
        for of_type in links.values():
            yield instance.values([link.variable for link in of_type]), of_type

    def _noted_accesses(self, instance: Instance) -> Iterator[tuple[Values, list[str]]]:
        """Yield the accesses to the outputs that a trace holds, and the names of their notes."""
        outputs = [
            variable
            for variable in self._description.with_causality("output").values()
            if variable.size == 1 and variable.python_type is not str
        ][:MOST_NAMES]
        names = _note_names(variable.name for variable in outputs)
        for fmi_type in dict.fromkeys(variable.fmi_type for variable in outputs):
            of_type = [variable for variable in outputs if variable.fmi_type == fmi_type]
            yield instance.values(of_type), [names[variable.name] for variable in of_type]

    @contextmanager
    def _naming_file(self) -> Iterator[None]:
        """Put the FMU's file before the messages of its errors."""
        try:
            yield
        except (FmuError, ControlsError) as error:
            raise type(error)(f"{self._path}: {error}") from None


def _period(stated: float | None, step: float | None) -> float:
    """Return the period of an FMU: stated by its table, else its step size if that is a period.

    Args:
        stated: period of the table, in s.
        step: preferred step size of the FMU, in s.

    Raises:
        ValueError: the stated period is no period of a driver.
    """
    shortest, longest = PERIODS
    for period in (stated, step):
        if period is not None:
            multiple = period / _PERIOD_STEP
            is_multiple = abs(multiple - round(multiple)) < _ROUNDING / _PERIOD_STEP
            if is_multiple and shortest - _ROUNDING <= period <= longest + _ROUNDING:
                return round(multiple) / round(1.0 / _PERIOD_STEP)
        if period is stated is not None:
            raise ValueError(
                f"the table's period is {period:g} s: {shortest:g} to {longest:g} in steps of"
                f" {_PERIOD_STEP:g}"
            )
    return PERIOD


def _note_names(names: Iterable[str]) -> dict[str, str]:
    """Return variable -> the name of its note, such as ``lka_delta`` for ``lka.delta``.

    Variables that would have the same are numbered: ``lka_delta_2`` for ``lka_delta`` after it.
    """
    notes: dict[str, str] = {}
    for name in names:
        text = re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", name)
        note, count = text[:LONGEST_NAME], 1
        while note in notes.values():
            count += 1
            end = f"_{count}"
            note = text[: LONGEST_NAME - len(end)] + end
        notes[name] = note
    return notes


def _check_value(variable: Variable, value: object) -> None:
    """Check the value of a parameter against its type.

    Raises:
        ValueError: it has another type.
    """
    kind: type = variable.python_type
    is_number = isinstance(value, int | float)
    if kind is bool:
        fits, needed = isinstance(value, bool), "true or false"
    elif kind is int:
        fits = isinstance(value, int | float) and float(value).is_integer()
        needed = "a whole number"
    elif kind is float:
        fits = is_number or (isinstance(value, str) and value in SETUP_SIGNALS)
        needed = f"a number, or {', '.join(SETUP_SIGNALS)},"
    else:
        fits, needed = isinstance(value, str | int | float), "a text"
    if not fits:
        raise ValueError(f"its parameter {variable.name} is {value!r}: {needed} is needed")


def _parameter_value(variable: Variable, value: Any, setup: DriveSetup) -> Any:
    """Return the value of a parameter for a drive, in the parameter's unit."""
    if variable.python_type is str:
        return str(value)
    if isinstance(value, str):
        factor = 1.0 if variable.unit is None else variable.unit.factor
        return float(getattr(setup, value)) / factor
    return value
