"""Tests and trajectories of campaigns as tables: a pandas data frame, and files made of it.

Files are made of the frames of a batch of tests at a time, so memory does not grow with a campaign.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from datetime import datetime
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

import numpy as np
from msgspec import to_builtins
from msgspec.json import encode

from frenetic._support.printable import text_cell
from frenetic._support.words import pip_install, simulated_time
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.columns import TEST_COLUMNS, value_at
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import SEED
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome, chosen_outcomes
from frenetic.oracle.verdict import Side
from frenetic.road import profile

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories"]
Place: TypeAlias = Campaign | CampaignStore | Path | str
"""A campaign, its folder, or a folder of several, such as a bench's."""
_Row: TypeAlias = tuple[str, Test]
"""Folder of a campaign, the test."""

_PATHS: Final[Mapping[str, Sequence[str]]] = {
    column.name: column.attributes for column in TEST_COLUMNS
}
_KINDS: Final = {column.name: column.kind for column in TEST_COLUMNS}
_DEPARTURE: Final = ("time", "distance", "x", "y", "side")
_ORDER: Final = """
    id result_number outcome reason operator parents generation
    length max_curvature curvatures step x y heading
    superelevation grade widening speed_limits
    moobd moobd_distance max_oob_share objective duration
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
    repeat source notes fault records
"""
TABLES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"tests": tuple(_ORDER.split()), "trajectories": ("id", *Trajectory.names())}
)
"""Name of a table -> its columns; of several campaigns, ``campaign`` comes first. A column for each
condition that some test has, such as ``condition_friction``, comes last."""

_CONDITION: Final = "condition_"
_DTYPES: Final = {
    "INTEGER": "int64",
    "REAL": "Float64",
    "TEXT": "string",
    "JSON": "object",
    "REALS": "object",
    "PAIRS": "object",
    "campaign": "string",
    f"{_CONDITION}{SEED}": "Int64",
    **dict.fromkeys(("length", "step", "seconds", "elapsed", "budget_spent"), "float64"),
    "finished_at": "datetime64[ms, UTC]",
    "records": "Int64",
}
"""Kind or name of a column -> its type in pandas; names go first, and others are REAL."""
_CATEGORIES: Final[Mapping[str, tuple[str, ...]]] = {
    "outcome": tuple(map(str, Outcome)),
    "departure_side": get_args(Side),
}
"""Name of a column -> its categories."""
_DICTIONARIES: Final = ("source", "notes", "fault")
TESTS_AT_ONCE: Final = 1000
"""Tests of which a file's rows are in memory together."""


