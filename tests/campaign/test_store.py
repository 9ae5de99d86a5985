"""What a campaign's database keeps, who may open it, and what it says when it cannot be used."""

from __future__ import annotations

import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from checksums import forget_checksums
from permissions import bound_by_permissions

from frenetic.campaign import store as store_module
from frenetic.campaign.record import Test
from frenetic.campaign.store import APPLICATION_ID, DATABASE, MIGRATIONS, CampaignStore, JSONValue
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.drive import Trajectory

CONFIG: dict[str, JSONValue] = {
    "strategy": "frenetic",
    "seed": 7,
    "budget": {"simulations": 100, "hours": None},
}


def make_candidate(id: int, samples: int = 25) -> Candidate:  # noqa: A002
    curvatures = np.random.default_rng(id).uniform(-0.07, 0.07, samples)
    parents = () if id < 3 else (id - 1, id - 2)
    return Candidate(id, curvatures, 10.0, Origin("C1" if parents else "random", parents, id // 3))


def make_trajectory(seed: int, records: int = 60) -> Trajectory:
    steps = np.random.default_rng(seed).integers(-50, 50, size=(records, 11))
    return Trajectory.from_rows(np.cumsum(steps, axis=0) / 1000.0)


def make_record(id: int, outcome: Outcome | None = None) -> Test:  # noqa: A002
    """Outcomes in turn, MOOBDs in no order."""
    outcome = outcome or (Outcome.FAIL, Outcome.PASS, Outcome.INVALID, Outcome.ERROR)[id % 4]
    record = Test(
        candidate=make_candidate(id),
        told=id,
        outcome=outcome,
        reason=f"reason {id}: κ → θ",
        budget_spent=id / 100,
        seconds=0.125,
        attempts=1 + id % 2,
        worker=f"worker {id}",
        elapsed=id / 8,
    )
    if not outcome.is_driven:
        return record
    return replace(
        record,
        pose=(10.0 + id, 20.0, np.pi / 3),
        moobd=-((id * 37) % 11) / 10.0,
        max_oob_share=0.5,
        duration=24.95,
        moobd_distance=120.5,
        departure_time=12.5 if outcome is Outcome.FAIL else None,
        departure_distance=118.25 if outcome is Outcome.FAIL else None,
        departure_x=50.0 if outcome is Outcome.FAIL else None,
        departure_y=60.0 if outcome is Outcome.FAIL else None,
        departure_side="left" if outcome is Outcome.FAIL else None,
        trajectory=make_trajectory(id),
    )


def tell(store: CampaignStore, *ids: int) -> None:
    for id in ids:  # noqa: A001
        store.asked(make_candidate(id))
        store.told(make_record(id))


def assert_same_candidate(one: Candidate, other: Candidate) -> None:
    assert (one.id, one.step, one.origin) == (other.id, other.step, other.origin)
    assert one.curvatures.tolist() == other.curvatures.tolist()
    assert (one.points is None) == (other.points is None)
    if one.points is not None and other.points is not None:
        assert one.points.tolist() == other.points.tolist()


def assert_same(one: Test, other: Test) -> None:
    for item in fields(Test):
        mine, theirs = getattr(one, item.name), getattr(other, item.name)
        if item.name == "candidate":
            assert_same_candidate(mine, theirs)
        elif item.name == "trajectory" and mine is not None:
            np.testing.assert_allclose(mine.to_rows(), theirs.to_rows(), atol=5.1e-4)
        else:
            assert mine == theirs, item.name


def one_line(caught: pytest.ExceptionInfo[CampaignError]) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "runs" / "a campaign?#%20 ö"


@pytest.fixture
def store(folder: Path) -> Iterator[CampaignStore]:
    with CampaignStore.create(folder, CONFIG) as store:
        yield store


@pytest.fixture
def finished(folder: Path) -> Path:
    """The folder of a closed campaign with ten tests."""
    with CampaignStore.create(folder, CONFIG) as store:
        tell(store, *range(1, 11))
    return folder


def execute(folder: Path, statement: str, *values: object) -> None:
    """Change the database behind the store's back."""
    connection = sqlite3.connect(folder / DATABASE)
    try:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute(statement, values)
        forget_checksums(connection)
        connection.commit()
    finally:
        connection.close()


# Round trips


def test_a_new_campaign_waits_for_the_disk_once_and_only_then_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed = []

    def flush(path: Path) -> None:
        assert path.name != DATABASE
        assert not path.with_name(DATABASE).exists()
        database = sqlite3.connect(path)
        (mode,) = database.execute("PRAGMA journal_mode").fetchone()
        assert database.execute("SELECT count(*) FROM campaign").fetchone() == (2,)
        database.close()
        flushed.append(mode)

    monkeypatch.setattr(store_module, "flush", flush)
    CampaignStore.create(tmp_path / "c", CONFIG).close()
    assert flushed == ["wal"], "it need not be changed again when it is opened to write"


def test_records_come_back(store: CampaignStore) -> None:
    tell(store, *range(1, 11))
    for id in range(1, 11):  # noqa: A001
        assert_same(store.test(id), make_record(id))
    for id, record in enumerate(store.tests(with_trajectory=True), start=1):  # noqa: A001
        assert_same(record, make_record(id))


def test_records_come_back_from_a_closed_campaign(finished: Path) -> None:
    for readonly in (True, False, True):
        with CampaignStore.open(finished, readonly=readonly) as store:
            assert store.config == CONFIG
            assert_same(store.test(4), make_record(4))


def test_trajectories_are_left_out_unless_asked_for(store: CampaignStore) -> None:
    tell(store, 1, 4)
    assert [record.trajectory for record in store.tests()] == [None, None]
    assert store.test(4, with_trajectory=False).trajectory is None
    assert store.test(4).trajectory is not None


def test_curvatures_keep_every_bit(store: CampaignStore) -> None:
    curvatures = np.array([np.pi * 1e-2, -0.0, 5e-324, 0.07, np.nextafter(0.07, 1.0)])
    store.asked(Candidate(1, curvatures, 10.0, Origin("random")))
    back = store.candidate(1)
    assert back.curvatures.tobytes() == curvatures.tobytes()
    assert not back.curvatures.flags.writeable


def test_an_empty_road_can_be_stored(store: CampaignStore) -> None:
    candidate = make_candidate(1, samples=0)
    store.asked(candidate)
    store.told(replace(make_record(1, Outcome.INVALID), candidate=candidate))
    assert len(store.test(1).candidate.curvatures) == 0


def test_numpy_numbers_are_numbers(store: CampaignStore) -> None:
    store.asked(make_candidate(4))
    store.told(replace(make_record(4), moobd=np.float64(-1.5), told=np.int64(1)))  # type: ignore[arg-type]
    assert store.test(4).moobd == -1.5


@pytest.mark.parametrize("reason", ["", "zero \0 inside", "two\nlines", "\N{SNOWMAN}" * 1000])
def test_any_reason_comes_back(store: CampaignStore, reason: str) -> None:
    store.asked(make_candidate(1))
    store.told(replace(make_record(1), reason=reason))
    assert store.test(1).reason == reason


def test_a_reason_that_is_no_text_stays_readable(store: CampaignStore) -> None:
    store.asked(make_candidate(1))
    store.told(replace(make_record(1), reason="cannot open caf\udce9"))
    assert store.test(1).reason == "cannot open caf\\udce9"


def test_tests_by_outcome_order_and_limit(store: CampaignStore) -> None:
    tell(store, *range(1, 21))
    assert [record.told for record in store.tests(Outcome.FAIL)] == [4, 8, 12, 16, 20]
    assert [record.told for record in store.tests(limit=3)] == [1, 2, 3]
    assert list(store.tests(limit=0)) == []
    by_moobd = [record.moobd for record in store.tests(order_by="moobd")]
    driven = [moobd for moobd in by_moobd if moobd is not None]
    assert driven == sorted(driven)
    assert by_moobd == driven + [None] * 10
    worst = store.tests(Outcome.FAIL, order_by="moobd", limit=1)
    assert next(worst).moobd == min(r.moobd for r in store.tests(Outcome.FAIL) if r.moobd)


def test_told_order_may_differ_from_asked_order(store: CampaignStore) -> None:
    for id in (1, 2, 3):  # noqa: A001
        store.asked(make_candidate(id))
    for told, id in enumerate((2, 3, 1), start=1):  # noqa: A001
        store.told(replace(make_record(id), told=told))
    assert [record.candidate.id for record in store.tests()] == [2, 3, 1]
    assert [candidate.id for candidate in store.candidates()] == [1, 2, 3]


def test_an_iterator_is_a_snapshot_that_blocks_nobody(store: CampaignStore) -> None:
    tell(store, 1, 2, 3)
    tests = store.tests()
    assert next(tests).told == 1
    tell(store, 4)
    assert [record.told for record in tests] == [2, 3]


def test_counts(store: CampaignStore) -> None:
    empty = store.counts()
    assert (empty.asked, empty.told, empty.min_moobd) == (0, 0, None)
    tell(store, *range(1, 11))
    store.asked(make_candidate(11))
    counts = store.counts()
    assert (counts.asked, counts.told) == (11, 10)
    assert counts.by_outcome == {
        Outcome.PASS: 3,
        Outcome.FAIL: 2,
        Outcome.INVALID: 3,
        Outcome.ERROR: 2,
        Outcome.DROPPED: 0,
    }
    assert (counts.tests, counts.simulations) == (10, 7)
    assert counts.min_moobd == min(r.moobd for r in store.tests() if r.moobd is not None)


def test_facts_and_finish(folder: Path) -> None:
    with CampaignStore.create(folder, CONFIG) as store:
        assert store.facts.keys() == {"created_at"}
        store.finish(seconds=1.5, stopped_by="budget")
        store.finish(seconds=2.5)
    with CampaignStore.open(folder) as store:
        assert store.facts.keys() == {"created_at", "finished_at", "seconds", "stopped_by"}
        assert store.facts["seconds"] == 2.5
        assert store.config == CONFIG


def test_the_config_is_json_or_refused(folder: Path) -> None:
    for config in ({"seed": object()}, {"rate": float("nan")}):
        with pytest.raises(ValueError):
            CampaignStore.create(folder, config)  # type: ignore[arg-type]
    assert not folder.exists()
    with CampaignStore.create(folder, {}) as store, pytest.raises(ValueError, match="config"):
        store.finish(config={})


def test_candidates_asked_are_written_on_closing(folder: Path) -> None:
    with CampaignStore.create(folder, CONFIG) as store:
        store.asked(make_candidate(1))
    with CampaignStore.open(folder) as store:
        assert_same_candidate(store.candidate(1), make_candidate(1))


def test_people_can_read_the_overview(finished: Path) -> None:
    connection = sqlite3.connect(finished / DATABASE)
    rows = connection.execute("SELECT told, outcome, metres FROM overview").fetchall()
    connection.close()
    assert rows[:2] == [(1, "PASS", 250.0), (2, "INVALID", 250.0)]


def test_a_campaign_continues_after_opening_for_writing(finished: Path) -> None:
    with CampaignStore.open(finished, readonly=False) as store:
        with pytest.raises(CampaignError, match="already holds candidate 10"):
            store.asked(make_candidate(10))
        tell(store, 11)
    with CampaignStore.open(finished) as store:
        assert store.counts().told == 11


# Misuse


def test_unknown_ids_are_answered_with_those_there_are(store: CampaignStore) -> None:
    with pytest.raises(CampaignError, match="no test of candidate 1: there are none so far"):
        store.test(1)
    tell(store, 2, 3)
    store.asked(make_candidate(4))
    for unknown in (0, -1, 4, 99, 10**30):
        with pytest.raises(CampaignError, match=f"no test .* {unknown}: ids run from 2 to 3"):
            store.test(unknown)
    with pytest.raises(CampaignError, match="no candidate 5: ids run from 2 to 4"):
        store.candidate(5)


def test_queries_are_checked_at_once(store: CampaignStore) -> None:
    with pytest.raises(ValueError, match="order_by is 'id'"):
        store.tests(order_by="id")  # type: ignore[arg-type]
    for limit in (-1, 1.5):
        with pytest.raises(ValueError, match=f"limit is {limit}: a whole number of at least 0"):
            store.tests(limit=limit)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="outcome is 'fail': one of PASS, FAIL, INVALID"):
        store.tests("fail")  # type: ignore[arg-type]
    for value in (1.5, "1"):
        with pytest.raises(ValueError, match=f"id is {value!r}: a whole number is needed"):
            store.test(value)  # type: ignore[arg-type]


def test_ids_and_limits_may_be_numpy_numbers(store: CampaignStore) -> None:
    tell(store, 1, 2, 3)
    number = np.int64(1)
    assert store.test(number).id == store.candidate(number).id == 1  # type: ignore[arg-type]
    assert store.trajectory(number) is not None  # type: ignore[arg-type]
    found = store.tests(limit=number, after=number)  # type: ignore[arg-type]
    assert [record.id for record in found] == [2]


def test_a_test_is_told_once_after_being_asked(store: CampaignStore) -> None:
    with pytest.raises(CampaignError, match="asked once, then told once"):
        store.told(make_record(1))
    tell(store, 1)
    with pytest.raises(CampaignError, match="asked once, then told once"):
        store.told(make_record(1))
    store.asked(make_candidate(2))
    with pytest.raises(CampaignError, match="asked once, then told once"):
        store.told(replace(make_record(2), told=1))
    store.told(make_record(2))
    assert store.counts().told == 2


@pytest.mark.parametrize("name", ["moobd", "seconds", "budget_spent", "departure_y"])
@pytest.mark.parametrize("value", [float("nan"), float("-inf")])
def test_numbers_are_finite(store: CampaignStore, name: str, value: float) -> None:
    store.asked(make_candidate(4))
    with pytest.raises(ValueError, match=name):
        store.told(replace(make_record(4), **{name: value}))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="curvatures of candidate 5"):
        store.asked(Candidate(5, np.array([0.0, value]), 10.0, Origin("random")))
    with pytest.raises(ValueError, match="step"):
        store.asked(Candidate(5, np.array([0.0]), value, Origin("random")))
    store.told(make_record(4))


