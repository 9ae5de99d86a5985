"""A check finds nothing in what campaigns write, and each kind of damage, whatever it is."""

from __future__ import annotations

import json
import random
import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import campaign, refused
from checksums import execute
from contents import contents, everything
from events import on_result

from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.cli import main
from frenetic.drivers import Planner
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator, Trajectory
from frenetic.testing import DummySimulator


def make_campaign(folder: Path, simulations: int, **options: Any) -> Campaign:
    """One whose tests end in every way but ERROR."""
    usual = {
        "strategy": Frenetic2021(seed=3, max_redraws=0),
        "simulator": EmbeddedSimulator(),
        "driver": Planner(),
        "lookahead": 16,
    }
    return campaign(folder, simulations, **(usual | options))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "c"
    make_campaign(folder, 80).run()
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    """A copy of the sound campaign, to be damaged."""
    return Path(shutil.copytree(sound, tmp_path / "c"))


def value(folder: Path, select: str, *values: object) -> Any:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        (found,) = connection.execute(select, values).fetchone()
    return found


def change_config(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    config = json.loads(value(folder, "SELECT value FROM fact WHERE name = 'config'"))
    change(config)
    execute(folder, "UPDATE fact SET value = ? WHERE name = 'config'", json.dumps(config))


def expect(folder: Path, text: str, *, quick: bool = True) -> None:
    """The check has such a finding, and each is one line."""
    findings = check_campaign(folder, quick=quick).findings
    assert any(text in finding for finding in findings), findings
    assert all("\n" not in finding for finding in findings)


# Sound campaigns


def test_nothing_is_found_in_a_sound_campaign_and_nothing_changed(folder: Path) -> None:
    before, seen = (folder / DATABASE).read_bytes(), []
    report = check_campaign(folder, on_test=lambda done, all_: seen.append((done, all_)))
    assert (folder / DATABASE).read_bytes() == before
    assert report.findings == ()
    assert report.is_sound
    with CampaignStore.open(folder) as store:
        assert report.counts == store.counts()
        assert report.created_at == store.fact("created_at")
    assert seen == [(n, report.counts.told) for n in range(1, report.counts.told + 1)]
    assert report.trajectories == 80
    assert report.outstanding == report.asked - report.counts.told
    for outcome in (Outcome.PASS, Outcome.FAIL, Outcome.INVALID, Outcome.DROPPED):
        assert report.counts.by_outcome[outcome] > 2
    assert report.size == len(before)
    assert set(report.versions) >= {"python", "numpy"}


def test_a_campaign_is_sound_while_it_runs_and_when_it_was_broken_off(tmp_path: Path) -> None:
    def breaks(road: Road) -> float:
        if abs(road.curvatures).max() > 0.065:
            raise RuntimeError("out of order")
        return 0.5

    def leave_after_20(progress: Any) -> None:
        if progress.tests == 20:
            assert check_campaign(tmp_path).findings == ()
            with refused("is being written"):  # the writer has not lost its lock by the check
                CampaignStore.open(tmp_path, readonly=False)
            raise ZeroDivisionError

    parts = {"strategy": RandomSearch(seed=1), "simulator": DummySimulator(breaks)}
    with pytest.raises(ZeroDivisionError):
        campaign(tmp_path, 30, **parts).run(on_event=on_result(leave_after_20))
    report = check_campaign(tmp_path)
    assert report.findings == ()
    assert report.counts.by_outcome[Outcome.ERROR] > 2


# The file


def is_found(folder: Path) -> bool:
    """Whether a check finds damage, or refuses to begin."""
    try:
        return not check_campaign(folder, quick=True).is_sound
    except CampaignError:
        return True


def restore(folder: Path, whole: bytes) -> None:
    for leftover in ("-wal", "-shm"):
        (folder / f"{DATABASE}{leftover}").unlink(missing_ok=True)
    (folder / DATABASE).write_bytes(whole)


def damaged(data: bytes, kind: int, rng: random.Random) -> bytes:
    """A database without its end, without its header, or with one to 2000 flipped bits."""
    whole = bytearray(data)
    if kind == 0:
        del whole[rng.randrange(len(whole)) :]
    elif kind == 1:
        whole[:16] = bytes(16)
    else:
        first = rng.randrange(len(whole) - 2000)
        for _ in range(rng.choice([1, 1, 1, 30, 2000])):
            whole[rng.randrange(first, first + 2000)] ^= 1 << rng.randrange(8)
    return bytes(whole)


@pytest.mark.endurance
def test_damage_is_found_and_refused_or_changes_nothing_that_is_read(
    tmp_path: Path, endurance: bool
) -> None:
    make_campaign(tmp_path, 12).run()
    whole, before = (tmp_path / DATABASE).read_bytes(), (everything(tmp_path), contents(tmp_path))
    rng, found = random.Random(5), 0
    for number in range(300 if endurance else 60):
        kind = number % 10
        data = damaged(whole, kind, rng)
        restore(tmp_path, data)
        with refused("already holds a campaign"):
            make_campaign(tmp_path, 13).run()
        if is_found(tmp_path):
            found += 1
            with refused() if kind < 2 else suppress(CampaignError):
                everything(tmp_path)
            if kind < 2:
                with refused():
                    make_campaign(tmp_path, 13).resume()
        else:
            assert (everything(tmp_path), contents(tmp_path)) == before
        assert (tmp_path / DATABASE).read_bytes() == data
    assert found > 25


def test_results_in_a_log_that_was_not_copied_are_missed(tmp_path: Path) -> None:
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
    expect(copied, f"the last ones are lost; was {DATABASE} copied without {DATABASE}-wal?")
    (copied / "campaign.log").unlink()
    assert check_campaign(copied, quick=True).is_sound  # nothing tells of more


# Rows and facts


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("DELETE FROM test WHERE told = 30", "candidates are there, but not those from 1 to"),
        ("DELETE FROM test WHERE told = (SELECT max(told) FROM test)", "the log tells of"),
        (
            "INSERT INTO finding VALUES (9999, 1, 'lane', 1, 1, 'left', 1, 1, 1, 1)",
            "findings of test 9999, which is missing",
        ),
    ],
)
def test_missing_rows_are_found(folder: Path, change: str, text: str) -> None:
    """What readers meet, too: see test_store.py."""
    execute(folder, change, renew=False)
    if change.startswith("DELETE"):
        execute(folder, "DELETE FROM finding WHERE test NOT IN (SELECT id FROM test)", renew=False)
    expect(folder, text)


