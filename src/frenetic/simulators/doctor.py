"""Checks of the simulators on this machine: what is wrong and what to do.

Every simulator has to start and to pass `drive_checks`. It may offer a method ``checks``, which
gives a `Check` for each further thing. A class attribute ``needs`` names the modules without which
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
from frenetic.simulators.checks import Check, broken, drive_checks
from frenetic.simulators.simulator import Simulator


class Health(StrEnum):
    """State of a simulator."""

    OK = "ok"
    BROKEN = "something is wrong"
    NOT_SET_UP = "not set up"
    """It is installed, but needs an option."""
    NOT_INSTALLED = "not installed"


@dataclass(frozen=True)
class Examination:
    """Findings about a simulator."""

    simulator: str
    health: Health
    checks: tuple[Check, ...]
    note: str = ""
    """Reason why nothing was checked; empty if something was."""

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that found something wrong."""
        return tuple(check for check in self.checks if not check.is_ok)


def examine(
    name: str,
    options: Mapping[str, Any] | None = None,
    *,
    on_check: Callable[[Check], None] | None = None,
) -> Examination:
    """Checks one simulator.

    Args:
        name: as on the command line.
        options: the simulator is made with.
        on_check: called with each finished check.

    Raises:
        FreneticError: there is no such simulator, or its options do not suit.
    """
    simulator: Simulator = SIMULATORS.make(name, **(options or {}))
    done = []
    for check in _checks(simulator):
        done.append(check)
        if on_check is not None:
            on_check(check)
    health = Health.OK if all(check.is_ok for check in done) else Health.BROKEN
    return Examination(name, health, tuple(done))


def examine_all() -> Iterator[Examination]:
    """Checks all installed simulators, each made without options."""
    for entry in SIMULATORS.entries():
        try:
            factory = SIMULATORS.load(entry.name)
            if usual(factory).missing:
                yield Examination(entry.name, Health.NOT_INSTALLED, (), pip_install(entry.name))
                continue
            yield examine(entry.name)
        except FreneticError as error:
            yield Examination(entry.name, Health.NOT_SET_UP, (), str(error))


def _checks(simulator: Simulator) -> Iterator[Check]:
    try:
        with simulator:
            yield Check("start", True, "it starts")
            yield from capabilities(simulator).checks()
            yield from drive_checks(simulator)
    except Exception as error:
        yield broken("start", error, "see the message; then try again")
