"""A campaign's tests and trajectories as tables, read many rows at a time.

One batch is in memory at a time, however large the campaign. A value of the wrong type is a
`CampaignError` that names the test.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.campaign.trajectory_codec import decode_columns
from frenetic.errors import CampaignError
from frenetic.export.columns import TESTS, TRAJECTORIES, Column, Kind
from frenetic.oracle import Side
from frenetic.outcome import Outcome

IntArray: TypeAlias = npt.NDArray[np.int64]
Which: TypeAlias = Literal["all", "failures", "none"]
"""Choice of tests whose trajectories are exported."""

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


_DERIVED: Final = ("length", "curvature_count", "max_curvature")
_STORED: Final = tuple(column for column in TESTS if column.name not in _DERIVED)
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
    by_outcome = store.counts().by_outcome
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
    while rows := list(store.rows(select, (done, last, *wanted))):
        batch = _to_batch(store, rows)
        yield batch
        done = int(batch.values["told"][-1])  # type: ignore[index, arg-type]


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
        for _, candidate_id, data in rows:
            if not isinstance(data, bytes):
                raise _damaged(store, f"the trajectory of test {candidate_id} is {_shown(data)}")
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


# Rows to columns. `set(map(type, values))` looks at all values of a column at the speed of C.


class _NoSuchValue(Exception):  # noqa: N818  # it becomes a CampaignError
    """The value in this row does not fit its column."""

    def __init__(self, row: int) -> None:
        self.row = row


def _to_batch(store: CampaignStore, rows: Sequence[tuple[Any, ...]]) -> Batch:
    raw = dict(zip((c.name for c in _STORED), map(list, zip(*rows, strict=True)), strict=True))
    values: dict[str, Values] = {}
    for column in _STORED:
        try:
            values[column.name] = _READERS[column.kind](raw[column.name], column)
        except _NoSuchValue as error:
            value, told = _shown(raw[column.name][error.row]), raw["told"][error.row]
            text = f"{column.name} of the result that was told as number {told} is {value}"
            raise _damaged(store, text) from None
    curvatures, step = values["curvatures"], values["step"]
    assert isinstance(curvatures, Lists)
    assert isinstance(step, np.ndarray)
    counts = np.diff(curvatures.offsets)
    values["curvature_count"] = counts
    values["length"] = np.maximum(counts - 1, 0) * step
    values["max_curvature"] = _largest(curvatures)
    return Batch(TESTS, {column.name: values[column.name] for column in TESTS}, len(rows))


def _largest(lists: Lists) -> FloatArray:
    """(n,) largest value without its sign of each list; NaN for empty ones."""
    largest = np.full(len(lists), np.nan)
    filled = np.diff(lists.offsets) > 0
    if filled.any():
        starts = lists.offsets[:-1][filled]
        largest[filled] = np.maximum.reduceat(np.abs(lists.values), starts)
    return largest


def _require(values: Sequence[object], column: Column, *allowed: type) -> None:
    """Raises `_NoSuchValue` unless all values are of these types, or missing where they may be."""
    types = (*allowed, type(None)) if column.optional else allowed
    if not set(map(type, values)) <= set(types):
        raise _NoSuchValue(next(k for k, value in enumerate(values) if type(value) not in types))


def _wholes(values: list[Any], column: Column) -> IntArray:
    _require(values, column, int)
    return np.array(values, dtype=np.int64)


def _reals(values: list[Any], column: Column) -> FloatArray:
    _require(values, column, float, int)
    numbers = np.array(values, dtype=np.float64)
    for row in np.flatnonzero(~np.isfinite(numbers)):
        if values[row] is not None:
            raise _NoSuchValue(int(row))
    return numbers


def _texts(values: list[Any], column: Column) -> list[str | None]:
    _require(values, column, str)
    if column.name == "departure_side" and not set(values) <= {None, *get_args(Side)}:
        sides = (None, *get_args(Side))
        raise _NoSuchValue(next(k for k, value in enumerate(values) if value not in sides))
    return values


def _moments(values: list[Any], column: Column) -> npt.NDArray[np.datetime64]:
    _require(values, column, str)
    plain = []
    for row, value in enumerate(values):
        match = _MOMENT.fullmatch(value)
        if match is None:
            raise _NoSuchValue(row)
        plain.append(match[1])
    try:
        return np.array(plain, dtype="datetime64[ms]")
    except ValueError:  # of some day that no calendar has
        raise _NoSuchValue(_first_refused(plain)) from None


def _first_refused(moments: Sequence[str]) -> int:
    for row, moment in enumerate(moments):
        try:
            np.datetime64(moment, "ms")
        except ValueError:
            return row
    raise AssertionError("each of them is a moment")


_MOMENT: Final = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,3})?)\+00:00")


def _lists_of_wholes(values: list[Any], column: Column) -> Lists:
    _require(values, column, str)
    lists = []
    for row, text in enumerate(values):
        numbers = _ids(text)
        if numbers is None:
            raise _NoSuchValue(row)
        lists.append(numbers)
    joined = np.fromiter(itertools.chain.from_iterable(lists), dtype=np.int64)
    return Lists(joined, _offsets([len(numbers) for numbers in lists]))


@lru_cache(maxsize=10_000)  # most roads have no parents, or those of their siblings
def _ids(text: str) -> tuple[int, ...] | None:
    """The ids in a JSON list, None for anything else."""
    try:
        numbers = json.loads(text)
    except (ValueError, RecursionError):
        return None
    is_fine = isinstance(numbers, list) and all(
        type(number) is int and 0 < number < 2**63 for number in numbers
    )
    return tuple(numbers) if is_fine else None


def _lists_of_reals(values: list[Any], column: Column) -> Lists:
    _require(values, column, bytes)
    sizes = [len(data) for data in values]
    for row, size in enumerate(sizes):
        if size % 8:
            raise _NoSuchValue(row)
    numbers = np.frombuffer(b"".join(values), dtype="<f8").astype(np.float64, copy=False)
    offsets = _offsets([size // 8 for size in sizes])
    bad = np.flatnonzero(~np.isfinite(numbers))
    if len(bad):
        raise _NoSuchValue(int(np.searchsorted(offsets, bad[0], side="right")) - 1)
    return Lists(numbers, offsets)


def _offsets(lengths: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])


_READERS: Final[Mapping[Kind, Callable[[list[Any], Column], Values]]] = {
    Kind.WHOLE: _wholes,
    Kind.REAL: _reals,
    Kind.TEXT: _texts,
    Kind.CHOICE: _texts,
    Kind.MOMENT: _moments,
    Kind.WHOLES: _lists_of_wholes,
    Kind.REALS: _lists_of_reals,
}


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _damaged(store: CampaignStore, what: str) -> CampaignError:
    return CampaignError(
        f"{store.folder / DATABASE} is damaged: {what}; 'frenetic check' says more"
    )
