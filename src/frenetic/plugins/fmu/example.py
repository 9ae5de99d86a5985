"""An example of an FMU: a lane keeper in C, which this module builds for this machine.

``python -m frenetic.plugins.fmu.example lane_keeper.fmu`` builds it, with the compiler ``cc``. Its
source and its variables are in ``lane_keeper.c`` beside this file.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal, NamedTuple
from zipfile import ZIP_DEFLATED, ZipFile

from frenetic.errors import FreneticError

SOURCE: Final = Path(__file__).with_name("lane_keeper.c")
"""Source of the FMU in C."""
IDENTIFIER: Final = "lane_keeper"
"""Name of the FMU's binary, without its ending."""
_COMPILERS: Final = ("cc", "gcc", "clang")


class ExampleVariable(NamedTuple):
    """A variable of the example; its value reference is the number of values before it."""

    name: str
    causality: Literal["input", "output", "parameter"]
    unit: str
    """Name of a unit of `_UNITS`; another has no base unit; empty for none."""
    start: float | None = None
    """Start value; None for an output."""
    size: int = 1
    """Number of values; more than one needs FMI 3."""


VARIABLES: Final = (
    ExampleVariable("lateralDeviation", "input", "m", 0.0),
    ExampleVariable("e_psi", "input", "rad", 0.0),
    ExampleVariable("kappa", "input", "1/m", 0.0),
    ExampleVariable("v", "input", "m/s", 0.0),
    ExampleVariable("steeringAngle", "output", "deg"),
    ExampleVariable("gain", "parameter", "1/s", 0.5),
    ExampleVariable("wheelbase", "parameter", "m", 2.7),
    ExampleVariable("limit", "parameter", "deg", 8.0),
    ExampleVariable("lag", "parameter", "s", 0.05),
    ExampleVariable("heading_gain", "parameter", "1", 0.4),
)
"""Variables of the example."""
_UNITS: Final = {
    "m": 'm="1"',
    "rad": 'rad="1"',
    "deg": 'rad="1" factor="0.017453292519943295"',
    "1/m": 'm="-1"',
    "m/s": 'm="1" s="-1"',
    "km/h": 'm="1" s="-1" factor="0.2777777777777778"',
    "s": 's="1"',
    "1/s": 's="-1"',
}
"""Name of a unit -> attributes of its base unit in FMI."""
_TIME: Final = (
    '<Float64 name="time" valueReference="1000" causality="independent" variability="continuous"/>'
)
"""Independent variable, which FMI 3.0 asks for."""


