"""Public names of packages: some are imported on use, and some modules have moved.

Importing an old documented path gives the module of today, and a `DeprecationWarning` that names
its place. Runs on Python 3.9, as all that the competition's pipeline imports of the package does.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final


def lazy_names(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose import imports nothing else.

    Args:
        package: its ``__name__``.
        homes: module -> names that the package takes from it.
    """
    home = {name: module for module, names in homes.items() for name in names}
    # Looked up now: a generator in a bench may bring a package of the same name later.
    importing = sys.modules[package]

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(importing, name, value)
        return value

    return get


MOVED: Final = {
    "frenetic.analysis.comparing": "frenetic.analysis.comparison",
    "frenetic.analysis.confirming": "frenetic.redrive.confirm",
    "frenetic.analysis.findings": "frenetic.analysis.conclusions",
    "frenetic.analysis.minimise": "frenetic.redrive.minimise",
    "frenetic.analysis.replaying": "frenetic.redrive.regression",
    "frenetic.analysis.rerunning": "frenetic.redrive.robustness",
    "frenetic.analysis.shrinking": "frenetic.redrive.shrinking",
    "frenetic.campaign.checking": "frenetic.campaign.check",
    "frenetic.campaign.dispatch": "frenetic.campaign.loop",
    "frenetic.campaign.workers.cluster": "frenetic.campaign.workers.dask.workers",
    "frenetic.export.columns": "frenetic.export.tables",
    "frenetic.gym.roads": "frenetic.gym.environment",
    "frenetic.ranking.roads": "frenetic.road.files",
    "frenetic.simulators.beamng.errors": "frenetic.simulators.beamng.link",
    "frenetic.simulators.starting": "frenetic.simulators.simulator",
}
"""Old path -> new path; a module of a package that moved needs no entry of its own."""


def install_moved() -> None:
    """Makes old paths importable."""
    if not any(isinstance(finder, _MovedFinder) for finder in sys.meta_path):
        # First, since the path of a moved package would lead other finders to a second copy.
        sys.meta_path.insert(0, _MovedFinder())


def new_path(name: str) -> str | None:
    """Today's path of an old one; None if it has not moved."""
    package = name if name.startswith("frenetic.") else ""
    while package:
        if package in MOVED:
            return MOVED[package] + name[len(package) :]
        package = package.rpartition(".")[0]
    return None


# No subclasses of importlib.abc's: its import takes longer than that of all else here.


class _MovedFinder:
    """Finds moved modules."""

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Spec of today's module; None for a name that has not moved."""
        found = new_path(name)
        if found is None:
            return None
        loader: Any = _MovedLoader(found)
        return ModuleSpec(name, loader)


class _MovedLoader:
    """Puts today's module in the place of the old one."""

    def __init__(self, new: str) -> None:
        self._new = new

    def create_module(self, _: ModuleSpec) -> None:
        """Leaves making a module to the import system."""

    def exec_module(self, module: ModuleType) -> None:
        """Gives the import system today's module instead."""
        old = module.__name__
        sys.modules[old] = import_module(self._new)
        warnings.warn(f"{old} is {self._new} now", DeprecationWarning, stacklevel=2)
