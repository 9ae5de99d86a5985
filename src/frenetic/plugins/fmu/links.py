"""Which variable of an FMU is which signal: by its table, else by its name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.signal_links import known_unit, units_in
from frenetic._support.signal_names import recognised
from frenetic._support.units import Unit
from frenetic.drivers.driver import AHEAD_SPACING
from frenetic.parts.registry import hint
from frenetic.plugins.fmu.description import Description, Variable
from frenetic.plugins.fmu.signals import (
    CONTROLS,
    LATERAL,
    LONGITUDINAL,
    PREVIEWS,
    SIGNALS,
    Source,
    source,
)
from frenetic.plugins.fmu.table import START, Entry, SignalTable, VariableLink

_ELEMENT: Final = re.compile(r"(.*)\[(\d+)\]")
"""Name of an element of an array, such as ``kappa[3]``."""
_INPUTS: Final[Mapping[str, Any]] = {**SIGNALS, **PREVIEWS}


class InputLink(NamedTuple):
    """Where the values of some inputs come from: ``value = factor * source``."""

    variables: Sequence[Variable]
    """An array, a scalar, or scalars that are elements of an array."""
    source: Source
    factor: float


class OutputLink(NamedTuple):
    """Which control an output is: ``control = factor * value``."""

    variable: Variable
    control: str
    factor: float


@dataclass(frozen=True)
class Links:
    """The links of an FMU's variables."""

    inputs: Sequence[InputLink]
    constants: Mapping[str, bool | float]
    """Input -> its constant value, in its unit."""
    outputs: Sequence[OutputLink]
    """Outputs that steer and drive."""

    @classmethod
    def of(cls, description: Description, table: SignalTable) -> Links:
        """Link the variables of an FMU.

        Raises:
            ValueError: an input has no source, no output steers, two outputs are one control, or an
                entry of the table does not suit the FMU.
        """
        inputs = description.with_causality("input")
        outputs = description.with_causality("output")
        arrays = _arrays(inputs, table.inputs)
        _require_known("input", table.inputs, [*inputs, *arrays])
        _require_known("output", table.outputs, outputs)
        links, missing = [], []
        constants: dict[str, bool | float] = {}
        for name, variables in arrays.items():
            entry = _entry(name, variables, table.inputs)
            if entry is None:
                missing.append(name)
            elif isinstance(entry, bool | float):
                constants |= {variable.name: entry for variable in variables}
            elif entry != START:
                links.append(_input_link(name, variables, entry))
        if missing:
            raise ValueError(
                f"no signal is known for its input {', '.join(missing[:20])}: name it in a table,"
                f" signals=table.toml; signals are {', '.join(_INPUTS)}"
            )
        return cls(links, constants, _output_links(outputs, table.outputs))


def _arrays(inputs: Mapping[str, Variable], entries: Iterable[str]) -> dict[str, list[Variable]]:
    """Return inputs by name; the elements of an array, such as ``kappa[1]``, are one input.

    An element that the table names is an input of its own.
    """
    named = frozenset(entries)
    elements: dict[str, list[tuple[int, Variable]]] = {}
    for name, variable in inputs.items():
        match = _ELEMENT.fullmatch(name)
        if match is not None and match[1] not in inputs and name not in named:
            elements.setdefault(match[1], []).append((int(match[2]), variable))
        else:
            elements[name] = [(0, variable)]
    return {
        name: [variable for _, variable in sorted(items, key=lambda item: item[0])]
        for name, items in elements.items()
    }


def _entry(
    name: str, variables: Sequence[Variable], entries: Mapping[str, Entry]
) -> Entry | VariableLink | None:
    """Return the entry of an input: of the table, else the signal of its name; None if unknown."""
    if name in entries:
        entry = entries[name]
        return float(entry) if isinstance(entry, int) and not isinstance(entry, bool) else entry
    if variables[0].python_type is str:
        return START
    return recognised(name, {signal: item.names for signal, item in _INPUTS.items()})


def _input_link(name: str, variables: Sequence[Variable], entry: str | VariableLink) -> InputLink:
    """Return the link of an input.

    Raises:
        ValueError: there is no such signal, or the signal does not suit the input.
    """
    link = entry if isinstance(entry, VariableLink) else VariableLink(signal=entry)
    if link.signal not in _INPUTS:
        raise ValueError(
            f"its input {name}: there is no signal {link.signal!r}{hint(link.signal, _INPUTS)}"
            f" There are {', '.join(_INPUTS)}"
        )
    if any(variable.python_type is str for variable in variables):
        raise ValueError(f"its input {name} is a text: no signal is one")
    size = sum(variable.size for variable in variables)
    unit = known_unit(_INPUTS[link.signal].unit)
    factor = link.factor / _factor("input", variables[0], link, unit)
    return InputLink(variables, source(link.signal, _distances(name, size, link)), factor)


