"""Checks of the simulators on this machine: what is wrong and what to do.

A simulator may offer a method ``checks``, which is called before the simulator is entered. It gives
a `Check` for each thing that it checks, and stops when the rest would be pointless. Every simulator
must pass `drive_checks`. A class attribute ``needs`` names the modules without which the simulator
is not installed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from frenetic.drivers import Driver, Stanley
from frenetic.errors import FreneticError, describe_error
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.registry import SIMULATORS
from frenetic.road import Pose, Road
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class Check:
    """One thing that was checked."""

    name: str
    is_ok: bool
    found: str
    """Its state, or what is wrong with it."""
    remedy: str = ""
    """What to do; empty if nothing is wrong."""


@runtime_checkable
class Checkable(Protocol):
    """A simulator that checks itself."""

    def checks(self) -> Iterator[Check]:
        """Its checks, in order, up to one that makes the rest pointless."""


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
            missing = [m for m in getattr(factory, "needs", ()) if find_spec(m) is None]
            if missing:
                note = f'pip install "frenetic-roads[{entry.name}]"'
                yield Examination(entry.name, Health.NOT_INSTALLED, (), note)
                continue
            yield examine(entry.name)
        except FreneticError as error:
            yield Examination(entry.name, Health.NOT_SET_UP, (), str(error))


def _checks(simulator: Simulator) -> Iterator[Check]:
    if isinstance(simulator, Checkable):
        yield from simulator.checks()
        return
    try:
        with simulator:
            yield Check("start", True, "it starts")
            yield from drive_checks(simulator)
    except Exception as error:
        yield broken("start", error, "see the message; then try again")


def broken(name: str, error: Exception, remedy: str) -> Check:
    """A check that ended in an error; our own errors say what to do."""
    text = str(error) if isinstance(error, FreneticError) else describe_error(error)
    return Check(name, False, text, remedy)


# Roads that every driver can follow

STRAIGHT: Final = Road(np.zeros(13), pose=Pose(40.0, 100.0, 0.0))
"""120 m."""
CURVE: Final = Road(
    np.array([0.0] * 4 + [0.01, 0.025, 0.025, 0.025, 0.01] + [0.0] * 4), pose=Pose(60.0, 60.0, 0.0)
)
"""A left-hand bend of 40 m radius between straights."""


def drive_checks(
    simulator: Simulator, driver: Driver | None = None, *, who: str = "Stanley"
) -> Iterator[Check]:
    """Checks that a driver stays in its lane on a straight road and in a curve.

    Args:
        simulator: entered.
        driver: Stanley if None.
        who: name of the driver.
    """
    for name, road in (("straight road", STRAIGHT), ("curve", CURVE)):
        yield drive_check(simulator, driver or Stanley(), road, f"{name}, {who}")


def drive_check(simulator: Simulator, driver: Driver, road: Road, name: str) -> Check:
    """Checks that a driver reaches the end of a road in its lane."""
    try:
        drive = simulator.drive(road, driver)
    except Exception as error:
        return broken(name, error, "see the message; 'frenetic --debug doctor' says more")
    result = judge(road, drive)
    if result.outcome is not Outcome.PASS or result.moobd is None or result.moobd <= 0.0:
        remedy = "draw it with 'frenetic drive --plot'; is the car or the road as it should be?"
        return Check(name, False, result.reason, remedy)
    found = f"{road.length:.0f} m in {result.duration:.1f} s, MOOBD {result.moobd:.2f} m"
    return Check(name, True, found)


def time_of_drives(simulator: Simulator, driver: Driver, times: int) -> float:
    """Wall time of the fastest of several drives on the road with the curve, in s."""
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        simulator.drive(CURVE, driver)
        taken.append(time.perf_counter() - start)
    return min(taken)
