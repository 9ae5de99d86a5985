"""The model description of an FMU: its variables with their units, and how it is simulated."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from frenetic._support.units import Unit, unit_named
from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, describe_error
from frenetic.plugins.fmu.archive import DESCRIPTION, FmuArchive

_MOST_TEXT: Final = 300
"""Largest number of characters of a reason in a message; our choice."""
_IN_SCHEMA: Final = re.compile(r"\(line \d+, column \d+\)")
"""Pattern of a problem that fmpy finds by the schema of FMI, rather than by its other rules."""
_TYPES: Final = {
    **dict.fromkeys(("Real", "Float64", "Float32"), float),
    **dict.fromkeys(("Integer", "Enumeration"), int),
    **{f"{sign}Int{bits}": int for sign in ("", "U") for bits in (8, 16, 32, 64)},
    "Boolean": bool,
    "String": str,
}
"""Type of a variable in FMI -> its type in Python; other types are not supported."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU."""

    name: str
    reference: int
    """Value reference."""
    fmi_type: str
    """Type in FMI, such as ``Real`` or ``Float64``."""
    causality: str
    size: int
    """Number of values: 1 for a scalar."""
    unit_name: str | None
    """Name of the unit; None without one."""
    unit: Unit | None
    """The unit; None if the variable has none, or one that is not known."""

    @property
    def python_type(self) -> type:
        """Type of the values in Python."""
        return _TYPES[self.fmi_type]


@dataclass(frozen=True)
class Description:
    """What is known of an FMU before its code is loaded."""

    fmi: int
    """Major version of FMI, 2 or 3."""
    identifier: str
    """Name of the binary, without its ending."""
    token: str
    """Token or GUID by which binary and description know each other."""
    variables: Mapping[str, Variable]
    """Name -> variable of a supported type, in the order of the description."""
    start_time: float
    """Time at which a simulation starts, in s."""
    step: float | None
    """Preferred step size, in s; None if the description names none."""
    folder: str
    """Folder of this machine's binaries in the archive."""

    @classmethod
    def of(cls, archive: FmuArchive) -> Self:
        """Read the description of an FMU.

        Raises:
            FreneticError: fmpy is not installed.
            ValueError: the description is damaged, or no FMU for co-simulation on this machine.
        """
        try:
            import fmpy  # of the extra "fmu"
        except ImportError as error:
            raise FreneticError(f"an FMU needs fmpy: {pip_install('fmu')}") from error
        model = _read(archive)
        fmi = int(model.fmiVersion[0])
        if model.coSimulation is None:
            raise ValueError("it is an FMU for model exchange: export it for co-simulation")
        folder = f"binaries/{fmpy.platform if fmi == 2 else fmpy.platform_tuple}"
        identifier = str(model.coSimulation.modelIdentifier)
        _require_binary(archive, f"{folder}/{identifier}{fmpy.sharedLibraryExtension}")
        experiment = model.defaultExperiment
        return cls(
            fmi=fmi,
            identifier=identifier,
            token=str(model.guid),
            variables=_variables(model),
            start_time=_number(getattr(experiment, "startTime", None)) or 0.0,
            step=_number(getattr(experiment, "stepSize", None)) or None,
            folder=folder,
        )

    def with_causality(self, *causalities: str) -> dict[str, Variable]:
        """Return name -> variable, of the variables with one of the causalities."""
        return {
            name: variable
            for name, variable in self.variables.items()
            if variable.causality in causalities
        }


def _read(archive: FmuArchive) -> Any:
    """Return the description as fmpy reads and validates it.

    Raises:
        ValueError: it is damaged, or of a version other than FMI 2 and 3.
    """
    # Of the extra "fmu".
    from fmpy.model_description import ValidationError, read_model_description

    try:
        text = archive.description.decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"its {DESCRIPTION} is damaged: it is no UTF-8") from None
    if re.search(r"<!(DOCTYPE|ENTITY)", text):  # they may name files of this machine
        raise ValueError(f"its {DESCRIPTION} has a document type, which FMI does not know")
    encoding = re.match(r"\s*<\?xml[^>]*\sencoding\s*=\s*[\"']([^\"']*)", text)
    if encoding is not None and encoding[1].lower() not in ("utf-8", "utf8", "us-ascii"):
        raise ValueError(f"its {DESCRIPTION} says that it is {encoding[1][:20]}: FMI needs UTF-8")
    version = re.search(r"<fmiModelDescription\s[^>]*?fmiVersion\s*=\s*[\"']([^\"']*)", text)
    if version is None or version[1][:2] not in ("2.", "3."):
        raise ValueError(f"it has FMI {version[1][:9] if version else '?'}: 2.0 or 3.0 is needed")
    file = archive.description_alone()
    try:
        try:
            return read_model_description(file)
        except ValidationError as error:
            problems = [str(problem) for problem in error.problems]
            if any(_IN_SCHEMA.search(problem) for problem in problems):
                raise
            # Tools break rules that do no harm here, such as about the variability of a number.
            logger.info("the FMU breaks rules of FMI: %s", "; ".join(problems)[:_MOST_TEXT])
            return read_model_description(file, validate=False)
    except ValidationError as error:
        more = f" (and {len(error.problems) - 1} more)" if error.problems[1:] else ""
        reason = f"{error.problems[0]}{more}"
    except Exception as error:  # fmpy and lxml raise many classes
        reason = describe_error(error)
    reason = " ".join(reason.split())[:_MOST_TEXT]
    raise ValueError(f"its {DESCRIPTION} is damaged: {reason}")


def _require_binary(archive: FmuArchive, binary: str) -> None:
    """Check that an FMU has a binary for this machine.

    Raises:
        ValueError: it has none; the message names the platforms that it has.
    """
    if binary in archive.names:
        return
    folders = {name.split("/")[1] for name in archive.names if name.startswith("binaries/")}
    platforms = ", ".join(sorted(filter(None, folders)))[:_MOST_TEXT]
    platforms = f"its platforms are {platforms}" if platforms else "it has no platform"
    if any(name.startswith("sources/") for name in archive.names):
        platforms += "; it has sources, which 'fmpy compile' compiles"
    raise ValueError(f"it has no {binary}: {platforms}")


def _variables(model: Any) -> dict[str, Variable]:
    """Return the variables of supported types: name -> variable."""
    units = {unit.name: _unit(unit) for unit in model.unitDefinitions}
    variables = {}
    for item in model.modelVariables:
        if item.type not in _TYPES:
            continue
        unit_name = item.unit or getattr(item.declaredType, "unit", None)
        unit = None
        if unit_name is not None:
            unit = units.get(unit_name) or unit_named(unit_name)
        variables[item.name] = Variable(
            name=item.name,
            reference=item.valueReference,
            fmi_type=item.type,
            causality=item.causality,
            size=math.prod(item.shape or ()),
            unit_name=unit_name,
            unit=unit,
        )
    return variables


def _unit(definition: Any) -> Unit | None:
    """Return a unit of the description; None if it is not defined, or of other dimensions."""
    base = definition.baseUnit
    if base is None or base.offset or any((base.kg, base.A, base.K, base.mol, base.cd)):
        return None
    return Unit(float(base.factor), int(base.m), int(base.s))


def _number(text: object) -> float | None:
    """Return a finite number of at least 0; None for any other text."""
    try:
        number = float(str(text))
    except ValueError:
        return None
    return number if 0.0 <= number < math.inf else None
