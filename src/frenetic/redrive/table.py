"""The tables of a campaign's database for roads that were driven again.

Each run is a row of ``redrive_run``, each drive one of ``redrive``. They have their own connection
and a short transaction per drive, so SQLite's locks let a campaign, and others that drive again,
write meanwhile. Side files of older versions are read into the tables once.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import logging
import sqlite3
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self, TypeVar

from msgspec import convert
from msgspec.json import decode as decode_json

from frenetic._support.words import present_moment
from frenetic.campaign.record import (
    CANDIDATE_COLUMNS,
    TEST_COLUMNS,
    Column,
    Kind,
    RowError,
    TestRecord,
    checksum_fault,
    read_row,
    with_checksum,
)
from frenetic.campaign.store import (
    DATABASE,
    CampaignStore,
    Owner,
    connect_to_write,
    find_database,
    transaction,
    translated,
)
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.errors import CampaignError, FreneticError
from frenetic.fingerprint import comparison_key
from frenetic.outcome import Outcome
from frenetic.redrive.conditions import Variation, conditions_document, read_conditions
from frenetic.redrive.record import Purpose, Redrive, Run
from frenetic.simulators.drive import CarBody, Rules
from frenetic.simulators.worlds import USUAL

T = TypeVar("T")

logger = logging.getLogger(__name__)

_VERDICT: Final = {
    **{
        name: TEST_COLUMNS[name]
        for name in (
            "outcome",
            "reason",
            "moobd",
            "max_oob_share",
            "duration",
            "departure_distance",
            "departure_side",
        )
    },
    "seconds": replace(TEST_COLUMNS["seconds"], optional=True),
}
_COLUMNS: Final[Mapping[str, Column]] = MappingProxyType(
    {
        "run": Column("run", Kind.WHOLE, "in which it was driven"),
        "number": Column("number", Kind.WHOLE, "counts the drives of a run from 1"),
        "test": Column("test", Kind.WHOLE, "whose road it is"),
        "step": replace(CANDIDATE_COLUMNS["step"], optional=True),
        "curvatures": replace(CANDIDATE_COLUMNS["curvatures"], optional=True),
        "conditions": Column("conditions", Kind.TEXT, "in which it was driven, JSON"),
        **_VERDICT,
    }
)
_DIFFERENCE: Final = Column("difference", Kind.REAL, "from the recorded failure", "m", True)
_RUN: Final = "purpose, driver, simulator, rules, car, planned, seed, variations, source, made_at"
# {} is the column of checksums, NULL in older schemas.
_SELECT_RUNS: Final = f"""
    SELECT id, {_RUN}, {{}} FROM redrive_run WHERE purpose = ? ORDER BY id
"""  # noqa: S608
_STORED_COLUMNS: Final = "SELECT name FROM pragma_table_info('redrive')"
# {} are the columns of differences and checksums, likewise.
_SELECT_DRIVES: Final = f"""
    SELECT {", ".join(_COLUMNS)}, trajectory, {{}}, {{}} FROM redrive
    WHERE run IN (SELECT id FROM redrive_run WHERE purpose = ?) ORDER BY run, number
"""  # noqa: S608
_INSERT_RUN: Final = f"""
    INSERT INTO redrive_run ({_RUN}, checksum)
    VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
"""  # noqa: S608
_INSERT_DRIVE: Final = f"""
    INSERT INTO redrive ({", ".join(_COLUMNS)}, trajectory, difference, checksum)
    VALUES ({", ".join("?" * (len(_COLUMNS) + 3))})
"""  # noqa: S608
# An ended run replaces a test's drives of older runs for the same purpose with the same parts and
# ranges, unless more of those were judged: an interrupted run replaces nothing complete.
_REPLACED: Final = """
    SELECT older.id FROM redrive_run AS older JOIN redrive_run AS this USING (purpose, variations)
    WHERE comparable(older.driver) = comparable(this.driver)
        AND comparable(older.simulator) = comparable(this.simulator)
        AND this.id = :run AND older.id < this.id AND older.ended_at IS NOT NULL
        AND (older.rules IS this.rules OR older.rules IS NULL)
"""
_DELETE_DRIVES: Final = f"""
    WITH judged AS (
        SELECT run, test, sum(outcome IN ('PASS', 'FAIL')) AS drives FROM redrive GROUP BY run, test
    )
    DELETE FROM redrive WHERE (run, test) IN (
        SELECT older.run, test FROM judged AS older JOIN judged AS this USING (test)
        WHERE this.run = :run AND older.run IN ({_REPLACED}) AND this.drives >= older.drives
    )
"""  # noqa: S608
_DELETE_UNJUDGED: Final = """
    DELETE FROM redrive WHERE run IN
        (SELECT id FROM redrive_run WHERE id = :run AND purpose = 'robustness')
        AND test NOT IN
            (SELECT test FROM redrive WHERE run = :run AND outcome IN ('PASS', 'FAIL'))
