"""Domains of OpenODD documents.

An attribute of its taxonomy is ours by its leaf: a number called like a quantity, or ``road_class``
with the names of road classes. Each has to be limited on its own, to one range. What OpenODD does
not say, such as how often an amount occurs, is under ``frenetic`` in the METADATA of a root module.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from itertools import groupby, pairwise
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, ValidationError, convert

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

    They are measured on a mapping from our names to amounts. It may have the distance driven
    (``way``, in m), and latitude and longitude (``place``).

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
            return context["place"]

        def position(self, context: Mapping[str, Any]) -> Any:
            return context["way"], 0.0, 0.0

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
    told = [module.metadata[OURS] for module in roots if OURS in module.metadata]
    try:
        ours = convert(told[0] if told else {}, _Ours)
    except ValidationError as error:
        raise ValueError(f"{OURS} in METADATA: {error}") from None
    rules = _Rules(odd)
    limited = {name for module in roots for name in rules.limited_by(module)}
    conditions: dict[str, dict[str, Any]] = {}
    entries: dict[str, Any] = {"about": " ".join(filter(None, (one.text for one in roots)))}
    foreign, free = [], []
    for attribute in odd.attributes:
        name, leaf, item = attribute.name, _leaf(attribute.name), attribute.item
        is_limited = name in limited
        literals = [] if item is None else list(item.values or ())
        edges = [] if item is None else list(filter(math.isfinite, item.edges))
        if leaf == ROAD_CLASS and (len(literals) == 1 or (literals and is_limited)):
            entries["roads"] = _roads(rules, name, literals, ours.roads)
        elif not is_limited:
            free.append(leaf)
        elif name in rules.ours and edges:
            shape = ours.conditions.get(leaf, {})
            conditions[leaf] = {**shape, **_range(rules, name, _own()[leaf], edges, shape)}
        else:
            foreign.append(leaf)
    if not conditions and "roads" not in entries:
        raise ValueError(
            f"it limits no quantity and names no {ROAD_CLASS}: see 'frenetic list quantities'"
        )
    whys = ((foreign, "no quantity"), (free, "no limits"))
    left_out = [f"{_listed(names)} ({why})" for names, why in whys if names]
    entries["left_out"] = ", ".join(filter(None, [ours.left_out, *left_out]))
    return {"name": ours.name or path.stem, **entries, "conditions": conditions}


class _Ours(Struct):
    """What only Frenetic's domains say."""

    name: str = ""
    left_out: str = ""
    conditions: dict[str, dict[str, float]] = {}
    """Name of a quantity -> the rest of its distribution."""
    roads: dict[str, Any] | None = None
    """Values of the road class."""


def _own() -> dict[str, Quantity]:
    """The quantities that a domain may name."""
    return {name: row for name, row in quantities().items() if not row.place_of}


def _leaf(name: str) -> str:
    return name.rpartition(".")[2]


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _roads(rules: _Rules, name: str, literals: list[Any], told: dict[str, Any] | None) -> Any:
    """The road class that is inside, with its values if the METADATA holds them."""
    inside = [str(one) for one in literals if rules.holds(name, one)]
    if len(inside) != 1:
        raise ValueError(f"{ROAD_CLASS} has {len(inside)} classes inside: a domain has one")
    return told if told is not None and told.get("name") == inside[0] else inside[0]


def _range(
    rules: _Rules, name: str, row: Quantity, edges: list[float], shape: Mapping[str, Any]
) -> dict[str, float]:
    """The low and high end of the one range of a quantity that is inside, both included.

    An end that is left open is the quantity's own.
    """
    # What holds changes at the edges alone: they, and an amount on either side, stand for all.
    steps = [(-math.inf, edges[0] - 1.0 - abs(edges[0]))]
    for edge, after in pairwise((*edges, edges[-1] + 2.0 + abs(edges[-1]))):
        steps += [(edge, edge), (math.nextafter(edge, math.inf), 0.5 * (edge + after))]
    ends = [*(math.nextafter(low, -math.inf) for low, _ in steps[1:]), math.inf]
    ranges = []
    for is_inside, group in groupby(
        zip(steps, ends, strict=True), lambda step: rules.holds(name, step[0][1])
    ):
        if is_inside:
            found = list(group)
            ranges.append((found[0][0][0], found[-1][1]))
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


class _Rules:
    """What the modules of an ODD limit."""

    def __init__(self, odd: OddDefinition) -> None:
        self._odd = odd
        self._by_name: dict[str, list[OddModule]] = {}
        for module in odd.modules:
            for name in (module.name, *module.labels):
                self._by_name.setdefault(name, []).extend([module] if module.active else [])
        known = {ROAD_CLASS, *_own()}
        self.ours = {one.name for one in odd.attributes if _leaf(one.name) in known}
        """Names of the attributes that are ours."""
        self._open = dict.fromkeys((one.name for one in odd.attributes), library().UNDECIDED)
        self._limited: dict[tuple[str, bool], frozenset[str]] = {}

    def holds(self, name: str, value: Any) -> bool:
        """Whether a value of one attribute may be inside, whatever the others are."""
        return self._odd.evaluate({**self._open, name: value}).inside

    def limited_by(self, module: OddModule, is_needed: bool = True) -> frozenset[str]:
        """The attributes that a module limits, or its negation.

        Raises:
            ValueError: it limits one of ours by another.
        """
        key = module.name, is_needed
        if key not in self._limited:
            conditions = iter(module.conditions())
            sections = []
            for section, texts in module.describe().items():
                kind, _, operator = section.partition("_")
                if kind in ("include", "exclude") and operator in ("and", "or"):
                    is_meant = is_needed == (kind == "include")
                    parts = [self._limited_in(next(conditions), text, is_meant) for text in texts]
                    sections.append(self._joined(parts, is_all=is_meant == (operator == "and")))
            self._limited[key] = self._joined(sections, is_all=is_needed)
        return self._limited[key]

    def _limited_in(self, condition: OddCondition, text: str, is_meant: bool) -> frozenset[str]:
        names, references = condition.attributes(), condition.references()
        is_needed = is_meant == text.rstrip(")").endswith(" is true")
        modules = [
            self.limited_by(module, is_needed)
            for reference in references
            for module in self._by_name.get(reference, [])
        ]
        # A label holds if any of its modules does. What a group needs is not told.
        is_reference = not names and len(references) == 1
        parts = [*modules, *(frozenset([name]) for name in names)]
        return self._joined(parts, is_all=is_reference and not is_needed)

    def _joined(self, parts: list[frozenset[str]], *, is_all: bool) -> frozenset[str]:
        """What parts limit of which all or any are needed."""
        names = frozenset[str]().union(*parts)
        if not is_all and len(list(filter(None, parts))) > 1 < len(names) and names & self.ours:
            told = " and ".join(sorted(_leaf(name) for name in names))
            raise ValueError(f"{told} depend on each other: a domain limits each on its own")
        return names
