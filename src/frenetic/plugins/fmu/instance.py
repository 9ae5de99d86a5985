"""A running instance of an FMU, by fmpy: its code is loaded here, and may do anything."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from ctypes import byref
from pathlib import Path
from typing import Any, Final

from frenetic.errors import DriverError, describe_error
from frenetic.plugins.fmu.description import Description, Variable

_MOST_MESSAGE: Final = 300
"""Largest number of characters of a message of the FMU; our choice."""
_WARNING: Final = 1
"""Status of FMI from which on a message tells what is wrong."""
_FATAL: Final = 4
"""Status of FMI after which no function of the FMU may be called."""


class FmuError(DriverError):
    """An FMU that cannot be loaded, or whose function failed."""


class Values:
    """The values of some variables of one type, which one call sets or gets.

    Args:
        component: the instance of fmpy.
        fmi: major version of FMI.
        variables: variables of one type.
    """

    def __init__(self, component: Any, fmi: int, variables: Sequence[Variable]) -> None:
        from fmpy import fmi2, fmi3  # of the extra "fmu"

        (name,) = {variable.fmi_type for variable in variables}
        if name == "Enumeration":
            name = "Integer" if fmi == 2 else "Int64"
        module = fmi2 if fmi == 2 else fmi3
        count, size = len(variables), sum(variable.size for variable in variables)
        element_type = getattr(module, f"fmi{fmi}{name}")
        self.is_float = variables[0].python_type is float
        self.values = (element_type * size)()
        """Values, in the order of the variables."""
        self._component = component
        self._functions = {
            verb: getattr(component, f"fmi{fmi}{verb}{name}") for verb in ("Get", "Set")
        }
        references = (module.__dict__[f"fmi{fmi}ValueReference"] * count)(
            *(variable.reference for variable in variables)
        )
        sizes = (size,) if fmi == 3 else ()
        self._arguments = (references, count, self.values, *sizes)

    def set(self, values: Sequence[Any]) -> None:
        """Set the variables' values; numbers are rounded for variables of whole numbers."""
        self.values[:] = values if self.is_float else [self._converted(v) for v in values]
        self._functions["Set"](self._component.component, *self._arguments)

    def get(self) -> list[Any]:
        """Return the variables' present values."""
        self._functions["Get"](self._component.component, *self._arguments)
        return list(self.values)

    def _converted(self, value: Any) -> Any:
        """Return a value as the array takes it."""
        if isinstance(value, str):
            return value.encode()
        if isinstance(value, bool):
            return value
        return round(value)


