"""Campaigns that are ended at any moment and go on as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import killing
import numpy as np
import pytest
from contents import contents
from events import on_result
from faulty import Marks
from pids import until_gone
from test_campaign import Scripted
from user_modules import own_modules

from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.campaign.campaign import LOOKAHEAD
from frenetic.campaign.check import check_campaign
from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.errors import CampaignError
from frenetic.search import Candidate, Evaluation, Frenetic, Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.testing import DummyDriver, DummySimulator

SIMULATIONS = 160


def drift(road) -> float:  # type: ignore[no-untyped-def]
    """More in sharper bends, so that there is something to learn."""
    return 70.0 * float(abs(road.curvatures).max()) - 1.2


def campaign(folder: Path, strategy=None, simulator=None, simulations=SIMULATIONS) -> Campaign:  # type: ignore[no-untyped-def]
    return Campaign(
        strategy=strategy or Frenetic2021(seed=4, cross_freq=10, cross_num=6, max_redraws=10),
        simulator=simulator or DummySimulator(drift),
        driver=DummyDriver(),
        budget=Budget(simulations=simulations),
        folder=folder,
    )


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


@pytest.mark.endurance
@pytest.mark.skipif(sys.platform == "win32", reason="a process kills itself by a POSIX signal")
@pytest.mark.parametrize(("workers", "ordered"), [(1, False), (2, True)])
def test_killed_at_random_moments_it_ends_as_if_it_had_not_been(
    tmp_path: Path, workers: int, ordered: bool, endurance: bool
) -> None:
    marks, folder, whole = (tmp_path / name for name in ("marks", "campaign", "whole"))
    marks.mkdir()
    killing.campaign(whole, marks, ordered=ordered).run()
    rng = random.Random(11 + workers)
    together = LOOKAHEAD if ordered else 1  # results in one transaction at most
    for kills in range(1, (25 if endurance else 5) + 1):
        blow = random_blow(rng, first=kills == 1)
        exit_code = go_on(folder, marks, workers, ordered, blow)
        assert exit_code == -signal.SIGKILL, f"{blow} has not come"
        reported = size(marks / "reported")
        stored = told(folder)
        # Whatever was reported is there, and per kill at most one transaction more.
        assert reported <= stored <= reported + kills * together
        if (folder / "campaign.sqlite").exists():
            assert check_campaign(folder).findings == (), blow
    assert 0 < told(folder) < killing.SIMULATIONS
    assert go_on(folder, marks, workers, ordered, None) == 0
    assert contents(folder) == contents(whole)
    assert check_campaign(folder).findings == ()
    until_gone(set(Marks(marks).pids()) - {os.getpid()})


def random_blow(rng: random.Random, *, first: bool) -> killing.Blow:
    """Sometimes early, more often somewhere in the next few tests, and often within a write."""
    kind = rng.choice(["start", "write", "write", "commit", "commit", "result"])
    if first:
        return killing.Blow("write", rng.randint(1, 200))  # when the database is made
    if kind == "start":
        return killing.Blow("start", 1, rng.uniform(0.0, 0.05))
    if kind == "write":
        return killing.Blow("write", rng.randint(1, 1000))
    return killing.Blow(kind, rng.randint(1, 7), rng.uniform(0.0, 5e-4))  # type: ignore[arg-type]


def go_on(
    folder: Path, marks: Path, workers: int, ordered: bool, blow: killing.Blow | None
) -> int | None:
    """Goes on with a campaign in a process of its own; returns its exit code."""
    return killing.exit_code_of(killing.go_on, folder, marks, workers, ordered, blow)


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def told(folder: Path) -> int:
    if not (folder / "campaign.sqlite").exists():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().told


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
        campaign(
            tmp_path, strategy=Frenetic2021(seed=5, cross_freq=10, cross_num=6, max_redraws=10)
        ),
        campaign(tmp_path, strategy=RandomSearch(seed=4)),
    ):
        with pytest.raises(CampaignError, match="was made with another strategy"):
            other.resume()
    assert contents(tmp_path) == before


def test_strategy_that_replays_differently_is_noticed(tmp_path: Path) -> None:
    class Changed(Frenetic2021):
        def ask(self) -> Candidate:
            asked = super().ask()
            if asked.id == 9:
                return Candidate(9, np.zeros(20), asked.step, asked.origin)
            return asked

    Changed.__module__, Changed.__qualname__ = Frenetic2021.__module__, Frenetic2021.__qualname__
    campaign(tmp_path, simulator=Stopping(20)).run()
    before = contents(tmp_path)
    changed = Changed(seed=4, cross_freq=10, cross_num=6, max_redraws=10)
    with pytest.raises(CampaignError, match="another road as candidate 9 than it did"):
        campaign(tmp_path, strategy=changed, simulator=Stopping(99)).resume()
    assert contents(tmp_path) == before


def test_there_has_to_be_a_campaign(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="holds no campaign"):
        campaign(tmp_path).resume()


def test_killed_after_its_budget_was_extended_it_goes_on_to_that_budget(tmp_path: Path) -> None:
    campaign(tmp_path, simulations=40).run()

    def end(progress: Summary) -> None:
        if progress.simulations == 60:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        campaign(tmp_path, simulations=70).resume(on_event=on_result(end))
    with CampaignStore.open(tmp_path) as store:
        assert "finished_at" not in store.facts
        assert store.facts["budget"] == {"simulations": 70, "time": None, "failures": None}


# Parts that were changed


PARTS = """
from frenetic.testing import DummyDriver