"""
_END_RUN: Final = "UPDATE redrive_run SET ended_at = :now WHERE id = :run"
_DELETE_RUNS: Final = """
    DELETE FROM redrive_run WHERE source IS NULL AND ended_at IS NOT NULL
        AND id NOT IN (SELECT run FROM redrive)
"""


def read_runs(folder: Path | str, purpose: Purpose) -> list[Run]:
    """The runs for a purpose, oldest first.

    Raises:
        CampaignError: the database, or a file of an older version, is damaged, or a newer version
            of frenetic has written it.
    """
    folder = Path(folder)
    file = SIDE_FILES.get(purpose)
    if not any((folder / name).exists() for name in (DATABASE, *([file.name] if file else []))):
        return []
    with CampaignStore.open(folder) as store:
        runs = take_in_side_file(store, purpose)
        if stored := {name for (name,) in store.rows(_STORED_COLUMNS)}:
            runs += _read_runs(store, purpose, stored)
    return runs


def latest(
    items: Iterable[T], key: Callable[[T], Hashable], judged: Callable[[T], int]
) -> tuple[T, ...]:
    """The item with each key that holds most judged drives, the last of equals, in their order."""
    last: dict[Hashable, T] = {}
    for item in items:
        if (name := key(item)) in last and judged(item) < judged(last[name]):
            continue
        last.pop(name, None)  # so that it stands where it was last driven
        last[name] = item
    return tuple(last.values())


def merged(runs: Iterable[Run]) -> list[Run]:
    """Runs that drive a test once: one for the same parts and rules, the last at the end."""
    alike: dict[Hashable, list[Run]] = {}
    for run in runs:
        key = comparison_key(run.driver, run.simulator), run.rules
        alike[key] = [*alike.pop(key, []), run]
    return [replace(own[-1], drives=_latest_drives(own)) for own in alike.values()]


def _latest_drives(runs: Iterable[Run]) -> tuple[Redrive, ...]:
    drives = (drive for run in runs for drive in run.drives)
    return latest(drives, lambda drive: drive.test_id, lambda drive: drive.outcome.is_driven)


def _read_runs(store: CampaignStore, purpose: Purpose, stored: Collection[str]) -> list[Run]:
    """The runs in the database, whose table of drives has the ``stored`` columns."""
    path = store.folder / DATABASE
    runs: dict[int, Run] = {}
    for number, *parts in store.rows(_SELECT_RUNS.format(store.checksum_column), (purpose,)):
        with _damaged(path, f"run {number} of what was driven again"):
            runs[number] = _to_run(purpose, *parts[1:8])
            _require_checksum(parts)
    drives: dict[int, list[Redrive]] = {number: [] for number in runs}
    records: dict[int, TestRecord] = {}
    difference = _DIFFERENCE.name if _DIFFERENCE.name in stored else "NULL"
    for row in store.rows(_SELECT_DRIVES.format(difference, store.checksum_column), (purpose,)):
        data = row[-3]
        with _damaged(path, f"drive {row[1]} of run {row[0]} of what was driven again"):
            values = read_row(_COLUMNS, row[:-3])
            values["difference"] = _DIFFERENCE.read(row[-2])
            _require_checksum(row)
            run, test = values.pop("run"), values.pop("test")
            if test not in records:
                records[test] = store.test(test, with_trajectory=False)
            del values["number"]
            values["outcome"] = Outcome(values["outcome"])
            values["conditions"] = read_conditions(decode_json(values["conditions"]))
            values["trajectory"] = None if data is None else decode(data)
            drives[run].append(Redrive(records[test], **values))
    return [replace(run, drives=tuple(drives[number])) for number, run in runs.items()]


def _require_checksum(row: Sequence[object]) -> None:
    if fault := checksum_fault(row):
        raise ValueError(f"it {fault}")


def _to_run(purpose: Purpose, *values: Any) -> Run:
    driver, simulator, rules, car, planned, seed, variations = values
    return Run(
        purpose,
        decode_json(driver, type=dict[str, Any]),
        decode_json(simulator, type=dict[str, Any]),
        None if rules is None else decode_json(rules, type=Rules),
        None if car is None else decode_json(car, type=CarBody),
        convert(planned, int),
        convert(seed, int | None),
        tuple(map(Variation.read, decode_json(variations, type=list[Any]))),
    )


@contextmanager
def _damaged(path: Path, what: str) -> Iterator[None]:
    """Turns the faults of a row into a `CampaignError`."""
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError, RowError) as error:
        raise CampaignError(
            f"{path} is damaged: {what}: {error}; restore it from a copy, or drive again"
        ) from None


def _comparable(described: object) -> str | None:
    """A described part for SQL; None if it is damaged."""
    try:
        return comparison_key(json.loads(str(described)))
    except (ValueError, RecursionError):
        return None


class RunWriter:
    """Stores the drives of a run as they come; a context manager.

    The run begins with its first drive. At the end it replaces older drives of its tests with the
    same parts and ranges, unless more of those were judged.

    Args:
        folder: of the campaign.
        purpose: of the run.
        describe: describes the run, once its simulator has started.
        optional: whether to go on if the run cannot be stored.

    Raises:
        CampaignError: the database cannot be written, or a file of an older version is damaged.
    """

    def __init__(
        self,
        folder: Path | str,
        purpose: Purpose,
        describe: Callable[[], Run],
        *,
        optional: bool = False,
    ) -> None:
        self._path = find_database(Path(folder))
        self._describe = describe
        self._optional = optional
        self._connection: sqlite3.Connection | None = None
        self._run: int | None = None
        with CampaignStore.open(folder) as store:
            take_in_side_file(store, purpose)
        with self._trying(), translated(self._path):
            self._connection = connect_to_write(self._path)
            self._owner = Owner(self._connection)
            self._connection.create_function("comparable", 1, _comparable, deterministic=True)

    def add(self, number: int, drive: Redrive) -> None:
        """Stores drive ``number`` of the run, durably.

        Raises:
            CampaignError: it cannot be written.
        """
        connection = self._connection
        if connection is None:
            return
        self._owner.require(self._path)
        with self._trying(), translated(self._path), transaction(connection):
            if self._run is None:
                self._run = _insert_run(connection, self._describe())
            _insert_drive(connection, self._run, number, drive)

    @contextmanager
    def _trying(self) -> Iterator[None]:
        try:
            yield
        except CampaignError as error:
            if not self._optional:
                raise
            logger.warning("what is driven is not stored: %s", error)
            self._close()

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        if self._connection is not None and not self._owner.is_here:
            return
        try:
            if self._connection is not None and self._run is not None:
                with (
                    suppress(*([] if error is None else [CampaignError])),
                    self._trying(),
                    translated(self._path),
                    transaction(self._connection),
                ):
                    run = {"run": self._run, "now": present_moment()}
                    for statement in (_END_RUN, _DELETE_DRIVES, _DELETE_UNJUDGED):
                        self._connection.execute(statement, run)
                    self._connection.execute(_DELETE_RUNS)
        finally:
            self._close()


def take_in_side_file(store: CampaignStore, purpose: Purpose) -> list[Run]:
    """Reads an older version's file into the database, once, and renames the file.

    Returns:
        Its contents, where the database cannot be written.

    Raises:
        CampaignError: it is damaged, or a newer version of frenetic has written it.
    """
    file = SIDE_FILES.get(purpose)
    path = store.folder / ("" if file is None else file.name)
    if file is None or not path.exists():
        return []
    runs, digest = file.read(store)
    try:
        _take_in(store.folder / DATABASE, runs, f"{file.name} {digest}")
    except CampaignError as error:
        logger.debug("%s stays as it is: %s", path, error)
        return runs
    with suppress(OSError):  # else it is known by its digest
        path.replace(path.with_name(f"{file.name}{READ}"))
    return []


def _take_in(path: Path, runs: list[Run], source: str) -> None:
    with translated(path):
        connection = connect_to_write(path)
    try:
        with translated(path), transaction(connection):
            known = "SELECT 1 FROM redrive_run WHERE source = ?"
            if connection.execute(known, (source,)).fetchone() is not None:
                return
            for run in runs:
                number = _insert_run(connection, run, source)
                for i, drive in enumerate(run.drives, start=1):
                    _insert_drive(connection, number, i, drive)
    finally:
        connection.close()


def _insert_run(connection: sqlite3.Connection, run: Run, source: str | None = None) -> int:
    values = (
        str(run.purpose),
        *(json.dumps(part, sort_keys=True) for part in (dict(run.driver), dict(run.simulator))),
        *(
            None if numbers is None else json.dumps(asdict(numbers))
            for numbers in (run.rules, run.car)
        ),
        run.planned,
        run.seed,
        json.dumps(sorted(map(asdict, run.variations), key=lambda one: str(one["quantity"]))),
        source,
        present_moment(),
    )
    number = connection.execute(_INSERT_RUN, with_checksum(values)).lastrowid
    assert number is not None
    if source is not None:
        connection.execute("UPDATE redrive_run SET ended_at = made_at WHERE id = ?", (number,))
    return number


def _insert_drive(connection: sqlite3.Connection, run: int, number: int, drive: Redrive) -> None:
    verdict = [getattr(drive, name) for name in _VERDICT]
    verdict[0] = str(drive.outcome)
    values = (
        run,
        number,
        drive.test_id,
        drive.step,
        None if drive.curvatures is None else drive.curvatures.astype("<f8").tobytes(),
        json.dumps(conditions_document(drive.conditions)),
        # numpy's numbers would be stored as blobs
        *(value if value is None or isinstance(value, str) else float(value) for value in verdict),
        None if drive.trajectory is None else encode(drive.trajectory),
        drive.difference,
    )
    connection.execute(_INSERT_DRIVE, with_checksum(values))


# Side files of older versions

READ: Final = ".read"
"""Suffix of a file that has been read."""


@dataclass(frozen=True)
class SideFile:
    """A file in a campaign's folder that holds a list of items."""

    name: str
    key: str
    """Name of the list in the file's JSON object."""
    maker: str
    """The command that made it, and makes it again."""
    read_item: Callable[[Any, CampaignStore], Run]

    def read(self, store: CampaignStore) -> tuple[list[Run], str]:
        """Its contents and digest.

        Raises:
            CampaignError: it cannot be read, is damaged, or was written by a newer version.
        """
        path = store.folder / self.name
        try:
            data = path.read_bytes()
            document = decode_json(data)
        except OSError as error:
            raise CampaignError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError):
            raise self._damaged(store, "it is not JSON") from None
        version = document.get("version") if isinstance(document, dict) else None
        if isinstance(version, int) and version > _VERSION:
            raise CampaignError(
                f"{path} was written by a newer version of frenetic (form {version}, this one reads"
                f" {_VERSION}): upgrade frenetic"
            )
        try:
            if version != _VERSION:
                raise ValueError(f"its version is {version!r}")
            runs = [self.read_item(item, store) for item in document[self.key]]
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
            raise self._damaged(store, f"{type(error).__name__}: {error}") from None
        except FreneticError as error:
            raise self._damaged(store, str(error)) from None
        return runs, hashlib.sha256(data).hexdigest()

    def _damaged(self, store: CampaignStore, what: str) -> CampaignError:
        return CampaignError(
            f"{store.folder / self.name} is damaged ({what[:200]}): remove it, and let"
            f" '{self.maker}' make it again"
        )


