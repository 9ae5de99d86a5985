"""Campaigns that are killed at any moment, and resumed with the same and with other parts."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import killing
import numpy as np
import pytest
from campaigns import Scripted, campaign, quick_search, refused
from contents import contents
from events import on_result
from faulty import FaultySimulator, Marks, bend
from pids import until_gone
from user_modules import own_modules

from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.campaign.check import check_campaign
from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.search import Candidate, Evaluation, Frenetic, Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec.terms import Terms
from frenetic.testing import DummySimulator

pytest_plugins = ["campaign_fixtures"]


@pytest.mark.endurance
@pytest.mark.skipif(sys.platform == "win32", reason="a process kills itself by a POSIX signal")
@pytest.mark.parametrize(
    ("workers", "max_in_flight"), [(1, 1), pytest.param(2, 16, marks=pytest.mark.heavy)]
)
def test_a_campaign_killed_at_random_moments_equals_one_run(
    tmp_path: Path, workers: int, max_in_flight: int, endurance: bool
) -> None:
    marks, folder, whole = (tmp_path / name for name in ("marks", "campaign", "whole"))
    marks.mkdir()
    simulator = FaultySimulator(marks)
    simulations = 600 if endurance else 200
    campaign(whole, simulations, simulator=simulator, max_in_flight=max_in_flight).run()

    def go_on(blow: killing.Blow | None) -> int | None:
        """Exit code of a process that runs or resumes the campaign."""
        arguments = folder, marks, simulations, workers, max_in_flight, blow
        return killing.exit_code_of(killing.go_on, *arguments)

    rng = random.Random(11 + workers)
    most_together = max_in_flight  # results in one transaction at most
    for kills in range(1, (25 if endurance else 5) + 1):
        blow = random_blow(rng, first=kills == 1)
        assert go_on(blow) == -signal.SIGKILL, f"{blow} has not come"
        report_file = marks / "reported"
        reported = report_file.stat().st_size if report_file.exists() else 0
        stored = result_count(folder)
        # Each reported result is stored, and per kill at most one transaction more.
        assert reported <= stored <= reported + kills * most_together
        if (folder / "campaign.sqlite").exists():
            assert check_campaign(folder).findings == (), blow
    assert 0 < result_count(folder) < simulations
    assert go_on(None) == 0
    assert contents(folder) == contents(whole)
    assert check_campaign(folder).findings == ()
    until_gone(set(Marks(marks).pids()) - {os.getpid()})


def random_blow(rng: random.Random, *, first: bool) -> killing.Blow:
    """A blow early, within the next few tests, or, most often, within a write."""
    kind = rng.choice(["start", "write", "write", "commit", "commit", "result"])
    if first:
        return killing.Blow("write", rng.randint(1, 200))  # when the database is made
    if kind == "start":
        return killing.Blow("start", 1, rng.uniform(0.0, 0.05))
    if kind == "write":
        return killing.Blow("write", rng.randint(1, 1000))
    return killing.Blow(kind, rng.randint(1, 7), rng.uniform(0.0, 5e-4))  # type: ignore[arg-type]


def result_count(folder: Path) -> int:
    if not (folder / "campaign.sqlite").exists():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().result_count


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished campaign, which no test changes."""
    folder = tmp_path_factory.mktemp("finished") / "c"
    campaign(folder, 20).run()
    return folder


def test_a_strategy_that_replays_differently_is_refused(tmp_path: Path, finished: Path) -> None:
    class Changed(Frenetic2021):
        def ask(self) -> Candidate:
            candidate = super().ask()
            if candidate.id == 9:
                return Candidate(9, np.zeros(20), candidate.step, candidate.origin)
            return candidate

    Changed.__module__, Changed.__qualname__ = Frenetic2021.__module__, Frenetic2021.__qualname__
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    options: dict[str, Any] = quick_search().options
    changed = Changed(**options)
    with refused("another road as candidate 9 than it did"):
        campaign(tmp_path, strategy=changed, simulations=30).resume()
    assert contents(tmp_path) == contents(finished)


