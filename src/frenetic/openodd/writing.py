"""Domains, and what was driven in them, for OpenODD's tools."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic._support.words import printable
from frenetic.campaign import CampaignStore, Test
from frenetic.domain import Distribution, Domain
from frenetic.errors import FreneticError
from frenetic.openodd.reading import MASS, OURS, ROAD_CLASS, bound, library
from frenetic.outcome import Outcome
from frenetic.quantities import quantity

ODD: Final = "odd.yaml"
RUNS: Final = "runs"
_ROADS: Final = "scenery.drivable_area"
_JUDGED: Final = (Outcome.PASS, Outcome.FAIL)
_BUCKETS: Final = 5
"""Parts of a range whose drives are counted apart."""
_DEGREE: Final = 6_378_137.0 * math.pi / 180.0
"""Length in m of a degree on the equator."""
_HEAD: Final = """\
# ASAM OpenODD 1.0, of Frenetic. Its conditions are ranges; how often a drive has which amount, and
# what the road class says, is under "frenetic" in METADATA, for Frenetic alone.
"""


def domain_document(domain: Domain) -> str:
    """A domain as OpenODD YAML, which `read_domain` reads back.

    Raises:
        FreneticError: the package ``openodd-py`` is not installed.
    """
    units = library().Units()
    units.add_conversions(MASS)
    taxonomy: dict[str, Any] = {}
    include: dict[str, Any] = {}
    modules: dict[str, Any] = {}
    shapes: dict[str, Any] = {}
    for name, of in domain.conditions.items():
        row = quantity(name)
        kind = units.unit_type(row.unit)
        _branch(taxonomy, row.taxon)[name] = f"float {kind or 'count'}"
        unit = f" {row.unit}" if kind else ""
        inside = f"[{of.low!r} .. {of.high!r}]{unit}"
        if _has_usual_apart(name, of):
            label = f"{name}_inside"
            for word, text in (("varied", inside), ("usual", f"{row.nothing!r}{unit}")):
                modules[f"{name}_{word}"] = {"LABEL": label, "INCLUDE_AND": {name: text}}
            include[label] = True
        else:
            include[name] = inside
        shape = {"mean": of.mean, "deviation": of.deviation} if of.mean is not None else {}
        if shape := shape | ({"chance": of.chance} if of.chance < 1.0 else {}):
            shapes[name] = shape
    told: dict[str, Any] = {"name": domain.name, "conditions": shapes}
    if domain.left_out:
        told["left_out"] = domain.left_out
    if domain.road_class is not None:
        _branch(taxonomy, _ROADS)[ROAD_CLASS] = [domain.road_class.name]
        include[ROAD_CLASS] = [domain.road_class.name]
        told["roads"] = domain.road_class.as_json()
    about = {"DESCRIPTION": domain.about} if domain.about else {}
    root = {**about, "METADATA": {OURS: told}, "INCLUDE_AND": include}
    document = {
        "TAXONOMY": taxonomy,
        "conversion": MASS,
        **({"MODULES": modules} if modules else {}),
        **({"ODD": {"domain": root}} if include else {}),
    }
    return _HEAD + "\n".join(_lines(document)) + "\n"


def write_campaign(
    folder: Path,
    store: CampaignStore,
    *,
    outcomes: Collection[Outcome],
    on_test: Callable[[int], None],
) -> None:
    """Writes the domain of a campaign, and what was driven in it.

    ``odd.yaml`` is the domain, ``campaign_cod.csv`` with its manifest and taxonomy an OpenODD table
    of the current operational domain (COD) with a row per drive, and ``runs/`` has a coverage file
    of ``openodd-py`` for each. Roads lie on a flat map, whose corner is put at 0° N, 0° E.

    Args:
        folder: exists and is empty.
        store: the campaign.
        outcomes: only tests of these that passed or failed are written.
        on_test: called with the number of tests so far.

    Raises:
        FreneticError: the campaign has no domain, or the package ``openodd-py`` is not installed.
        OSError: a file cannot be written.
    """
    domain = store.setting.domain
    if domain is None:
        raise FreneticError(f"{store.folder} has no domain to write: search in one with --odd")
    openodd, text = library(), domain_document(domain)
    (folder / ODD).write_text(text, encoding="utf-8")
    (folder / RUNS).mkdir()
    edges = {
        name: np.linspace(of.low, of.high, _BUCKETS + 1) for name, of in domain.conditions.items()
    }
    # A single amount, or nearly so, has no parts.
    buckets = {name: of.tolist() for name, of in edges.items() if (np.diff(of) > 0.0).all()}
    odd, backend = bound(text, domain.name, buckets)
    attributes: list[dict[str, Any]] = []
    rows: list[list[Any]] = []
    start = ""
    for test in _driven(store, outcomes, on_test):
        start = start or test.finished_at
        collector = openodd.CoverageCollector([], odd=odd, backend=backend)
        pose, duration = test.road.pose, test.result.duration or 0.0
        values = _amounts(domain, test.candidate.conditions)
        context = {**values, "place": (pose.y / _DEGREE, pose.x / _DEGREE), "way": 0.0}
        collector.start(context, 0.0)
        way = test.road.length if test.departure is None else test.departure.distance
        collector.tick({**context, "way": way}, duration)
        is_failure = test.outcome is Outcome.FAIL
        collector.record_outcome(not is_failure, failed_at=duration if is_failure else None)
        document = collector.to_dict(domain.name)
        document["odd"]["started_at"] = test.finished_at
        path = folder / RUNS / f"test-{test.id:05}_coverage.json"
        path.write_text(json.dumps(document), encoding="utf-8")
        samples = document["odd"]["samples"]
        attributes = samples["attributes"]
        elapsed = _moment(test.finished_at) - _moment(start)
        rows.append([elapsed, *samples["rows"][0][1:], test.id, str(test.outcome), test.moobd])
    attributes += [
        {"name": "test", "unit": "", "values": None},
        {"name": "outcome", "unit": "", "values": [str(one) for one in _JUDGED]},
        {"name": "moobd", "unit": "m", "values": None},
    ]
    samples = {"attributes": attributes, "rows": rows}
    openodd.export_cod({"odd": {"samples": samples, "started_at": start}}, folder, "campaign")


def _driven(
    store: CampaignStore, outcomes: Collection[Outcome], on_test: Callable[[int], None]
) -> Iterator[Test]:
    """The tests that passed or failed."""
    for done, test in enumerate(store.tests(with_trajectory=False), start=1):
        on_test(done)
        if test.outcome in outcomes and test.outcome in _JUDGED:
            yield test


def _amounts(domain: Domain, conditions: Mapping[str, float]) -> dict[str, Any]:
    """Value of each of a domain's attributes; None where it is no number."""
    values: dict[str, Any] = {}
    for name in domain.conditions:
        amount = conditions.get(name, quantity(name).nothing)
        values[name] = None if amount is None or math.isinf(amount) else amount
    if domain.road_class is not None:
        values[ROAD_CLASS] = domain.road_class.name
    return values


def _has_usual_apart(name: str, of: Distribution) -> bool:
    """Whether the usual amount is inside by its chance alone, outside of the range."""
    usual = quantity(name).nothing
    if of.chance == 1.0 or usual is None or math.isinf(usual):
        return False
    return not of.low <= usual <= of.high


def _branch(tree: dict[str, Any], taxon: str) -> dict[str, Any]:
    for part in taxon.split("."):
        tree = tree.setdefault(part, {})
    return tree


def _moment(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def _lines(tree: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """YAML, with METADATA and lists in the form of JSON."""
    for key, value in tree.items():
        if isinstance(value, Mapping) and key != "METADATA" and value:
            yield f"{indent}{key}:"
            yield from _lines(value, f"{indent}  ")
        else:
            yield f"{indent}{key}: {printable(json.dumps(value, ensure_ascii=False))}"
