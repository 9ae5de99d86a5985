"""The store of a campaign: round trips, readers and writers, damage, full disks."""

from __future__ import annotations

import re
import sqlite3
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

import numpy as np
import pytest
from campaigns import refused
from contents import execute, plain
from msgspec import to_builtins
from permissions import bound_by_permissions
from small_disk import Bounded, Breaking

from frenetic._support.json_value import JSONValue
from frenetic.campaign.check import check_campaign
from frenetic.campaign.columns import CANDIDATE_COLUMNS, TEST_COLUMNS
from frenetic.campaign.database import APPLICATION_ID, DATABASE, FORMAT
from frenetic.campaign.lock import lock_file
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.trajectory_codec import rounded
from frenetic.errors import CampaignError, Fault
from frenetic.oracle.drive import CarBody, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin, SourceTest
from frenetic.spec.terms import DriveSetting

pytest_plugins = ["campaign_fixtures"]

SETTING = DriveSetting(lane_width=4.0, map_size=200.0, map_margin=1.0, rules=Rules(), car=CarBody())
CONFIG: dict[str, JSONValue] = {
    "strategy": "frenetic",
    "seed": 7,
    **to_builtins(SETTING),
    "rules": Rules().as_json(),
}


def make_candidate(id: int, samples: int = 25) -> Candidate:  # noqa: A002
    curvatures = np.random.default_rng(id).uniform(-0.07, 0.07, samples)
    parents = () if id < 3 else (id - 1, id - 2)
    return Candidate(id, curvatures, 10.0, Origin("C1" if parents else "random", parents, id // 3))


def make_trajectory(seed: int, records: int = 60) -> Trajectory:
    steps = np.random.default_rng(seed).integers(-50, 50, size=(records, 11))
    return Trajectory.from_rows(np.cumsum(steps, axis=0) / 1000.0)


def make_test(id: int, outcome: Outcome | None = None, result_number: int | None = None) -> Test:  # noqa: A002
    """A test with the outcome of its turn, and MOOBDs that neither rise nor fall."""
    outcome = outcome or (Outcome.FAIL, Outcome.PASS, Outcome.INVALID, Outcome.ERROR)[id % 4]
    result, pose, path = Result(outcome, f"reason {id}: κ → θ"), None, None
    if outcome.is_driven:
        departure = Finding("lane", 0.97, 0.95, "left", 12.5, 118.25, 50.0, 60.0)
        findings = (departure,) if outcome is Outcome.FAIL else ()
        moobd = 0.5 - ((id * 37) % 11) / 10.0
        result = Result(outcome, result.reason, moobd, 120.5, 0.5, 24.95, 131.5, findings)
        pose, path = Pose(10.0 + id, 20.0, np.pi / 3), make_trajectory(id)
    return Test(
        candidate=make_candidate(id),
        result=result,
        pose=pose,
        trajectory=path,
        result_number=result_number or id,
        budget_spent=min(id / 100, 1.0),
        elapsed=id / 8,
    )


def add_tests(store: CampaignStore, *ids: int) -> None:
    """Add a candidate and a result for each id, and write them."""
    for id in ids:  # noqa: A001
        store.add_candidate(make_candidate(id))
        store.add_result(make_test(id))
    store.write()


def as_read(test: Test, setting: DriveSetting | None = SETTING) -> Any:
    """A test as the store returns it with its trajectory."""
    if (path := test.trajectory) is not None:
        test = replace(test, trajectory=rounded(path), records=len(path))
    return plain(replace(test, setting=setting))


def changed(record: Any, path: str, value: object) -> Any:
    """A copy of nested records with another value at a path like ``result.moobd``."""
    name, _, inner_path = path.partition(".")
    inner = changed(getattr(record, name), inner_path, value) if inner_path else value
    replaced: dict[str, Any] = {name: inner}
    return record._replace(**replaced) if isinstance(record, Pose) else replace(record, **replaced)


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
        add_tests(store, *range(1, 11))
    return folder


# Round trips

FULL = Test(
    candidate=Candidate(
        1,
        np.array([np.pi * 1e-2, -0.0, 5e-324, 0.07, np.nextafter(0.07, 1.0)]),
        10.0,
        Origin("C1", (4, 2), 3),
        points=np.array([[10.0, 20.0], [0.1 + 0.2, 30.0], [1e-3, -4.0]]),
        conditions={"fog": 60.0, "delay": -0.0},
        repeat=2,
        source=SourceTest("../runs/früher", 12),
        notes={"twin": {"role": "control", "drawn": 20, "moobd": None}, "kinds": [1, "x"]},
        superelevation=np.array([[0.0, 0.025], [30.0, -0.06]]),
        grade=np.array([[-0.0, np.nextafter(0.04, 1.0)]]),
        widening=np.array([[5.0, 0.25]]),
        speed_limits=np.array([[0.0, 50.0]]),
    ),
    result=Result(
        Outcome.FAIL,
        "two\nlines, \0 and \N{SNOWMAN}",
        -1.5,
        120.5,
        0.97,
        24.95,
        131.5,
        (
            Finding("lane", 0.97, 0.95, "left", 12.5, 118.25, 50.0, 60.0),
            Finding("speed", 21.5, 19.4, None, 13.0, 121.0, 51.0, 61.5),
            Finding("lane", 0.96, 0.95, "right", 14.0, 130.0, 52.0, 63.0),
        ),
        Fault("driver", "ValueError", "mpc.py", 42),
    ),
    pose=Pose(10.0, 20.0, np.pi / 3),
    trajectory=make_trajectory(1),
    worker="worker 1",
    seconds=0.125,
    reported_share=0.5,
    result_number=1,
    budget_spent=0.01,
    attempts=2,
    elapsed=0.25,
    finished_at="2026-01-02T03:04:05+00:00",
    objective=-0.75,
)
"""A test without default values: each column has another value."""


def with_numpy_numbers(test: Test) -> Test:
    """The same test with numbers of numpy, also in conditions and notes."""
    test = changed(test, "candidate.conditions", {"fog": np.float64(60.0)})
    test = changed(test, "candidate.notes", {"drawn": np.int64(3), "far": np.float32(0.5)})
    test = changed(test, "candidate.source.test", np.int64(3))
    for column in TEST_COLUMNS:
        if column.kind in ("REAL", "INTEGER") and column.name not in ("id", "records"):
            number = np.float64(0.25) if column.kind == "REAL" else np.int64(1)
            test = changed(test, column.path, number)
    finding = replace(test.result.findings[0], value=np.float64(0.99))
    return changed(test, "result.findings", (finding,))  # type: ignore[no-any-return]


def with_half_characters(test: Test) -> Test:
    """The same test with texts that are no valid Unicode."""
    half = "caf\udce9"
    test = changed(test, "result.reason", f"cannot open {half}")
    test = changed(test, "result.fault", Fault("simulator", "OSError", half, 1))
    test = changed(test, "candidate.source", SourceTest(half, 1))
    return changed(test, "candidate.notes", {"said": [half]})  # type: ignore[no-any-return]


CASES = {
    "every column": FULL,
    "numbers of numpy": with_numpy_numbers(FULL),
    "half characters": with_half_characters(FULL),
    "an empty road": replace(
        make_test(1, Outcome.INVALID), candidate=replace(make_candidate(1, 0), points=None)
    ),
    "points without a road": replace(
        make_test(1, Outcome.INVALID),
        candidate=replace(make_candidate(1, 0), points=np.array([[1.0, 2.0], [3.0, 4.0]])),
    ),
    "a failure without MOOBD and trajectory": changed(
        make_test(1, Outcome.INVALID), "result", Result(Outcome.FAIL, "it hit a wall")
    ),
    "a trajectory without records": changed(
        make_test(1, Outcome.ERROR), "trajectory", Trajectory.empty()
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_stored_tests_are_read_back_equal(folder: Path, name: str) -> None:
    test = CASES[name]
    with CampaignStore.create(folder, CONFIG) as store:
        store.add_candidate(test.candidate)
        store.add_result(test)
        assert plain(store.test(1)) == as_read(test)
    with CampaignStore.open(folder) as store:
        assert store.config == CONFIG
        (read,) = store.tests(with_trajectory=True)
        assert plain(read) == as_read(test)
        ((candidate, results_before),) = store.candidates()
        assert plain([candidate, store.candidate(1)]) == 2 * [as_read(test)["candidate"]]
        assert results_before == 0
        (without,) = store.tests()
        assert plain(without) == as_read(test) | {"trajectory": None}
        assert without.trajectory is None
        assert plain(store.trajectory(1)) == plain(read.trajectory)
        for array in (read.candidate.curvatures, read.candidate.points):
            assert array is None or not array.flags.writeable


def test_the_full_test_has_a_value_in_each_column(store: CampaignStore) -> None:
    store.add_candidate(FULL.candidate)
    store.add_result(FULL)
    (row,) = store.rows("SELECT * FROM test")
    assert None not in row


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_numbers_that_are_not_finite_are_refused(store: CampaignStore, value: float) -> None:
    candidate_columns = [
        column for column in CANDIDATE_COLUMNS if column.kind in ("REAL", "REALS", "PAIRS")
    ]
    for column in candidate_columns:
        bad = value if column.kind == "REAL" else np.full((3, 2)[: len(column.kind) - 3], value)
        with pytest.raises(ValueError, match=column.name):
            store.add_candidate(changed(FULL, column.path, bad).candidate)
    for name in ("conditions", "notes"):
        with pytest.raises(ValueError, match=name):
            store.add_candidate(changed(FULL.candidate, name, {"fog": value}))
    store.add_candidate(FULL.candidate)
    result_columns = [
        column
        for column in TEST_COLUMNS
        if column.kind == "REAL" and column not in candidate_columns
    ]
    for column in result_columns:
        with pytest.raises(ValueError, match=column.name):
            store.add_result(changed(FULL, column.path, value))
    (finding, *_) = FULL.result.findings
    with pytest.raises(ValueError, match="limit"):
        store.add_result(changed(FULL, "result.findings", (replace(finding, limit=value),)))
    store.add_result(FULL)
    assert plain(store.test(1)) == as_read(FULL)
    assert len(candidate_columns) + len(result_columns) > 12


def test_a_campaign_without_recorded_terms_can_be_read(folder: Path) -> None:
    with CampaignStore.create(folder, {"seed": 7}) as store:
        add_tests(store, 1)
        test = store.test(1)
        assert plain(test) == as_read(make_test(1), None)
        with refused("does not say with what test 1 was driven"):
            _ = test.road
        with refused(r"its configuration: .*lane_width"):
            _ = store.setting


# A store compared with plain lists


Candidates: TypeAlias = list[tuple[Candidate, int]]


def in_turn(values: Iterable[float | None]) -> float:
    """Return the sum of values, added in turn as a campaign does; `sum` may round less often."""
    total = 0.0
    for value in values:
        total += value or 0.0
    return total


def require_same(store: CampaignStore, candidates: Candidates, results: list[Test]) -> None:
    """Require that a store holds these candidates and results, in this order, and no others."""
    expected = [as_read(test) for test in results]
    assert plain(list(store.tests(with_trajectory=True))) == expected
    assert plain(list(store.candidates())) == plain(candidates)
    failed = [test["result_number"] for test in expected if test["result"]["outcome"] == "FAIL"]
    assert [test.result_number for test in store.tests(Outcome.FAIL, limit=2)] == failed[:2]
    moobds = sorted((test.moobd is None, test.moobd or 0.0) for test in results)
    by_moobd = [test.moobd for test in store.tests(order_by="moobd")]
    assert by_moobd == [None if is_missing else moobd for is_missing, moobd in moobds]
    counts = store.counts()
    assert counts.by_outcome == store.by_outcome()
    assert counts.by_outcome == {
        outcome: [t.outcome for t in results].count(outcome) for outcome in Outcome
    }
    assert counts.min_moobd == min(
        [moobd for is_missing, moobd in moobds if not is_missing], default=None
    )
    assert counts.roads == sum(test.outcome.is_test for test in results)
    assert counts.driven_metres == in_turn(test.result.distance for test in results)
    assert counts.simulated_seconds == in_turn(test.result.duration for test in results)
    assert store.elapsed() == max((test.elapsed for test in results), default=0.0)
    assert store.stored() == len(results)
    for test in results[-1:]:
        assert plain(store.test(test.id)) == expected[-1]
        assert plain(store.trajectory(test.id)) == expected[-1]["trajectory"]
    for candidate, _ in candidates[-1:]:
        assert plain(store.candidate(candidate.id)) == plain(candidate)


@pytest.mark.parametrize("seed", range(12))
def test_a_store_holds_all_candidates_and_results_after_broken_writes(
    folder: Path, breaking: type[Breaking], seed: int
) -> None:
    """Readers see whole transactions only; what was not written yet is written later."""
    rng = Random(seed)
    candidates: Candidates = []
    results: list[Test] = []
    waiting: list[int] = []
    written = 0, 0  # numbers of candidates and of results
    store, reader = CampaignStore.create(folder, CONFIG), CampaignStore.open(folder)
    deeds = ("ask", "ask", "tell", "tell", "write", "break", "break", "look", "reopen")
    for deed in rng.choices(deeds, k=30):
        if deed == "ask":
            last = candidates[-1][0].id if candidates else 0
            candidates.append((make_candidate(last + rng.randint(1, 2)), len(results)))
            waiting.append(candidates[-1][0].id)
            store.add_candidate(candidates[-1][0])
        elif deed == "tell" and waiting:
            id = waiting.pop(rng.randrange(len(waiting)))  # noqa: A001
            results.append(make_test(id, rng.choice([*Outcome, Outcome.FAIL]), len(results) + 1))
            store.add_result(results[-1])
        elif deed == "break":
            breaking.left, breaking.is_after = rng.choice([1, 2, 3, 4, 5, 6, 6]), rng.random() < 0.5
            errors = [KeyboardInterrupt(), sqlite3.OperationalError("disk I/O error")]
            breaking.error = errors[not breaking.is_after and rng.random() < 0.5]
            is_held, is_last = written != (len(candidates), len(results)), breaking.left == 6
            with pytest.raises((CampaignError, KeyboardInterrupt)) if is_held else nullcontext():
                store.write()
            breaking.left = 0
            if breaking.is_after and is_last:  # the commit came before the break
                written = len(candidates), len(results)
        elif deed in ("write", "look", "reopen"):
            if deed == "write":
                store.write()
            elif deed == "look":
                require_same(store, candidates, results)
            else:
                store.close()
                store = CampaignStore.open(folder, readonly=False)
            written = len(candidates), len(results)
        require_same(reader, candidates[: written[0]], results[: written[1]])
    store.close()
    reader.close()


# Reading


def test_a_reader_sees_the_results_of_the_moment_when_it_began(store: CampaignStore) -> None:
    count = 1200  # more rows than are read at once
    for id in range(1, count + 1):  # noqa: A001
        store.add_candidate(make_candidate(id, 2))
        store.add_result(make_test(id, Outcome.INVALID))
    store.write()
    with CampaignStore.open(store.folder) as reader:
        writer_tests, tests, candidates = store.tests(), reader.tests(), reader.candidates()
        assert [next(iterator).result_number for iterator in (writer_tests, tests)] == [1, 1]
        add_tests(store, count + 1)
        assert [test.result_number for test in writer_tests] == list(range(2, count + 1))
        assert [test.result_number for test in tests] == list(range(2, count + 1))
        assert [candidate.id for candidate, _ in candidates] == list(range(1, count + 1))
        assert plain(reader.test(count + 1)) == as_read(make_test(count + 1))


def test_facts_are_replaced(folder: Path) -> None:
    facts: dict[str, JSONValue] = {"earlier_settings": {"a": 1}, "pi": 3.25}
    with CampaignStore.create(folder, CONFIG, facts) as store:
        assert store.facts.keys() == {"created_at", "pi"}
        store.finish(seconds=1.5, ended="budget")
        store.finish(seconds=np.float64(2.5))
        with pytest.raises(ValueError, match="JSON"):
            store.finish(rate=float("nan"))
    with CampaignStore.open(folder, readonly=False) as store:
        assert store.fact("earlier_settings") == {"a": 1}
        assert store.facts.keys() == {"created_at", "pi", "finished_at", "seconds", "ended"}
        assert store.facts["seconds"] == 2.5
        assert store.fact("nothing") is None
        store.reopen(resumed=True)
        assert store.facts.keys() == {"created_at", "pi", "resumed"}


# Misuse


def test_unknown_ids_are_refused_and_numpy_ids_are_accepted(store: CampaignStore) -> None:
    with refused("no test of candidate 1: there are none so far"):
        store.test(1)
    add_tests(store, 1)
    store.add_candidate(make_candidate(2))
    store.add_result(make_test(2))
    store.add_candidate(make_candidate(4))
    for unknown in (0, -1, 4, 99, 10**30):
        with refused(f"no test .* {unknown}: ids run from 1 to 2"):
            store.test(unknown)
    with refused("no candidate 5: ids run from 1 to 4"):
        store.candidate(5)
    number: Any = np.int64(1)
    assert store.test(number).id == store.candidate(number).id == 1
    assert store.trajectory(number) is not None
    assert [test.id for test in store.tests(limit=number)] == [1]


def test_a_candidate_with_an_old_id_is_refused(finished: Path) -> None:
    with CampaignStore.open(finished, readonly=False) as store:
        for id in (1, 10):  # noqa: A001
            with refused("already holds candidate 10"):
                store.add_candidate(make_candidate(id))


def test_a_second_writer_is_refused_and_nothing_is_overwritten(store: CampaignStore) -> None:
    add_tests(store, 1)
    with refused("is being written by this process"):
        CampaignStore.open(store.folder, readonly=False)
    add_tests(store, 2)
    store.close()
    store.close()
    before = (store.folder / DATABASE).read_bytes()
    with refused(r"already holds a campaign; choose another place") as caught:
        CampaignStore.create(store.folder, CONFIG)
    assert str(store.folder) in str(caught.value)
    assert (store.folder / DATABASE).read_bytes() == before
    CampaignStore.open(store.folder, readonly=False).close()


def test_a_reader_and_a_closed_store_refuse_to_write(finished: Path) -> None:
    with CampaignStore.open(finished) as store:
        writes: list[Callable[[], None]] = [
            lambda: store.add_candidate(make_candidate(11)),
            store.finish,
            store.reopen,
        ]
        for write in writes:
            with refused("opened for reading"):
                write()
        with refused("readonly"):
            list(store.rows("DELETE FROM test"))
    store.close()
    for use in (lambda: store.test(1), store.counts, lambda: store.tests(), lambda: store.facts):
        with refused("closed"):
            use()


# Folders


def test_a_campaign_exists_once_it_is_complete_and_is_never_replaced(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for config in ({"seed": object()}, {"rate": float("nan")}):
        with pytest.raises(ValueError, match="JSON"):
            CampaignStore.create(folder, config)  # type: ignore[arg-type]
    assert not folder.exists()
    folder.mkdir(parents=True)
    (folder / f"{DATABASE}.new").write_bytes(b"left over from a power cut")
    with refused("holds no campaign"):
        CampaignStore.open(folder)

    def lock_late(path: Path) -> Any:
        (folder / DATABASE).write_bytes(b"of somebody who was faster")
        return lock_file(path)

    with monkeypatch.context() as patch, refused("already holds a campaign"):
        patch.setattr("frenetic.campaign.store.lock_file", lock_late)
        CampaignStore.create(folder, CONFIG)
    assert (folder / DATABASE).read_bytes() == b"of somebody who was faster"
    (folder / DATABASE).unlink()
    CampaignStore.create(folder, CONFIG).close()
    assert sorted(path.name for path in folder.iterdir()) == ["campaign.lock", DATABASE]


def test_unusable_folders_are_named_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("precious")
    for below in ("file", "file/deeper", "x" * 5000):
        with refused("cannot make the folder .*choose another place"):
            CampaignStore.create(tmp_path / below, CONFIG)
    for name, message in (
        ("nowhere", "does not exist"),
        ("", "holds no campaign"),
        ("file", "is not a folder"),
    ):
        for readonly in (True, False):
            with refused(f"{tmp_path / name} {message}"):
                CampaignStore.open(tmp_path / name, readonly)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["precious"]


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no such permissions there")
def test_a_folder_without_write_permission_can_be_read_but_not_created(
    finished: Path, tmp_path: Path
) -> None:
    unwritable = tmp_path / "shut"
    unwritable.mkdir()
    unwritable.chmod(0o555)
    finished.chmod(0o555)
    try:
        with bound_by_permissions(unwritable, finished):
            for folder in (unwritable, unwritable / "below"):
                with refused("ermission"):
                    CampaignStore.create(folder, CONFIG)
            with CampaignStore.open(finished) as store:  # reading needs no permission to write
                assert store.counts().result_count == 10
    finally:
        unwritable.chmod(0o755)
        finished.chmod(0o755)


# Databases that are not ours, or damaged


def foreign_database(path: Path, application_id: int, version: int) -> bytes:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE precious (x)")
        connection.execute(f"PRAGMA application_id = {application_id}")
        connection.execute(f"PRAGMA user_version = {version}")
    return path.read_bytes()


@pytest.mark.parametrize("readonly", [True, False])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ((0, 0), "is not a campaign's database"),
        ((42, FORMAT), "is not a campaign's database"),
        ((APPLICATION_ID, FORMAT - 1), "has format 8, .* reads format 9: use the version"),
        ((APPLICATION_ID, FORMAT + 1), "has format 10, .* reads format 9: use the version"),
        (b"no database at all" * 500, "is not a database"),
        (b"", "is not a campaign's database"),
        (b"SQLite format 3\0" + b"x" * 84, "is not a"),
    ],
)
def test_foreign_databases_are_refused_and_left_alone(
    tmp_path: Path, content: tuple[int, int] | bytes, message: str, readonly: bool
) -> None:
    path = tmp_path / DATABASE
    if isinstance(content, bytes):
        path.write_bytes(content)
    before = content if isinstance(content, bytes) else foreign_database(path, *content)
    for _ in range(2):  # the first refusal released the lock
        with refused(message) as caught:
            CampaignStore.open(tmp_path, readonly)
        assert str(path) in str(caught.value)
    assert path.read_bytes() == before


DAMAGE = [
    ("UPDATE test SET outcome = 'MAYBE' WHERE id = 4", "test 4: .*'MAYBE'.*outcome"),
    ("UPDATE test SET moobd = 9e999 WHERE id = 4", "test 4: .*moobd"),
    ("UPDATE test SET x = NULL WHERE id = 4", "test 4: .*pose"),
    ("UPDATE test SET seconds = -1.0 WHERE id = 4", "test 4: .*seconds"),
    ("UPDATE test SET parents = '[1, ' WHERE id = 4", "test 4: "),
    ("UPDATE test SET parents = '[1.5]' WHERE id = 4", "test 4: .*parents"),
    ("UPDATE test SET parents = hex(zeroblob(9)) WHERE id = 4", "test 4: "),
    ("UPDATE test SET conditions = '[]' WHERE id = 4", "test 4: .*conditions"),
    ('UPDATE test SET fault = \'{"part": "road"}\' WHERE id = 4', "test 4: .*fault"),
    ("UPDATE test SET curvatures = x'00' WHERE id = 4", "test 4: "),
    ("UPDATE test SET curvatures = x'000000000000f07f' WHERE id = 4", "curvatures .* finite"),
    ("UPDATE test SET points = x'0000000000000000' WHERE id = 4", "test 4: "),
    ("UPDATE finding SET side = 'up' WHERE test = 4", "test 4: .*side"),
    ("DROP TABLE finding", "no such table"),
    ("ALTER TABLE test RENAME worker TO other", "no such column"),
    ("UPDATE test SET trajectory = x'' WHERE id = 4", "test 4: .*trajectory"),
    ("UPDATE test SET trajectory = zeroblob(99) WHERE id = 4", "test 4: .*trajectory"),
    ("UPDATE test SET trajectory = NULL WHERE id = 4", "trajectory of test 4 is gone"),
    ("UPDATE test SET reason = CAST(x'ff41' AS TEXT) WHERE id = 4", "not decode to UTF-8"),
]
"""Statements that damage the test 4, and the message about the damage."""


@pytest.mark.parametrize(("statement", "message"), DAMAGE)
def test_readers_and_the_check_name_damage_and_other_tests_can_be_read(
    finished: Path, statement: str, message: str
) -> None:
    execute(finished, statement)
    findings = check_campaign(finished).findings
    assert re.search(message, "\n".join(findings)), findings
    assert "\n" not in "".join(findings)
    with CampaignStore.open(finished) as store:
        with refused(message) as caught:
            list(store.tests(with_trajectory=True))
        assert str(finished) in str(caught.value)
        with pytest.raises(CampaignError):
            store.test(4)
        if not statement.startswith(("DROP", "ALTER")):
            assert plain(store.test(5)) == as_read(make_test(5))


def test_a_row_that_is_deleted_while_rows_are_read_is_reported(finished: Path) -> None:
    with CampaignStore.open(finished) as store:
        tests, candidates = store.tests(), store.candidates()
        execute(finished, "DELETE FROM test WHERE id = 7")
        for read in (tests, candidates):
            with refused("candidate 7 is missing"):
                list(read)


@pytest.mark.parametrize("value", ["[", "[]", "null", "[" * 100_000, None])
def test_a_damaged_or_missing_configuration_is_refused(finished: Path, value: str | None) -> None:
    if value is None:
        execute(finished, "DELETE FROM fact WHERE name = 'config'")
    else:
        execute(finished, "UPDATE fact SET value = ? WHERE name = 'config'", value)
    for readonly in (True, False):
        with refused("config"):
            CampaignStore.open(finished, readonly)


# Full disks and locks


@pytest.fixture
def limit_pages(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Limit how many pages databases opened from now on may grow; 0: no limit."""
    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Bounded))
    with monkeypatch.context() as context:
        yield lambda pages: context.setattr(Bounded, "pages", pages or None)


def test_a_full_disk_loses_no_result(folder: Path, limit_pages: Callable[[int], None]) -> None:
    def fill(store: CampaignStore, number: int) -> None:
        store.add_candidate(make_candidate(number))
        store.add_result(make_test(number, Outcome.FAIL))
        store.write()

    with CampaignStore.create(folder, CONFIG) as store:
        limit_pages(40)
        with refused(f"{DATABASE} .*the disk is full: free"):
            for number in range(1, 1000):
                fill(store, number)
        for extra in range(1, 4):
            with refused("the disk is full"):
                fill(store, number + extra)
        assert store.stored() == number - 1 > 3
        limit_pages(0)  # there is space again: all that waited is written
        store.write()
        expected = [as_read(make_test(test_id, Outcome.FAIL)) for test_id in range(1, number + 4)]
        assert plain(list(store.tests(with_trajectory=True))) == expected


def test_closing_on_a_full_disk_still_closes_and_hides_no_other_error(
    folder: Path, limit_pages: Callable[[int], None]
) -> None:
    with pytest.raises(KeyError), CampaignStore.create(folder, CONFIG) as store:  # noqa: PT012
        limit_pages(1)
        store.add_candidate(make_candidate(1, samples=10_000))
        raise KeyError
    store = CampaignStore.open(folder, readonly=False)
    store.add_candidate(make_candidate(1, samples=10_000))
    with refused("the disk is full"):
        store.close()
    with CampaignStore.open(folder, readonly=False) as reopened:
        assert list(reopened.candidates()) == []


def test_a_database_locked_by_another_program_is_written_later(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = sqlite3.connect
    monkeypatch.setattr(
        sqlite3,
        "connect",
        lambda *arguments, **options: connect(*arguments, **(options | {"timeout": 0.0})),
    )
    with (
        closing(sqlite3.connect(finished / DATABASE, isolation_level=None)) as other,
        CampaignStore.open(finished, readonly=False) as store,
    ):
        other.execute("BEGIN IMMEDIATE")
        with refused("in use by another program"):
            add_tests(store, 11)
        other.execute("ROLLBACK")
        store.write()
        assert plain(store.test(11)) == as_read(make_test(11))