def _distances(name: str, size: int, link: VariableLink) -> FloatArray:
    """Return the distances ahead of an input's elements, (size,) in m.

    Raises:
        ValueError: the link has another number of distances, or its signal has none.
    """
    if link.signal in SIGNALS:
        if link.distances or size > 1:
            raise ValueError(
                f"its input {name} has {size} elements and {len(link.distances)} distances:"
                f" {link.signal} is one number, without distances"
            )
        return np.zeros(1)
    if link.distances and len(link.distances) != size:
        raise ValueError(
            f"its input {name} has {size} elements and {len(link.distances)} distances: as many are"
            " needed"
        )
    if link.distances:
        return np.array(link.distances)
    return AHEAD_SPACING * np.arange(size, dtype=np.float64)


def _factor(kind: str, variable: Variable, link: VariableLink, unit: Unit) -> float:
    """Return the number of our units in one of a variable's units.

    Raises:
        ValueError: the variable's unit is not known, or measures something else.
    """
    try:
        return units_in(link, variable.name, variable.unit_name, variable.unit, unit)
    except ValueError as error:
        raise ValueError(f"its {kind} {error}") from None


def _output_links(
    outputs: Mapping[str, Variable], entries: Mapping[str, str | VariableLink]
) -> list[OutputLink]:
    """Return the links of the outputs that steer and drive.

    Raises:
        ValueError: no output steers, two outputs are one control, or an entry is wrong.
    """
    links = {name: _as_link(entry) for name, entry in entries.items()}
    for name, link in links.items():
        if link.signal not in CONTROLS:
            raise ValueError(
                f"its output {name}: there is no control {link.signal!r}"
                f"{hint(link.signal, CONTROLS)} There are {', '.join(CONTROLS)}"
            )
        if outputs[name].python_type is str or outputs[name].size != 1:
            raise ValueError(f"its output {name} is no number: the {link.signal} is one")
    names = {control: item.names for control, item in CONTROLS.items()}
    guesses = {
        name: VariableLink(signal=control)
        for name, variable in outputs.items()
        if name not in links and variable.size == 1 and variable.python_type is not str
        if (control := recognised(name, names)) is not None
    }
    chosen: dict[str, VariableLink] = {}
    for groups in ([(control,) for control in LATERAL], LONGITUDINAL):
        for candidates in (links, guesses):  # what the table says comes before what names say
            group = _first_group(candidates, groups)
            if group:
                chosen |= group
                break
    if not any(link.signal in LATERAL for link in chosen.values()):
        raise ValueError(
            f"none of its outputs ({', '.join([*outputs][:20]) or 'none'}) is known to steer: name"
            f" one in a table, signals=table.toml, as {' or '.join(LATERAL)}"
        )
    return [
        OutputLink(
            outputs[name],
            link.signal,
            _factor("output", outputs[name], link, known_unit(CONTROLS[link.signal].unit))
            / link.factor,
        )
        for name, link in chosen.items()
    ]


def _first_group(
    links: Mapping[str, VariableLink], groups: Iterable[tuple[str, ...]]
) -> dict[str, VariableLink] | None:
    """Return the outputs of the first group of controls that there are; None without any.

    Raises:
        ValueError: two outputs are one control.
    """
    for group in groups:
        members = {name: link for name, link in links.items() if link.signal in group}
        for control in group:
            names = [name for name, link in members.items() if link.signal == control]
            if len(names) > 1:
                raise ValueError(
                    f"its outputs {' and '.join(names)} may both be the {control}: name one in a"
                    " table, signals=table.toml"
                )
        if members:
            return members
    return None


def _as_link(entry: str | VariableLink) -> VariableLink:
    """Return an entry of the table as a link."""
    return entry if isinstance(entry, VariableLink) else VariableLink(signal=entry)


def _require_known(kind: str, entries: Iterable[str], known: Iterable[str]) -> None:
    """Check that the FMU has the variables that a table names.

    Raises:
        ValueError: it lacks one.
    """
    names = list(known)
    for name in entries:
        if name not in names:
            raise ValueError(f"it has no {kind} {name!r}{hint(name, names)}")