class Instance:
    """An instance of an FMU for one drive.

    Args:
        description: description of the FMU.
        folder: folder with its binaries and resources.
        parameters: name of a parameter -> its value.

    Raises:
        FmuError: the FMU cannot be loaded or instantiated, or refuses a parameter.
    """

    def __init__(
        self, description: Description, folder: Path, parameters: Mapping[str, Any]
    ) -> None:
        self._description = description
        self._message = ""
        self._is_initialised = self._is_fatal = False
        self._time = description.start_time
        self._component: Any = None
        try:
            self._guard("it cannot be loaded", lambda: self._load(folder))
            self._guard("it refuses its parameters", lambda: self._set_parameters(parameters))
        except FmuError:
            self.close()
            raise

    def _load(self, folder: Path) -> None:
        """Load the FMU's code and instantiate it."""
        from fmpy import fmi2, fmi3  # of the extra "fmu"

        description = self._description
        kind = fmi2.FMU2Slave if description.fmi == 2 else fmi3.FMU3Slave
        before = Path.cwd()
        try:
            component = kind(
                guid=description.token,
                modelIdentifier=description.identifier,
                unzipDirectory=str(folder),
                instanceName=description.identifier,
            )
        finally:
            os.chdir(before)  # fmpy stays in another folder if the library cannot be loaded
        try:
            if description.fmi == 2:
                component.instantiate(callbacks=self._callbacks(), loggingOn=True)
            else:
                component.instantiate(logMessage=self._log_3, loggingOn=True)
        except Exception:
            component.freeLibrary()  # there is no instance to free
            raise
        self._component = component
        if description.fmi == 2:
            component.setupExperiment(startTime=self._time)

    def _set_parameters(self, parameters: Mapping[str, Any]) -> None:
        """Set the parameters."""
        for name, value in parameters.items():
            variable = self._description.variables[name]
            self.values([variable]).set([value] * variable.size)

    def values(self, variables: Sequence[Variable]) -> Values:
        """Return the access to the values of variables of one type."""
        return Values(self._component, self._description.fmi, variables)

    def set_inputs(self, inputs: Sequence[tuple[Values, Sequence[Any]]]) -> None:
        """Set inputs; at first, initialise the FMU with them.

        Args:
            inputs: access to variables, and their values.

        Raises:
            FmuError: a function of the FMU failed.
        """

        def set_all() -> None:
            for values, numbers in inputs:
                values.set(numbers)

        if self._is_initialised:
            self._guard("it refuses its inputs", set_all)
        else:
            self._guard("its initialisation failed", lambda: self._initialise(set_all))

    def step(self, step: float) -> None:
        """Do a step of a time, in s.

        Raises:
            FmuError: the step failed, or the FMU asks to end.
        """
        time = self._time - self._description.start_time
        self._guard(f"its step at {time:g} s failed", lambda: self._do_step(step))
        self._time += step

    def get(self, values: Values) -> list[Any]:
        """Return the values of variables.

        Raises:
            FmuError: the FMU refuses.
        """
        numbers: list[Any] = []
        self._guard("it refuses its outputs", lambda: numbers.extend(values.get()))
        return numbers

    def error(self, text: str) -> str:
        """Return a text about an error, with the FMU's last message."""
        return f"{text}; its last message: {self._message}" if self._message else text

    def close(self) -> None:
        """End the simulation and free the instance, and its code."""
        component, self._component = self._component, None
        if component is None or self._is_fatal:
            return
        with suppress(Exception):  # an FMU that failed may refuse
            if self._is_initialised:
                component.terminate()
        with suppress(Exception):
            component.freeInstance()

    def _initialise(self, set_inputs: Callable[[], None]) -> None:
        """Pass through the initialization mode of FMI."""
        arguments = {} if self._description.fmi == 2 else {"startTime": self._time}
        self._component.enterInitializationMode(**arguments)
        set_inputs()
        self._component.exitInitializationMode()
        self._is_initialised = True

    def _do_step(self, step: float) -> None:
        """Do a step.

        Raises:
            FmuError: the FMU asks to end.
        """
        result = self._component.doStep(self._time, step)
        if self._description.fmi == 3 and result[1]:
            raise FmuError("it asks to end the simulation")

    def _guard(self, text: str, call: Callable[[], object]) -> None:
        """Call a function of the FMU.

        Raises:
            FmuError: it failed; the message begins with the text.
        """
        try:
            call()
        except FmuError as error:
            raise FmuError(self.error(f"{text}: {error}")) from None
        except Exception as error:  # fmpy raises several classes
            self._is_fatal = getattr(error, "status", None) == _FATAL
            reason = str(error) if hasattr(error, "status") else describe_error(error)
            reason = " ".join(reason.split()).removesuffix(".")[:_MOST_MESSAGE]
            raise FmuError(self.error(f"{text}: {reason}")) from None

    def _callbacks(self) -> Any:
        """Return the functions that an FMU of FMI 2 may call."""
        from fmpy import calloc, fmi2, free  # of the extra "fmu"

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log_2)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        with suppress(Exception):  # a machine without fmpy's library sees messages unformatted
            from fmpy.logging import addLoggerProxy  # a library for some platforms

            addLoggerProxy(byref(callbacks))
        return callbacks

    def _log_2(self, _: Any, name: bytes, status: int, category: bytes, message: bytes) -> None:
        """Take a message of an FMU of FMI 2."""
        del name
        self._log_3(_, status, category, message)

    def _log_3(self, _: Any, status: int, category: bytes, message: bytes) -> None:
        """Take a message of the FMU: the last one from `_WARNING` on is kept."""
        del category
        if status >= _WARNING:
            text = (message or b"").decode(errors="replace")
            self._message = " ".join(text.split())[:_MOST_MESSAGE]
