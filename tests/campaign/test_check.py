"""The check reports nothing for a sound campaign, and a finding for each kind of damage."""

from __future__ import annotations

import json
import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from campaigns import campaign, refused
from contents import contents, execute, stored_values
from events import on_result

from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.cli import main
from frenetic.drivers import Planner
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.search import Frenetic2021
from frenetic.simulators import EmbeddedSimulator


def make_campaign(folder: Path, simulations: int, **options: Any) -> Campaign:
    """A campaign with every outcome but ERROR."""
    usual = {
        "strategy": Frenetic2021(seed=3, max_redraws=0),
        "simulator": EmbeddedSimulator(),
        "driver": Planner(),
        "max_in_flight": 16,
    }
    return campaign(folder, simulations, **(usual | options))


@pytest.fixture(scope="module")
def sound_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "c"
    make_campaign(folder, 80).run()
    return folder


@pytest.fixture
def folder(sound_campaign: Path, tmp_path: Path) -> Path:
    """A copy of the sound campaign, to be damaged."""
    return Path(shutil.copytree(sound_campaign, tmp_path / "c"))


def require_finding(folder: Path, text: str) -> None:
    """Require that a finding of the check holds the text, and that each finding is one line."""
    findings = check_campaign(folder).findings
    assert any(text in finding for finding in findings), findings
    assert all("\n" not in finding for finding in findings)


def restore(folder: Path, whole: bytes) -> None:
    for leftover in ("-wal", "-shm"):
        (folder / f"{DATABASE}{leftover}").unlink(missing_ok=True)
    (folder / DATABASE).write_bytes(whole)


def test_the_check_of_a_sound_campaign_reports_and_changes_nothing(folder: Path) -> None:
    before = (folder / DATABASE).read_bytes()
    report = check_campaign(folder)
    assert (folder / DATABASE).read_bytes() == before
    assert report.findings == ()
    with CampaignStore.open(folder) as store:
        assert report.counts == store.counts()
        assert report.asked == len(list(store.candidates()))
    assert report.trajectories == 80
    for outcome in (Outcome.PASS, Outcome.FAIL, Outcome.INVALID, Outcome.DROPPED):
        assert report.counts.by_outcome[outcome] > 2
    assert report.size == len(before)


def test_a_campaign_is_sound_while_it_runs(tmp_path: Path) -> None:
    def look(progress: Any) -> None:
        if progress.tests == 5:
            assert check_campaign(tmp_path).findings == ()
            with refused("is being written"):  # the check left the writer its lock
                CampaignStore.open(tmp_path, readonly=False)

    campaign(tmp_path, 10).run(on_event=on_result(look))


def with_damage(data: bytes, kind: int, rng: random.Random) -> bytes:
    """A database without its end (kind 0), without its header (1), or with flipped bits."""
    whole = bytearray(data)
    if kind == 0:
        del whole[rng.randrange(len(whole)) :]
    elif kind == 1:
        whole[:16] = bytes(16)
    else:
        first = rng.randrange(len(whole) - 2000)
        for _ in range(2000):
            whole[rng.randrange(first, first + 2000)] ^= 1 << rng.randrange(8)
    return bytes(whole)


@pytest.mark.endurance
def test_a_damaged_database_is_refused_in_one_line_and_not_written(
    tmp_path: Path, endurance: bool
) -> None:
    make_campaign(tmp_path, 12).run()
    whole = (tmp_path / DATABASE).read_bytes()
    before = stored_values(tmp_path), contents(tmp_path)
    rng, damaged_files = random.Random(5), 0
    for number in range(300 if endurance else 30):
        kind = number % 10
        data = with_damage(whole, kind, rng)
        restore(tmp_path, data)
        with refused("already holds a campaign"):
            make_campaign(tmp_path, 13).run()
        try:
            is_damaged = bool(check_campaign(tmp_path).findings)
        except CampaignError:
            is_damaged = True
        damaged_files += is_damaged
        if is_damaged and kind < 2:
            with refused():
                make_campaign(tmp_path, 13).resume()
        elif not is_damaged:
            assert (stored_values(tmp_path), contents(tmp_path)) == before
        assert (tmp_path / DATABASE).read_bytes() == data
    assert damaged_files > 10


def test_results_in_a_write_ahead_log_that_was_not_copied_are_missed(tmp_path: Path) -> None:
    folder, copied = tmp_path / "c", tmp_path / "copy"
    copied.mkdir()
    readers: list[CampaignStore] = []

    def read_on(progress: Any) -> None:
        if progress.tests == 5:  # a reader keeps SQLite from clearing its log away
            readers.append(CampaignStore.open(folder))

    make_campaign(folder, 12).run(on_event=on_result(read_on))
    assert (folder / f"{DATABASE}-wal").stat().st_size > 0
    for name in (DATABASE, "campaign.log"):
        shutil.copy(folder / name, copied)
    readers[0].close()
    require_finding(
        copied, f"the last ones are lost; was {DATABASE} copied without {DATABASE}-wal?"
    )
    (copied / "campaign.log").unlink()
    assert not check_campaign(copied).findings  # no other file counts the results


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("DELETE FROM test WHERE result_number = 30", "but not as numbers 1 to"),
        (
            "DELETE FROM test WHERE result_number = 30",
            "candidates are there, but not those from 1 to",
        ),
        (
            "DELETE FROM test WHERE result_number = (SELECT max(result_number) FROM test)",
            "the log tells of",
        ),
        (
            "INSERT INTO finding VALUES (9999, 1, 'lane', 1, 1, 'left', 1, 1, 1, 1)",
            "findings of test 9999, which is missing",
        ),
    ],
)
def test_missing_rows_are_findings(folder: Path, change: str, text: str) -> None:
    execute(folder, change)
    require_finding(folder, text)
    if "30" in change:
        with refused("is damaged: it holds"):
            make_campaign(folder, 100).resume()


def test_damage_that_readers_never_read_is_a_finding(folder: Path) -> None:
    with CampaignStore.open(folder, readonly=False) as store:
        last = len(list(store.candidates())) + 1
        store.add_candidate(replace(store.candidate(1), id=last))
    assert not check_campaign(folder).findings
    execute(folder, "UPDATE test SET parents = '[1.5]' WHERE id = ?", last)
    require_finding(folder, f"candidate {last}: ")
    whole = bytearray((folder / DATABASE).read_bytes())
    whole[39] ^= 1  # number of free pages
    restore(folder, bytes(whole))
    require_finding(folder, "SQLite says: ")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda config: config.pop("map_size"), "missing required field `map_size`"),
        (lambda config: config["rules"].update(oob_tolerance=1.5), "oob_tolerance is 1.5"),
        (lambda config: config["car"].update(width="wide"), "at `$.car.width`"),
    ],
)
def test_a_wrong_configuration_is_a_finding(
    folder: Path, change: Callable[[dict[str, Any]], object], text: str
) -> None:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        select = "SELECT value FROM fact WHERE name = 'config'"
        config = json.loads(connection.execute(select).fetchone()[0])
    change(config)
    execute(folder, "UPDATE fact SET value = ? WHERE name = 'config'", json.dumps(config))
    require_finding(folder, text)


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["check", *arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_the_command_prints_20_findings_and_exits_1(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(folder)) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    execute(folder, "UPDATE test SET seconds = -1.0 WHERE result_number <= 23")
    assert run(str(folder)) == 1
    out = capsys.readouterr().out
    assert sum("test " in line and "seconds" in line for line in out.splitlines()) == 20
    assert "3 more" in out
    assert run(str(folder), "--json") == 1
    assert len(json.loads(capsys.readouterr().out)["findings"]) == 23