_VERSION: Final = 1  # of the form of these files


def _rerun(item: Any, store: CampaignStore) -> Run:
    test_id = convert(item["test"], int)
    _repeat(item["recorded"])
    drives = [_repeat(drive) for drive in item["drives"]]
    variations = [Variation.read(one) for one in item["variations"]]
    recorded = store.test(test_id, with_trajectory=False)
    return Run(
        Purpose.ROBUSTNESS,
        dict(item["driver"]),
        dict(item["simulator"]),
        planned=len(drives),
        seed=convert(item["seed"], int),
        variations=tuple(variations),
        drives=tuple(Redrive(recorded, **drive) for drive in drives),
    )


def _repeat(item: Any) -> dict[str, Any]:
    trouble = convert(item["trouble"], str | None)
    conditions = read_conditions(item["world"])
    return {**_verdict(item), "conditions": conditions, "reason": trouble or ""}


def _confirmation(item: Any, store: CampaignStore) -> Run:
    simulator, driver = _described(item["simulator"]), _described(item["driver"])
    drives = [_confirmed(one, store) for one in item["tests"]]
    return Run(
        Purpose.CONFIRMATION,
        driver,
        simulator,
        convert(item["rules"], Rules),
        convert(item["car"], CarBody),
        planned=len(drives) + convert(item["missing"], int),
        drives=tuple(drives),
    )


