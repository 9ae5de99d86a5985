"""A check finds nothing in what campaigns write, and each kind of damage, whatever it is."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checksums import forget_checksums

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.check import CheckReport, Severity, State, Subject, check_campaign
from frenetic.campaign.check.report import SHOWN
from frenetic.campaign.lock import lock_file
from frenetic.campaign.store import APPLICATION_ID, DATABASE, LOCK, MIGRATIONS
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.cli import main
from frenetic.drivers import Planner
from frenetic.errors import CampaignError
from frenetic.export import export_campaign
from frenetic.outcome import Outcome
from frenetic.redrive.confirm import confirm
from frenetic.road import Road
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.simulators import EmbeddedSimulator, Trajectory
from frenetic.spec import CONFIGURATION, command_entries, decode_config
from frenetic.testing import DummyDriver, DummySimulator

COMMAND = [name for name, entry in command_entries().items() if entry.is_needed]

COMMAND_LINE: dict[str, Any] = {
    "strategy": "frenetic",
    "strategy_options": {"max_redraws": 0},
    "driver": "planner",
    "driver_options": {},
    "noise": None,
    "delay": None,
    "view": None,
    "simulator": "embedded",
    "simulator_options": {},
    "speed_limit": 70.0,
    "oob_tolerance": 0.95,
    "wall_limit": 60.0,
}


def make_campaign(folder: Path, budget: Budget, **options: Any) -> Campaign:
    """One whose tests end in every way but ERROR."""
    return Campaign(
        strategy=Frenetic2021(seed=3, max_redraws=0),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=budget,
        folder=folder,
        **{"ordered": True, "description": {"command": COMMAND_LINE}, **options},
    )


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "c"
    make_campaign(folder, Budget(simulations=80)).run()
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    """A copy of the sound campaign, to be damaged."""
    return Path(shutil.copytree(sound, tmp_path / "c"))


def execute(folder: Path, statement: str, *values: object, keep_checksums: bool = False) -> int:
    """Changes the database behind everybody's back; returns how many rows.

    Its rows lose their checksums, as an older version has them, which would find each change.
    """
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        changed = connection.execute(statement, values).rowcount
        if not keep_checksums:
            forget_checksums(connection)
        connection.commit()
    return changed


def value(folder: Path, select: str, *values: object) -> Any:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        (found,) = connection.execute(select, values).fetchone()
    return found


def test_of(folder: Path, outcome: Outcome) -> int:
    """Id of a test with this outcome, somewhere in the middle."""
    ids = "SELECT candidate_id FROM test WHERE outcome = ? ORDER BY told LIMIT 1 OFFSET 2"
    found: int = value(folder, ids, str(outcome))
    return found


test_of.__test__ = False  # type: ignore[attr-defined]


def change_config(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    config = json.loads(value(folder, "SELECT value FROM campaign WHERE key = 'config'"))
    change(config)
    execute(folder, "UPDATE campaign SET value = ? WHERE key = 'config'", json.dumps(config))


def expect(
    report: CheckReport, subject: Subject, text: str, severity: Severity = Severity.ERROR
) -> None:
    """The report has such a finding, and every finding is one line."""
    assert all("\n" not in finding.message for finding in report.findings)
    found = [f.message for f in report.findings if (f.subject, f.severity) == (subject, severity)]
    assert any(text in message for message in found), report.findings


# Sound campaigns


def test_nothing_is_found_in_a_sound_campaign(sound: Path) -> None:
    report = check_campaign(sound)
    assert report.findings == ()
    assert report.is_sound
    holds = report.holdings
    with CampaignStore.open(sound) as store:
        assert holds.counts == store.counts()
    assert holds.state is State.FINISHED
    assert holds.writer is None
    assert holds.schema == len(MIGRATIONS)
    assert holds.trajectories == 80
    assert holds.outstanding == holds.counts.asked - holds.counts.told
    for outcome in (Outcome.PASS, Outcome.FAIL, Outcome.INVALID, Outcome.DROPPED):
        assert holds.counts.by_outcome[outcome] > 2
    assert holds.size >= (sound / DATABASE).stat().st_size
    assert holds.bytes_per_test == holds.size / holds.counts.told
    assert set(holds.versions) >= {"python", "numpy"}


def test_the_database_stays_as_it_is(folder: Path) -> None:
    before = hashlib.sha256((folder / DATABASE).read_bytes()).digest()
    check_campaign(folder)
    assert hashlib.sha256((folder / DATABASE).read_bytes()).digest() == before


def test_broken_drives_are_sound(tmp_path: Path) -> None:
    def breaks(road: Road) -> float:
        if abs(road.curvatures).max() > 0.065:
            raise RuntimeError("out of order")
        return 0.5

    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=DummySimulator(breaks),
        driver=DummyDriver(),
        budget=Budget(simulations=40),
        folder=tmp_path,
    ).run()
    report = check_campaign(tmp_path)
    assert report.is_sound
    assert report.holdings.counts.by_outcome[Outcome.ERROR] > 2


@pytest.mark.parametrize(
    "budget", [Budget(simulations=60), Budget(failures=12), Budget(time=3600.0, simulations=60)]
)
def test_a_campaign_that_was_interrupted_and_extended_is_sound(
    tmp_path: Path, budget: Budget
) -> None:
    class Enough(Exception):  # noqa: N818
        """Stands for whatever ends a process."""

    def stop_after_20(progress: Any) -> None:
        if progress.tests == 20:
            raise Enough

    campaign = make_campaign(tmp_path, budget, ordered=False)
    with pytest.raises(Enough):
        campaign.run(stop_after_20)
    report = check_campaign(tmp_path)
    assert report.is_sound
    assert report.holdings.state is State.UNFINISHED
    for more in (1, 2, 3):
        extended = replace(
            budget,
            simulations=budget.simulations and budget.simulations * more,
            failures=budget.failures and budget.failures * more,
        )
        make_campaign(tmp_path, extended, ordered=False).resume()
        report = check_campaign(tmp_path)
        assert report.findings == ()
        assert report.holdings.state is State.FINISHED


def test_a_campaign_that_went_on_after_its_end_and_was_killed_is_unfinished(folder: Path) -> None:
    execute(folder, "UPDATE campaign SET value = '0.001' WHERE key = 'seconds'")
    assert check_campaign(folder, quick=True).holdings.state is State.UNFINISHED


def test_an_interrupted_campaign_says_so(folder: Path) -> None:
    execute(folder, "UPDATE campaign SET value = 'true' WHERE key = 'interrupted'")
    assert check_campaign(folder, quick=True).holdings.state is State.INTERRUPTED


def test_a_running_campaign_can_be_checked(folder: Path) -> None:
    with CampaignStore.open(folder, readonly=False):
        report = check_campaign(folder)
        with pytest.raises(CampaignError):  # the writer has not lost its lock by the check
            CampaignStore.open(folder, readonly=False)
    assert report.is_sound
    assert report.holdings.state is State.RUNNING
    assert report.holdings.writer == "this process"


def test_another_process_that_writes_is_named(folder: Path) -> None:
    code = "import sys; from pathlib import Path; from frenetic.campaign import CampaignStore\n"
    code += "with CampaignStore.open(Path(sys.argv[1]), readonly=False): print(); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdin is not None
        assert writer.stdout is not None
        writer.stdout.readline()
        assert check_campaign(folder, quick=True).holdings.writer == f"process {writer.pid}"
        writer.stdin.write(b"\n")
    assert check_campaign(folder, quick=True).holdings.writer is None
    lock_file(folder / LOCK).release()  # nobody was kept out


def test_a_database_of_the_first_schema_is_sound_and_stays_one(sound: Path, tmp_path: Path) -> None:
    old = tmp_path / DATABASE
    with closing(sqlite3.connect(old, isolation_level=None)) as connection:
        for statement in MIGRATIONS[0]:
            connection.execute(statement)
        connection.execute("ATTACH ? AS new", (str(sound / DATABASE),))
        for table in ("campaign", "candidate", "test", "trajectory"):
            rows = connection.execute("SELECT name FROM pragma_table_info(?)", (table,))
            names = ", ".join(name for (name,) in rows.fetchall())
            connection.execute(f"INSERT INTO {table} SELECT {names} FROM new.{table}")
        connection.execute("DETACH new")
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute("PRAGMA user_version = 1")
    report = check_campaign(tmp_path)
    assert report.findings == ()
    assert report.holdings.schema == 1
    assert value(tmp_path, "PRAGMA user_version") == 1


def test_what_is_needed_is_what_campaigns_write(tmp_path: Path) -> None:
    campaign = make_campaign(tmp_path, Budget(simulations=1), description={})
    assert campaign.configuration().keys() == CONFIGURATION.keys()


def test_the_command_is_what_the_command_line_writes(tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--simulations", "1", "--workers", "1", "--out", str(tmp_path / "c")])
    with CampaignStore.open(tmp_path / "c") as store:
        command = store.config["command"]
    assert isinstance(command, dict)
    assert command.keys() == set(COMMAND)
    assert check_campaign(tmp_path / "c").is_sound


# The file and its tables


def test_no_campaign_and_a_newer_one_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="holds no campaign"):
        check_campaign(tmp_path)
    execute(folder, f"PRAGMA user_version = {len(MIGRATIONS) + 1}")
    with pytest.raises(CampaignError, match="newer version"):
        check_campaign(folder)
    (folder / DATABASE).write_text("no database")
    with pytest.raises(CampaignError, match="not a database"):
        check_campaign(folder)


@pytest.mark.parametrize(
    ("statement", "text", "severity"),
    [
        ("DROP TABLE trajectory", "the table trajectory is missing", Severity.ERROR),
        ("DROP TABLE campaign", "the table campaign is missing", Severity.ERROR),
        ("DROP VIEW overview", "the view overview is missing", Severity.WARNING),
        ("DROP INDEX test_by_outcome", "the index test_by_outcome is missing", Severity.WARNING),
        ("ALTER TABLE test RENAME worker TO who", "the table test has no worker", Severity.ERROR),
        (
            "ALTER TABLE candidate RENAME step TO s",
            "the table candidate has no step",
            Severity.ERROR,
        ),
    ],
)
def test_missing_tables_and_columns(
    folder: Path, statement: str, text: str, severity: Severity
) -> None:
    execute(folder, statement)
    expect(check_campaign(folder), Subject.SCHEMA, text, severity)


def test_a_damaged_page_is_found(folder: Path) -> None:
    page = value(folder, "SELECT rootpage FROM sqlite_schema WHERE name = 'test_by_outcome'")
    size = value(folder, "PRAGMA page_size")
    with (folder / DATABASE).open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(b"\x13" * size)
    report = check_campaign(folder)
    assert {finding.subject for finding in report.findings} == {Subject.DATABASE}


def contents(folder: Path) -> list[list[tuple[Any, ...]]]:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        return [
            connection.execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()
            for table in ("campaign", "candidate", "test", "trajectory")
        ]


def test_all_damage_to_the_file_is_found_but_where_it_is_free(folder: Path) -> None:
    path = folder / DATABASE
    whole, held = path.read_bytes(), contents(folder)
    source = random.Random(5)
    found = 0
    for _ in range(25):
        data = bytearray(whole)
        start = source.randrange(100, len(data) - 300)
        data[start : start + 300] = source.randbytes(300)
        path.write_bytes(data)
        for leftover in ("-wal", "-shm"):
            path.with_name(DATABASE + leftover).unlink(missing_ok=True)
        try:
            is_sound = check_campaign(folder).is_sound
        except CampaignError:
            is_sound = False
        found += not is_sound
        assert not is_sound or contents(folder) == held
    assert found > 10


def test_rows_that_belong_to_nothing(folder: Path) -> None:
    data = encode(Trajectory.empty())
    execute(folder, "INSERT INTO trajectory VALUES (99999, ?, NULL)", data)
    expect(check_campaign(folder), Subject.DATABASE, "of trajectory belongs to no row of test")


# What it says about the campaign


@pytest.mark.parametrize("name", [name for name, e in CONFIGURATION.items() if e.is_needed])
def test_each_missing_value_of_the_configuration(folder: Path, name: str) -> None:
    change_config(folder, lambda config: config.pop(name))
    report = check_campaign(folder, quick=True)
    expect(report, Subject.CONFIGURATION, f"{name} is missing")
    assert len(report.findings) == 1


@pytest.mark.parametrize("name", CONFIGURATION)
def test_each_value_of_the_configuration_of_the_wrong_type(tmp_path: Path, name: str) -> None:
    config = make_campaign(tmp_path, Budget(simulations=1)).configuration()
    allowed: dict[str, list[object]] = {
        "seed": ["seven", -1, True, 10**400],
        "cluster": ["seven"],
        "workers": [10**400],
        "lookahead": [10**400],
        "versions": [{}],
        "fingerprints": [{}],
        "screen": [{}],
        "start_from": [[]],
        "objective": ["seven"],
    }
    bads: list[object] = [[], {}, "seven", -1, True, 10**400]
    accepted = []
    for bad in bads:
        faults = decode_config({**config, name: bad}).faults
        assert all(fault.startswith(f"{name} is ") for fault in faults)
        if not faults:
            accepted.append(bad)
    assert accepted == allowed.get(name, [])


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("rules", {"stuck_time": None}, "its stuck_time has to be a number"),
        ("rules", {"oob_tolerance": 1.5}, "oob_tolerance is 1.5"),
        ("rules", {"patience": 1.0}, "it has no patience"),
        ("car", {"width": "wide"}, "its width has to be a number"),
        ("budget", {"simulations": 0}, "simulations is 0"),
        ("strategy", {"options": 3}, "options is 3: an object is needed"),
        ("driver", {"driver": {"options": {}}}, "class is missing"),
    ],
)
def test_records_in_the_configuration_are_read_to_the_end(
    folder: Path, name: str, change: dict[str, Any], text: str
) -> None:
    change_config(folder, lambda config: config[name].update(change))
    expect(check_campaign(folder, quick=True), Subject.CONFIGURATION, text)


@pytest.mark.parametrize("name", ["rules", "car"])
def test_a_record_that_lacks_a_field(folder: Path, name: str) -> None:
    change_config(folder, lambda config: config[name].popitem())
    expect(check_campaign(folder, quick=True), Subject.CONFIGURATION, "it lacks ")


@pytest.mark.parametrize("name", COMMAND)
def test_a_command_that_cannot_be_resumed(folder: Path, name: str) -> None:
    change_config(folder, lambda config: config["command"].pop(name))
    text = f"the campaign cannot be resumed: the command: {name} is missing"
    expect(check_campaign(folder, quick=True), Subject.CONFIGURATION, text, Severity.WARNING)


def test_a_configuration_that_is_none(folder: Path) -> None:
    for damage, text in (
        ("UPDATE campaign SET value = '{' WHERE key = 'config'", "the fact config is not JSON"),
        ("UPDATE campaign SET value = '[]' WHERE key = 'config'", "there is no configuration"),
        ("DELETE FROM campaign", "there is no configuration"),
    ):
        execute(folder, damage)
        expect(check_campaign(folder, quick=True), Subject.CONFIGURATION, text)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("created_at", '"yesterday"'),
        ("created_at", '"2026-01-01T00:00:00"'),
        ("finished_at", "7"),
        ("seconds", "-1"),
        ("interrupted", "0"),
        ("budget", '{"simulations": 5}'),
    ],
)
def test_other_facts(folder: Path, name: str, bad: str) -> None:
    execute(folder, "UPDATE campaign SET value = ? WHERE key = ?", bad, name)
    expect(check_campaign(folder, quick=True), Subject.CONFIGURATION, f"the fact {name} is ")


# Candidates


@pytest.mark.parametrize(
    ("column", "bad", "text"),
    [
        ("operator", "CAST(X'FF' AS TEXT)", "a text is needed"),
        ("parents", "'1, 2'", "a JSON list of ids is needed"),
        ("parents", "'[true]'", "a JSON list of ids is needed"),
        ("generation", "-1", "generation is -1"),
        ("generation", "generation + 1", "is of generation 1, its parents make it 0"),
        ("step", "0.0", "a positive number of metres is needed"),
        ("step", "9e999", "a positive number of metres is needed"),
        ("curvatures", "X'0102030405'", "no whole number of float64"),
        ("curvatures", "X'000000000000F87F'", "not all finite"),
        ("points", "X'0102030405'", "no whole pairs of float64"),
        ("points", "X'000000000000F87F000000000000F87F'", "the points are not all finite"),
        ("asked_after", "-1", "asked_after is -1"),
    ],
)
def test_each_fault_of_a_candidate(folder: Path, column: str, bad: str, text: str) -> None:
    assert execute(folder, f"UPDATE candidate SET {column} = {bad} WHERE id = 20") == 1
    expect(check_campaign(folder), Subject.CANDIDATE, text)


@pytest.mark.parametrize(
    ("column", "bad", "text"),
    [
        ("parents", "'[21]'", "parents that were not asked before it: 21"),
        ("parents", "'[0]'", "parents that were not asked before it: 0"),
        ("asked_after", "0", "was asked after 0 results, the one before it after"),
        ("asked_after", "100000", "was asked after 100000 results, but there are"),
        ("id", "100000", "candidate 20 is missing"),
    ],
)
def test_each_fault_in_the_order_of_candidates(
    folder: Path, column: str, bad: str, text: str
) -> None:
    assert execute(folder, f"UPDATE candidate SET {column} = {bad} WHERE id = 20") == 1
    expect(check_campaign(folder), Subject.ORDER, text)


def test_a_gap_among_the_candidates(folder: Path) -> None:
    for table, column in (
        ("trajectory", "candidate_id"),
        ("test", "candidate_id"),
        ("candidate", "id"),
    ):
        execute(folder, f"DELETE FROM {table} WHERE {column} BETWEEN 30 AND 33")
    expect(check_campaign(folder), Subject.ORDER, "candidates 30 to 33 are missing")


# Results


def test_a_gap_among_the_results(folder: Path) -> None:
    execute(folder, "DELETE FROM trajectory WHERE candidate_id = 30")
    told = value(folder, "SELECT told FROM test WHERE candidate_id = 30")
    execute(folder, "DELETE FROM test WHERE candidate_id = 30")
    text = f"results are told as numbers {told - 1} and then {told + 1}"
    expect(check_campaign(folder), Subject.ORDER, text)


def test_a_result_before_its_candidate(folder: Path) -> None:
    execute(folder, "UPDATE candidate SET asked_after = 60 WHERE id BETWEEN 30 AND 40")
    expect(check_campaign(folder), Subject.ORDER, "before it was asked, after 60 results")


def test_time_that_goes_back(folder: Path) -> None:
    execute(folder, "UPDATE test SET elapsed = elapsed + 1000 WHERE told = 30")
    expect(check_campaign(folder), Subject.ORDER, "the one before it at 100")


@pytest.mark.parametrize(
    ("outcome", "change", "text"),
    [
        ("PASS", "outcome = 'GREAT'", "the outcome is 'GREAT'"),
        ("PASS", "reason = CAST(X'FF' AS TEXT)", "a text is needed"),
        ("PASS", "finished_at = 'soon'", "finished_at is 'soon'"),
        ("PASS", "worker = CAST(X'FF' AS TEXT)", "the worker is"),
        ("PASS", "attempts = 0", "attempts is 0"),
        ("PASS", "moobd = 9e999", "moobd is inf"),
        ("PASS", "seconds = -1.0", "seconds is -1.0"),
        ("PASS", "max_oob_share = 1.5", "max_oob_share is 1.5"),
        ("PASS", "budget_spent = 1.5", "budget_spent is 1.5"),
        ("PASS", "heading = NULL", "only a part of its pose"),
        ("PASS", "x = NULL, y = NULL, heading = NULL", "PASS without x"),
        ("PASS", "moobd = NULL", "PASS without moobd"),
        ("PASS", "duration = NULL", "PASS without duration"),
        ("PASS", "departure_time = 1.0", "PASS with departure_time"),
        ("FAIL", "max_oob_share = NULL", "FAIL without max_oob_share"),
        ("FAIL", "departure_side = 'up'", "departure_side is 'up'"),
        ("FAIL", "departure_x = NULL", "a departure that lacks departure_x"),
        (
            "FAIL",
            "departure_time = NULL, departure_distance = NULL, departure_x = NULL,"
            " departure_y = NULL, departure_side = NULL",
            "of the car outside its lane, but without departure_time",
        ),
        ("FAIL", "max_oob_share = 0.3", "FAIL with a departure, but with 30.0%"),
        ("INVALID", "moobd = 0.5", "INVALID with moobd"),
        ("INVALID", "duration = 0.5", "INVALID with duration"),
        ("DROPPED", "x = 1.0, y = 1.0, heading = 1.0", "DROPPED with x"),
        ("DROPPED", "attempts = -1", "attempts is -1"),
        ("PASS", "outcome = 'ERROR'", "ERROR with moobd"),
        ("INVALID", "outcome = 'ERROR', duration = 3.0", "only one of duration and trajectory"),
    ],
)
def test_each_fault_of_a_result(folder: Path, outcome: str, change: str, text: str) -> None:
    number = test_of(folder, Outcome(outcome))
    assert execute(folder, f"UPDATE test SET {change} WHERE candidate_id = ?", number) == 1
    report = check_campaign(folder)
    expect(report, Subject.TEST, f"test {number}: ")
    expect(report, Subject.TEST, text)


@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("change", ["0.0", "budget_spent * 0.9", "min(1.0, budget_spent + 0.3)"])
def test_a_share_of_the_budget_that_is_none(folder: Path, place: float, change: str) -> None:
    told = 1 + round(place * (value(folder, "SELECT count(*) FROM test") - 1))
    before = value(folder, "SELECT budget_spent FROM test WHERE told = ?", told)
    execute(folder, f"UPDATE test SET budget_spent = {change} WHERE told = ?", told)
    report = check_campaign(folder)
    if value(folder, "SELECT budget_spent FROM test WHERE told = ?", told) == before:
        assert report.is_sound  # the last one was 1.0, and is
    else:
        number = value(folder, "SELECT candidate_id FROM test WHERE told = ?", told)
        expect(report, Subject.BUDGET, f"test {number}: budget_spent is ")


def test_many_findings_are_counted(folder: Path) -> None:
    changed = execute(folder, "UPDATE test SET seconds = -1.0 WHERE outcome = 'PASS'")
    report = check_campaign(folder)
    expect(report, Subject.TEST, f"{changed - SHOWN} more about a test")
    assert len(report.findings) == SHOWN + 1


# Trajectories and verdicts


def test_a_trajectory_that_is_missing_or_too_many(folder: Path) -> None:
    passed, invalid = test_of(folder, Outcome.PASS), test_of(folder, Outcome.INVALID)
    execute(
        folder, "UPDATE trajectory SET candidate_id = ? WHERE candidate_id = ?", invalid, passed
    )
    report = check_campaign(folder)
    expect(report, Subject.TEST, f"test {passed}: PASS without trajectory")
    expect(report, Subject.TEST, f"test {invalid}: INVALID with trajectory")


def test_a_trajectory_that_cannot_be_decoded(folder: Path) -> None:
    number = test_of(folder, Outcome.FAIL)
    half = "UPDATE trajectory SET data = substr(data, 1, length(data) / 2) WHERE candidate_id = ?"
    execute(folder, half, number)
    expect(check_campaign(folder, quick=True), Subject.TRAJECTORY, f"of test {number}: ")


def change_trajectory(folder: Path, number: int, change: Callable[[Any], Any]) -> None:
    data = value(folder, "SELECT data FROM trajectory WHERE candidate_id = ?", number)
    changed = encode(Trajectory.from_rows(change(decode(data).to_rows())))
    execute(folder, "UPDATE trajectory SET data = ? WHERE candidate_id = ?", changed, number)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda rows: rows[:0], "has no records"),
        (lambda rows: rows[::-1], "goes back in time"),
    ],
)
def test_a_trajectory_that_is_none(folder: Path, change: Callable[[Any], Any], text: str) -> None:
    change_trajectory(folder, test_of(folder, Outcome.PASS), change)
    expect(check_campaign(folder, quick=True), Subject.TRAJECTORY, text)


def test_a_drive_that_is_judged_otherwise(folder: Path) -> None:
    number = test_of(folder, Outcome.PASS)
    change_trajectory(folder, number, lambda rows: rows[: len(rows) // 2])
    text = f"test {number}: it is stored as PASS, judged again it is ERROR"
    expect(check_campaign(folder), Subject.VERDICT, text)
    assert check_campaign(folder, quick=True).is_sound


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("moobd = moobd - 0.0002", "moobd is stored as"),
        ("max_oob_share = max_oob_share - 0.001", "max_oob_share is stored as"),
        ("duration = duration + 0.05", "duration is stored as"),
        ("departure_time = departure_time - 0.05", "departure_time is stored as"),
        ("departure_distance = departure_distance + 0.01", "departure_distance is stored as"),
        ("departure_x = departure_x + 0.01", "departure_x is stored as"),
        (
            "departure_side = iif(departure_side = 'left', 'right', 'left')",
            "judged again to the",
        ),
        ("x = x + 3.0", "judged again"),
    ],
)
def test_numbers_that_are_judged_otherwise(folder: Path, change: str, text: str) -> None:
    number = test_of(folder, Outcome.FAIL)
    execute(folder, f"UPDATE test SET {change} WHERE candidate_id = ?", number)
    expect(check_campaign(folder), Subject.VERDICT, text)
    assert check_campaign(folder, quick=True).is_sound


def test_a_road_that_was_changed(folder: Path) -> None:
    number = test_of(folder, Outcome.FAIL)
    straight = np.zeros(20).astype("<f8").tobytes()
    execute(folder, "UPDATE candidate SET curvatures = ? WHERE id = ?", straight, number)
    expect(check_campaign(folder), Subject.VERDICT, f"test {number}: ")


def test_a_road_that_is_none(folder: Path) -> None:
    number = test_of(folder, Outcome.FAIL)
    execute(folder, "UPDATE candidate SET curvatures = X'' WHERE id = ?", number)
    expect(check_campaign(folder), Subject.VERDICT, "it was driven, but its road is none")


def test_a_refused_road_that_is_valid(folder: Path) -> None:
    number = test_of(folder, Outcome.INVALID)
    straight = np.zeros(12).astype("<f8").tobytes()
    execute(folder, "UPDATE candidate SET curvatures = ? WHERE id = ?", straight, number)
    text = f"test {number}: it is stored as INVALID, but its road is valid"
    expect(check_campaign(folder), Subject.VERDICT, text)
    assert check_campaign(folder, quick=True).is_sound


def test_points_that_were_refused_and_are_valid(folder: Path) -> None:
    number = test_of(folder, Outcome.INVALID)
    points = np.array([[20.0, 20.0], [60.0, 20.0], [100.0, 20.0], [140.0, 20.0]])
    change = "UPDATE candidate SET points = ? WHERE id = ?"
    execute(folder, change, (points - 18.0).astype("<f8").tobytes(), number)
    assert check_campaign(folder).is_sound
    execute(folder, change, points.astype("<f8").tobytes(), number)
    text = f"test {number}: it is stored as INVALID, but its road is valid"
    expect(check_campaign(folder), Subject.VERDICT, text)


def test_another_version_may_judge_otherwise(folder: Path) -> None:
    change_config(folder, lambda config: config["versions"].update(numpy="1.0"))
    number = test_of(folder, Outcome.FAIL)
    execute(folder, "UPDATE test SET moobd = moobd - 0.1 WHERE candidate_id = ?", number)
    report = check_campaign(folder)
    expect(report, Subject.VERDICT, "versions differ: numpy 1.0, now", Severity.WARNING)
    assert len(report.findings) == 1


@pytest.mark.parametrize(("short_of", "is_sound"), [(2e-5, True), (0.01, False)])
def test_rounding_may_end_a_drive_elsewhere(
    tmp_path: Path, short_of: float, is_sound: bool
) -> None:
    """The goal is drawn so near that the stored last record lies just outside."""
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=0.3),
        budget=Budget(simulations=1),
        folder=tmp_path,
    ).run()
    with CampaignStore.open(tmp_path) as store:
        record = store.test(1)
    assert record.outcome is Outcome.PASS
    assert record.trajectory is not None
    assert record.pose is not None
    road = Road(record.candidate.curvatures, record.candidate.step, record.pose)
    last = record.trajectory.to_rows()[-1, 1:3]
    goal = float(np.hypot(*(last - road.points[-1]))) - short_of
    change_config(tmp_path, lambda config: config["rules"].update(goal_distance=goal))
    assert check_campaign(tmp_path).is_sound == is_sound


# On the command line


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["check", *arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_command_on_a_sound_campaign(sound: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(sound)) == 0
    out = capsys.readouterr().out
    assert "nothing is wrong" in out
    assert "finished" in out
    assert run(str(sound), "--quick", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["is_sound"] is True
    assert document["by_outcome"]["PASS"] + document["by_outcome"]["FAIL"] == 80


def test_command_on_a_damaged_campaign(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    execute(folder, "UPDATE test SET seconds = -1.0 WHERE told = 9")
    assert run(str(folder)) == 1
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("error: test: test ") for line in lines) == 1
    assert run(str(folder), "--json") == 1
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["severity"] == "error"


def test_command_without_a_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(tmp_path)) == 2
    answer = capsys.readouterr()
    assert answer.out == ""
    assert len(answer.err.splitlines()) == 1


@pytest.mark.parametrize("name", [*COMMAND, "map_size"])
def test_resuming_without_a_part_of_the_command_is_one_line(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    in_command = name in COMMAND
    change_config(folder, lambda config: (config["command"] if in_command else config).pop(name))
    with pytest.raises(SystemExit) as stop:
        main(["resume", str(folder), "--simulations", "3"])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{name} is missing" in line


def test_resuming_with_a_budget_that_is_none_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    execute(folder, """UPDATE campaign SET value = '{"tests": 5}' WHERE key = 'budget'""")
    with pytest.raises(SystemExit) as stop:
        main(["resume", str(folder)])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the budget is {'tests': 5}: it lacks simulations, time, failures" in line


# Checksums


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


def test_one_changed_bit_is_found_in_each_stored_value(folder: Path) -> None:
    with CampaignStore.open(folder) as store:
        failure = next(store.tests(Outcome.FAIL)).id
    confirm(folder, EmbeddedSimulator(friction=0.9), Planner(), test_ids=[failure])
    minimise = ("minimise", str(folder), str(failure), "--max-drives", "30")
    with pytest.raises(SystemExit):
        main([*minimise])
    assert check_campaign(folder, quick=True).is_sound
    unnoticed, cases = [], 0
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        for table, row in rows_to_flip(connection, failure):
            for _, column, *_, is_key in connection.execute(f"PRAGMA table_info({table})"):
                if is_key:  # what belongs to the row would belong to nothing
                    continue
                of_row = f"FROM {table} WHERE rowid = {row}"
                (stored,) = connection.execute(f"SELECT {column} {of_row}").fetchone()
                if stored is None or (table, column) in (("redrive_run", "ended_at"),):
                    continue
                change = f"UPDATE {table} SET {column} = ? WHERE rowid = {row}"
                try:
                    connection.execute(change, (flipped(stored),))
                except sqlite3.IntegrityError:  # a number that another row has, which SQLite finds
                    continue
                cases += 1
                if check_campaign(folder, quick=True).is_sound:
                    unnoticed.append((table, column))
                connection.execute(change, (stored,))
    assert cases > 60
    assert unnoticed == []
    assert check_campaign(folder, quick=True).is_sound


def rows_to_flip(connection: sqlite3.Connection, failure: int) -> list[tuple[str, int]]:
    """A table and the number of one of its rows, for rows that hold all kinds of values."""
    minimised = "SELECT max(rowid) FROM redrive WHERE curvatures IS NOT NULL"
    rows = [
        ("campaign", "SELECT rowid FROM campaign WHERE key = 'config'"),
        ("campaign", "SELECT rowid FROM campaign WHERE key = 'budget'"),
        *((name, f"SELECT {failure}") for name in ("candidate", "test", "trajectory")),
        ("redrive_run", "SELECT min(id) FROM redrive_run"),
        ("redrive", "SELECT min(rowid) FROM redrive"),
        ("redrive", minimised),
    ]
    return [(table, connection.execute(select).fetchone()[0]) for table, select in rows]


@pytest.mark.parametrize(
    ("change", "subject", "text"),
    [
        ("UPDATE test SET moobd = moobd + 1e-12 WHERE candidate_id = {}", Subject.TEST, "test {}"),
        (
            "UPDATE candidate SET step = step + 1e-12 WHERE id = {}",
            Subject.CANDIDATE,
            "candidate {}",
        ),
        (
            "UPDATE trajectory SET checksum = checksum + 1 WHERE candidate_id = {}",
            Subject.TRAJECTORY,
            "the trajectory of test {}",
        ),
    ],
)
def test_a_changed_row_is_one_line_for_every_reader(
    folder: Path, change: str, subject: Subject, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    number = test_of(folder, Outcome.FAIL)
    assert execute(folder, change.format(number), keep_checksums=True) == 1
    text = f"{text.format(number)} does not match its checksum"
    expect(check_campaign(folder, quick=True), subject, text)
    with CampaignStore.open(folder) as store, pytest.raises(CampaignError, match=text):
        store.test(number)
    with pytest.raises(CampaignError, match=text):
        export_campaign(folder, "json", folder / "out")
    with pytest.raises(SystemExit) as stop:
        main(["show", str(folder), str(number)])
    assert stop.value.code == 2
    assert text in capsys.readouterr().err


def test_rows_of_before_there_were_checksums_have_none_and_later_ones_keep_theirs(
    folder: Path,
) -> None:
    forget = "UPDATE test SET checksum = NULL WHERE told"
    execute(folder, f"{forget} <= 40", keep_checksums=True)
    assert check_campaign(folder, quick=True).is_sound
    execute(folder, f"{forget} = 60", keep_checksums=True)
    number = value(folder, "SELECT candidate_id FROM test WHERE told = 60")
    expect(check_campaign(folder, quick=True), Subject.TEST, f"test {number} has lost its checksum")
