"""Domains of OpenODD documents.

An attribute of its taxonomy is ours by its leaf: a number called like a quantity, or ``road_class``
with the names of road classes. Each has to be limited on its own, to one range. What OpenODD does
not say, such as how often an amount occurs, is under ``frenetic`` in the METADATA of a root module.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError
from frenetic.quantities import Quantity, quantities

if TYPE_CHECKING:
    from openodd import OddCondition, OddDefinition, OddModule

ROAD_CLASS: Final = "road_class"
OURS: Final = "frenetic"
"""Our key in a module's METADATA."""
MASS: Final = {"mass": {"kg": {"t": {"scale": 0.001}}}}
"""A conversion that makes known to OpenODD's reader what a kg is."""
_MOST_NAMED: Final = 6  # attributes in a line


def library() -> ModuleType:
    """The package ``openodd``.

    Raises:
        FreneticError: it is not installed; the message tells how to install it.
    """
    try:
        import openodd  # an extra
    except ImportError as error:
        raise FreneticError(f"OpenODD needs openodd-py: {pip_install('odd')}") from error
    return openodd


def bound(
    source: Path | str, name: str, buckets: Mapping[str, Any] = MappingProxyType({})
) -> tuple[OddDefinition, Any]:
    """An ODD whose attributes with our names are measured in our units, and its backend.

    They are measured on a mapping from our names to amounts; ``place`` is latitude and longitude.

    Args:
        source: of the ODD, a file or YAML.
        name: its name.
        buckets: our name -> edges of its buckets.

    Raises:
        FreneticError: the package is not installed.
        ValueError: the sources are wrong, or two attributes have one of our names.
    """
    openodd = library()
    units = {ROAD_CLASS: "", **{row.name: row.unit for row in _own().values()}}

    class Backend(openodd.Backend):  # type: ignore[misc, name-defined]
        def geolocation(self, context: Mapping[str, Any]) -> Any:
            return context.get("place")

    def probe(of: str) -> Any:
        return lambda context: context.get(of)

    backend = Backend(
        probes={of: (probe(of), unit) for of, unit in units.items()}, allow_imports=False
    )
    sources = (source, json.dumps({"conversion": MASS}))
    leaves = [_leaf(one.name) for one in openodd.load_openodd(*sources, name=name).attributes]
    for leaf in units:
        if leaves.count(leaf) > 1:
            raise ValueError(f"its taxonomy has {leaves.count(leaf)} attributes named {leaf}")
    bindings: dict[str, Any] = {of: {"probe": of} for of in units if of in leaves}
    for of, edges in buckets.items():
        bindings[of]["buckets"] = edges
    odd = openodd.load_openodd(*sources, name=name, bindings=bindings, backend=backend)
    return odd, backend


def read_domain(path: Path) -> dict[str, Any]:
    """The entries of a domain that an OpenODD document says, as `frenetic.domain` takes them.

    Raises:
        FreneticError: the package is not installed.
        ValueError: the document is wrong, or says no domain that Frenetic can draw from.
    """
    library()
    try:
        odd, _ = bound(path, path.stem)
    except ValueError as error:
        raise ValueError(" ".join(str(error).split())) from None
    roots = [module for module in odd.modules if module.name in odd.roots and module.active]
    told = [module.metadata.get(OURS) for module in roots]
    ours: dict[str, Any] = next((one for one in told if isinstance(one, dict)), {})
    shapes = ours.get("conditions", {})
    rules = _Rules(odd)
    rules.require_separate(roots)
    limited = {name for module in roots for name in rules.attributes_of(module)}
    conditions: dict[str, dict[str, Any]] = {}
    entries: dict[str, Any] = {"about": " ".join(filter(None, (one.text for one in roots)))}
    foreign, free = [], []
    for attribute in odd.attributes:
        name, leaf, item = attribute.name, _leaf(attribute.name), attribute.item
        if attribute.derived:
            continue  # by what it is worked out from
        if leaf == ROAD_CLASS and item is not None and item.values:
            entries["roads"] = _roads(rules, name, item.values, ours.get("roads"))
        elif name not in limited:
            free.append(leaf)
        elif name in rules.ours and item is not None and item.edges:
            shape = shapes.get(leaf, {})
            conditions[leaf] = {**shape, **_range(rules, name, _own()[leaf], item.edges, shape)}
        else:
            foreign.append(leaf)
    if not conditions and "roads" not in entries:
        raise ValueError(
            f"it limits no quantity and names no {ROAD_CLASS}: see 'frenetic list quantities'"
        )
    notes = [_listed(foreign), f"without limits {_listed(free)}" if free else ""]
    if left_out := ", ".join(filter(None, notes)):
        entries["left_out"] = left_out
    if isinstance(ours.get("name"), str):
        entries["name"] = ours["name"]
    return {**entries, "conditions": conditions}


def _own() -> dict[str, Quantity]:
    """The quantities that a domain may name."""
    return {name: row for name, row in quantities().items() if not row.place_of}