def build(
    file: Path | str,
    *,
    fmi: Literal[2, 3] = 2,
    variables: Iterable[ExampleVariable] = VARIABLES,
    law: Path | None = None,
    step: float | None = None,
) -> Path:
    """Build the example, or a variation of it, and return the FMU's path.

    Args:
        file: path of the FMU.
        fmi: major version of FMI.
        variables: variables, with as many values as `VARIABLES`.
        law: file in C with the function ``law``, in place of the example's, see ``lane_keeper.c``.
        step: preferred step size, in s; None to name none.

    Raises:
        FreneticError: there is no compiler, or the source cannot be compiled.
    """
    with TemporaryDirectory() as folder:
        name = f"{IDENTIFIER}{_ending()}"
        binary = Path(folder) / name
        options = [f"-DFMI={fmi}", *([] if law is None else [f'-DLAW="{law.resolve()}"'])]
        _compile(binary, options)
        with ZipFile(file, "w", ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", _description(fmi, variables, step))
            archive.write(binary, f"binaries/{platform_folder(fmi)}/{name}")
    return Path(file)


def compiler() -> str | None:
    """Return the path of a compiler for C; None if there is none."""
    return next(filter(None, map(shutil.which, _COMPILERS)), None)


def platform_folder(fmi: int) -> str:
    """Return the name of the folder of this machine's binaries in an FMU."""
    from fmpy import platform, platform_tuple  # of the extra "fmu"

    return str(platform if fmi == 2 else platform_tuple)


def _ending() -> str:
    """Return the ending of the name of a shared library."""
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _compile(binary: Path, options: Iterable[str]) -> None:
    """Compile the source into a shared library.

    Raises:
        FreneticError: there is no compiler, or it refuses the source.
    """
    program = compiler()
    if program is None:
        raise FreneticError(f"there is no compiler for C: install {' or '.join(_COMPILERS)}")
    command = [program, "-shared", "-fPIC", "-O1", *options, str(SOURCE), "-o"]
    ended = subprocess.run(  # noqa: S603  # the compiler of this machine compiles our source
        [*command, str(binary), "-lm"], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        raise FreneticError(f"{program} cannot compile {SOURCE.name}: {ended.stderr.strip()[:300]}")


def _description(fmi: int, variables: Iterable[ExampleVariable], step: float | None) -> str:
    """Return the model description of the FMU, as XML."""
    variables = tuple(variables)
    names = dict.fromkeys(variable.unit for variable in variables if variable.unit)
    units = "".join(f'<Unit name="{name}">{_base_unit(name)}</Unit>' for name in names)
    of_version = _description_2 if fmi == 2 else _description_3
    head, elements, outputs = of_version(variables)
    experiment = "" if step is None else f'<DefaultExperiment stepSize="{step}"/>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription {head}'
        f' modelName="LaneKeeper"><CoSimulation modelIdentifier="{IDENTIFIER}"'
        f' canHandleVariableCommunicationStepSize="true"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions>"
        '<LogCategories><Category name="logStatusError"/></LogCategories>'
        f"{experiment}<ModelVariables>{''.join(elements)}</ModelVariables>"
        f"<ModelStructure>{outputs}</ModelStructure></fmiModelDescription>\n"
    )


def _base_unit(name: str) -> str:
    """Return the element of a unit's base unit; empty for a unit that only has a name."""
    return f"<BaseUnit {_UNITS[name]}/>" if name in _UNITS else ""


def _description_2(variables: Sequence[ExampleVariable]) -> tuple[str, list[str], str]:
    """Return the parts of FMI 2.0's description: head, variables, and lists of outputs."""
    elements = [
        f'<ScalarVariable name="{variable.name}" valueReference="{reference}"'
        f" {_kind(variable)}><Real{_unit_and_start(variable)}/></ScalarVariable>"
        for reference, variable in _numbered(variables)
    ]
    unknowns = "".join(
        f'<Unknown index="{i}"/>'
        for i, variable in enumerate(variables, start=1)
        if variable.causality == "output"
    )
    lists = "".join(f"<{name}>{unknowns}</{name}>" for name in ("Outputs", "InitialUnknowns"))
    return 'fmiVersion="2.0" guid="{1}"', elements, lists


def _description_3(variables: Sequence[ExampleVariable]) -> tuple[str, list[str], str]:
    """Return the parts of FMI 3.0's description: head, variables, and lists of outputs."""
    elements = [_TIME]
    for reference, variable in _numbered(variables):
        dimension = f'<Dimension start="{variable.size}"/>' if variable.size > 1 else ""
        elements.append(
            f'<Float64 name="{variable.name}" valueReference="{reference}" {_kind(variable)}'
            f"{_unit_and_start(variable)}>{dimension}</Float64>"
        )
    lists = "".join(
        f'<{name} valueReference="{reference}"/>'
        for name in ("Output", "InitialUnknown")
        for reference, variable in _numbered(variables)
        if variable.causality == "output"
    )
    return 'fmiVersion="3.0" instantiationToken="{1}"', elements, lists


def _numbered(variables: Sequence[ExampleVariable]) -> Iterator[tuple[int, ExampleVariable]]:
    """Yield value reference and variable."""
    references = accumulate((variable.size for variable in variables), initial=0)
    yield from zip(references, variables, strict=False)


def _kind(variable: ExampleVariable) -> str:
    """Return the attributes of a variable's kind."""
    variability = "fixed" if variable.causality == "parameter" else "continuous"
    return f'causality="{variable.causality}" variability="{variability}"'


def _unit_and_start(variable: ExampleVariable) -> str:
    """Return the attributes of a variable's unit and start value."""
    unit = f' unit="{variable.unit}"' if variable.unit else ""
    starts = "" if variable.start is None else " ".join([str(variable.start)] * variable.size)
    return unit + (f' start="{starts}"' if starts else "")


if __name__ == "__main__":
    build(*sys.argv[1:2] or [f"{IDENTIFIER}.fmu"])
