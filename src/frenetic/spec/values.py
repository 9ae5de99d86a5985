"""Values of entries: road classes, domains, criteria and workers, from texts and files.

Every command's help reads this module, so slow imports are inside functions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.words import part_word, read_part, shortened
from frenetic.criteria.criterion import CriteriaSet

# Imports inside functions below are too slow for help.

if TYPE_CHECKING:
    from frenetic.conditions.domain import Domain
    from frenetic.road.classes import RoadClass

COMPETITION: Final = "competition"
"""Name of the roads that keep the competition's rules alone, in place of a road class."""
MAX_WORKERS: Final = 1024
"""Most roads that one computer drives at once; a cluster has as many seats as it has."""


def read_class(roads: str | Mapping[str, Any]) -> RoadClass | None:
    """Return the road class of an entry; None for the competition's roads.

    Raises:
        ValueError: the entry is wrong.
        FreneticError: no class has this name.
    """
    from frenetic.road.classes import class_of  # numba takes its time

    return class_of(roads)


def roads_entry(road_class: RoadClass | None) -> str | dict[str, Any]:
    """Return the entry for a road class: its name if the class is built in."""
    from frenetic.road.classes import RoadClass, classes  # numba takes its time

    if road_class is None:
        return COMPETITION
    name = road_class.name
    is_known = name in classes() and RoadClass.of(name) == road_class
    return name if is_known else road_class.as_json()


def read_domain(odd: str | Mapping[str, Any]) -> Domain:
    """Return the domain of an entry: in a file, or of entries.

    Raises:
        ValueError: the entry is wrong.
        FreneticError: the file does not exist, or is wrong.
    """
    from frenetic.conditions.domain import Domain  # numba takes its time

    if isinstance(odd, str):
        return Domain.of(odd)
    return Domain.from_entries(str(odd.get("name", "own")), odd)


def read_profile(criteria: str | Mapping[str, Any]) -> CriteriaSet:
    """Return the criteria of an entry from `criteria_entries`."""
    if isinstance(criteria, str):
        name, options = read_part(criteria)
        return CriteriaSet.of(name or COMPETITION, options)
    entries = {key: value for key, value in criteria.items() if key != "name"}
    return CriteriaSet.from_entries(str(criteria.get("name", "own")), entries)


def criteria_entries(criteria: str | Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries in a text such as ``after-iso-11270,lateral_jerk=4,speed_limit=60``.

    A text with rules alone gives no criteria.
    """
    rules: dict[str, Any] = {}
    if isinstance(criteria, str):
        name, options = read_part(criteria)
    else:
        name, options = str(criteria.get("name", "own")), dict(criteria)
    for rule in ("speed_limit", "oob_tolerance"):
        if rule in options:
            rules[rule] = options.pop(rule)
    if isinstance(criteria, str) and name is None and not options:
        return {**rules, "criteria": None}
    profile = read_profile(part_word(name, options) if isinstance(criteria, str) else options)
    return {**rules, "criteria": profile.entry()}


def require_worker_count(workers: int) -> int:
    """Return a number of workers that one computer may have.

    Raises:
        ValueError: the number exceeds `MAX_WORKERS`.
    """
    if workers > MAX_WORKERS:
        raise ValueError(f"workers is {workers}: at most {MAX_WORKERS} are allowed")
    return workers


def read_workers(text: str) -> int | str:
    """Return a number of workers, or the address of a Dask scheduler.

    Raises:
        ValueError: the text is neither.
    """
    if re.fullmatch("-?[0-9]+", text):
        if len(text) <= 9 and 1 <= int(text) <= MAX_WORKERS:
            return int(text)
        raise ValueError(f"{shortened(text, 60)} workers are given: 1 to {MAX_WORKERS} are allowed")
    if ":" not in text:
        raise ValueError(
            f"{text!r} is neither a number nor the address of a Dask scheduler, such as"
            " tcp://10.0.0.1:8786"
        )
    return text
