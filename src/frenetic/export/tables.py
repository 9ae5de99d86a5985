"""A campaign's tests and trajectories as tables, read many rows at a time.

The columns, the same in every format, are those of tests in `frenetic.campaign.record`, three that
are made of them, and the objective, which has a table of its own. One batch is in memory at a time,
however large the campaign. A damaged value is a `CampaignError` that names the test.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import CANDIDATE_COLUMNS, TEST_COLUMNS
from frenetic.campaign.record import Column as Column
from frenetic.campaign.record import Kind as Kind
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.campaign.trajectory_codec import RESOLUTIONS, decode_columns
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.spec import shown

IntArray: TypeAlias = npt.NDArray[np.int64]
Which: TypeAlias = Literal["all", "failures", "none"]
"""Choice of tests whose trajectories are exported."""

DERIVED: Final = (
    Column("length", Kind.REAL, "of the road", "m"),
    Column("curvature_count", Kind.WHOLE, "number of curvatures"),
    Column("max_curvature", Kind.REAL, "largest curvature, without its sign", "1/m", True),
)
"""Columns of tests that are not stored."""
OBJECTIVE: Final = Column(
    "objective", Kind.REAL, "what the search minimised, if it is not the MOOBD", "", True
)

_BY_NAME: Final = {
    **TEST_COLUMNS,
    **CANDIDATE_COLUMNS,
    **{column.name: column for column in (*DERIVED, OBJECTIVE)},
}
_ORDER: Final = """
    id told outcome reason operator parents generation asked_after
    length curvature_count max_curvature curvatures step x y heading
    moobd moobd_distance max_oob_share objective duration
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
"""

TESTS: Final = tuple(_BY_NAME[name] for name in _ORDER.split())
"""The table of tests: one row per candidate that was told."""

_DRIVEN: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "time": ("since the start of the drive", "s"),
        "x": ("centre of mass", "m"),
        "y": ("centre of mass", "m"),
        "heading": ("counter-clockwise from +x, unwrapped", "rad"),
        "speed": ("along the car", "m/s"),
        "lateral_speed": ("across the car, positive to the left", "m/s"),
        "yaw_rate": ("positive to the left", "rad/s"),
        "steering": ("angle of the front wheels, positive to the left", "rad"),
        "steering_input": ("the angle that the driver asked for", "rad"),
        "throttle": ("0..1, as the driver asked", ""),
        "brake": ("0..1, as the driver asked", ""),
    }
)

TRAJECTORIES: Final = (
    Column("id", Kind.WHOLE, "of the test"),
    *(Column(name, Kind.REAL, *_DRIVEN[name]) for name in RESOLUTIONS),
)
"""The table of trajectories: one row per record of a drive."""

TABLES: Final[Mapping[str, tuple[Column, ...]]] = MappingProxyType(
    {"tests": TESTS, "trajectories": TRAJECTORIES}
)
"""Name of a table -> its columns."""

ALL: Final = tuple(Outcome)
TESTS_AT_ONCE: Final = 5_000
"""Rows of the table of tests in a batch."""
RECORDS_AT_ONCE: Final = 250_000
"""Rows of the table of trajectories in a batch, extended to whole trajectories."""
_TRAJECTORIES_AT_ONCE: Final = 200  # fetched from the database


@dataclass(frozen=True, eq=False)
class Lists:
    """A column of lists."""

    values: npt.NDArray[Any]
    """(k,) the lists' values, one list after the other."""
    offsets: IntArray
    """(n + 1,) where each list begins in them, and where the last one ends."""

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __iter__(self) -> Iterator[npt.NDArray[Any]]:
        """The lists, as views."""
        places = self.offsets.tolist()
        return (self.values[a:b] for a, b in itertools.pairwise(places))


Values: TypeAlias = "FloatArray | IntArray | npt.NDArray[np.datetime64] | list[str | None] | Lists"
"""The values of a column: NaN or None where they are missing."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Some rows of a table."""

    columns: tuple[Column, ...]
    values: Mapping[str, Values]
    """Name of a column -> its values, all of one length."""

    tests: int
    """Number of their tests."""

    def __len__(self) -> int:
        return len(self.values["id"])


