"""Makes drivers, simulators, strategies and campaigns from a command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic.cli.options import as_usage_error
from frenetic.registry import SIMULATORS, Registry

if TYPE_CHECKING:
    from frenetic.drivers import Driver
    from frenetic.simulators import Simulator

LAYERS = ("noise", "delay", "view")
LIMITS = ("speed_limit", "oob_tolerance", "wall_limit")

WALL_LIMIT: Final = 60.0
"""Default limit of a drive's wall time, in s, unless the simulator has its own."""


def make_driver(
    spec: str,
    options: Mapping[str, Any],
    noise: float | None,
    delay: float | None,
    view: float | None,
) -> Driver:
    """The driver of a command line, under the layers that it asks for."""
    from frenetic.drivers.loading import load_driver

    return load_driver(spec, options, noise=noise, delay=delay, view=view)


def make_simulator(
    spec: str,
    options: Mapping[str, Any],
    speed_limit: float,
    oob_tolerance: float,
    wall_limit: float,
) -> Simulator:
    """The simulator of a command line, with its rules."""
    from frenetic.simulators import Rules

    with as_usage_error():
        rules = Rules(speed_limit=speed_limit, oob_tolerance=oob_tolerance)
    simulator: Simulator = make_part(
        SIMULATORS, spec, options, {"rules": rules, "wall_limit": wall_limit}
    )
    return simulator


def usual_wall_limit(simulator: str) -> float:
    """The wall time in s that a drive in the simulator of that name may take by default."""
    from frenetic.simulators.capabilities import usual

    return usual(SIMULATORS.load(simulator)).usual_wall_limit


def make_part(
    registry: Registry, spec: str, options: Mapping[str, Any], available: Mapping[str, object]
) -> Any:
    """A part with its options, and with those of the command that its class takes."""
    for name in options:
        if name in available:
            raise click.UsageError(
                f"--{registry.kind}-option {name} is not allowed: it follows from the options of"
                " the command"
            )
    return registry.make_from(spec, options, available)
