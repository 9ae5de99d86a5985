"""What installed packages add to this one: their entry points.

Apart from the registry, which imports more than the help of the commands may take.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Entry:
    """A part that has a name."""

    name: str
    target: str
    """``module:Class``."""
    origin: str
    """``built in``, or the distribution that installed it."""
    summary: str = ""
    """One line, if known without an import."""


@cache
def _installed(group: str, path: tuple[str, ...]) -> tuple[Entry, ...]:  # noqa: ARG001
    """Entries that packages on the module path have installed, in alphabetical order."""
    from importlib.metadata import entry_points  # takes its time, and no help needs it

    return tuple(
        Entry(point.name, point.value, point.dist.name if point.dist is not None else "unknown")
        for point in sorted(entry_points(group=group), key=lambda p: p.name)
    )


def imported(target: str) -> Any:
    """What ``module:name`` stands for."""
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def installed(group: str) -> tuple[Entry, ...]:
    """Entries of a group that packages on the module path have installed.

    A new process sees what is installed later.
    """
    return _installed(group, tuple(sys.path))
