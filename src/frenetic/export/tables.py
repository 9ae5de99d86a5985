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

from frenetic._support.words import pip_install, simulated_time, text_cell
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import FINISHED, Column, Test, value_at
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Trajectory
from frenetic.errors import FreneticError
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.quantities import SEED, quantities
from frenetic.road import profile

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Table: TypeAlias = Literal["tests", "trajectories"]
Place: TypeAlias = Campaign | CampaignStore | Path | str
"""A campaign, its folder, or a folder of several, such as a bench's."""
_Row: TypeAlias = tuple[str, int, Test]
"""Folder of a campaign, number of results told before the test was asked, the test."""

_DERIVED: Final = (
    Column("asked_after", "", "INTEGER", "number of results told when it was asked"),
    Column("length", "", "REAL", "of the road", "m"),
    Column("curvature_count", "", "INTEGER", "number of curvatures"),
    Column("max_curvature", "", "REAL", "largest curvature, without its sign", "1/m"),
    Column("departure_time", "departure.time", "REAL", "when the car left its lane", "s"),
    Column("departure_distance", "departure.distance", "REAL", "along the road to there", "m"),
    Column("departure_x", "departure.x", "REAL", "where it was then", "m"),
    Column("departure_y", "departure.y", "REAL", "where it was then", "m"),
    Column("departure_side", "departure.side", "TEXT", "left or right"),
)
_BY_NAME: Final = {column.name: column for column in (*FINISHED, *_DERIVED)}
_ORDER: Final = """
    id told outcome reason operator parents generation asked_after
    length curvature_count max_curvature curvatures step x y heading
    superelevation grade widening
    moobd moobd_distance max_oob_share objective duration
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
    repeat source notes fault records
"""
TABLES: Final[Mapping[str, tuple[Column, ...]]] = MappingProxyType(
    {
        "tests": tuple(_BY_NAME[name] for name in _ORDER.split()),
        "trajectories": (
            Column("id", "id", "INTEGER", "of the test"),
            Column("time", "time", "REAL", "since the start of the drive", "s"),
            Column("x", "x", "REAL", "centre of mass", "m"),
            Column("y", "y", "REAL", "centre of mass", "m"),
            Column("heading", "heading", "REAL", "counter-clockwise from +x, unwrapped", "rad"),
            Column("speed", "speed", "REAL", "along the car", "m/s"),
            Column("lateral_speed", "lateral_speed", "REAL", "positive to the left", "m/s"),
            Column("yaw_rate", "yaw_rate", "REAL", "positive to the left", "rad/s"),
            Column("steering", "steering", "REAL", "of the wheels, positive to the left", "rad"),
            Column("steering_input", "steering_input", "REAL", "as the driver asked", "rad"),
            Column("throttle", "throttle", "REAL", "0..1, as the driver asked"),
            Column("brake", "brake", "REAL", "0..1, as the driver asked"),
        ),
    }
)
"""Name of a table -> its columns; of several campaigns, `CAMPAIGN` comes first. A column for each
condition that some test has, such as ``condition_friction``, comes last."""
CAMPAIGN: Final = Column("campaign", "", "TEXT", "folder of the campaign")