_STORED: Final = tuple(column for column in TESTS if column not in (*DERIVED, OBJECTIVE))
_SELECT_TESTS: Final = f"""
    SELECT {", ".join(column.name for column in _STORED)}
    FROM test LEFT JOIN candidate ON candidate.id = candidate_id
    WHERE told > ? AND told <= ? AND +outcome IN ({{}}) ORDER BY told LIMIT {TESTS_AT_ONCE}
"""  # noqa: S608  # names of columns; the + lets SQLite go along told
_SELECT_TRAJECTORIES: Final = f"""
    SELECT told, candidate_id, data FROM test JOIN trajectory USING (candidate_id)
    WHERE told > ? AND told <= ? AND +outcome IN ({{}}) ORDER BY told LIMIT {_TRAJECTORIES_AT_ONCE}
"""  # noqa: S608


def number_of_tests(store: CampaignStore, outcomes: Collection[Outcome] = ALL) -> int:
    """Number of tests with these outcomes."""
    by_outcome = store.by_outcome()
    return sum(by_outcome[outcome] for outcome in outcomes)


def number_of_trajectories(store: CampaignStore, outcomes: Collection[Outcome] = ALL) -> int:
    """Number of tests with these outcomes and a trajectory."""
    select = "SELECT count(*) FROM test JOIN trajectory USING (candidate_id) WHERE outcome IN ({})"
    ((number,),) = store.rows(
        select.format(", ".join("?" * len(outcomes))), list(map(str, outcomes))
    )
    return int(number)


def batches_of_tests(store: CampaignStore, outcomes: Collection[Outcome] = ALL) -> Iterator[Batch]:
    """The table of tests in the order of telling, a batch at a time.

    Args:
        store: the campaign. Later results are left out.
        outcomes: of the tests.

    Raises:
        CampaignError: the campaign is damaged.
    """
    wanted = [str(outcome) for outcome in outcomes]
    select = _SELECT_TESTS.format(", ".join("?" * len(wanted)))
    last, done = _last_told(store), 0
    objectives = store.objectives()
    while rows := list(store.rows(select, (done, last, *wanted))):
        batch = _to_batch(store, rows, objectives)
        told = int(batch.values["told"][-1])  # type: ignore[index, arg-type]
        store.require_checksums(done, told)
        yield batch
        done = told


def batches_of_trajectories(
    store: CampaignStore, outcomes: Collection[Outcome] = ALL
) -> Iterator[Batch]:
    """The table of trajectories, a batch at a time: drives in the order of telling, each in time.

    Args:
        store: the campaign.
        outcomes: of the tests.

    Raises:
        CampaignError: the campaign is damaged.
    """
    ids: list[int] = []
    parts: list[FloatArray] = []
    records = 0
    for candidate_id, columns in trajectories_of(store, outcomes):
        ids.append(candidate_id)
        parts.append(columns)
        records += columns.shape[1]
        if records >= RECORDS_AT_ONCE:
            yield _trajectory_batch(ids, parts)
            ids, parts, records = [], [], 0
    if records:
        yield _trajectory_batch(ids, parts)


def trajectories_of(
    store: CampaignStore, outcomes: Collection[Outcome] = ALL
) -> Iterator[tuple[int, FloatArray]]:
    """Ids of the driven tests in the order of telling, each with its (11, n) trajectory.

    Raises:
        CampaignError: the campaign is damaged.
    """
    wanted = [str(outcome) for outcome in outcomes]
    select = _SELECT_TRAJECTORIES.format(", ".join("?" * len(wanted)))
    last, done = _last_told(store), 0
    while rows := list(store.rows(select, (done, last, *wanted))):
        store.require_checksums(done, rows[-1][0], trajectories=True)
        for _, candidate_id, data in rows:
            if not isinstance(data, bytes):
                raise _damaged(store, f"the trajectory of test {candidate_id} is {shown(data)}")
            try:
                yield candidate_id, decode_columns(data)
            except CampaignError as error:
                raise _damaged(store, f"test {candidate_id}: {error}") from error
        done = rows[-1][0]


def _trajectory_batch(ids: list[int], parts: list[FloatArray]) -> Batch:
    columns = np.concatenate(parts, axis=1)
    repeated = np.repeat(np.array(ids, dtype=np.int64), [part.shape[1] for part in parts])
    names = [column.name for column in TRAJECTORIES[1:]]
    values = {"id": repeated, **dict(zip(names, columns, strict=True))}
    return Batch(TRAJECTORIES, values, len(ids))


def _last_told(store: CampaignStore) -> int:
    ((last,),) = store.rows("SELECT max(told) FROM test")
    return last if isinstance(last, int) else 0


# Rows to columns. All values of a column are read together, at the speed of C; if one is damaged,
# `Column.read` says which, and why.