def test_a_reader_writes_nothing(finished: Path) -> None:
    with CampaignStore.open(finished) as store:
        with pytest.raises(CampaignError, match="opened for reading"):
            store.asked(make_candidate(11))
        with pytest.raises(CampaignError, match="opened for reading"):
            store.told(make_record(11))
        with pytest.raises(CampaignError, match="opened for reading"):
            store.finish()
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            store._connection.execute("DELETE FROM test")


def test_a_closed_store_says_so(finished: Path) -> None:
    store = CampaignStore.open(finished, readonly=False)
    store.close()
    store.close()
    for use in (lambda: store.test(1), store.counts, lambda: store.tests(), lambda: store.facts):
        with pytest.raises(CampaignError, match="closed"):
            use()


# Folders


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_fork_never_writes(folder: Path) -> None:
    with CampaignStore.create(folder, {}) as store:
        tell(store, 1, 2)
        store.asked(make_candidate(3))  # held by both processes
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            said = []
            writes: list[Callable[[], None]] = [
                lambda: store.told(make_record(3)),
                lambda: store.asked(make_candidate(4)),
                store.write,
                store.finish,
                store.close,
            ]
            for write in writes:
                try:
                    write()
                except CampaignError as error:
                    said.append(str(error))
            os.write(theirs, "\n".join(said).encode())
            os._exit(0)
        os.waitpid(child, 0)
        os.close(theirs)
        said = os.read(ours, 10_000).decode().splitlines()
        os.close(ours)
        assert len(said) == 4
        for line in said:
            assert f"is written by process {os.getpid()}; this one, {child}, is a fork" in line
        store.told(make_record(3))
    with CampaignStore.open(folder) as store:
        store.require_whole()
        assert [record.id for record in store.tests()] == [1, 2, 3]


