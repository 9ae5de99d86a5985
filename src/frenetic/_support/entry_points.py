"""Entry points: parts that installed packages add to Frenetic.

The help of the commands reads entry points, too, so this module imports less than
`frenetic.parts.registry`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


@dataclass(frozen=True)
class RegisteredPart:
    """A built-in or installed object that users choose by name."""

    name: str
    """Name by which users choose the object."""
    target: str
    """Where the object is defined: ``module:Class``."""
    origin: str
    """``built in``, or the name of the distribution that installed the object."""
    summary: str = ""
    """Summary in one line; empty if the object has to be imported to read it."""


@cache
def _select_from(path: tuple[str, ...]) -> Callable[..., EntryPoints]:  # noqa: ARG001
    """Return the function that selects entry points of the packages on the module path."""
    from importlib.metadata import entry_points  # imports slowly

    return entry_points().select


@cache
def _installed(group: str, path: tuple[str, ...]) -> tuple[RegisteredPart, ...]:
    """Return the parts that packages on the module path have installed, in alphabetical order."""
    return tuple(
        RegisteredPart(
            point.name, point.value, point.dist.name if point.dist is not None else "unknown"
        )
        for point in sorted(_select_from(path)(group=group), key=lambda p: p.name)
    )


def imported(target: str) -> Any:
    """Import and return the object at ``module:name``."""
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def installed(group: str) -> tuple[RegisteredPart, ...]:
    """Return the parts of a group that packages on the module path have installed.

    The answer is cached: only a new process sees packages that are installed later.
    """
    return _installed(group, tuple(sys.path))