def test_a_resumed_campaign_that_breaks_off_keeps_its_extended_budget(
    tmp_path: Path, finished: Path
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)

    def end(progress: Summary) -> None:
        if progress.simulations == 23:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        campaign(tmp_path, simulations=26).resume(on_event=on_result(end))
    with CampaignStore.open(tmp_path) as store:
        assert "finished_at" not in store.facts
        assert store.facts["budget"] == asdict(Budget(simulations=26))


# Changed parts


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
    """A campaign whose driver and objective are loaded anew from a file beside its folder."""
    with own_modules():
        yield campaign(
            folder,
            simulations,
            driver=load_driver(f"{folder.parent}/parts.py:Mpc", options),
            objective=f"{folder.parent}/parts.py:worst",
        )


def test_resume_refuses_changed_parts_and_accepts_the_original_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, folder = tmp_path / "parts.py", tmp_path / "c"
    file.write_text(PARTS, encoding="utf-8")
    with with_parts(folder, 5) as search:
        search.run()
    before = contents(folder)

    def refusal(**options: object) -> str:
        with refused() as caught, with_parts(folder, 10, **options) as edited:
            edited.resume()
        assert contents(folder) == before
        return str(caught.value)

    message = refusal(comfort=1.0)
    assert "made with another driver: driver Mpc: comfort is 1.0, it was 2.0; restore" in message
    assert message.endswith(f"start a new campaign from this one: frenetic run --from {folder}")
    file.write_text(PARTS.replace("max()", "min()"), encoding="utf-8")
    message = refusal()
    assert "was made with another driver and version: parts.py was edited; driver Mpc: " in message
    assert "; objective: it is source " in message
    file.write_text(PARTS, encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr("frenetic.oracle.verdict.BEHAVIOUR", 99)
        assert "rules: it is version 99, it was version" in refusal()
    with with_parts(folder, 10) as search:
        assert search.resume().simulations == 10


@pytest.mark.parametrize(
    ("term", "changed"),
    [
        ("map size", {"terms": Terms(map_size=150.0)}),
        ("map margin", {"terms": Terms(map_margin=5.0)}),
        ("lane width", {"terms": Terms(lane_width=3.5)}),
        ("conditions", {"terms": Terms(conditions={"noise": 0.1})}),
        ("max in flight", {"max_in_flight": 16}),
        ("objective", {"objective": "oob-share"}),
        ("rules", {"simulator": DummySimulator(bend, rules=Rules(speed_limit=50.0))}),
        ("strategy", {"strategy": RandomSearch(seed=4)}),
        ("strategy", {"strategy": quick_search(seed=5)}),
    ],
)
def test_resume_refuses_other_terms_and_changes_nothing(
    tmp_path: Path, finished: Path, term: str, changed: dict[str, Any]
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    usual = {"strategy": Scripted()} if term == "map size" else {}
    with refused(f"was made with another {term}: "):
        campaign(tmp_path, 30, **(usual | changed)).resume()
    assert contents(tmp_path) == contents(finished)


class Recording(Frenetic):
    """Records the evaluations that it gets."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.evaluations: list[tuple[Any, ...]] = []

    def tell(self, evaluation: Evaluation) -> None:
        trace = evaluation.trace
        traces = [] if trace is None else [trace.distance, trace.lateral_offset, trace.speed]
        values = (evaluation.finding, evaluation.worst_place, evaluation.duration)
        columns = (column.tobytes() for column in traces)
        self.evaluations.append((*values, evaluation.fitness, *columns))
        super().tell(evaluation)


def test_a_resumed_strategy_gets_the_same_evaluations(tmp_path: Path) -> None:
    strategy, resumed = Recording(seed=4), Recording(seed=4)
    parts = {"simulator": EmbeddedSimulator(), "driver": Planner(aggression=1.3)}
    campaign(tmp_path, 40, strategy=strategy, **parts).run()
    campaign(tmp_path, 42, strategy=resumed, **parts).resume()
    assert len(strategy.evaluations[0]) == 7
    sides = {None if finding is None else finding.side for finding, *_ in strategy.evaluations}
    assert sides == {"left", "right", None}
    assert resumed.evaluations[: len(strategy.evaluations)] == strategy.evaluations
    assert len(resumed.evaluations) > len(strategy.evaluations)