def test_a_campaign_is_not_overwritten(finished: Path) -> None:
    before = (finished / DATABASE).read_bytes()
    with pytest.raises(CampaignError, match=r"already holds a campaign.*--out") as caught:
        CampaignStore.create(finished, CONFIG)
    assert str(finished) in one_line(caught)
    assert (finished / DATABASE).read_bytes() == before


def test_an_unfinished_creation_is_no_campaign(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / f"{DATABASE}.new").write_bytes(b"left over from a power cut")
    with pytest.raises(CampaignError, match="holds no campaign"):
        CampaignStore.open(folder)
    CampaignStore.create(folder, CONFIG).close()
    assert sorted(path.name for path in folder.iterdir()) == ["campaign.lock", DATABASE]


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_file_in_the_way(tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("precious")
    with pytest.raises(
        CampaignError, match=r"a file is in the way|cannot make the folder"
    ) as caught:
        CampaignStore.create(tmp_path / "file" / below, CONFIG)
    assert "--out" in one_line(caught)
    assert (tmp_path / "file").read_text() == "precious"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="cannot make the folder"):
        CampaignStore.create(tmp_path / ("x" * 5000), CONFIG)


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no such permissions there")
def test_folders_without_permission(finished: Path, tmp_path: Path) -> None:
    shut = tmp_path / "shut"
    shut.mkdir()
    shut.chmod(0o555)
    finished.chmod(0o555)
    try:
        with bound_by_permissions(shut, finished):
            check_folders_without_permission(shut, finished)
    finally:
        shut.chmod(0o755)
        finished.chmod(0o755)


