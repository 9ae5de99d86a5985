"""Merging of two specs, of which the later one wins.

1. An entry of the later spec replaces the earlier entry.
2. A later part of the same name keeps the earlier options that it does not set.
3. Conditions are added to the earlier conditions; an amount without effect removes a condition.
4. A later simulator whose option sets a condition removes the earlier amount of this condition.
5. Later roads bring their own speed limit, map and lanes, so the earlier ones are left out.
6. Another simulator has its own wall limit, so the earlier one is left out.
7. A merged spec is not signed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

from msgspec import structs

from frenetic._support.option_text import read_part
from frenetic.conditions.condition import SEED, SPEED, amounts_in, condition_named
from frenetic.spec.files import SIGNED
from frenetic.spec.parts import PARTS, merged_part
from frenetic.spec.run_settings import RunSettings

MergedSpec = TypeVar("MergedSpec", bound=RunSettings)


def merged(earlier: MergedSpec, later: RunSettings) -> MergedSpec:
    """Return the earlier spec with the entries of the later one, by the rules of this module."""
    later_values = later.user_values
    values: dict[str, Any] = dict.fromkeys(_outdated_entries(earlier, later))
    values |= later_values
    for kind in later_values.keys() & {*PARTS}:
        if (earlier_text := getattr(earlier, kind)) is not None:
            values[kind] = merged_part(earlier_text, later_values[kind])
    values["conditions"] = _merged_conditions(earlier, later)
    values[SIGNED] = None
    return structs.replace(earlier, **values)


def _outdated_entries(earlier: RunSettings, later: RunSettings) -> Iterator[str]:
    """Yield the earlier entries that do not suit later roads or another simulator."""
    if later.names_roads:
        yield from ("roads", "speed_limit", "map_size", "lane_width")
    if later.simulator is not None:
        simulator, _ = read_part(later.simulator)
        if simulator not in (None, earlier.part("simulator").name):
            yield "wall_limit"


def _merged_conditions(earlier: RunSettings, later: RunSettings) -> dict[str, float]:
    """Return the later conditions over the earlier ones that nothing in the later spec sets."""
    conditions = dict(earlier.conditions)
    if later.names_roads or later.speed_limit is not None:
        conditions.pop(SPEED, None)
    if later.simulator is not None:
        _, options = read_part(later.simulator)
        for name in amounts_in(options):
            conditions.pop(name, None)
    return {
        name: amount
        for name, amount in (conditions | later.conditions).items()
        if name == SEED or amount != condition_named(name).no_effect
    }
