"""Makes drivers, simulators, strategies and campaigns from a command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic.cli.options import as_usage_error
from frenetic.registry import SIMULATORS, STRATEGIES, Registry

if TYPE_CHECKING:
    from frenetic.campaign import Budget, Campaign
    from frenetic.drivers import Driver
    from frenetic.search import Strategy
    from frenetic.simulators import Simulator

LAYERS = ("noise", "delay", "view")
LIMITS = ("speed_limit", "oob_tolerance", "wall_limit")

WALL_LIMIT: Final = 60.0
"""s of wall time that a drive may take unless it is said, or the simulator says otherwise."""


def make_campaign(
    command: Mapping[str, Any],
    *,
    seed: object,
    map_size: float,
    budget: Budget,
    folder: Path,
    lookahead: int | None,
    workers: int | None,
    cluster: str | None,
    drive_limit: float | None,
) -> Campaign:
    """The campaign of a command line, as it was given or as a campaign has recorded it.

    Without a number of workers there are as many as the simulator is best used by, or as there are
    cores.
    """
    from frenetic.campaign import LOOKAHEAD, Campaign
    from frenetic.campaign.workers import available_cores

    driver = make_driver(*(command[k] for k in ("driver", "driver_options", *LAYERS)))
    simulator = make_simulator(*(command[k] for k in ("simulator", "simulator_options", *LIMITS)))
    strategy: Strategy = make_part(
        STRATEGIES,
        command["strategy"],
        command["strategy_options"],
        {"seed": seed, "map_size": map_size},
    )
    with as_usage_error():
        return Campaign(
            strategy=strategy,
            simulator=simulator,
            driver=driver,
            budget=budget,
            folder=folder,
            map_size=map_size,
            workers=workers or getattr(simulator, "usual_workers", None) or available_cores(),
            cluster=cluster,
            ordered=lookahead is not None,
            lookahead=lookahead or LOOKAHEAD,
            drive_limit=drive_limit,
            description={"seed": seed, "command": dict(command)},  # type: ignore[dict-item]
        )


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
    limit: float = getattr(SIMULATORS.load(simulator), "usual_wall_limit", WALL_LIMIT)
    return limit


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
