"""Parts of a run by their names: strategy, driver and simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from frenetic._support.words import part_word, read_part
from frenetic.parts.registry import SIMULATORS

if TYPE_CHECKING:
    from frenetic.simulators.capabilities import SimulatorDefaults

USUAL: Final = {"strategy": "frenetic", "driver": "planner", "simulator": "embedded"}
"""Parts of a spec without names."""


class Part(NamedTuple):
    """The name of a strategy, driver or simulator, and its options."""

    name: str
    """A registered name, ``package.module:Class`` or ``file.py:Class``."""
    options: Mapping[str, Any]

    def __str__(self) -> str:
        return part_word(self.name, self.options)


def followed_by(earlier: str, later: str) -> str:
    """Return the text of the later part, with the earlier options if the part is the same."""
    name, options = read_part(earlier)
    later_name, later_options = read_part(later)
    if later_name is not None and name not in (None, later_name):
        return later
    return part_word(later_name or name, {**options, **later_options})


def usual_of(simulator: str) -> SimulatorDefaults:
    """Return the defaults that a simulator's class declares."""
    from frenetic.simulators.capabilities import defaults_of  # numba takes its time

    return defaults_of(SIMULATORS.load(simulator))
