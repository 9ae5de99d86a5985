"""Domains of OpenODD documents.

An attribute of its taxonomy is ours by its leaf: a number called like a quantity, or ``road_class``
with the names of road classes. Each has to be limited on its own, to one range. What OpenODD does
not say, such as how often an amount occurs, is under ``frenetic`` in the METADATA of a root module.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from itertools import combinations, groupby, pairwise, product
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct, ValidationError, convert

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError
from frenetic.quantities import Quantity, quantities

if TYPE_CHECKING:
    from openodd import OddDefinition

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
    except RecursionError:
        raise ValueError("it is nested too deep") from None
    roots = [module for module in odd.modules if module.name in odd.roots and module.active]
    told = [module.metadata[OURS] for module in roots if OURS in module.metadata]
    try:
        ours = convert(told[0] if told else {}, _Ours)
    except ValidationError as error:
        raise ValueError(f"{OURS} in METADATA: {error}") from None
    probes = {one.name: _probes(one.item) for one in odd.attributes}
    undecided = dict.fromkeys(probes, library().UNDECIDED)

    def holds(**values: Any) -> bool:
        """Whether values of attributes may be inside, whatever the others are."""
        return odd.evaluate({**undecided, **values}).inside

    inside = {
        name: [one for one in found if holds(**{name: one.value})] for name, found in probes.items()
    }
    known = {ROAD_CLASS, *_own()}
    for pair in combinations(probes, 2):
        if known.isdisjoint(map(_leaf, pair)):
            continue
        for values in product(*(inside[name] for name in pair)):
            if not holds(**{name: one.value for name, one in zip(pair, values, strict=True)}):
                both = " and ".join(sorted(map(_leaf, pair)))
                raise ValueError(f"{both} depend on each other: a domain limits each on its own")
    conditions: dict[str, dict[str, Any]] = {}
    entries: dict[str, Any] = {"about": " ".join(filter(None, (one.text for one in roots)))}
    foreign, free = [], []
    named = {
        name
        for module in odd.modules
        for condition in module.conditions()
        for name in condition.attributes()
    }
    for name, found in probes.items():
        leaf, is_limited = _leaf(name), len(inside[name]) < len(found)
        is_literal = any(math.isnan(one.low) for one in found)
        if leaf == ROAD_CLASS and is_literal and (len(found) == 1 or name in named):
            entries["roads"] = _roads([str(one.value) for one in inside[name]], ours.roads)
        elif not is_limited and (leaf in known or name not in named):
            free.append(leaf)
        elif leaf in known and not is_literal:
            shape = ours.conditions.get(leaf, {})
            conditions[leaf] = {**shape, **_range(_own()[leaf], found, inside[name], shape)}
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


def _roads(inside: list[str], told: dict[str, Any] | None) -> Any:
    """The road class that is inside, with its values if the METADATA holds them."""
    if len(inside) != 1:
        raise ValueError(f"{ROAD_CLASS} has {len(inside)} classes inside: a domain has one")
    return told if told is not None and told.get("name") == inside[0] else inside[0]


class _Probe(NamedTuple):
    """A value of an attribute that stands for others."""

    value: Any
    low: float = math.nan
    """Least amount for which it stands; nan for a literal."""
    high: float = math.nan


def _probes(item: Any) -> list[_Probe]:
    """Values of an attribute that stand for all: its literals, or its edges and what is between."""
    if item is None:
        return []
    edges = list(filter(math.isfinite, item.edges))
    if item.values or not edges:
        return [_Probe(one) for one in item.values or ()]
    below = math.nextafter(edges[0], -math.inf)
    probes = [_Probe(edges[0] - 1.0 - abs(edges[0]), -math.inf, below)]
    for edge, after in pairwise((*edges, edges[-1] + 2.0 + abs(edges[-1]))):
        end = math.inf if edge == edges[-1] else math.nextafter(after, -math.inf)
        between = _Probe(0.5 * (edge + after), math.nextafter(edge, math.inf), end)
        probes += [_Probe(edge, edge, edge), between]
    return probes


def _range(
    row: Quantity, probes: list[_Probe], inside: list[_Probe], shape: Mapping[str, Any]
) -> dict[str, float]:
    """The low and high end of the one range of a quantity that is inside, both included.

    An end that is left open is the quantity's own.
    """
    ranges = []
    for is_inside, group in groupby(probes, lambda one: one in inside):
        if is_inside:
            found = list(group)
            ranges.append((found[0].low, found[-1].high))
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