class Mpc(DummyDriver):
    def __init__(self, comfort=2.0):
        super().__init__()
        self.comfort = comfort

def worst(road, drive):
    return -float(drive.trajectory.speed.max())
"""


@contextmanager
def with_parts(folder: Path, simulations: int, **options: object) -> Iterator[Campaign]:
    """A campaign with a driver and an objective of a file beside it, loaded anew."""
    with own_modules():
        yield Campaign(
            strategy=RandomSearch(seed=4),
            simulator=DummySimulator(drift),
            driver=load_driver(f"{folder.parent}/parts.py:Mpc", options),
            budget=Budget(simulations=simulations),
            folder=folder,
            objective=f"{folder.parent}/parts.py:worst",
        )


def test_a_campaign_goes_on_with_the_parts_that_it_was_made_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, folder = tmp_path / "parts.py", tmp_path / "c"
    file.write_text(PARTS, encoding="utf-8")
    with with_parts(folder, 5) as search:
        search.run()
    before = contents(folder)

    def refusal(**options: object) -> str:
        with pytest.raises(CampaignError) as refused, with_parts(folder, 10, **options) as edited:
            edited.resume()
        assert contents(folder) == before
        assert "\n" not in str(refused.value)
        return str(refused.value)

    message = refusal(comfort=1.0)
    assert "made with another driver: driver Mpc: comfort is 1.0, it was 2.0; restore" in message
    assert message.endswith(f"start a new campaign from this one: frenetic run --from {folder}")
    file.write_text(PARTS.replace("max()", "min()"), encoding="utf-8")
    message = refusal()
    assert "was made with another driver and version: parts.py was edited; driver Mpc: " in message
    assert "; objective: it is source " in message
    file.write_text(PARTS, encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr("frenetic.oracle.BEHAVIOUR", 99)
        assert "rules: it is version 99, it was version" in refusal()
    with with_parts(folder, 10) as search:
        assert search.resume().simulations == 10


@pytest.mark.parametrize(
    ("term", "changed"),
    [
        ("map size", {"map_size": 150.0}),
        ("margin", {"margin": 5.0}),
        ("lane width", {"lane_width": 3.5}),
        ("lookahead", {"ordered": True}),
        ("objective", {"objective": "oob-share"}),
        ("rules", {"simulator": DummySimulator(drift, rules=Rules(speed_limit=50.0))}),
    ],
)
def test_other_terms_are_refused(tmp_path: Path, term: str, changed: dict[str, Any]) -> None:
    def search(simulations: int, **options: Any) -> Campaign:
        parts: dict[str, Any] = {"simulator": DummySimulator(drift), "driver": DummyDriver()}
        return Campaign(
            strategy=Scripted([0.0] * 8),
            budget=Budget(simulations=simulations),
            folder=tmp_path,
            **(parts | options),
        )

    search(3).run()
    with pytest.raises(CampaignError, match=f"was made with another {term}: "):
        search(6, **changed).resume()
    assert search(6).resume().simulations == 6


class Watching(Frenetic):
    """Notes what it is told of drives."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.told: list[tuple[object, ...]] = []

    def tell(self, evaluation: Evaluation) -> None:
        trace = evaluation.trace
        seen = [] if trace is None else [trace.distance, trace.lateral_offset, trace.speed]
        told = (evaluation.place, evaluation.side, evaluation.duration, evaluation.severity)
        self.told.append((*told, *(column.tobytes() for column in seen)))
        super().tell(evaluation)


def test_a_resumed_strategy_is_told_of_drives_what_it_was_told(tmp_path: Path) -> None:
    def watched(simulations: int) -> tuple[Watching, Campaign]:
        strategy = Watching(seed=4)
        return strategy, Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(),
            driver=Planner(aggression=1.3),
            budget=Budget(simulations=simulations),
            folder=tmp_path,
        )

    strategy, first = watched(60)
    first.run()
    resumed, second = watched(62)
    second.resume()
    assert len(strategy.told[0]) == 7
    assert {told[1] for told in strategy.told} == {"left", "right", None}
    assert resumed.told[: len(strategy.told)] == strategy.told
    assert len(resumed.told) > len(strategy.told)