def _leaf(name: str) -> str:
    return name.rpartition(".")[2]


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _roads(rules: _Rules, name: str, literals: Iterable[Any], told: Any) -> Any:
    """The road class that is inside, with its values if the METADATA holds them."""
    inside = [str(one) for one in literals if rules.holds(name, one)]
    if len(inside) != 1:
        raise ValueError(f"{ROAD_CLASS} has {len(inside)} classes inside: a domain has one")
    is_told = isinstance(told, Mapping) and told.get("name") == inside[0]
    return told if is_told else inside[0]


def _range(
    rules: _Rules, name: str, row: Quantity, edges: Iterable[float], shape: Mapping[str, Any]
) -> dict[str, float]:
    """The low and high end of the one range of a quantity that is inside, both included.

    An end that is left open is the quantity's own.
    """
    finite = [edge for edge in edges if math.isfinite(edge)]
    outer = (finite[0] - 1.0 - abs(finite[0]), finite[-1] + 1.0 + abs(finite[-1]))
    # Each edge, and an amount between any two: nothing changes elsewhere.
    steps = [(-math.inf, math.nextafter(finite[0], -math.inf), outer[0])]
    for edge, after in pairwise((*finite, math.inf)):
        end = math.nextafter(after, -math.inf) if math.isfinite(after) else math.inf
        between = 0.5 * (edge + after) if math.isfinite(after) else outer[1]
        steps += [(edge, edge, edge), (math.nextafter(edge, math.inf), end, between)]
    ranges = []
    for is_inside, group in groupby(steps, lambda step: rules.holds(name, step[2])):
        if is_inside:
            found = list(group)
            ranges.append((found[0][0], found[-1][1]))
    if len(ranges) > 1 and "chance" in shape:
        ranges = [one for one in ranges if one != (row.nothing, row.nothing)]
    if len(ranges) != 1:
        where = " and ".join(f"{low:g} to {high:g}" for low, high in ranges) or "nowhere"
        raise ValueError(f"{row.name} is inside at {where}: one range is needed")
    low, high = ranges[0]
    return {
        "low": row.low if math.isinf(low) else low,
        "high": row.high if math.isinf(high) else high,
    }


@dataclass(frozen=True)
class _Part:
    """A part of a rule: conditions of which all or any are needed, or one on some attributes."""

    names: frozenset[str]
    parts: tuple[_Part, ...] = ()
    is_all: bool = True


class _Rules:
    """What the modules of an ODD limit."""

    def __init__(self, odd: OddDefinition) -> None:
        self._odd = odd
        self._by_name: dict[str, list[OddModule]] = {}
        for module in odd.modules:
            for name in (module.name, *module.labels):
                self._by_name.setdefault(name, []).extend([module] if module.active else [])
        self._sources = {one.name: one.derived_from for one in odd.attributes if one.derived}
        known = {ROAD_CLASS, *_own()}
        self.ours = {one.name for one in odd.attributes if _leaf(one.name) in known}
        """Names of the attributes that are ours."""
        self._open = {
            one.name: library().UNDECIDED for one in odd.attributes if not one.derived
        }

    def holds(self, name: str, value: Any) -> bool:
        """Whether a value of one attribute may be inside, whatever the others are."""
        return self._odd.evaluate(self._odd.complete({**self._open, name: value})).inside

    def attributes_of(self, module: OddModule) -> frozenset[str]:
        """The attributes that a module limits."""
        return self._part(module, True).names

    def require_separate(self, roots: Iterable[OddModule]) -> None:
        """Refuses rules by which our attributes depend on others."""
        for module in roots:
            self._require(self._part(module, True))

    def _require(self, part: _Part) -> None:
        if len(part.names) < 2 or not part.names & self.ours:
            return
        if not part.parts or not (part.is_all or len(part.parts) == 1):
            names = " and ".join(sorted(_leaf(name) for name in part.names))
            raise ValueError(f"{names} depend on each other: a domain limits each on its own")
        for one in part.parts:
            self._require(one)

    def _part(self, module: OddModule, is_needed: bool) -> _Part:
        """What a module says, or its negation."""
        conditions = iter(module.conditions())
        sections = []
        for key, texts in module.describe().items():
            kind, _, operator = key.partition("_")
            if kind in ("include", "exclude") and operator in ("and", "or"):
                is_meant = is_needed == (kind == "include")
                parts = [self._of_condition(next(conditions), text, is_meant) for text in texts]
                sections.append(_joined(parts, is_all=is_meant == (operator == "and")))
        return _joined(sections, is_all=is_needed)

    def _of_condition(self, condition: OddCondition, text: str, is_meant: bool) -> _Part:
        names: set[str] = set()
        for name in condition.attributes():
            names.update(self._sources.get(name, [name]))
        references = condition.references()
        is_needed = is_meant == text.rstrip(")").endswith(" is true")
        modules = [
            self._part(module, is_needed)
            for reference in references
            for module in self._by_name.get(reference, [])
        ]
        if not names and len(references) == 1:  # a label holds if any of its modules does
            return _joined(modules, is_all=not is_needed)
        return _Part(frozenset(names).union(*(one.names for one in modules)))


def _joined(parts: list[_Part], *, is_all: bool) -> _Part:
    names = frozenset[str]().union(*(part.names for part in parts))
    return _Part(names, tuple(part for part in parts if part.names), is_all)