def check_folders_without_permission(shut: Path, finished: Path) -> None:
    with pytest.raises(CampaignError, match="ermission"):
        CampaignStore.create(shut, CONFIG)
    with pytest.raises(CampaignError, match="ermission"):
        CampaignStore.create(shut / "below", CONFIG)
    with CampaignStore.open(finished) as store:  # reading needs no permission to write
        assert store.counts().told == 10


@pytest.mark.parametrize("readonly", [True, False])
def test_a_missing_campaign_is_named(tmp_path: Path, readonly: bool) -> None:
    (tmp_path / "file").write_text("")
    for name, message in (
        ("nowhere", "does not exist"),
        ("", "holds no campaign"),
        ("file", "is not a folder"),
    ):
        with pytest.raises(CampaignError, match=message) as caught:
            CampaignStore.open(tmp_path / name, readonly)
        assert str(tmp_path / name) in one_line(caught)
        assert DATABASE in one_line(caught)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# Databases that are not ours, or damaged


def foreign_database(path: Path, application_id: int, version: int) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE precious (x)")
    connection.execute(f"PRAGMA application_id = {application_id}")
    connection.execute(f"PRAGMA user_version = {version}")
    connection.close()


@pytest.mark.parametrize("readonly", [True, False])
@pytest.mark.parametrize(
    ("application_id", "version", "message"),
    [
        (0, 0, "is not a campaign's database"),
        (42, 1, "is not a campaign's database"),
        (APPLICATION_ID, 0, "is not a campaign's database"),
        (APPLICATION_ID, -3, "is not a campaign's database"),
        (APPLICATION_ID, len(MIGRATIONS) + 1, "newer version of frenetic.*upgrade"),
        (APPLICATION_ID, 1, "no such table"),
    ],
)
def test_other_databases_are_left_alone(
    tmp_path: Path, readonly: bool, application_id: int, version: int, message: str
) -> None:
    path = tmp_path / DATABASE
    foreign_database(path, application_id, version)
    before = path.read_bytes()
    with pytest.raises(CampaignError, match=message) as caught:
        CampaignStore.open(tmp_path, readonly)
    assert str(path) in one_line(caught)
    if message != "no such table":
        assert path.read_bytes() == before


