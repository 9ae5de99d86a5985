"""Third-party drivers: controllers of other projects, unmodified, from their packages.

Each file holds the glue between an `Observation` and one package's own controller; ``vehicles`` has
the packages' own cars. What the glue decides is said in each class, and for all of them:

- The speed. Who has a speed law follows the built-in drivers' plan with it; the others take their
  pedals. The option ``lateral`` is what the plan accepts in bends; 100 keeps the speed limit.
- The car. What a controller asks about it, such as the wheelbase, comes from the `DriveSetup`.

Nothing here imports a package before its driver is made, so that it need not be installed.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final

from frenetic._support.words import pip_install
from frenetic.drivers import DriveSetup, Planner, SpeedPlan
from frenetic.errors import FreneticError

LATERAL: Final = 4.0
"""Lateral acceleration that a third-party driver accepts in bends by default, in m/s^2."""


def package(module: str, extra: str) -> Any:
    """A module of a package, which the extra of the driver's name brings.

    Raises:
        FreneticError: it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise FreneticError(
            f"the driver {extra} needs the package {error.name}: {pip_install(extra)}"
        ) from error


def speed_plan(setup: DriveSetup, lateral: float) -> SpeedPlan:
    """Return the built-in drivers' speed plan with this lateral acceleration in bends, in m/s^2."""
    return SpeedPlan(setup, Planner(lateral_acceleration=lateral))
