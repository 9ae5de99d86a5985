"""Parts of a run by their names: strategy, driver and simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from frenetic._support.option_text import part_word, read_part
from frenetic.parts.registry import SIMULATORS

if TYPE_CHECKING:
    from frenetic.simulators.capabilities import SimulatorDefaults

PARTS: Final = ("strategy", "driver", "simulator")
"""Kinds of the parts of a run."""
USUAL: Final = {"strategy": "frenetic", "driver": "planner", "simulator": "embedded"}
"""Kind of a part -> name of the part where the user names none."""


class Part(NamedTuple):
    """The name of a strategy, driver or simulator, and its options."""

    name: str
    """A registered name, ``package.module:Class`` or ``file.py:Class``."""
    options: Mapping[str, Any]

    def __str__(self) -> str:
        return part_word(self.name, self.options)


def merged_part(earlier: str, later: str) -> str:
    """Return the text of the later part, with the earlier options if both have the same name.

    A text with options alone, such as ``aggression=1.2``, has the name of the other text.
    """
    earlier_name, earlier_options = read_part(earlier)
    later_name, later_options = read_part(later)
    if later_name is not None and earlier_name not in (None, later_name):
        return later
    return part_word(later_name or earlier_name, {**earlier_options, **later_options})


def simulator_defaults(simulator: str) -> SimulatorDefaults:
    """Return the defaults that the class of a simulator declares, by the simulator's name."""
    from frenetic.simulators.capabilities import defaults_of  # imports numba

    return defaults_of(SIMULATORS.load(simulator))
