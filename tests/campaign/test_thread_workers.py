"""Campaigns whose compiled driver drives many roads side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from contents import contents

from frenetic import Budget, Campaign, CampaignStore, Frenetic
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import workers_for
from frenetic.campaign.workers.threads import ThreadWorkers
from frenetic.campaign.workers.workers import InProcessWorker
from frenetic.conditions.domain import Domain
from frenetic.drivers import Planner
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.search import Strategy
from frenetic.search.random_search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.embedded.batch import CompiledDrive

DRIVES = 60


class PythonPlanner(Planner):
    """The planner, called from Python."""


def run(folder: Path, strategy: Strategy, workers: int = 1) -> dict[str, Any]:
    """Run a campaign and return what it stored."""
    Campaign(
        strategy=strategy,
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=DRIVES),
        folder=folder,
        workers=workers,
        max_in_flight=16,
    ).run()
    return contents(folder)


@pytest.mark.parametrize("has_conditions", [False, True])
def test_roads_side_by_side_give_the_campaign_of_roads_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_conditions: bool
) -> None:
    ranges = {"friction": {"low": 0.6, "high": 1.0}, "delay": {"low": 0.0, "high": 0.2}}
    domain = Domain.from_entries("d", {"conditions": ranges}) if has_conditions else None

    def strategy() -> Strategy:
        return Frenetic(seed=2, domain=domain)

    stored = [run(tmp_path / f"{count}", strategy(), workers=count) for count in (1, 2, 3)]
    with monkeypatch.context() as patched:
        patched.setattr(RoadTester, "drives_side_by_side", property(lambda _: False))
        stored.append(run(tmp_path / "alone", strategy()))
    assert stored[0] == stored[1] == stored[2] == stored[3]


def test_refused_roads_are_stored_beside_driven_ones(tmp_path: Path) -> None:
    run(tmp_path / "c", RandomSearch(seed=1, max_redraws=0))
    with CampaignStore.open(tmp_path / "c") as store:
        outcomes = {test.outcome for test in store.tests()}
    assert outcomes >= {Outcome.INVALID, Outcome.PASS}


def test_an_error_is_the_error_of_one_road(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive_compiled = EmbeddedSimulator.drive_compiled
    doomed: list[float] = []

    def breaking(
        self: EmbeddedSimulator, drives: Sequence[CompiledDrive], **options: Any
    ) -> list[Drive]:
        if not doomed:
            doomed.append(drives[3].road.length)
        if any(drive.road.length == doomed[0] for drive in drives):
            raise MemoryError("no room")
        return drive_compiled(self, drives, **options)

    monkeypatch.setattr(EmbeddedSimulator, "drive_compiled", breaking)
    run(tmp_path / "c", RandomSearch(seed=1))
    with CampaignStore.open(tmp_path / "c") as store:
        tests = list(store.tests())
    errors = [test for test in tests if test.outcome is Outcome.ERROR]
    assert errors
    assert all(test.road.length == doomed[0] and test.attempts == 2 for test in errors)
    assert {test.outcome for test in tests} > {Outcome.PASS}


def test_only_compiled_drives_run_in_threads(tmp_path: Path) -> None:
    options: Any = {
        "isolate": False,
        "drive_limit": 100.0,
        "log": None,
        "may_queue": True,
        "keep_exact": False,
    }
    compiled = RoadTester(EmbeddedSimulator(), Planner())
    assert isinstance(workers_for(compiled, 2, **options), ThreadWorkers)
    called = RoadTester(EmbeddedSimulator(), PythonPlanner())
    workers = workers_for(called, 1, **options)
    assert isinstance(workers, InProcessWorker)
    assert not isinstance(workers, ThreadWorkers)