@pytest.mark.parametrize("readonly", [True, False])
@pytest.mark.parametrize(
    "content", [b"no database at all" * 500, b"", b"SQLite format 3\0" + b"x" * 84]
)
def test_files_that_are_no_databases(tmp_path: Path, readonly: bool, content: bytes) -> None:
    path = tmp_path / DATABASE
    path.write_bytes(content)
    with pytest.raises(CampaignError, match="is not a"):
        CampaignStore.open(tmp_path, readonly)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        (
            "UPDATE test SET outcome = 'MAYBE' WHERE candidate_id = 4",
            "outcome of test 4 is 'MAYBE'",
        ),
        ("UPDATE test SET moobd = 9e999 WHERE candidate_id = 4", "moobd of test 4 is inf"),
        ("UPDATE test SET x = NULL WHERE candidate_id = 4", "x of test 4 is None"),
        ("UPDATE test SET departure_side = 'up' WHERE candidate_id = 4", "'up'"),
        ("UPDATE test SET reason = CAST(x'ff' AS TEXT) WHERE candidate_id = 4", "UTF-8"),
        ("UPDATE candidate SET parents = '[1, ' WHERE id = 4", "parents of candidate 4"),
        ("UPDATE candidate SET parents = '{}' WHERE id = 4", "parents of candidate 4"),
        ("UPDATE candidate SET parents = '[1.5]' WHERE id = 4", "parents of candidate 4"),
        ("UPDATE candidate SET parents = hex(zeroblob(9)) WHERE id = 4", "parents of candidate 4"),
        ("UPDATE candidate SET step = -1 WHERE id = 4", "step of candidate 4"),
        ("UPDATE candidate SET curvatures = x'00' WHERE id = 4", "curvatures of candidate 4"),
        (
            "UPDATE candidate SET curvatures = x'000000000000f07f' WHERE id = 4",
            "curvatures of candidate 4 are not all finite",
        ),
        ("DELETE FROM candidate WHERE id = 4", "candidate 4 is missing"),
        ("UPDATE trajectory SET data = x'' WHERE candidate_id = 4", "trajectory of test 4"),
        (
            "UPDATE trajectory SET data = zeroblob(99) WHERE candidate_id = 4",
            "trajectory of test 4",
        ),
        ("DROP TABLE trajectory", "no such table"),
    ],
)
def test_damaged_rows_are_named_and_others_still_read(
    finished: Path, statement: str, message: str
) -> None:
    execute(finished, statement)
    with CampaignStore.open(finished) as store:
        with pytest.raises(CampaignError, match=message) as caught:
            store.test(4)
        assert str(finished) in one_line(caught)
        if "DROP" not in statement:
            assert_same(store.test(5), make_record(5))
        with pytest.raises(CampaignError):
            list(store.tests(with_trajectory=True))


