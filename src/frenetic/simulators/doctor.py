"""Examine the simulators on this machine: say what is wrong and what to do.

An examination starts a simulator, makes the checks that its method ``checks`` yields, if it has
one, and drives two roads, see `drive_checks`. The class attribute ``needs`` of a simulator names
the modules that must be importable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError
from frenetic.parts.registry import SIMULATORS
from frenetic.simulators.capabilities import capabilities, defaults_of
from frenetic.simulators.checks import SimulatorCheck, drive_checks, failed_by_error
from frenetic.simulators.simulator import Simulator


class Health(StrEnum):
    """Result of a simulator's examination."""

    OK = "ok"
    BROKEN = "something is wrong"
    """At least one check failed."""
    NOT_SET_UP = "not set up"
    """The simulator cannot be made without options: it needs one, or its code cannot be loaded."""
    NOT_INSTALLED = "not installed"
    """A module that the simulator needs is missing."""


@dataclass(frozen=True)
class Examination:
    """Examination of a simulator: the results of all checks."""

    simulator: str
    """Name of the simulator, as on the command line."""
    health: Health
    """Result of the examination."""
    checks: tuple[SimulatorCheck, ...]
    """Results of the checks, in order; empty if the simulator was not checked."""
    note: str = ""
    """Reason why nothing was checked, or the remedy if the simulator is not installed; empty if the
    simulator was checked."""

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
    """Make a simulator and check it.

    Args:
        name: Name of the simulator, as on the command line.
        options: Options with which the simulator is made.
        on_check: Called with the result of each check as soon as the check is finished.

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
    """Yield an examination of each known simulator, made without options.

    A simulator that is not installed, or that cannot be made, is not checked.
    """
    for entry in SIMULATORS.entries():
        try:
            factory = SIMULATORS.load(entry.name)
            if defaults_of(factory).missing_modules:
                # The extra that installs a simulator's modules has the simulator's name.
                remedy = pip_install(entry.name)
                yield Examination(entry.name, Health.NOT_INSTALLED, (), remedy)
                continue
            yield examine(entry.name)
        except FreneticError as error:
            yield Examination(entry.name, Health.NOT_SET_UP, (), str(error))


def _checks(simulator: Simulator) -> Iterator[SimulatorCheck]:
    """Yield the results of all checks.

    An error outside a check becomes a failed check named after the stage: ``start``, ``checks`` or
    ``end``.
    """
    stage = "start"
    try:
        with simulator:
            yield SimulatorCheck("start", is_ok=True, state="it starts")
            stage = "checks"
            yield from capabilities(simulator).checks()
            yield from drive_checks(simulator)
            stage = "end"
    except Exception as error:
        yield failed_by_error(stage, error)