def _confirmed(item: Any, store: CampaignStore) -> Redrive:
    packed = item["trajectory"]
    try:
        trajectory = None if packed is None else decode(base64.b64decode(packed, validate=True))
    except binascii.Error as error:
        raise ValueError(f"a trajectory is no base64: {error}") from None
    _verdict(item["recorded"])
    return Redrive(
        conditions=USUAL,
        **_verdict(item["other"]),
        reason=str(item["reason"]),
        trajectory=trajectory,
        recorded=store.test(convert(item["test"], int), with_trajectory=False),
    )


def _described(part: Any) -> dict[str, Any]:
    if not isinstance(part, dict) or not isinstance(part.get("class"), str):
        raise TypeError("a part without a class")
    return part


def _verdict(item: Any) -> dict[str, Any]:
    names = ("outcome", "moobd", "departure_distance", "departure_side")
    values = {name: TEST_COLUMNS[name].read(item[name]) for name in names}
    return {**values, "outcome": Outcome(values["outcome"])}


SIDE_FILES: Final[Mapping[Purpose, SideFile]] = MappingProxyType(
    {
        Purpose.ROBUSTNESS: SideFile("reruns.json", "reruns", "frenetic rerun", _rerun),
        Purpose.CONFIRMATION: SideFile(
            "confirmations.json", "confirmations", "frenetic confirm", _confirmation
        ),
    }
)
"""Purpose of driving again -> the file with its drives."""