_CONDITION: Final = "condition_"
_DTYPES: Final = {
    "INTEGER": "int64",
    "REAL": "Float64",
    "TEXT": "string",
    "JSON": "object",
    "REALS": "object",
    "PAIRS": "object",
    f"{_CONDITION}{SEED}": "Int64",
    **dict.fromkeys(("length", "step", "seconds", "elapsed", "budget_spent"), "float64"),
    "finished_at": "datetime64[ms, UTC]",
    "records": "Int64",
}
"""Kind or name of a column -> its type in pandas; names go first."""
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
    outcomes: Collection[Outcome | str] = (),
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
        source: a campaign, opened or not, its folder, a folder of several, such as a bench's, or a
            list of folders.
        table: ``tests``, one row per candidate that was told, or ``trajectories``, one row per
            record of a drive: 96 bytes each, 25 kB for an ordinary test.
        outcomes: only tests of these, such as ``["FAIL"]``; of all without any.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign cannot be read.
        ValueError: there is no such table or outcome.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = tuple(Outcome(outcome) for outcome in outcomes) or tuple(Outcome)
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
    """Writes the tables of campaigns as `export_campaign` describes.

    Args:
        folder: exists.
        source: of the tests.
        format: of the files.
        outcomes: of the tests.
        driven: outcomes of the tests whose trajectories are written; None for no trajectories.
        on_progress: called with the number of tests written, and of all, after each batch.

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
    writers: dict[Table, Callable[[pd.DataFrame], object]] = {}
    with ExitStack() as files:
        while True:
            batch = list(islice(rows, TESTS_AT_ONCE))
            parts: dict[Table, list[_Row]] = {"tests": batch}
            if driven is not None:
                parts["trajectories"] = [row for row in batch if row[-1].outcome in driven]
            for table, part in parts.items():
                frame = _frame(table, part, named, conditions)
                if table not in writers:
                    known = (CAMPAIGN, *TABLES[table], *conditions.values())
                    writer = _writer(folder / table, known, format, frame)
                    writers[table] = files.enter_context(writer)
                writers[table](frame)
            done += len(batch)
            on_progress(done, total)
            if len(batch) < TESTS_AT_ONCE:
                return


def _require_extra(what: str) -> None:
    """Checks that the extra ``tables`` is installed.

    Raises:
        FreneticError: it is not; the message says how to install it.
    """
    try:
        import pandas  # noqa: F401  # an extra
        import pyarrow  # noqa: F401  # an extra
    except ImportError as error:
        raise FreneticError(
            f"{what} needs pandas and pyarrow, and {error.name or 'one of them'} is not installed:"
            f" {pip_install('tables')}"
        ) from error


# From campaigns to a frame


def opened(campaign: Place) -> AbstractContextManager[CampaignStore]:
    """A campaign, opened unless it is."""
    if isinstance(campaign, Campaign):
        campaign = campaign.folder
    if isinstance(campaign, CampaignStore):
        return nullcontext(campaign)
    return CampaignStore.open(campaign)


def _campaigns(source: Place | Iterable[Path | str]) -> tuple[Sequence[Place], bool]:
    """The campaigns of a source, and whether a column names them."""
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
            tests = store.tests(only, with_trajectory=with_trajectory)
            asked_after = dict(store.rows("SELECT id, asked_after FROM test"))
            name = store.folder.as_posix()
            for test in tests:
                if test.outcome in outcomes:
                    yield name, asked_after[test.id], test


def _conditions(campaigns: Iterable[Place]) -> dict[str, Column]:
    """The conditions that tests of some campaigns have -> their columns."""
    columns = {}
    for campaign in campaigns:
        with opened(campaign) as store:
            for (name,) in store.rows(
                "SELECT DISTINCT key FROM test, json_each(conditions) ORDER BY key"
            ):
                row = quantities().get(name)  # its package may be gone
                about, unit = ("", "") if row is None else (row.about, row.unit)
                columns[name] = Column(f"{_CONDITION}{name}", "", "REAL", about, unit)
    return columns


def _frame(
    table: Table, rows: Iterable[_Row], named: bool, conditions: Mapping[str, Column]
) -> pd.DataFrame:
    frame = _tests(rows, conditions) if table == "tests" else _trajectories(rows)
    return frame if named else frame.drop(columns=CAMPAIGN.name)


def _tests(rows: Iterable[_Row], conditions: Mapping[str, Column]) -> pd.DataFrame:
    import pandas as pd  # an extra

    columns = (CAMPAIGN, *TABLES["tests"], *conditions.values())
    values: dict[str, list[Any]] = {column.name: [] for column in columns}
    paths = [
        (values[column.name], column.path.split("."))
        for column in columns
        if column.path and column.name not in profile.NAMES
    ]
    for campaign, asked_after, test in rows:
        values["campaign"].append(campaign)
        values["asked_after"].append(asked_after)
        for found, path in paths:
            found.append(value_at(test, path))
        for name, column in conditions.items():
            values[column.name].append(test.candidate.conditions.get(name))
        # Some of a road's profiles follow from its class; what was refused may be no road.
        is_road = test.attempt.pose is not None and len(test.candidate.curvatures) > 1
        whole = test.road if is_road else test.candidate
        for name in profile.NAMES:
            pairs = getattr(whole, name)
            values[name].append(None if pairs is None else pairs.tolist() or None)
    roads = values["curvatures"]
    values |= {
        "curvature_count": [len(road) for road in roads],
        "length": [
            max(len(road) - 1, 0) * step for road, step in zip(roads, values["step"], strict=True)
        ],
        "max_curvature": [np.abs(road).max() if len(road) else None for road in roads],
        "curvatures": [np.array(road) for road in roads],
        "parents": [np.array(parents, np.int64) for parents in values["parents"]],
        "outcome": [str(outcome) for outcome in values["outcome"]],
        **{n: [simulated_time(t) for t in values[n]] for n in ("duration", "departure_time")},
        **{n: [to_builtins(value) or None for value in values[n]] for n in _DICTIONARIES},
    }
    dtypes: dict[str, Any] = {c.name: _DTYPES.get(c.name, _DTYPES[c.kind]) for c in columns}
    dtypes |= {name: pd.CategoricalDtype(known) for name, known in _CATEGORIES.items()}
    return pd.DataFrame({n: pd.Series(values[n], dtype=dtype) for n, dtype in dtypes.items()})


def _trajectories(rows: Iterable[_Row]) -> pd.DataFrame:
    import pandas as pd  # an extra

    driven = [(name, t.id, t.trajectory) for name, _, t in rows if t.trajectory is not None]
    records = np.array([len(path) for *_, path in driven], np.int64)
    names = pd.Series([name for name, *_ in driven], dtype="string")
    ids = np.array([number for _, number, _ in driven], np.int64)
    columns = {
        name: np.concatenate([np.empty(0), *(getattr(path, name) for *_, path in driven)])
        for name in Trajectory.names()
    }
    campaigns = names.repeat(records).reset_index(drop=True)
    return pd.DataFrame({CAMPAIGN.name: campaigns, "id": np.repeat(ids, records), **columns})


# From a frame to a file


@contextmanager
def _writer(
    path: Path,
    columns: Sequence[Column],
    format: str,  # noqa: A002
    first: pd.DataFrame,
) -> Iterator[Callable[[pd.DataFrame], object]]:
    """A function that adds frames like the first one to a table's file, a path without suffix."""
    from pyarrow.csv import CSVWriter  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    if format == "json":
        with path.with_suffix(".jsonl").open("wb") as lines:
            yield lambda frame: lines.writelines(_lines(frame))
    elif format == "csv":
        with CSVWriter(path.with_suffix(".csv"), _texts(first).schema) as file:
            yield lambda frame: file.write_table(_texts(frame))
    else:
        schema = _described(first, columns).schema
        with ParquetWriter(path.with_suffix(".parquet"), schema, compression="zstd") as file:
            yield lambda frame: file.write_table(_described(frame, columns))