def test_damage_that_no_reader_meets(folder: Path) -> None:
    with CampaignStore.open(folder, readonly=False) as store:
        last = len(list(store.candidates())) + 1
        store.asked(replace(store.candidate(1), id=last))
    assert check_campaign(folder, quick=True).outstanding == 1
    execute(folder, "UPDATE test SET step = step + 1e-12 WHERE id = ?", last, renew=False)
    expect(folder, f"test {last} does not match its checksum")
    whole = bytearray((folder / DATABASE).read_bytes())
    whole[39] ^= 1  # number of free pages
    restore(folder, bytes(whole))
    expect(folder, "SQLite says: ")
    restore(folder, bytes(whole).replace(b"NOT NULL", b"\xffOT NULL", 1))  # SQLite quotes it
    with refused("is damaged"):
        check_campaign(folder)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda config: config.pop("map_size"), "missing required field `map_size`"),
        (lambda config: config["rules"].update(oob_tolerance=1.5), "oob_tolerance is 1.5"),
        (lambda config: config["car"].update(width="wide"), "at `$.car.width`"),
    ],
)
def test_faults_of_the_configuration(
    folder: Path, change: Callable[[dict[str, Any]], object], text: str
) -> None:
    change_config(folder, change)
    expect(folder, text)


def flipped(stored: Any) -> Any:
    """A stored value with one bit changed, of the same type."""
    match stored:
        case int():
            return stored ^ 1
        case float():
            data = bytearray(struct.pack("<d", stored))
            data[0] ^= 1
            return struct.unpack("<d", data)[0]
        case bytes():
            return stored[:-1] + bytes([stored[-1] ^ 1])
    return stored[:-1] + chr(ord(stored[-1]) ^ 1)


def test_one_changed_bit_is_found_in_each_stored_value(tmp_path: Path) -> None:
    make_campaign(tmp_path, 12, objective="oob-share").run()
    whole = (tmp_path / DATABASE).read_bytes()
    failure = f"= (SELECT min(id) FROM test WHERE outcome = '{Outcome.FAIL}')"
    unnoticed, cases = [], 0
    for table, where in (
        ("fact", "name = 'config'"),
        ("fact", "name = 'seconds'"),
        ("test", f"id {failure}"),
        ("finding", f"test {failure}"),
    ):
        names = value(tmp_path, "SELECT group_concat(name) FROM pragma_table_info(?)", table)
        for column in names.split(","):
            stored = value(tmp_path, f'SELECT "{column}" FROM {table} WHERE {where}')
            if stored is None:
                continue
            change = f'UPDATE {table} SET "{column}" = ? WHERE {where}'
            try:
                execute(tmp_path, change, flipped(stored), renew=False)
            except sqlite3.IntegrityError:  # an id that another row has
                continue
            cases += 1
            if not is_found(tmp_path):
                unnoticed.append((table, column))
            restore(tmp_path, whole)
    assert unnoticed == []
    assert cases > 40
    assert not is_found(tmp_path)


# Verdicts


