"""A campaign as a results folder of the SBST/SBFT cyber-physical systems competition."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from frenetic._support.arrays import FloatArray
from frenetic._support.words import text_cell
from frenetic.analysis.competition import competition_segment
from frenetic.analysis.sparseness import competition_sparseness
from frenetic.campaign.record import TestRecord
from frenetic.campaign.store import CampaignStore
from frenetic.errors import RoadError
from frenetic.export.competition import stored_test_document
from frenetic.outcome import Outcome

Sides: TypeAlias = Literal["geometry", "competition"]
"""Rule for the side of a departure in ``oob_stats.csv``: where the car was, or the official one."""

MOST_COMPARED: Final = 2000
"""Most failures for sparseness, whose time grows with their square."""


def write_competition_folder(
    folder: Path,
    store: CampaignStore,
    *,
    outcomes: Collection[Outcome],
    driven: Collection[Outcome],
    sides: Sides,
    on_test: Callable[[int], None],
) -> None:
    """Writes a file per road test, and three tables about the whole campaign.

    DROPPED candidates are no road tests and have no file. The tables cover all tests, with or
    without a file. A cell of unknown value is empty: ``time_budget`` without one,
    ``real_time_generation`` where several tests were driven at once, and sparseness for fewer than
    two failures or more than `MOST_COMPARED`.

    Args:
        folder: exists and is empty.
        store: the campaign.
        outcomes: only tests of these get a file.
        driven: only files of tests of these hold execution data.
        sides: whose ``left_oob`` and ``right_oob``. By geometry they add up to ``total_oob``. The
            competition's side is that of `CompetitionSegment`, where its code makes a segment.
        on_test: called after each test with their number so far.

    Raises:
        CampaignError: the campaign is damaged.
        OSError: a file cannot be written.
    """
    failures = store.by_outcome()[Outcome.FAIL]
    statistics = _Statistics(sides, with_sparseness=failures <= MOST_COMPARED)
    for done, record in enumerate(store.tests(), start=1):
        outcome = record.outcome
        if outcome.is_test:
            statistics.count(record)
            if outcome in outcomes:
                _write_test(folder, store.test(record.id) if outcome in driven else record)
        on_test(done)
    alone = store.config.get("workers", 1) == 1 and store.config.get("cluster") is None
    _write_row(folder / "generation_stats.csv", statistics.generation(alone))
    _write_row(folder / "oob_stats.csv", statistics.out_of_bounds())
    _write_row(folder / "experiment_description.csv", _experiment(store))


def _is_road(record: TestRecord) -> bool:
    """Whether there is a road; what was proposed may be none."""
    try:
        return record.road is not None
    except RoadError:
        return False


def _write_test(folder: Path, record: TestRecord) -> None:
    document: Mapping[str, Any]
    if _is_road(record):
        document = stored_test_document(record)
    else:
        points = record.candidate.points
        document = {
            "id": record.candidate.id,
            "is_valid": False,
            "validation_message": record.reason,
            "road_points": [] if points is None else points.tolist(),
            "interpolated_points": [],
            "test_outcome": str(record.outcome),
            "description": record.reason,
            "execution_data": [],
        }
    path = folder / f"test.{record.candidate.id:04d}.json"
    path.write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")


class _Statistics:
    """Totals of the tests for the competition's tables."""

    def __init__(self, sides: Sides, *, with_sparseness: bool) -> None:
        self._rule = sides
        self._with_sparseness = with_sparseness
        self._outcomes: Counter[Outcome] = Counter()
        self._departures = 0
        self._sides: Counter[str] = Counter()
        self._segments: list[FloatArray] = []
        self._seconds = self._simulated = self._elapsed = 0.0

    def count(self, record: TestRecord) -> None:
        """Takes one more test into account."""
        self._outcomes[record.outcome] += 1
        self._simulated += record.duration or 0.0
        if record.outcome is not Outcome.INVALID:
            self._seconds += record.seconds
        self._elapsed = record.elapsed or self._elapsed + record.seconds
        departure = record.departure
        if record.outcome is Outcome.FAIL and departure is not None and _is_road(record):
            self._departures += 1
            by_geometry = self._rule == "geometry"
            if by_geometry:
                self._sides[departure.side] += 1
            if by_geometry and not self._with_sparseness:
                return
            points = record.candidate.points
            segment = competition_segment(
                record.road.road_points if points is None else points, (departure.x, departure.y)
            )
            if segment is None:
                return
            if not by_geometry:
                self._sides[segment.side] += 1
            if self._with_sparseness:
                self._segments.append(segment.points)

    def generation(self, alone: bool) -> dict[str, object]:
        """The row of generation_stats.csv; ``alone`` if one test was driven at a time."""
        number = self._outcomes
        invalid = number[Outcome.INVALID]
        return {
            "test_generated": number.total(),
            "test_valid": number.total() - invalid,
            "test_invalid": invalid,
            "test_passed": number[Outcome.PASS],
            "test_failed": number[Outcome.FAIL],
            "test_in_error": number[Outcome.ERROR],
            "real_time_generation": round(self._elapsed - self._seconds, 3) if alone else "",
            "real_time_execution": round(self._seconds, 3),
            "simulated_time_execution": round(self._simulated, 3),
        }

    def out_of_bounds(self) -> dict[str, object]:
        """The row of oob_stats.csv."""
        sparseness = competition_sparseness(self._segments)
        return {
            "total_oob": self._departures,
            "left_oob": self._sides["left"],
            "right_oob": self._sides["right"],
            "avg_sparseness": _or_nothing(sparseness.mean),
            "stdev_sparseness": _or_nothing(sparseness.stdev),
        }


def _or_nothing(value: float | None) -> object:
    return "" if value is None else round(value, 6)


def _experiment(store: CampaignStore) -> dict[str, object]:
    """The row of experiment_description.csv: options of the competition's command line."""
    config = store.config
    rules = _mapping(config.get("rules"))
    module, _, name = str(_mapping(config.get("strategy")).get("class", "")).rpartition(":")
    # In a bench, time is virtual.
    in_bench = _mapping(_mapping(config.get("entrant")).get("budget"))
    budget = in_bench or _mapping(store.facts.get("budget", config.get("budget")))
    return {
        "executor": str(_mapping(config.get("simulator")).get("class", "")).rpartition(":")[2],
        "time_budget": budget.get("time"),
        "map_size": config.get("map_size"),
        "oob_tolerance": rules.get("oob_tolerance"),
        "speed_limit": rules.get("speed_limit"),
        "module_name": module,
        "class_name": name,
    }


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _write_row(path: Path, row: Mapping[str, object]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(row), lineterminator="\n")
        writer.writeheader()
        writer.writerow({k: text_cell(v) if isinstance(v, str) else v for k, v in row.items()})
