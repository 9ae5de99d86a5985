"""A campaign as the results folder of the SBST/SBFT competition: a file per test, and tables."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from frenetic._support.arrays import FloatArray
from frenetic._support.printable import text_cell
from frenetic.analysis.official_segment import failure_segment
from frenetic.analysis.sparseness import MOST_COMPARED, largest_distances
from frenetic.campaign.configuration import owner_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.export.official_format import stored_test_text
from frenetic.oracle.outcome import Outcome


def write_competition_folder(
    folder: Path,
    store: CampaignStore,
    *,
    outcomes: Collection[Outcome],
    driven: Collection[Outcome],
    on_test: Callable[[int], None],
) -> None:
    """Write a file for each chosen test, and three tables about the whole campaign.

    DROPPED candidates are no tests and have no file. The tables cover all tests, with or without a
    file. A cell of unknown value is empty: ``time_budget`` without a time budget,
    ``real_time_generation`` if several tests were driven at once, and sparseness for fewer than two
    failures or more than `MOST_COMPARED`.

    Args:
        folder: an empty folder.
        store: the campaign.
        outcomes: outcomes of the tests that get a file.
        driven: outcomes of the tests whose files hold execution data.
        on_test: called with the number of stored candidates that have been read so far.

    Raises:
        CampaignError: the campaign is damaged.
        OSError: a file cannot be written.
    """
    statistics = _Statistics(store.by_outcome()[Outcome.FAIL] <= MOST_COMPARED)
    for count, test in enumerate(store.tests(), start=1):
        on_test(count)
        if not test.outcome.is_test:
            continue
        statistics.add(test)
        if test.outcome in outcomes:
            _write_test(folder, store.test(test.id) if test.outcome in driven else test)
    is_serial = store.config.get("workers", 1) == 1 and store.config.get("cluster") is None
    _write_row(folder / "generation_stats.csv", statistics.generation_row(is_serial=is_serial))
    _write_row(folder / "oob_stats.csv", statistics.oob_row())
    _write_row(folder / "experiment_description.csv", _experiment(store))


@dataclass
class _Statistics:
    """Numbers and times of a campaign's tests."""

    has_sparseness: bool
    """Whether the failures are few enough to be compared with each other."""
    numbers: Counter[Outcome] = field(default_factory=Counter)
    """Outcome -> number of tests."""
    sides: Counter[str] = field(default_factory=Counter)
    """Side -> number of failures that left the lane there."""
    segments: list[FloatArray] = field(default_factory=list)
    """Segment of the road around each departure, see `failure_segment`."""
    driving_time: float = 0.0
    """Wall time of the drives, in s."""
    simulated_time: float = 0.0
    """Simulated time of the drives, in s."""
    elapsed: float = 0.0
    """Wall time of the campaign until the last test, in s."""

    def add(self, test: Test) -> None:
        """Count a test."""
        self.numbers[test.outcome] += 1
        self.simulated_time += test.result.duration or 0.0
        self.driving_time += 0.0 if test.outcome is Outcome.INVALID else test.seconds
        self.elapsed = test.elapsed
        if test.outcome is Outcome.FAIL and test.departure is not None:
            self.sides[str(test.departure.side)] += 1
            if self.has_sparseness and (segment := failure_segment(test)) is not None:
                self.segments.append(segment)

    def generation_row(self, *, is_serial: bool) -> dict[str, object]:
        """Return the row of generation_stats.csv.

        Args:
            is_serial: whether tests were driven one after the other, so that the time that was not
                spent on driving was spent on generating roads.
        """
        generating_time = self.elapsed - self.driving_time
        return {
            "test_generated": self.numbers.total(),
            "test_valid": self.numbers.total() - self.numbers[Outcome.INVALID],
            "test_invalid": self.numbers[Outcome.INVALID],
            "test_passed": self.numbers[Outcome.PASS],
            "test_failed": self.numbers[Outcome.FAIL],
            "test_in_error": self.numbers[Outcome.ERROR],
            "real_time_generation": round(generating_time, 3) if is_serial else None,
            "real_time_execution": round(self.driving_time, 3),
            "simulated_time_execution": round(self.simulated_time, 3),
        }

    def oob_row(self) -> dict[str, object]:
        """Return the row of oob_stats.csv: failures by side, and their sparseness."""
        distances = largest_distances(self.segments)
        return {
            "total_oob": self.sides.total(),
            "left_oob": self.sides["left"],
            "right_oob": self.sides["right"],
            "avg_sparseness": round(float(distances.mean()), 6) if len(distances) else None,
            "stdev_sparseness": round(float(distances.std()), 6) if len(distances) else None,
        }


def _write_test(folder: Path, test: Test) -> None:
    """Write the document of a test."""
    path = folder / f"test.{test.id:04d}.json"
    path.write_text(f"{stored_test_text(test)}\n", encoding="utf-8")


def _experiment(store: CampaignStore) -> dict[str, object]:
    """Return the row of experiment_description.csv: options of the competition's command line."""
    config = store.config
    rules = _mapping(config.get("rules"))
    module, _, name = str(_mapping(config.get("strategy")).get("class", "")).rpartition(":")
    owner = owner_of(config)
    time_budget = _mapping(store.facts.get("budget", config.get("budget"))).get("time")
    if owner is not None and owner.time_budget is not None:  # the limit that a bench enforces
        time_budget = owner.time_budget
    return {
        "executor": str(_mapping(config.get("simulator")).get("class", "")).rpartition(":")[2],
        "time_budget": time_budget,
        "map_size": config.get("map_size"),
        "oob_tolerance": rules.get("oob_tolerance"),
        "speed_limit": rules.get("speed_limit"),
        "module_name": module,
        "class_name": name,
    }


def _mapping(value: object) -> Mapping[str, Any]:
    """Return a value if it is a mapping, else an empty mapping."""
    return value if isinstance(value, Mapping) else {}


def _write_row(path: Path, row: Mapping[str, object]) -> None:
    """Write a CSV file of a header and one row; no spreadsheet reads its texts as formulas."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(row), lineterminator="\n")
        writer.writeheader()
        writer.writerow(
            {
                name: text_cell(value) if isinstance(value, str) else value
                for name, value in row.items()
            }
        )