class _DamagedRow(Exception):  # noqa: N818  # it becomes a CampaignError
    def __init__(self, row: int, fault: str) -> None:
        self.row, self.fault = row, fault


def _to_batch(
    store: CampaignStore, rows: Sequence[tuple[Any, ...]], objectives: Mapping[int, float]
) -> Batch:
    raw = dict(zip((c.name for c in _STORED), map(list, zip(*rows, strict=True)), strict=True))
    values: dict[str, Values] = {}
    for column in _STORED:
        try:
            values[column.name] = _read(column, raw[column.name])
        except _DamagedRow as error:
            told = raw["told"][error.row]
            text = f"{column.name} of the result that was told as number {told} {error.fault}"
            raise _damaged(store, text) from None
    curvatures, step = values["curvatures"], values["step"]
    assert isinstance(curvatures, Lists)
    assert isinstance(step, np.ndarray)
    counts = np.diff(curvatures.offsets)
    values["curvature_count"] = counts
    values["length"] = np.maximum(counts - 1, 0) * step
    values["max_curvature"] = _largest(curvatures)
    values["objective"] = np.array([objectives.get(one, np.nan) for one in raw["id"]])
    return Batch(TESTS, {column.name: values[column.name] for column in TESTS}, len(rows))


def _largest(lists: Lists) -> FloatArray:
    """(n,) largest value without its sign of each list; NaN for empty ones."""
    largest = np.full(len(lists), np.nan)
    filled = np.diff(lists.offsets) > 0
    if filled.any():
        starts = lists.offsets[:-1][filled]
        largest[filled] = np.maximum.reduceat(np.abs(lists.values), starts)
    return largest


def _read(column: Column, raw: list[Any]) -> Values:
    """The values of a column.

    Raises:
        _DamagedRow: the first that is none of the column.
    """
    allowed, read = _READERS[column.kind]
    types = {*allowed, type(None)} if column.optional else allowed
    if set(map(type, raw)) <= types:
        with suppress(ValueError):
            return read(column, raw)
    for row, value in enumerate(raw):
        try:
            column.read(value)
        except ValueError as error:
            raise _DamagedRow(row, str(error)) from None
    raise AssertionError(f"each value of {column.name} is one, and all of them are none")


def _wholes(_: Column, raw: list[Any]) -> IntArray:
    return np.array(raw, dtype=np.int64)


def _reals(column: Column, raw: list[Any]) -> FloatArray:
    numbers = np.array(raw, dtype=np.float64)
    if np.isinf(numbers).any() or (column.is_positive and (numbers <= 0.0).any()):
        raise ValueError
    return numbers


def _texts(column: Column, raw: list[Any]) -> list[str | None]:
    if column.choices and not set(raw) <= {None, *column.choices}:
        raise ValueError
    return raw


def _moments(_: Column, raw: list[Any]) -> npt.NDArray[np.datetime64]:
    moments = [datetime.fromisoformat(text) for text in raw]
    if None in {moment.tzinfo for moment in moments}:
        raise ValueError
    plain = [moment.astimezone(UTC).replace(tzinfo=None) for moment in moments]
    return np.array(plain, dtype="datetime64[ms]")


def _lists_of_wholes(column: Column, raw: list[Any]) -> Lists:
    lists = [column.read(text) for text in raw]
    joined = np.fromiter(itertools.chain.from_iterable(lists), dtype=np.int64)
    return Lists(joined, _offsets([len(numbers) for numbers in lists]))


def _lists_of_reals(_: Column, raw: list[Any]) -> Lists:
    sizes = [len(data) for data in raw]
    numbers = np.frombuffer(b"".join(raw), dtype="<f8").astype(np.float64, copy=False)
    if any(size % 8 for size in sizes) or not np.isfinite(numbers).all():
        raise ValueError
    return Lists(numbers, _offsets([size // 8 for size in sizes]))


def _offsets(lengths: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])


_READERS: Final[Mapping[Kind, tuple[set[type], Callable[[Column, list[Any]], Values]]]] = {
    Kind.WHOLE: ({int}, _wholes),
    Kind.REAL: ({float, int}, _reals),
    Kind.TEXT: ({str}, _texts),
    Kind.CHOICE: ({str}, _texts),
    Kind.MOMENT: ({str}, _moments),
    Kind.WHOLES: ({str}, _lists_of_wholes),
    Kind.REALS: ({bytes}, _lists_of_reals),
}


def _damaged(store: CampaignStore, what: str) -> CampaignError:
    return CampaignError(
        f"{store.folder / DATABASE} is damaged: {what}; 'frenetic check' says more"
    )
