"""Campaigns that are ended at any moment and go on as if nothing had happened."""

from __future__ import annotations

import random
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.errors import CampaignError
from frenetic.search import Candidate, Frenetic, RandomSearch
from frenetic.testing import DummyDriver, DummySimulator

SIMULATIONS = 160


def drift(road) -> float:  # type: ignore[no-untyped-def]
    """More in sharper bends, so that there is something to learn."""
    return 70.0 * float(abs(road.curvatures).max()) - 1.2


def campaign(folder: Path, strategy=None, simulator=None, simulations=SIMULATIONS) -> Campaign:  # type: ignore[no-untyped-def]
    return Campaign(
        strategy=strategy or Frenetic(seed=4, cross_freq=10, cross_num=6),
        simulator=simulator or DummySimulator(drift),
        driver=DummyDriver(),
        budget=Budget(simulations=simulations),
        folder=folder,
    )


def contents(folder: Path) -> dict[str, list[tuple[object, ...]]]:
    """Every row of a campaign's database, but for times."""
    connection = sqlite3.connect(folder / "campaign.sqlite")
    try:
        columns = [
            row[1]
            for row in connection.execute("PRAGMA table_info(test)")
            if row[1] not in ("seconds", "finished_at", "elapsed", "worker")
        ]
        queries = {
            "candidate": "SELECT * FROM candidate ORDER BY id",
            "test": f"SELECT {', '.join(columns)} FROM test ORDER BY told",
            "trajectory": "SELECT * FROM trajectory ORDER BY candidate_id",
        }
        return {name: connection.execute(query).fetchall() for name, query in queries.items()}
    finally:
        connection.close()


class Stopping(DummySimulator):
    """Is interrupted in its nth drive."""

    def __init__(self, drives: int) -> None:
        super().__init__(drift)
        self.left = drives

    def drive(self, road, driver):  # type: ignore[no-untyped-def]
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().drive(road, driver)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[object, ...]]]:
    folder = tmp_path_factory.mktemp("whole")
    campaign(folder).run()
    return contents(folder)


def test_interrupted_again_and_again_it_ends_as_if_it_had_not_been(
    tmp_path: Path, uninterrupted: dict[str, list[tuple[object, ...]]]
) -> None:
    assert campaign(tmp_path, simulator=Stopping(7)).run().interrupted
    for _ in range(100):
        summary = campaign(tmp_path, simulator=Stopping(23)).resume()
        if not summary.interrupted:
            break
    assert summary.simulations == SIMULATIONS
    assert contents(tmp_path) == uninterrupted


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_resume import campaign
folder = Path({folder!r})
one = campaign(folder)
(one.resume if (folder / "campaign.sqlite").exists() else one.run)()
"""


def test_killed_at_random_moments_it_ends_as_if_it_had_not_been(
    tmp_path: Path, uninterrupted: dict[str, list[tuple[object, ...]]]
) -> None:
    rng = random.Random(11)
    script = SCRIPT.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    kills = 0
    for attempt in range(40):
        process = subprocess.Popen([sys.executable, "-c", script])
        before = told(tmp_path)
        wanted = rng.randint(1, 12)
        # Not before it got somewhere, or it would never end; then at once, wherever it is.
        while process.poll() is None and attempt < 8 and told(tmp_path) < before + wanted:
            time.sleep(0.001)
        if attempt < 8:
            kills += process.poll() is None
            process.kill()
        if process.wait() == 0:
            break
    assert kills >= 5
    assert told(tmp_path) == len(uninterrupted["test"])
    assert contents(tmp_path) == uninterrupted


def told(folder: Path) -> int:
    try:
        with CampaignStore.open(folder) as store:
            return store.counts().told
    except CampaignError:
        return 0


def test_extended_budget_goes_on_from_where_it_ended(tmp_path: Path) -> None:
    campaign(tmp_path, simulations=40).run()
    first = contents(tmp_path)
    summary = campaign(tmp_path, simulations=70).resume()
    assert summary.simulations == 70
    extended = contents(tmp_path)
    assert extended["test"][: len(first["test"])] == first["test"]


def test_other_parts_are_refused_and_nothing_is_changed(tmp_path: Path) -> None:
    campaign(tmp_path, simulator=Stopping(20)).run()
    before = contents(tmp_path)
    for other in (
        campaign(tmp_path, strategy=Frenetic(seed=5, cross_freq=10, cross_num=6)),
        campaign(tmp_path, strategy=RandomSearch(seed=4)),
    ):
        with pytest.raises(CampaignError, match="was made with another strategy"):
            other.resume()
    assert contents(tmp_path) == before


def test_strategy_that_replays_differently_is_noticed(tmp_path: Path) -> None:
    class Changed(Frenetic):
        def ask(self) -> Candidate:
            asked = super().ask()
            if asked.id == 9:
                return Candidate(9, np.zeros(20), asked.step, asked.origin)
            return asked

    Changed.__module__, Changed.__qualname__ = Frenetic.__module__, Frenetic.__qualname__
    campaign(tmp_path, simulator=Stopping(20)).run()
    before = contents(tmp_path)
    changed = Changed(seed=4, cross_freq=10, cross_num=6)
    with pytest.raises(CampaignError, match="another road as candidate 9 than it did"):
        campaign(tmp_path, strategy=changed, simulator=Stopping(99)).resume()
    assert contents(tmp_path) == before


def test_there_has_to_be_a_campaign(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="holds no campaign"):
        campaign(tmp_path).resume()
