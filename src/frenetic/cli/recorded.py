"""The driver and simulator of a campaign, made again from its record, or others in their place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

import click

from frenetic.cli.beamng import beamng_options, with_beamng
from frenetic.cli.options import Setting, as_usage_error
from frenetic.cli.parts import (
    LAYERS,
    WALL_LIMIT,
    make_driver,
    make_part,
    usual_wall_limit,
)
from frenetic.errors import CampaignError
from frenetic.registry import SIMULATORS

if TYPE_CHECKING:
    from frenetic.campaign import CampaignStore
    from frenetic.drivers import Driver
    from frenetic.simulators import Rules, Simulator

_WITHOUT: Final = {"noise": 0.0, "delay": 0.0, "view": math.inf}
"""Amounts that make a layer superfluous."""

P = ParamSpec("P")
R = TypeVar("R")


def part_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose other parts than the recorded ones; None if not given."""
    options = [
        click.option("--driver", metavar="D", help="Another driver than the campaign's."),
        click.option(
            "--driver-option",
            "driver_options",
            type=Setting(),
            multiple=True,
            help="An option of the driver, such as aggression=1.2; may be repeated.",
        ),
        click.option("--noise", type=float, metavar="M", help="Another noise, as in run; 0: none."),
        click.option("--delay", type=float, metavar="S", help="Another delay, as in run; 0: none."),
        click.option("--view", type=float, metavar="M", help="Another view, as in run; inf: all."),
        click.option(
            "--simulator",
            metavar="S",
            is_eager=True,
            help="Another simulator than the campaign's.",
        ),
        click.option(
            "--simulator-option",
            "simulator_options",
            type=Setting(),
            multiple=True,
            callback=with_beamng,
            help="An option of the simulator, such as friction=0.7; may be repeated.",
        ),
        click.option("--speed-limit", type=float, metavar="KMH", help="Another speed limit."),
        click.option("--oob-tolerance", type=float, metavar="SHARE", help="Another tolerance."),
        click.option(
            "--wall-limit", type=float, metavar="S", help="Another limit of a drive's wall time."
        ),
    ]
    command = beamng_options(command)
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class RecordedParts:
    """A driver and a simulator by name, with all that their making takes."""

    driver: str
    """A name, ``package.module:Class`` or ``file.py:Class``."""
    driver_options: Mapping[str, Any]
    noise: float | None
    """Amount of the layer over the driver, in m; None without it, as for the next two."""
    delay: float | None
    """s."""
    view: float | None
    """m."""
    simulator: str
    simulator_options: Mapping[str, Any]
    rules: Rules
    wall_limit: float
    """s."""

    def make_driver(self) -> Driver:
        """The driver under its layers."""
        return make_driver(self.driver, self.driver_options, self.noise, self.delay, self.view)

    def make_simulator(self) -> Simulator:
        """The simulator with its rules, not yet entered."""
        available = {"rules": self.rules, "wall_limit": self.wall_limit}
        simulator: Simulator = make_part(
            SIMULATORS, self.simulator, self.simulator_options, available
        )
        return simulator


def recorded_parts(store: CampaignStore, given: Mapping[str, Any] | None = None) -> RecordedParts:
    """The parts of a campaign, with what was given on the command line in their place.

    Another driver or simulator comes with the options that are given for it, as the recorded ones
    belong to the old one; without another, given options are added to the recorded ones. Layers and
    rules are as recorded unless they are given.

    Args:
        store: the campaign.
        given: values of the options of `part_options`.

    Raises:
        CampaignError: the campaign was started from Python and a part is not given, or its record
            is damaged.
        click.UsageError: a rule that is given is out of range.
    """
    from frenetic.campaign.configuration import command_faults, configuration_faults
    from frenetic.campaign.store import DATABASE
    from frenetic.simulators import Rules

    asked = {k: v for k, v in (given or {}).items() if v is not None and v != ()}
    config: Mapping[str, Any] = store.config
    command = config.get("command")
    if command is None and not {"driver", "simulator"} <= asked.keys():
        raise CampaignError(
            f"{store.folder} was started from Python, so its driver and simulator have no names:"
            " give --driver and --simulator, or do it from Python"
        )
    if faults := [*configuration_faults(config), *command_faults(config)]:
        raise CampaignError(
            f"{store.folder / DATABASE} does not say with what it was driven: {'; '.join(faults)};"
            " restore it from a copy"
        )
    recorded = {} if command is None else command
    parts: dict[str, Any] = {}
    for part in ("driver", "simulator"):
        options = f"{part}_options"
        is_another = part in asked
        parts[part] = asked[part] if is_another else recorded[part]
        own = {} if is_another else recorded[options]
        parts[options] = {**own, **dict(asked.get(options, ()))}
    for name in LAYERS:
        parts[name] = asked.get(name, recorded.get(name))
        if asked.get(name) == _WITHOUT[name]:
            parts[name] = None
    changed = {k: asked[k] for k in ("speed_limit", "oob_tolerance") if k in asked}
    with as_usage_error():
        rules = replace(Rules(**config["rules"]), **changed)
    # The limit of another simulator says nothing about this one.
    is_same = parts["simulator"] == recorded.get("simulator")
    usual = WALL_LIMIT if is_same else usual_wall_limit(parts["simulator"])
    limit = recorded.get("wall_limit", usual) if is_same else usual
    return RecordedParts(**parts, rules=rules, wall_limit=asked.get("wall_limit", limit))
