"""The tables of what was driven again: old campaigns, kills, and several at once."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from checksums import forget_checksums
from redrives import redriven

from frenetic.campaign import Budget, Campaign, CampaignStore, RoadTester, Test
from frenetic.campaign.check import check_campaign
from frenetic.campaign.store import DATABASE, MIGRATIONS
from frenetic.drivers import Planner
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.minimise import Minimised, MinimiseProgress, minimise_test
from frenetic.redrive.record import Match, Purpose, Run
from frenetic.redrive.robustness import read_reruns, rerun
from frenetic.redrive.table import RunWriter, read_runs
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.worlds import USUAL


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with some failures."""
    folder = tmp_path_factory.mktemp("made") / "c"
    Campaign(
        strategy=Frenetic2021(seed=3, max_redraws=10),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(failures=4),
        folder=folder,
    ).run()
    return folder


@pytest.fixture
def campaign(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "c"))


def failures(folder: Path) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [record.id for record in store.tests(Outcome.FAIL)]


SINCE = ("earlier", "objective", "screening")
"""Tables that came later still."""


def make_old(folder: Path) -> None:
    """Makes a database of the version before these tables."""
    with closing(sqlite3.connect(folder / DATABASE)) as connection, connection:
        for table in ("redrive", "redrive_run", *SINCE):
            connection.execute(f"DROP TABLE {table}")
        for table in ("campaign", "candidate", "test", "trajectory"):
            connection.execute(f"ALTER TABLE {table} DROP COLUMN checksum")
        connection.execute("PRAGMA user_version = 3")


def version_of(folder: Path) -> int:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


# Campaigns of older versions


def test_an_old_campaign_is_read_as_it_is_and_gets_the_tables_when_it_is_driven_again(
    campaign: Path,
) -> None:
    make_old(campaign)
    assert read_reruns(campaign) == ()
    assert check_campaign(campaign).is_sound
    assert version_of(campaign) == 3
    reruns = rerun(campaign, EmbeddedSimulator(), Planner(), times=2)
    assert len(read_reruns(campaign)) == len(reruns) == len(failures(campaign))
    assert version_of(campaign) == len(MIGRATIONS)
    assert check_campaign(campaign).is_sound


def test_drives_of_a_table_without_differences_are_read(campaign: Path) -> None:
    found = rerun(campaign, EmbeddedSimulator(), Planner(), times=2)
    assert {drive.match for one in found for drive in one.drives} == {Match.SAME}
    with closing(sqlite3.connect(campaign / DATABASE)) as connection, connection:
        for table in SINCE:
            connection.execute(f"DROP TABLE {table}")
        connection.execute("ALTER TABLE redrive DROP COLUMN difference")
        for table in ("campaign", "candidate", "test", "trajectory", "redrive_run", "redrive"):
            connection.execute(f"ALTER TABLE {table} DROP COLUMN checksum")
        connection.execute("PRAGMA user_version = 4")
    older = read_reruns(campaign)
    assert version_of(campaign) == 4
    assert {drive.match for one in older for drive in one.drives} == {Match.SAME_PLACE}
    rerun(campaign, EmbeddedSimulator(), Planner(), times=2)
    newer = read_reruns(campaign)
    assert {drive.match for one in newer for drive in one.drives} == {Match.SAME}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("redrive SET outcome = 'MAYBE'", "outcome"),
        ("redrive SET conditions = '['", "drive 1 of run 1"),
        ("""redrive SET conditions = '{"weather": 1}'""", "weather"),
        ("redrive SET test = 100000", "no test of candidate 100000"),
        ("redrive_run SET driver = '3'", "run 1"),
        ("""redrive_run SET variations = '[{"quantity": "mass"}]'""", "run 1"),
    ],
)
def test_a_damaged_row_is_one_line(campaign: Path, change: str, text: str) -> None:
    rerun(campaign, EmbeddedSimulator(), Planner(), times=1)
    with closing(sqlite3.connect(campaign / DATABASE)) as connection, connection:
        connection.execute(f"UPDATE {change}")
        forget_checksums(connection)
    with pytest.raises(CampaignError, match=text) as caught:
        read_reruns(campaign)
    assert "\n" not in str(caught.value)