@pytest.mark.parametrize("value", ["[", "[]", "null", "[" * 100_000])
def test_a_damaged_config_is_named(finished: Path, value: str) -> None:
    execute(finished, "UPDATE campaign SET value = ? WHERE key = 'config'", value)
    with pytest.raises(CampaignError, match="config"):
        CampaignStore.open(finished)


def test_a_missing_config_is_named(finished: Path) -> None:
    execute(finished, "DELETE FROM campaign")
    with pytest.raises(CampaignError, match="config"):
        CampaignStore.open(finished)


def test_damaged_files_raise_nothing_but_campaign_errors(finished: Path, tmp_path: Path) -> None:
    whole = (finished / DATABASE).read_bytes()
    picker = random.Random(11)
    for attempt in range(150):
        data = bytearray(whole)
        for _ in range(picker.choice([1, 20, 300])):
            data[picker.randrange(len(data))] = picker.randrange(256)
        if attempt % 5 == 0:
            del data[picker.randrange(len(data)) :]
        broken = tmp_path / "broken"
        broken.mkdir()
        (broken / DATABASE).write_bytes(data)
        try:
            with CampaignStore.open(broken, readonly=attempt % 2 == 0) as store:
                store.counts()
                for id in range(1, 11):  # noqa: A001
                    with suppress(CampaignError):
                        store.test(id)
                list(store.candidates())
                if attempt % 2:
                    tell(store, 1000)
        except CampaignError as error:
            lines = str(error).splitlines()
            assert len(lines) == 1
        shutil.rmtree(broken)


def test_points_come_back_as_they_were(store: CampaignStore) -> None:
    points = np.array([[10.0, 20.0], [0.1 + 0.2, 30.0], [1e-3, -4.0]])
    with_points = replace(make_candidate(1), curvatures=np.empty(0), points=points)
    store.asked(with_points)
    assert_same_candidate(store.candidate(1), with_points)
    found = store.candidate(1).points
    assert found is not None
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 0.0
    with pytest.raises(ValueError, match="points of candidate 2"):
        store.asked(replace(with_points, id=2, points=np.array([[1.0, np.nan]])))


# Schema


@pytest.mark.parametrize("readonly", [False, True])
def test_an_older_schema_is_migrated_when_it_is_opened(
    finished: Path, monkeypatch: pytest.MonkeyPatch, readonly: bool
) -> None:
    note = ("ALTER TABLE campaign ADD COLUMN note TEXT", "UPDATE campaign SET note = 'new'")
    monkeypatch.setattr(store_module, "MIGRATIONS", (*MIGRATIONS, note))
    with (
        lock_file(finished / "campaign.lock"),
        pytest.raises(CampaignError, match=r"older version.*cannot be brought up to date"),
    ):
        CampaignStore.open(finished)
    with CampaignStore.open(finished, readonly=readonly) as store:
        assert store.counts().told == 10
        (version,) = store._connection.execute("PRAGMA user_version").fetchone()
        assert version == len(MIGRATIONS) + 1
    with CampaignStore.open(finished) as store:
        assert_same(store.test(4), make_record(4))


