"""Campaigns that are ended at any moment and go on as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import killing
import numpy as np
import pytest
from checksums import forget_checksums
from contents import contents
from faulty import Marks
from pids import until_gone

from frenetic.campaign import Budget, Campaign, CampaignStore, Progress
from frenetic.campaign.campaign import LOOKAHEAD
from frenetic.campaign.check import check_campaign
from frenetic.campaign.store import DATABASE
from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.errors import CampaignError
from frenetic.registry import USER_MODULE
from frenetic.search import Candidate, Evaluation, Frenetic, Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator
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


def test_a_campaign_of_a_version_with_fewer_options_goes_on(tmp_path: Path) -> None:
    campaign(tmp_path, simulator=Stopping(20)).run()
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        forget = "UPDATE campaign SET value = json_remove(value, ?) WHERE key = 'config'"
        connection.execute(forget, ("$.strategy.options.skip_repeats",))
        forget_checksums(connection)
        connection.commit()
    summary = campaign(tmp_path, simulator=Stopping(999)).resume()
    assert not summary.interrupted


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

    def end(progress: Progress) -> None:
        if progress.simulations == 60:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        campaign(tmp_path, simulations=70).resume(end)
    with CampaignStore.open(tmp_path) as store:
        assert "finished_at" not in store.facts
        assert store.facts["budget"] == {"simulations": 70, "time": None, "failures": None}


# Parts that were changed


DRIVER = """
from frenetic.testing import DummyDriver

class Mpc(DummyDriver):
    def __init__(self, comfort=2.0):
        super().__init__()
        self.comfort = comfort
"""


@pytest.fixture
def driver_file(tmp_path: Path) -> Iterator[Path]:
    """A user's driver, loaded anew by `with_driver`."""
    path = tmp_path / "mpc.py"
    path.write_text(DRIVER, encoding="utf-8")
    search_path = list(sys.path)
    yield path
    forget_user_files()
    sys.path[:] = search_path


def forget_user_files() -> None:
    for name in [name for name in sys.modules if name.startswith(USER_MODULE)]:
        del sys.modules[name]


def with_driver(folder: Path, file: Path, simulations: int, **options: object) -> Campaign:
    forget_user_files()
    return Campaign(
        strategy=Frenetic2021(seed=4, cross_freq=10, cross_num=6, max_redraws=10),
        simulator=DummySimulator(drift),
        driver=load_driver(f"{file}:Mpc", options),
        budget=Budget(simulations=simulations),
        folder=folder,
    )


def test_a_changed_driver_is_refused_unless_it_is_accepted_and_then_marked(
    tmp_path: Path, driver_file: Path
) -> None:
    folder = tmp_path / "c"
    with_driver(folder, driver_file, 20).run()
    before = contents(folder)
    driver_file.write_text(DRIVER + "\n", encoding="utf-8")
    with pytest.raises(CampaignError, match=r"another driver: driver Mpc: mpc\.py was changed;"):
        with_driver(folder, driver_file, 40).resume()
    with pytest.raises(CampaignError, match=r"driver Mpc: comfort is 1\.0, it was 2\.0"):
        with_driver(folder, driver_file, 40, comfort=1.0).resume()
    assert contents(folder) == before
    with CampaignStore.open(folder) as store:
        told, first = store.counts().told, store.parts["driver"]
        assert store.changes == ()
    changed = with_driver(folder, driver_file, 40)
    assert changed.resume(accept_changed=True).simulations == 40
    assert changed.notes == (f"changed from result {told + 1} on: driver Mpc: mpc.py was changed",)
    with CampaignStore.open(folder) as store:
        (mark,) = store.changes
        assert (mark.first, mark.what) == (told + 1, ("driver Mpc: mpc.py was changed",))
        assert store.config["driver"] == first != store.parts["driver"]
    # It is the campaign's driver now, and the first one is another.
    unchanged = with_driver(folder, driver_file, 50)
    unchanged.resume()
    assert unchanged.notes == ()
    driver_file.write_text(DRIVER, encoding="utf-8")
    with pytest.raises(CampaignError, match="another driver"):
        with_driver(folder, driver_file, 60).resume()
    with_driver(folder, driver_file, 60).resume(accept_changed=True)
    with CampaignStore.open(folder) as store:
        assert [change.parts["driver"] == first for change in store.changes] == [False, True]


def test_a_change_without_a_result_since_is_replaced(tmp_path: Path, driver_file: Path) -> None:
    folder = tmp_path / "c"
    stopped = with_driver(folder, driver_file, 40)
    stopped.tester = replace(stopped.tester, simulator=Stopping(20))
    stopped.run()
    for more, marks in (("\n# one", 1), ("\n# two", 1), ("", 0)):
        driver_file.write_text(DRIVER + more, encoding="utf-8")
        interrupted = with_driver(folder, driver_file, 40)
        interrupted.tester = replace(interrupted.tester, simulator=Stopping(0))
        interrupted.resume(accept_changed=True)
        with CampaignStore.open(folder) as store:
            assert len(store.changes) == marks