def change_trajectory(folder: Path, number: int, change: Callable[[Any], Any]) -> None:
    data = value(folder, "SELECT trajectory FROM test WHERE id = ?", number)
    changed = encode(Trajectory.from_rows(change(decode(data).to_rows())))
    execute(folder, "UPDATE test SET trajectory = ? WHERE id = ?", changed, number)


def floats(*numbers: float) -> str:
    return f"x'{np.array(numbers, '<f8').tobytes().hex()}'"


VERDICTS = [
    ("FAIL", "moobd = moobd - 0.0002", "moobd is stored as"),
    ("FAIL", "moobd = moobd - 0.00005", ""),
    ("FAIL", "moobd = NULL", "moobd is stored as nothing"),
    ("FAIL", "max_oob_share = max_oob_share - 0.001", "max_oob_share is stored as"),
    ("FAIL", "duration = duration + 0.05", "duration is stored as"),
    ("FAIL", "finding.distance = distance + 0.01", "departure distance is stored as"),
    ("FAIL", "finding.side = iif(side = 'left', 'right', 'left')", "it broke lane "),
    ("FAIL", "finding.criterion = 'speed'", "departure distance is stored as nothing"),
    ("FAIL", "outcome = 'PASS'", "it is stored as PASS, judged again it is FAIL"),
    ("PASS", "outcome = 'FAIL'", "it is stored as FAIL, judged again it is PASS"),
    ("FAIL", "x = x + 3.0", "judged again"),
    ("FAIL", f"curvatures = {floats(*20 * [0.0])}", "judged again"),
    ("FAIL", "curvatures = x''", "it was driven, but its road is none"),
    ("INVALID", f"curvatures = {floats(*12 * [0.0])}", "but its road is valid"),
    ("INVALID", f"points = {floats(20, 20, 60, 20, 100, 20, 140, 20)}", "its road is valid"),
    ("INVALID", f"points = {floats(2, 2, 42, 2, 82, 2, 122, 2)}", ""),
]
"""An outcome, a change to a test with it, and what is found; nothing where it is rounding."""


@pytest.mark.parametrize("part", range(3))
def test_what_is_judged_otherwise_is_found_beyond_rounding(folder: Path, part: int) -> None:
    """Each change is of a test of its own."""
    with CampaignStore.open(folder) as store:
        ids = {one: [test.id for test in store.tests(one)] for one in Outcome}
    expected: dict[int, str] = {}
    for outcome, change, text in VERDICTS[part::3]:
        expected[number := ids[Outcome(outcome)].pop()] = text
        table, key = ("finding", "test") if "finding." in change else ("test", "id")
        statement = f"UPDATE {table} SET {change.removeprefix('finding.')} WHERE {key} = ?"
        assert execute(folder, statement, number) == 1
    half, backwards = ids[Outcome.PASS].pop(), ids[Outcome.PASS].pop()
    change_trajectory(folder, half, lambda rows: rows[: len(rows) // 2])
    expected[half] = "it is stored as PASS, judged again it is ERROR"
    change_config(folder, lambda config: config["versions"].update(numpy="1.0"))
    assert check_campaign(folder, quick=True).is_sound
    change_trajectory(folder, backwards, lambda rows: rows[::-1])
    findings = {finding.split(": ")[0]: finding for finding in check_campaign(folder).findings}
    assert findings.pop(f"the trajectory of test {backwards} goes back in time")
    assert findings.keys() == {f"test {number}" for number, text in expected.items() if text}
    for number, text in expected.items():
        if text:
            assert text in findings[f"test {number}"]
            assert "versions differ: numpy 1.0, now" in findings[f"test {number}"]


@pytest.mark.parametrize(("short_of", "is_sound"), [(2e-5, True), (0.01, False)])
def test_rounding_may_end_a_drive_elsewhere(
    tmp_path: Path, short_of: float, is_sound: bool
) -> None:
    """The goal is drawn so near that the stored last record lies just outside."""
    careful = Planner(aggression=0.3)
    make_campaign(tmp_path, 1, strategy=RandomSearch(seed=1), driver=careful).run()
    with CampaignStore.open(tmp_path) as store:
        test = store.test(1)
    assert test.outcome is Outcome.PASS
    assert test.trajectory is not None
    last = test.trajectory.to_rows()[-1, 1:3]
    goal = float(np.hypot(*(last - test.road.points[-1]))) - short_of
    change_config(tmp_path, lambda config: config["rules"].update(goal_distance=goal))
    assert check_campaign(tmp_path).is_sound == is_sound


# On the command line


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["check", *arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(folder)) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    execute(folder, "UPDATE test SET seconds = -1.0 WHERE told <= 23")
    assert run(str(folder)) == 1
    out = capsys.readouterr().out
    assert sum("test " in line and "seconds" in line for line in out.splitlines()) == 20
    assert "3 more" in out
    assert run(str(folder), "--json") == 1
    assert len(json.loads(capsys.readouterr().out)["findings"]) == 23