def test_a_campaign_of_the_first_version_is_read(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    for statement in (
        f"PRAGMA application_id = {APPLICATION_ID}",
        "PRAGMA user_version = 1",
        *MIGRATIONS[0],
        f"INSERT INTO campaign VALUES ('config', '{json.dumps(CONFIG)}')",
    ):
        execute(tmp_path / "old", statement)
    execute(tmp_path / "old", "INSERT INTO candidate VALUES (1, 'P1', '[]', 0, 10, x'', 0)")
    execute(
        tmp_path / "old",
        "INSERT INTO test VALUES (1, 1, 'INVALID', 'too sharp', 0, NULL, NULL, NULL, NULL, NULL,"
        " NULL, NULL, NULL, NULL, NULL, NULL, NULL, 0.5, '2026-01-01')",
    )
    with CampaignStore.open(tmp_path / "old") as store:
        record = store.test(1)
    assert (record.attempts, record.worker, record.elapsed) == (1, None, None)
    assert record.seconds == 0.5


def test_a_migration_that_breaks_changes_nothing(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = ("DELETE FROM trajectory", "no SQL")
    monkeypatch.setattr(store_module, "MIGRATIONS", (*MIGRATIONS, broken))
    with pytest.raises(CampaignError, match="syntax error"):
        CampaignStore.open(finished, readonly=False)
    monkeypatch.undo()
    with CampaignStore.open(finished) as store:
        assert_same(store.test(4), make_record(4))


# Several at once


def test_a_reader_follows_a_writer(store: CampaignStore) -> None:
    with CampaignStore.open(store.folder) as reader:
        for id in range(1, 6):  # noqa: A001
            store.asked(make_candidate(id))
            assert reader.counts().told == id - 1
            store.told(make_record(id))
            assert reader.counts().told == id
            assert_same(reader.test(id), make_record(id))
        tests = reader.tests()
        next(tests)
        tell(store, 6)  # a reader in the middle of something holds up nobody
        assert len(list(tests)) == 4


def test_held_results_are_one_transaction(store: CampaignStore) -> None:
    transactions: list[str] = []
    with CampaignStore.open(store.folder) as reader:
        store._connection.set_trace_callback(transactions.append)
        for id in (1, 2, 3):  # noqa: A001
            store.asked(make_candidate(id))
            store.told(make_record(id), hold=True)
        store.asked(make_candidate(4))
        assert reader.counts().told == 0
        store.write()
        assert (reader.counts().told, reader.counts().asked) == (3, 4)
        store.write()
        assert transactions.count("COMMIT") == 1
        assert_same(reader.test(3), make_record(3))
        places = [place for _, place in reader.candidates_with_place()]
        assert places == [0, 1, 2, 3]


def test_its_writer_sees_what_it_holds(store: CampaignStore) -> None:
    looks: list[Callable[[], float]] = [
        lambda: store.counts().told,
        lambda: len(list(store.tests())),
        lambda: store.test(3).told,
        lambda: store.elapsed() * 8,
        lambda: sum(1 for _ in store.rows("SELECT * FROM test")),
    ]
    for number, look in enumerate(looks, start=1):
        store.asked(make_candidate(number))
        store.told(make_record(number), hold=True)
        assert look() == number
    store.asked(make_candidate(6))
    store.told(make_record(6), hold=True)
    store.close()
    with CampaignStore.open(store.folder) as again:
        assert again.counts().told == 6


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )


OPEN_TO_WRITE = """
import sys
from pathlib import Path
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
try:
    CampaignStore.open(Path(sys.argv[1]), readonly=False).close()
except CampaignError as error:
    print(error)
"""


def test_a_second_writer_is_refused(store: CampaignStore) -> None:
    tell(store, 1)
    with pytest.raises(CampaignError, match="is being written by this process"):
        CampaignStore.open(store.folder, readonly=False)
    elsewhere = run_python(OPEN_TO_WRITE, store.folder)  # the refusal left our lock in place
    assert f"written by process {os.getpid()}" in elsewhere.stdout
    assert elsewhere.stdout.count("\n") == 1
    tell(store, 2)
    store.close()
    assert run_python(OPEN_TO_WRITE, store.folder).stdout == ""
    CampaignStore.open(store.folder, readonly=False).close()


def test_a_failed_opening_releases_the_lock(tmp_path: Path) -> None:
    (tmp_path / DATABASE).write_bytes(b"no database at all" * 500)
    for _ in range(2):
        with pytest.raises(CampaignError, match="is not a database"):
            CampaignStore.open(tmp_path, readonly=False)


# When things go wrong


def test_a_full_disk_loses_nothing_that_was_stored(store: CampaignStore) -> None:
    (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
    store._connection.execute(f"PRAGMA max_page_count = {pages + 8}").fetchone()
    stored = 0
    record = replace(make_record(4), trajectory=make_trajectory(4, records=500))
    with pytest.raises(CampaignError, match="the disk is full: free") as caught:  # noqa: PT012
        while stored < 1000:
            record = replace(record, candidate=make_candidate(stored + 1), told=stored + 1)
            store.asked(record.candidate)
            store.told(record)
            stored += 1
    assert DATABASE in one_line(caught)
    assert stored > 0
    assert store.counts().told == stored
    with pytest.raises(CampaignError, match="the disk is full"):
        store.told(record)
    store._connection.execute("PRAGMA max_page_count = 1000000").fetchone()
    store.told(record)  # space was made: the same record goes in, with its candidate
    assert [test.told for test in store.tests()] == list(range(1, stored + 2))


def test_on_a_full_disk_what_is_held_waits(store: CampaignStore) -> None:
    tell(store, 1)
    (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
    store._connection.execute(f"PRAGMA max_page_count = {pages}").fetchone()
    for id in range(2, 40):  # noqa: A001
        store.asked(make_candidate(id))
        store.told(make_record(id), hold=True)
    with pytest.raises(CampaignError, match="the disk is full"):
        store.write()
    with CampaignStore.open(store.folder) as reader:
        assert reader.counts().told == 1
    store._connection.execute("PRAGMA max_page_count = 1000000").fetchone()
    store.write()
    assert [test.told for test in store.tests()] == list(range(1, 40))


def test_closing_on_a_full_disk_still_closes(folder: Path) -> None:
    store = CampaignStore.create(folder, CONFIG)
    store._connection.execute("PRAGMA max_page_count = 1").fetchone()
    store.asked(make_candidate(1, samples=10_000))
    with pytest.raises(CampaignError, match="the disk is full"):
        store.close()
    with CampaignStore.open(folder, readonly=False) as again:
        assert again.counts().asked == 0


def test_an_error_under_way_is_not_hidden_by_closing(folder: Path) -> None:
    with pytest.raises(KeyError), CampaignStore.create(folder, CONFIG) as store:  # noqa: PT012
        store._connection.execute("PRAGMA max_page_count = 1").fetchone()
        store.asked(make_candidate(1, samples=10_000))
        raise KeyError


def test_a_database_locked_by_another_program(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "_BUSY_TIMEOUT", 0.0)
    other = sqlite3.connect(finished / DATABASE, isolation_level=None)
    try:
        with CampaignStore.open(finished, readonly=False) as store:
            other.execute("BEGIN IMMEDIATE")
            store.asked(make_candidate(11))
            with pytest.raises(CampaignError, match="in use by another program"):
                store.told(make_record(11))
            other.execute("ROLLBACK")
            store.told(make_record(11))
    finally:
        other.close()


WRITE_FOREVER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_store import make_candidate, make_record
from frenetic.campaign.store import CampaignStore
store = CampaignStore.open(Path(sys.argv[1]), readonly=False)
first = store.counts().asked + 1
for id in range(first, first + 100_000):
    store.asked(make_candidate(id))
    store.told(make_record(id))
    print(id, flush=True)
"""


def test_what_was_told_survives_a_kill(folder: Path) -> None:
    CampaignStore.create(folder, CONFIG).close()
    reported = 0
    for until in (1, 97, 40):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITE_FOREVER, str(folder), str(Path(__file__).parent)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        assert writer.stdout is not None
        with writer, writer.stdout:
            for _ in range(until):
                reported = int(writer.stdout.readline())
            writer.kill()  # whatever it is at by now
            lines = writer.stdout.read().splitlines(keepends=True)
            reported = max([reported, *(int(line) for line in lines if line.endswith("\n"))])
        with CampaignStore.open(folder) as store:
            (verdict,) = store._connection.execute("PRAGMA integrity_check").fetchone()
            assert verdict == "ok"
            told = [record.told for record in store.tests(with_trajectory=True)]
            assert told == list(range(1, len(told) + 1))
            assert len(told) in (reported, reported + 1)
            assert_same(store.test(reported), make_record(reported))