def test_built_in_rules_that_changed_are_refused_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign(tmp_path, simulations=20).run()
    monkeypatch.setattr("frenetic.oracle.BEHAVIOUR", 2)
    with pytest.raises(CampaignError, match="rules: it is version 2, it was version 1"):
        campaign(tmp_path, simulations=30).resume()
    campaign(tmp_path, simulations=30).resume(accept_changed=True)


def test_a_campaign_without_fingerprints_is_resumed_with_a_note_and_has_them_then(
    tmp_path: Path, driver_file: Path
) -> None:
    folder = tmp_path / "c"
    with_driver(folder, driver_file, 20).run()
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        for path in (
            "strategy.fingerprint",
            "simulator.fingerprint",
            "driver.fingerprint",
            "driver.options",
            "fingerprints",
        ):
            forget = "UPDATE campaign SET value = json_remove(value, ?) WHERE key = 'config'"
            connection.execute(forget, (f"$.{path}",))
        forget_checksums(connection)
        connection.commit()
    driver_file.write_text(DRIVER + "\n", encoding="utf-8")
    old = with_driver(folder, driver_file, 30)
    old.resume()
    (note,) = old.notes
    assert note.startswith(
        "whether these are as before is unknown: strategy Frenetic2021: the campaign"
    )
    again = with_driver(folder, driver_file, 40)
    again.resume()
    assert again.notes == ()
    driver_file.write_text(DRIVER, encoding="utf-8")
    with pytest.raises(CampaignError, match=r"mpc\.py was changed"):
        with_driver(folder, driver_file, 50).resume()
    with CampaignStore.open(folder) as store:
        (mark,) = store.changes
        assert mark.what == ()
    assert check_campaign(folder).is_sound


@pytest.mark.parametrize("damage", ["7", '[{"first": 0}]', "[7]", '"text"'])
def test_a_damaged_mark_is_one_line(tmp_path: Path, damage: str) -> None:
    campaign(tmp_path, simulations=20).run()
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        connection.execute("INSERT INTO campaign (key, value) VALUES ('changes', ?)", (damage,))
        connection.commit()
    with pytest.raises(CampaignError, match="is damaged: the fact changes: a list of changes"):
        campaign(tmp_path, simulations=30).resume()
    (finding,) = check_campaign(tmp_path).findings
    assert "the fact changes is" in finding.message


class _Watching(Frenetic):
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
    def watched(simulations: int) -> tuple[_Watching, Campaign]:
        strategy = _Watching(seed=4)
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


def test_a_changed_objective_of_ones_own_is_refused(tmp_path: Path, driver_file: Path) -> None:
    def searching(simulations: int) -> Campaign:
        forget_user_files()
        return Campaign(
            strategy=RandomSearch(seed=4),
            simulator=DummySimulator(drift),
            driver=DummyDriver(),
            budget=Budget(simulations=simulations),
            folder=tmp_path / "c",
            objective=f"{file}:worst",
        )

    file = driver_file.with_name("objective.py")
    source = "def worst(road, drive):\n    return -float(drive.trajectory.speed.max())\n"
    file.write_text(source, encoding="utf-8")
    searching(5).run()
    file.write_text(source.replace("max", "min"), encoding="utf-8")
    with pytest.raises(CampaignError, match=r"objective: objective\.py was changed"):
        searching(10).resume()
    assert searching(10).resume(accept_changed=True).simulations == 10


def test_a_search_goes_on_from_what_another_version_of_it_began(tmp_path: Path) -> None:
    def searching(name: str, simulations: int, seed: int) -> Campaign:
        search = Frenetic(seed=seed, random_roads=5, random_budget=1.0)
        return campaign(tmp_path / name, search, simulations=simulations)

    for name in ("in steps", "at once"):
        searching(name, 20, seed=1).run()
    with pytest.raises(CampaignError, match="made with another strategy"):
        searching("in steps", 30, seed=2).resume()
    for simulations in (30, 40):
        searching("in steps", simulations, seed=2).resume(accept_changed=True)
    searching("at once", 40, seed=2).resume(accept_changed=True)
    found = []
    for name in ("in steps", "at once"):
        with CampaignStore.open(tmp_path / name) as store:
            found.append([record.candidate.curvatures.tobytes() for record in store.tests()])
    assert len(set(found[0])) == 40
    assert found[0] == found[1]
