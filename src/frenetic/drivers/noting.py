"""A wrapper that keeps what a driver is told, and what it notes and plans."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.stack import OwnWrapper, stack_of
from frenetic.errors import DriverError
from frenetic.oracle.notes import OBSERVED, DriverNotes

LONGEST_NAME: Final = 60
"""Largest number of letters of a note's name; our choice."""
MOST_NAMES: Final = 100
"""Largest number of different notes in a drive; our choice."""
_NAME: Final = re.compile(rf"[A-Za-z_][A-Za-z0-9_]{{0,{LONGEST_NAME - 1}}}")
"""Name of a note."""
_MOST_POINTS: Final = 1000  # largest number of points of a plan (our choice)


class NotingDriver(OwnWrapper):
    """A driver whose observations, notes and plans of a drive are kept.

    After each call of ``act`` the driver's attributes ``trace_notes`` and ``trace_plan`` are read,
    if it has them: a mapping of names to numbers, and points (m, 2) in m in the frame of the car.

    Args:
        driver: the driver, without wrappers that change what it sees.
    """

    place = 1000  # under all wrappers

    def __init__(self, driver: Driver) -> None:
        super().__init__(driver)
        self._forget()

    def _forget(self) -> None:
        self._observed: list[list[float]] = []
        self._noted: list[dict[str, float]] = []
        self._plans: list[Any] = []

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive, and forget the last one's notes."""
        self._forget()
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls, and keep what it was told, noted and planned."""
        controls = self.driver.act(observation)
        self._observed.append([float(getattr(observation, name)) for name in OBSERVED])
        self._noted.append(_numbers(getattr(self.driver, "trace_notes", None)))
        self._plans.append(_points(getattr(self.driver, "trace_plan", None)))
        return controls

    @property
    def last_notes(self) -> DriverNotes:
        """Notes of the last drive.

        Raises:
            DriverError: the driver noted numbers of too many names.
        """
        if not self._observed:
            return DriverNotes()
        names = tuple(dict.fromkeys(name for numbers in self._noted for name in numbers))
        if len(names) > MOST_NAMES:
            raise DriverError(
                f"the driver notes numbers of {len(names)} names: at most {MOST_NAMES} are allowed"
            )
        rows = [[numbers.get(name, np.nan) for name in names] for numbers in self._noted]
        return DriverNotes(
            observed=np.array(self._observed),
            names=names,
            noted=np.array(rows, float).reshape(len(self._observed), len(names)),
            plan_lengths=tuple(map(len, self._plans)) if any(map(len, self._plans)) else (),
            plan_points=np.concatenate([np.empty((0, 2)), *self._plans]),
        )


def drive_notes(driver: Driver) -> DriverNotes | None:
    """Return the notes of a stack's last drive; None if no wrapper in it keeps notes.

    Wrappers are copied when others are laid over them, so the stack that drove is asked.

    Raises:
        DriverError: the driver noted numbers of too many names.
    """
    noting = [part for part in stack_of(driver) if isinstance(part, NotingDriver)]
    return noting[0].last_notes if noting else None


def _numbers(notes: object) -> dict[str, float]:
    """Return a driver's notes.

    Raises:
        DriverError: the notes are no mapping of names to numbers.
    """
    if notes is None:
        return {}
    try:
        if isinstance(notes, Mapping) and all(map(_NAME.fullmatch, notes)):
            return {name: float(value) for name, value in notes.items()}
    except (TypeError, ValueError):
        pass
    raise DriverError(
        f"the driver's trace_notes are {repr(notes)[:60]}: a mapping of names (of letters, digits"
        " and _) to numbers is needed"
    )


def _points(plan: object) -> Any:
    """Return the points of a driver's plan, (m, 2).

    Raises:
        DriverError: the plan is no list of points.
    """
    if plan is None:
        return np.empty((0, 2))
    try:
        points = np.array(plan, float)  # a copy: the driver may change its own
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) > _MOST_POINTS:
        raise DriverError(
            f"the driver's trace_plan is {repr(plan)[:60]}: points (m, 2) in the car's frame are"
            f" needed, at most {_MOST_POINTS}"
        )
    return points
