"""The configuration in a campaign's database, and its validation.

`Campaign.configuration` writes it; it is validated here once when it is read.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from frenetic.errors import CampaignError
from frenetic.simulators.drive import CarBody, Rules
from frenetic.spec import Budget

Check: TypeAlias = Callable[[object], str]
"""What is wrong with a value, in words that follow "is ..:"; empty if nothing is."""


@dataclass(frozen=True)
class Entry:
    """A value of a configuration."""

    check: Check
    is_needed: bool = True
    """Whether it is always there; campaigns of older versions lack the others."""


def is_number(value: object) -> bool:
    """Whether it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max  # a whole number may be too large for a float


def _a_number(*, above: float = -math.inf, at_least: float = -math.inf) -> Check:
    allowed = "a number"
    if above > -math.inf:
        allowed += f" above {above:g}"
    if at_least > -math.inf:
        allowed += f" of at least {at_least:g}"

    def check(value: object) -> str:
        fits = is_number(value) and value > above and value >= at_least  # type: ignore[operator]
        return "" if fits else f"{allowed} is needed"

    return check


def _a_whole_number(at_least: int) -> Check:
    def check(value: object) -> str:
        fits = isinstance(value, int) and not isinstance(value, bool) and value >= at_least
        return "" if fits else f"a whole number of at least {at_least} is needed"

    return check


def _or_none(check: Check) -> Check:
    return lambda value: (
        "" if value is None else check(value).replace(" is needed", " or null is needed")
    )


def _a_text(value: object) -> str:
    return "" if isinstance(value, str) else "a text is needed"


def _an_object(value: object) -> str:
    return "" if isinstance(value, Mapping) else "an object is needed"


def _a_seed(value: object) -> str:
    """Strategies of one's own may take whatever they like for a seed."""
    return "an object or list is no seed" if isinstance(value, (Mapping, list)) else ""


def _a_part(value: object) -> str:
    if not isinstance(value, Mapping) or not isinstance(value.get("class"), str):
        return "an object with a class is needed"
    for name in ("options", "driver"):
        if name in value and not isinstance(value[name], Mapping):
            return f"its {name} have to be an object"
    return _a_part(value["driver"]) if "driver" in value else ""


def _versions(value: object) -> str:
    is_fine = isinstance(value, Mapping) and all(isinstance(v, str) for v in value.values())
    return "" if is_fine else "an object with a text for each package is needed"


def _fields_of(kind: type, *, or_none: bool = False) -> Check:
    """Numbers for all fields of a dataclass, which it takes."""

    def check(value: object) -> str:
        if not isinstance(value, Mapping):
            return "an object is needed"
        names = [item.name for item in fields(kind)]
        if missing := [name for name in names if name not in value]:
            return f"it lacks {', '.join(missing)}"
        for name, number in value.items():
            if name not in names:
                return f"it has no {name}"
            if not (is_number(number) or (number is None and or_none)):
                return f"its {name} has to be a number"
        try:
            kind(**value)
        except (TypeError, ValueError) as error:
            return str(error)
        return ""

    return check


BUDGET: Final[Check] = _fields_of(Budget, or_none=True)
"""Checks a budget."""

CONFIGURATION: Final[Mapping[str, Entry]] = MappingProxyType(
    {
        "seed": Entry(_a_seed),
        "strategy": Entry(_a_part),
        "simulator": Entry(_a_part),
        "driver": Entry(_a_part),
        "rules": Entry(_fields_of(Rules)),
        "car": Entry(_fields_of(CarBody)),
        "budget": Entry(BUDGET),
        "map_size": Entry(_a_number(above=0.0)),
        "margin": Entry(_a_number(at_least=0.0)),
        "lane_width": Entry(_a_number(above=0.0)),
        "workers": Entry(_a_whole_number(1), is_needed=False),
        "cluster": Entry(_or_none(_a_text), is_needed=False),
        "lookahead": Entry(_or_none(_a_whole_number(1)), is_needed=False),
        "versions": Entry(_versions),
    }
)
"""What `Campaign.configuration` writes."""

COMMAND: Final[Mapping[str, Entry]] = MappingProxyType(
    {
        "strategy": Entry(_a_text),
        "strategy_options": Entry(_an_object),
        "driver": Entry(_a_text),
        "driver_options": Entry(_an_object),
        "noise": Entry(_or_none(_a_number())),
        "delay": Entry(_or_none(_a_number())),
        "view": Entry(_or_none(_a_number())),
        "simulator": Entry(_a_text),
        "simulator_options": Entry(_an_object),
        "speed_limit": Entry(_a_number(above=0.0)),
        "oob_tolerance": Entry(_a_number(above=0.0)),
        "wall_limit": Entry(_a_number(above=0.0)),
    }
)
"""What the configuration holds as ``command`` if the campaign was started from a command line."""


def configuration_faults(config: Mapping[str, Any]) -> list[str]:
    """What is wrong with a configuration, each in one line."""
    return faults_of(CONFIGURATION, config)


def command_faults(config: Mapping[str, Any]) -> list[str]:
    """What keeps a campaign of a command line from being resumed, each in one line."""
    command = config.get("command")
    if command is None:
        return []
    if not isinstance(command, Mapping):
        return [f"the command is {shown(command)}: an object is needed"]
    return [f"the command: {fault}" for fault in faults_of(COMMAND, command)]


def faults_of(entries: Mapping[str, Entry], values: Mapping[str, Any]) -> list[str]:
    """What is wrong with some values, each in one line."""
    faults = []
    for name, entry in entries.items():
        if name not in values:
            if entry.is_needed:
                faults.append(f"{name} is missing")
        elif fault := entry.check(values[name]):
            faults.append(f"{name} is {shown(values[name])}: {fault}")
    return faults


def shown(value: object) -> str:
    """What a value looks like, shortened."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@dataclass(frozen=True)
class RecordedCommand:
    """The command line that started a campaign."""

    options: Mapping[str, Any]
    """Name -> value, the names being those of `COMMAND`."""
    seed: Any
    map_size: float
    """m."""
    lookahead: int | None


def recorded_command(config: Mapping[str, Any], database: object) -> RecordedCommand | None:
    """Returns the command line that started a campaign, None if it was started from Python.

    Args:
        config: the campaign's.
        database: what to call the place where it stands.

    Raises:
        CampaignError: it is incomplete.
    """
    if config.get("command") is None:
        return None
    needed = {name: CONFIGURATION[name] for name in ("seed", "map_size", "lookahead")}
    if faults := [*command_faults(config), *faults_of(needed, config)]:
        raise CampaignError(
            f"{database} does not say how to go on with the campaign: {'; '.join(faults)}; restore"
            " it from a copy, or run the campaign again"
        )
    return RecordedCommand(
        config["command"], config["seed"], config["map_size"], config.get("lookahead")
    )


def recorded_budget(
    config: Mapping[str, Any], facts: Mapping[str, Any], database: object
) -> Budget:
    """Returns the budget that a campaign had last.

    Args:
        config: the campaign's.
        facts: the campaign's.
        database: what to call the place where it stands.

    Raises:
        CampaignError: it is no budget.
    """
    budget: Any = facts.get("budget", config.get("budget"))
    if fault := BUDGET(budget):
        raise CampaignError(
            f"{database} does not say how to go on with the campaign: the budget is"
            f" {shown(budget)}: {fault}; restore it from a copy, or say how much more"
        )
    return Budget(**budget)
