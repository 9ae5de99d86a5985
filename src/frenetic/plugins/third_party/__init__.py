"""Third-party drivers: controllers of other projects, unmodified, from their packages.

Each file holds the glue that turns an `Observation` into the input of one package's controller, and
its output into `Controls`. ``vehicles`` has the cars that the packages bring. Each class says what
its glue decides. All have in common:

- Speed: ``fiss-planner`` plans its speed itself. The other drivers follow the built-in drivers'
  speed plan: HighwayEnv by its own speed law, the others with the pedals of the plan. The option
  ``lateral`` is the lateral acceleration that is accepted in bends; with 100 m/s^2, cars keep to
  the speed limit alone.
- Car: values that a controller needs, such as the wheelbase, come from the `DriveSetup`.

A package is imported when its driver is made, so packages of other drivers need not be installed.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError


def package(module: str, extra: str) -> Any:
    """Import and return a module of a package.

    Args:
        module: full name of the module.
        extra: name of the driver, and of the extra that installs the package.

    Raises:
        FreneticError: the package is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise FreneticError(
            f"the driver {extra} needs the package {error.name}: {pip_install(extra)}"
        ) from error