def data_frame(
    source: Place | Iterable[Path | str],
    table: Table = "tests",
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
) -> pd.DataFrame:
    """The tests of campaigns, or the trajectories of their drives, as a pandas data frame.

    The columns are those that ``frenetic export`` writes, see `frenetic.export.TABLES`; of several
    campaigns a column ``campaign`` with their folders comes first. Tests come in the order of
    telling. Outcomes and sides are categories; numbers that may be missing are nullable
    (``Float64``); curvatures and parents are arrays; superelevation,
    grade and widening are lists of pairs; source, notes and fault are
    dictionaries; ``finished_at`` is a time with its zone, UTC. A column for each condition that
    some test has, such as ``condition_friction``, comes last.

    Args:
        source: a campaign, open or not, its folder, a folder of several campaigns, such as a
            bench's, or a list of folders.
        table: ``tests``, one row per candidate that was told, or ``trajectories``, one row per
            record of a drive: 96 bytes each, 25 kB for an ordinary test.
        outcomes: only tests of this outcome, such as ``"FAIL"``, or of these; of all without any.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign cannot be read.
        ValueError: the table or an outcome is unknown.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = chosen_outcomes(outcomes)
    _require_extra("a data frame")
    campaigns, named = _campaigns(source)
    rows = _rows(campaigns, wanted, table == "trajectories")
    return _frame(table, rows, named, _conditions(campaigns))


def write_tables(
    folder: Path,
    source: Place,
    format: str,  # noqa: A002
    outcomes: Collection[Outcome],
    driven: Collection[Outcome] | None,
    on_progress: Callable[[int, int], None],
) -> None:
    """Write the tables of campaigns as `export_campaign` describes.

    Args:
        folder: an existing folder.
        source: the campaigns of the tests.
        format: format of the files.
        outcomes: outcomes of the tests.
        driven: outcomes of the tests whose trajectories are written; None for no trajectories.
        on_progress: called after each batch with the number of written tests and of all tests.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign is damaged.
        OSError: a file cannot be written.
    """
    _require_extra(f"the format {format}")
    campaigns, named = _campaigns(source)
    conditions = _conditions(campaigns)
    done = total = 0
    for campaign in campaigns:
        with opened(campaign) as store:
            total += sum(number for o, number in store.by_outcome().items() if o in outcomes)
    rows = _rows(campaigns, outcomes, driven is not None)
    with ExitStack() as files:
        writers: dict[Table, Callable[[pd.DataFrame], object]] = {}
        while True:
            batch = list(islice(rows, TESTS_AT_ONCE))
            parts: dict[Table, list[_Row]] = {"tests": batch}
            if driven is not None:
                parts["trajectories"] = [row for row in batch if row[-1].outcome in driven]
            for table, part in parts.items():
                frame = _frame(table, part, named, conditions)
                if table not in writers:
                    writer = _WRITERS[format](folder / table, frame)
                    writers[table] = files.enter_context(writer)
                writers[table](frame)
            done += len(batch)
            on_progress(done, max(done, total))  # the campaign may grow meanwhile
            if len(batch) < TESTS_AT_ONCE:
                return


def _require_extra(purpose: str) -> None:
    """Check that the extra ``tables`` is installed, which a purpose needs.

    Raises:
        FreneticError: the extra is not installed; the message says how to install it.
    """
    try:
        import pandas  # noqa: F401  # an extra
        import pyarrow  # noqa: F401  # an extra
    except ImportError as error:
        raise FreneticError(
            f"{purpose} needs pandas and pyarrow, and {error.name or 'one of them'} is not"
            f" installed: {pip_install('tables')}"
        ) from error


# From campaigns to a frame


def opened(campaign: Place) -> AbstractContextManager[CampaignStore]:
    """Return the store of a campaign, which the context closes unless it was open before."""
    if isinstance(campaign, Campaign):
        campaign = campaign.folder
    if isinstance(campaign, CampaignStore):
        return nullcontext(campaign)
    return CampaignStore.open(campaign)


def _campaigns(source: Place | Iterable[Path | str]) -> tuple[Sequence[Place], bool]:
    """Return the campaigns of a source, and whether a column names them."""
    if isinstance(source, Campaign | CampaignStore):
        return [source], False
    if isinstance(source, Path | str):
        folders = find_campaigns(source)
        return folders, folders != [Path(source)]
    return [folder for place in source for folder in find_campaigns(place)], True


def _rows(
    campaigns: Iterable[Place], outcomes: Collection[Outcome], with_trajectory: bool
) -> Iterator[_Row]:
    only = next(iter(outcomes)) if len(outcomes) == 1 else None
    for campaign in campaigns:
        with opened(campaign) as store:
            name = store.folder.as_posix()
            for test in store.tests(only, with_trajectory=with_trajectory):
                if test.outcome in outcomes:
                    yield name, test


def _conditions(campaigns: Iterable[Place]) -> list[str]:
    """Return the names of the conditions that tests of the campaigns have."""
    names: dict[str, None] = {}
    for campaign in campaigns:
        with opened(campaign) as store:
            rows = store.rows("SELECT DISTINCT key FROM test, json_each(conditions) ORDER BY key")
            names |= {name: None for (name,) in rows}
    return list(names)


def _frame(
    table: Table, rows: Iterable[_Row], named: bool, conditions: Iterable[str]
) -> pd.DataFrame:
    frame = _tests(rows, conditions) if table == "tests" else _trajectories(rows)
    return frame if named else frame.drop(columns="campaign")


def _tests(rows: Iterable[_Row], conditions: Iterable[str]) -> pd.DataFrame:
    import pandas as pd  # an extra

    names = ("campaign", *TABLES["tests"], *(f"{_CONDITION}{name}" for name in conditions))
    values: dict[str, list[Any]] = {name: [] for name in names}
    for campaign, test in rows:
        row = _row_of(test)
        row["campaign"] = campaign
        for name in names:
            values[name].append(row.get(name))
    dtypes: dict[str, Any] = {
        name: _DTYPES.get(name) or _DTYPES[_KINDS.get(name, "REAL")] for name in names
    }
    dtypes |= {name: pd.CategoricalDtype(known) for name, known in _CATEGORIES.items()}
    return pd.DataFrame({n: pd.Series(values[n], dtype=dtype) for n, dtype in dtypes.items()})


def _row_of(test: Test) -> dict[str, Any]:
    """Return the row of a test: name of a column -> value."""
    row = {name: value_at(test, path) for name, path in _PATHS.items()}
    candidate, departure = test.candidate, test.departure
    curvatures = candidate.curvatures
    row["outcome"] = str(test.outcome)
    row["duration"] = simulated_time(test.result.duration)
    row["curvatures"] = np.array(curvatures)
    row["parents"] = np.array(candidate.origin.parents, np.int64)
    row["length"] = max(len(curvatures) - 1, 0) * candidate.step
    row["max_curvature"] = np.abs(curvatures).max() if len(curvatures) else None
    for name in _DICTIONARIES:
        row[name] = to_builtins(row[name]) or None
    if departure is not None:
        row |= {f"departure_{name}": getattr(departure, name) for name in _DEPARTURE}
        row["departure_time"] = simulated_time(departure.time)
    row |= {f"{_CONDITION}{name}": amount for name, amount in candidate.conditions.items()}
    # Some of a road's profiles follow from its class; a refused candidate may describe no road.
    whole = test.road if test.pose is not None and len(curvatures) > 1 else candidate
    for name in profile.NAMES:
        pairs = getattr(whole, name)
        row[name] = None if pairs is None else pairs.tolist() or None
    return row


def _trajectories(rows: Iterable[_Row]) -> pd.DataFrame:
    import pandas as pd  # an extra

    driven = [(name, test.id, test.trajectory) for name, test in rows if test.trajectory]
    records = np.array([len(path) for *_, path in driven], np.int64)
    names = pd.Series([name for name, *_ in driven], dtype="string")
    ids = np.array([number for _, number, _ in driven], np.int64)
    columns = {
        name: np.concatenate([np.empty(0), *(getattr(path, name) for *_, path in driven)])
        for name in Trajectory.names()
    }
    campaigns = names.repeat(records).reset_index(drop=True)
    return pd.DataFrame({"campaign": campaigns, "id": np.repeat(ids, records), **columns})


# From a frame to a file: each writer takes a path without suffix and the first frame


@contextmanager
def _lines(path: Path, _: pd.DataFrame) -> Iterator[Callable[[pd.DataFrame], object]]:
    """Yield a function that appends frames to a file, one JSON object per row."""
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(frame: pd.DataFrame) -> None:
            for row in zip(*(_plain(frame[name]) for name in frame), strict=True):
                file.write(encode(dict(zip(frame, row, strict=True))) + b"\n")

        yield write


@contextmanager
def _csv(path: Path, first: pd.DataFrame) -> Iterator[Callable[[pd.DataFrame], object]]:
    """Yield a function that appends frames to a CSV file.

    Values that are no numbers are texts that no spreadsheet reads as a formula.
    """
    import pandas as pd  # an extra

    texts = [name for name in first if not pd.api.types.is_numeric_dtype(first[name])]
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        first[:0].to_csv(file, index=False)
        yield lambda frame: _with_texts(frame, texts).to_csv(
            file, index=False, header=False, lineterminator="\n"
        )


@contextmanager
def _parquet(path: Path, first: pd.DataFrame) -> Iterator[Callable[[pd.DataFrame], object]]:
    """Yield a function that appends frames to a Parquet file."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    texts = [name for name in _DICTIONARIES if name in first]
    numbers = pa.list_(pa.float64())
    lists = {"curvatures": numbers, "parents": pa.list_(pa.int64())}
    lists |= dict.fromkeys(profile.NAMES, pa.list_(numbers))
    inferred = pa.Schema.from_pandas(_with_texts(first, texts), preserve_index=False)
    fields = [pa.field(item.name, lists.get(item.name, item.type)) for item in inferred]
    schema = pa.schema(fields, inferred.metadata)
    with ParquetWriter(path.with_suffix(".parquet"), schema, compression="zstd") as file:
        yield lambda frame: file.write_table(
            pa.Table.from_pandas(_with_texts(frame, texts), schema, preserve_index=False)
        )


_WRITERS: Final = {"json": _lines, "csv": _csv, "parquet": _parquet}


def _with_texts(frame: pd.DataFrame, names: Iterable[str]) -> pd.DataFrame:
    """Return a frame with some columns as texts for cells; lists and dictionaries are JSON."""
    import pandas as pd  # an extra

    texts = {name: [_cell(value) for value in _plain(frame[name])] for name in names}
    return frame.assign(**{n: pd.array(cells, dtype="string") for n, cells in texts.items()})


def _cell(value: Any) -> str | None:
    if value is None:
        return None
    return text_cell(value) if isinstance(value, str) else json.dumps(value)


def _plain(values: pd.Series[Any]) -> list[Any]:
    """Return the values of a column in types of JSON; None for missing values."""
    return [_plain_value(value) for value in values.to_numpy(object, na_value=None)]


def _plain_value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.isoformat(timespec="milliseconds") if isinstance(value, datetime) else value
