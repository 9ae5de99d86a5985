"""Checks of the simulators on this machine: what is wrong and what to do.

Every simulator has to start and to pass `drive_checks`. It may offer a method ``checks``, which
gives further checks. A class attribute ``needs`` names the modules without which
the simulator is not installed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError
from frenetic.parts.registry import SIMULATORS
from frenetic.simulators.capabilities import capabilities, usual
from frenetic.simulators.checks import SimulatorCheck, broken, drive_checks
from frenetic.simulators.simulator import Simulator


class Health(StrEnum):
    """State of a simulator."""

    OK = "ok"
    BROKEN = "something is wrong"
    NOT_SET_UP = "not set up"
    """The simulator is installed, but needs an option."""
    NOT_INSTALLED = "not installed"


@dataclass(frozen=True)
class Examination:
    """Findings about a simulator."""

    simulator: str
    health: Health
    checks: tuple[SimulatorCheck, ...]
    note: str = ""
    """Reason why nothing was checked; empty if the simulator was checked."""

    @property
    def failed(self) -> tuple[SimulatorCheck, ...]:
        """Checks that failed."""
        return tuple(check for check in self.checks if not check.is_ok)


def examine(
    name: str,
    options: Mapping[str, Any] | None = None,
    *,
    on_check: Callable[[SimulatorCheck], None] | None = None,
) -> Examination:
    """Check one simulator.

    Args:
        name: Name of the simulator, as on the command line.
        options: Options with which it is made.
        on_check: Called with each finished check.

    Raises:
        FreneticError: There is no such simulator, or an option does not suit it.
    """
    simulator: Simulator = SIMULATORS.make(name, **(options or {}))
    checks = []
    for check in _checks(simulator):
        checks.append(check)
        if on_check is not None:
            on_check(check)
    health = Health.OK if all(check.is_ok for check in checks) else Health.BROKEN
    return Examination(name, health, tuple(checks))


def examine_all() -> Iterator[Examination]:
    """Check all installed simulators, each made without options."""
    for entry in SIMULATORS.entries():
        try:
            factory = SIMULATORS.load(entry.name)
            if usual(factory).missing:
                yield Examination(entry.name, Health.NOT_INSTALLED, (), pip_install(entry.name))
                continue
            yield examine(entry.name)
        except FreneticError as error:
            yield Examination(entry.name, Health.NOT_SET_UP, (), str(error))


def _checks(simulator: Simulator) -> Iterator[SimulatorCheck]:
    try:
        with simulator:
            yield SimulatorCheck("start", True, "it starts")
            yield from capabilities(simulator).checks()
            yield from drive_checks(simulator)
    except Exception as error:
        yield broken("start", error, "see the message; then try again")