# Several at once, and ends of all kinds


def test_two_at_once_lose_nothing_of_each_other(campaign: Path) -> None:
    record = CampaignStore.open(campaign).test(failures(campaign)[0])
    drive = redriven(USUAL, Outcome.FAIL, -1.0, test=record)

    def write(number: int) -> None:
        run = Run(Purpose.ROBUSTNESS, {"class": f"driver {number}"}, {"class": "s"}, seed=0)
        with RunWriter(campaign, lambda: run) as writer:
            for i in range(1, 31):
                writer.add(i, drive)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    reruns = read_reruns(campaign)
    assert {str(one.driver["class"]) for one in reruns} == {f"driver {n}" for n in range(4)}
    assert [len(one.drives) for one in reruns] == [30] * 4


def test_a_campaign_that_is_running_can_be_driven_again(tmp_path: Path) -> None:
    done: list[int] = []

    def now_and_then(progress: Any) -> None:
        if progress.failed and progress.tests % 10 == 0 and len(done) < 3:
            found = rerun(tmp_path / "c", EmbeddedSimulator(), Planner(), times=1)
            done.append(len(found))

    summary = Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=80),
        folder=tmp_path / "c",
    ).run(now_and_then)
    assert summary.simulations == 80
    assert len(done) == 3
    assert len(read_reruns(tmp_path / "c")) == done[-1] > 0
    assert check_campaign(tmp_path / "c").is_sound


KILLED = """
import os, signal, sys
from frenetic import EmbeddedSimulator, Planner
from frenetic.redrive.robustness import rerun

def told(progress):
    print(progress.drives, flush=True)
    if progress.drives == 7:
        os.kill(os.getpid(), signal.SIGKILL)

rerun(sys.argv[1], EmbeddedSimulator(), Planner(), times=3, on_progress=told)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL there")
def test_a_kill_loses_nothing_that_was_told(campaign: Path) -> None:
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(campaign)], capture_output=True, check=False
    )
    assert killed.returncode == -signal.SIGKILL
    told = killed.stdout.decode().split()
    assert told == [str(number) for number in range(1, 8)]
    assert sorted(len(one.drives) for one in read_reruns(campaign)) == [1, 3, 3]
    assert check_campaign(campaign).is_sound
    rerun(campaign, EmbeddedSimulator(), Planner(), times=3)
    assert {len(one.drives) for one in read_reruns(campaign)} == {3}


# Minimising


def test_each_smaller_road_is_stored_as_it_is_found(campaign: Path) -> None:
    told: list[float] = []
    with CampaignStore.open(campaign) as store:
        first, second = (store.test(number) for number in failures(campaign)[:2])

    def minimised(record: Test, progress: Any = None) -> Minimised:
        simulator = EmbeddedSimulator()
        with simulator:
            return minimise_test(
                campaign,
                record,
                RoadTester(simulator, Planner()),
                max_drives=60,
                on_progress=progress,
            )

    def look(progress: MinimiseProgress) -> None:
        (run,) = read_runs(campaign, Purpose.MINIMISING)
        told.append(progress.length)
        assert run.drives[-1].length == progress.length

    found = minimised(first, look)
    (run,) = read_runs(campaign, Purpose.MINIMISING)
    original, smallest = run.drives[0], run.drives[-1]
    assert len(run.drives) == 1 + len(found.improvements)
    assert original.test_id == smallest.test_id == first.id
    assert original.is_same
    assert smallest.curvatures is not None
    assert smallest.curvatures.tolist() == found.road.curvatures.tolist()
    assert (smallest.step, smallest.moobd) == (found.road.step, found.result.moobd)
    assert smallest.length == found.road.length == told[-1] < original.length
    minimised(second)
    minimised(first)
    ids = [[drive.test_id for drive in run.drives] for run in read_runs(campaign, run.purpose)]
    assert [set(one) for one in ids if one] == [{second.id}, {first.id}]
    assert check_campaign(campaign).is_sound