def _lines(frame: pd.DataFrame) -> Iterator[bytes]:
    """A JSON object per row."""
    names = list(frame)
    for row in zip(*(_plain(frame[name]) for name in names), strict=True):
        yield encode(dict(zip(names, row, strict=True))) + b"\n"


def _texts(frame: pd.DataFrame) -> pa.Table:
    """A frame for CSV: what is no number as a text that no spreadsheet takes for a formula."""
    import pandas as pd  # an extra
    import pyarrow as pa  # an extra

    others = [name for name in frame if not pd.api.types.is_numeric_dtype(frame[name])]
    return pa.Table.from_pandas(_with_texts(frame, others), preserve_index=False)


def _described(frame: pd.DataFrame, columns: Sequence[Column]) -> pa.Table:
    """A frame for Parquet: fields have descriptions and units."""
    import pyarrow as pa  # an extra

    frame = _with_texts(frame, [name for name in _DICTIONARIES if name in frame])
    found = pa.Schema.from_pandas(frame, preserve_index=False)
    lists = {"curvatures": pa.list_(pa.float64()), "parents": pa.list_(pa.int64())}
    lists |= dict.fromkeys(profile.NAMES, pa.list_(lists["curvatures"]))
    fields = [
        pa.field(
            column.name,
            lists.get(column.name, found.field(column.name).type),
            metadata={"description": column.about, "unit": column.unit},
        )
        for column in columns
        if column.name in frame
    ]
    return pa.Table.from_pandas(frame, pa.schema(fields), preserve_index=False)


def _with_texts(frame: pd.DataFrame, names: Iterable[str]) -> pd.DataFrame:
    """A frame with some columns as texts for a cell, lists and dictionaries as JSON."""
    import pandas as pd  # an extra

    texts = {name: [_cell(value) for value in _plain(frame[name])] for name in names}
    return frame.assign(**{n: pd.array(cells, dtype="string") for n, cells in texts.items()})


def _cell(value: Any) -> str | None:
    if value is None:
        return None
    return text_cell(value) if isinstance(value, str) else json.dumps(value)


def _plain(values: pd.Series[Any]) -> list[Any]:
    """The values of a column as JSON knows them; None for missing ones."""
    return [_plain_value(value) for value in values.to_numpy(object, na_value=None)]


def _plain_value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.isoformat(timespec="milliseconds") if isinstance(value, datetime) else value
