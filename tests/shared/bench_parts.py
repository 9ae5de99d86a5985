"""Simulators and strategies for tests of the bench, in a module that its processes can import."""

from __future__ import annotations

import os
from pathlib import Path

from frenetic.drivers import Driver
from frenetic.errors import FreneticError
from frenetic.road import Road
from frenetic.search import Candidate, Frenetic2021
from frenetic.simulators import Drive
from frenetic.testing import DummySimulator


class Reluctant(DummySimulator):
    """A simulator that does not start while the file `mark` exists."""

    def __init__(self, mark: Path) -> None:
        super().__init__()
        self.place = mark  # not `mark`, so that its content is not recorded with the simulator

    def __enter__(self):  # type: ignore[no-untyped-def]
        if self.place.exists():
            raise FreneticError("not today")
        return super().__enter__()


class Frail(DummySimulator):
    """A simulator that ends its process in the fifth drive, while the file `mark` exists."""

    def __init__(self, mark: Path) -> None:
        super().__init__()
        self.place = mark  # not `mark`, so that its content is not recorded with the simulator
        self.drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        if self.drives == 5 and self.place.exists():
            os._exit(9)
        return super().drive(road, driver)


class Eager(Frenetic2021):
    """A strategy of a user, derived from a built-in one."""


class Broken(Frenetic2021):
    """A strategy that raises at its third road."""

    def ask(self) -> Candidate:
        candidate = super().ask()
        if candidate.id == 3:
            raise KeyError("pool")
        return candidate
