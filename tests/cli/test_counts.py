"""All commands and files give the same counts of a campaign's tests."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

PARTS = """
import numpy as np
from frenetic.search import Origin, SearchEnded
from frenetic.search.strategy import Ledger, Strategy
from frenetic.testing import DummySimulator

# On roads bent to the left the driver fails, on those bent to the right the simulator breaks.
STRAIGHT, LEFT, RIGHT = np.zeros(12), np.full(12, 0.01), np.full(12, -0.01)
LOOP = np.full(14, 0.07)
ROADS = [STRAIGHT, LEFT, LOOP, STRAIGHT, RIGHT, LEFT, LEFT / 2, LOOP]
UNWANTED = 7


class Mixed(Strategy):
    def __init__(self, seed=0, map_size=200.0):
        self.ledger, self.asked = Ledger(), 0

    def ask(self):
        if self.asked == len(ROADS):
            raise SearchEnded("all roads are proposed")
        self.asked += 1
        return self.ledger.issue(ROADS[self.asked - 1], 10.0, Origin("random"))

    def tell(self, evaluation):
        self.ledger.settle(evaluation)

    def is_wanted(self, candidate):
        return candidate.id != UNWANTED


def drift(road):
    return 400.0 * road.curvatures.mean()


class Moody(DummySimulator):
    def __init__(self, rules=None, wall_limit=60.0):
        super().__init__(drift, rules=rules)

    def drive(self, road, driver):
        if road.curvatures.mean() < 0.0:
            raise RuntimeError("it broke")
        return super().drive(road, driver)
"""
SEARCH = (
    *("run", "--strategy", "parts.py:Mixed", "--simulator", "parts.py:Moody"),
    *("--simulations", "50", "--seed", "1", "--workers", "1"),
)
COUNTS_TEXT = (
    "7 tests of 4 different roads: 2 passed, 2 failed (1 repeat), 2 invalid, 1 error, 1 dropped"
)
COUNTS = {
    "tests": 7,
    "roads": 4,
    "repeats": 3,
    "failures": 1,
    "simulations": 5,
    "passed": 2,
    "failed": 2,
    "invalid": 2,
    "errors": 1,
    "dropped": 1,
}


def counts_of(document: dict[str, Any]) -> dict[str, Any]:
    return {name: document[name] for name in COUNTS}


@pytest.fixture
def mixed_campaign(frenetic: Frenetic) -> str:
    """A campaign with every outcome, in which two roads were driven twice."""
    Path("parts.py").write_text(PARTS)
    answer = frenetic(*SEARCH, "--out", "c")
    assert answer.code == 0
    assert COUNTS_TEXT in answer.out
    return "c"


def test_every_command_gives_the_same_counts(frenetic: Frenetic, mixed_campaign: str) -> None:
    frenetic(*SEARCH, "--out", "d")
    for command in (
        ("show", mixed_campaign),
        ("show", mixed_campaign, "--follow"),
        ("check", mixed_campaign),
    ):
        assert COUNTS_TEXT in frenetic(*command).out
        assert counts_of(frenetic(*command, "--json").json) == COUNTS
    compare = ("compare", "one=c", "two=d")
    lines = frenetic(*compare).out.splitlines()
    assert [line for line in lines if COUNTS_TEXT in line] == [
        f"one: {COUNTS_TEXT}",
        f"two: {COUNTS_TEXT}",
    ]
    compared = frenetic(*compare, "--json").json["groups"]
    documents = [document for group in compared.values() for document in group]
    assert [counts_of(document) for document in documents] == [COUNTS, COUNTS]
    log = [
        json.loads(line) for line in Path(mixed_campaign, "campaign.log").read_text().splitlines()
    ]
    last = [line for line in log if line["event"] in ("progress", "finished")][-2:]
    assert [counts_of(line) for line in last] == [COUNTS, COUNTS]
    assert all(COUNTS_TEXT in line["message"] for line in last)
    assert COUNTS_TEXT in frenetic("resume", mixed_campaign, "--workers", "1").out
    assert counts_of(frenetic("resume", mixed_campaign, "--workers", "1", "--json").json) == COUNTS


@pytest.mark.heavy
def test_tables_give_the_same_counts(frenetic: Frenetic, mixed_campaign: str) -> None:
    exported = frenetic(
        "export", mixed_campaign, "--format", "csv", "--out", "tables", "--json"
    ).json
    with Path(exported["folder"], "tests.csv").open(newline="") as file:
        outcomes = Counter(row["outcome"] for row in csv.DictReader(file))
    assert outcomes == {"PASS": 2, "FAIL": 2, "INVALID": 2, "ERROR": 1, "DROPPED": 1}


def test_a_bench_gives_the_same_counts(frenetic: Frenetic) -> None:
    Path("parts.py").write_text(PARTS)
    parts = ("--strategy", "parts.py:Mixed", "--simulator", "parts.py:Moody")
    bench = ("bench", *parts, "--simulations", "50", "--repeats", "1", "--workers", "1")
    (group,) = frenetic(*bench, "--out", "b", "--json").json["groups"].values()
    assert [counts_of(run) for run in group] == [COUNTS]
    assert COUNTS_TEXT in frenetic("bench", "--resume", "--out", "b").out
