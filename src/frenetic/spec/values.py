"""Reading values of entries: road classes, domains, criteria and workers.

Every command's help reads this module, so slow imports are inside functions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.option_text import part_word, read_part
from frenetic._support.printable import shortened
from frenetic.criteria.criterion import CriteriaSet

if TYPE_CHECKING:
    from frenetic.conditions.domain import Domain
    from frenetic.road.classes import RoadClass

COMPETITION: Final = "competition"
"""Value of ``roads`` for roads that keep the competition's rules and no road class."""
MAX_WORKERS: Final = 1024
"""Largest number of workers on one computer (our choice); the size of a cluster is not limited."""
_DEFAULT_NAME: Final = "own"
"""Name of a user's domain or criteria whose entries have no name."""
_RULES: Final = ("speed_limit", "oob_tolerance")
"""Rules of a drive that a text with criteria may set, too."""
_MAX_DIGITS: Final = 9
"""Largest number of digits that are converted to a number of workers; `MAX_WORKERS` has 4."""


def read_class(roads: str | Mapping[str, Any]) -> RoadClass | None:
    """Return the road class that an entry names or describes; None for the competition's roads.

    Raises:
        ValueError: the entry is wrong.
        FreneticError: no class has this name.
    """
    from frenetic.road.classes import class_of  # imports numba

    return class_of(roads)


def roads_entry(road_class: RoadClass | None) -> str | dict[str, Any]:
    """Return the entry for a road class: the name of a built-in class, else all its rules."""
    from frenetic.road.classes import RoadClass, classes  # imports numba

    if road_class is None:
        return COMPETITION
    name = road_class.name
    is_built_in = name in classes() and RoadClass.of(name) == road_class
    return name if is_built_in else road_class.as_json()


def read_domain(odd: str | Mapping[str, Any]) -> Domain:
    """Return the operational design domain in a file, or of its entries.

    Args:
        odd: path of a TOML file, or entries by name.

    Raises:
        ValueError: an entry is wrong.
        FreneticError: the file does not exist, or is wrong.
    """
    from frenetic.conditions.domain import Domain  # imports numba

    if isinstance(odd, str):
        return Domain.of(odd)
    return Domain.from_entries(str(odd.get("name", _DEFAULT_NAME)), odd)


def read_criteria(criteria: str | Mapping[str, Any]) -> CriteriaSet:
    """Return the set of criteria that a text or entries without rules describe.

    Args:
        criteria: an entry ``criteria`` as `criteria_entries` returns it.
    """
    if isinstance(criteria, str):
        name, options = read_part(criteria)
        return CriteriaSet.of(name or COMPETITION, options)
    entries = {key: value for key, value in criteria.items() if key != "name"}
    return CriteriaSet.from_entries(str(criteria.get("name", _DEFAULT_NAME)), entries)


def criteria_entries(criteria: str | Mapping[str, Any]) -> dict[str, Any]:
    """Return criteria and the rules that are named with them as entries of their own.

    Args:
        criteria: a text such as ``after-iso-11270,lateral_jerk=4,speed_limit=60``, or entries. With
            rules alone, as in ``speed_limit=60``, ``criteria`` is None.
    """
    if isinstance(criteria, str):
        name, options = read_part(criteria)
    else:
        name, options = None, dict(criteria)
    rules: dict[str, Any] = {rule: options.pop(rule) for rule in _RULES if rule in options}
    if isinstance(criteria, str) and name is None and not options:
        return {**rules, "criteria": None}
    limits = part_word(name, options) if isinstance(criteria, str) else options
    return {**rules, "criteria": read_criteria(limits).entry()}


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
        if len(text) <= _MAX_DIGITS and 1 <= int(text) <= MAX_WORKERS:
            return int(text)
        raise ValueError(f"workers is {shortened(text, most=60)}: 1 to {MAX_WORKERS} are allowed")
    if ":" not in text:
        raise ValueError(
            f"{text!r} is neither a number nor the address of a Dask scheduler, such as"
            " tcp://10.0.0.1:8786"
        )
    return text
