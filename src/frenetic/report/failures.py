"""Files of failing roads in a campaign's folder, and their picture at a glance."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from frenetic._support.files import replacing
from frenetic._support.json_value import JSONValue
from frenetic._support.words import rounded_seconds
from frenetic.campaign.database import DATABASE
from frenetic.campaign.record import Test, file_stem
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.stored_spec import signed_driving
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.processes.interrupt import catch_interrupt
from frenetic.road import Road
from frenetic.road.files import entries_of
from frenetic.spec import DRIVEN, Spec

FAILURES: Final = "failures"
"""Name of the folder for failing roads in a campaign's folder."""
PICTURES: Final = "pictures"
"""Name of the folder for pictures of tests that did not fail, in a campaign's folder."""
GALLERY: Final = "gallery.png"
"""Name of the file in `FAILURES` with the picture of the listed failures at a glance."""
MOST_FILES: Final = 1000
"""Largest number of failing roads that get a file, the most severe first; our choice.

The database holds all failing roads.
"""


def verdict_entries(result: Result) -> dict[str, Any]:
    """Return the entries of a road's document that say how it was driven."""
    departure = result.departure
    return {
        "test_outcome": str(result.outcome),
        "description": result.reason,
        "moobd": result.moobd,
        "max_oob_share": result.max_oob_share,
        "duration": rounded_seconds(result.duration),
        "departure": departure and departure.as_json(),
        "findings": [finding.as_json() for finding in result.findings],
    }


def road_entries(road: Road) -> dict[str, Any]:
    """Return the entries of a road's document that describe the road."""
    return entries_of(road) | {"road_points": road.road_points.round(6).tolist()}


def road_document(
    record: Test, config: Mapping[str, JSONValue], spec: Spec | None
) -> dict[str, Any]:
    """Return a test as JSON for `frenetic drive` and the competition's tools.

    Args:
        record: the test.
        config: configuration of the campaign.
        spec: spec of the campaign's drives, from `frenetic.campaign.stored_spec.signed_driving`;
            None if it is unknown.
    """
    candidate, road = record.candidate, record.road
    return {
        "id": candidate.id,
        "is_valid": record.outcome is not Outcome.INVALID,
        "validation_message": record.reason if record.outcome is Outcome.INVALID else "",
        **verdict_entries(record.result),
        "origin": {
            "operator": candidate.origin.operator,
            "parents": list(candidate.origin.parents),
            "generation": candidate.origin.generation,
        },
        "driver": config.get("driver"),
        "rules": config.get("rules"),
        **({} if spec is None else {DRIVEN: spec.in_conditions(candidate.conditions).entries()}),
        **road_entries(road),
    }


def write_failures(
    store: CampaignStore,
    failures: Iterable[Test],
    listed: Sequence[Test],
    shortened: Mapping[int, Test] = MappingProxyType({}),
) -> None:
    """Write failing roads as JSON files, and draw the listed failures at a glance.

    Args:
        store: the campaign.
        failures: the campaign's failures, of which the first `MOST_FILES` get a file.
        listed: failures in the gallery, or nearest misses if nothing failed.
        shortened: id of a test -> drive on its minimised road, which the gallery shows instead.

    Raises:
        CampaignError: a file cannot be written.
    """
    from frenetic.report.picture import draw_gallery  # matplotlib imports slowly

    folder = store.folder / FAILURES
    spec = signed_driving(store)
    try:
        folder.mkdir(exist_ok=True)
        for record in islice(failures, MOST_FILES):
            document = json.dumps(road_document(record, store.config, spec)) + "\n"
            path = folder / f"{file_stem(record.candidate.id)}.json"
            if not _has_text(path, document):  # an unchanged file keeps its time of change
                with replacing(path) as partial:
                    partial.write_text(document, encoding="utf-8")
    except OSError as error:
        raise CampaignError(
            f"{folder} cannot be written: {error.strerror or error}; all results are safe in"
            f" {store.folder / DATABASE}"
        ) from None
    items = []
    for record in listed:
        test = shortened.get(record.id) or store.test(record.id)
        cut = f", cut to {test.road.length:.0f} m" if record.id in shortened else ""
        items.append((f"Test {record.id}{cut}", test.road, test))
    if items:
        are_misses = listed[0].outcome is Outcome.PASS
        title = "The nearest misses" if are_misses else "The most telling failures"
        with catch_interrupt():
            draw_gallery(items, folder / GALLERY, title=title)


def _has_text(path: Path, text: str) -> bool:
    """Return whether a file exists and has this text."""
    try:
        return path.is_file() and path.read_text(encoding="utf-8") == text
    except (OSError, ValueError):
        return False
