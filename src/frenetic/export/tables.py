"""A campaign's tests and trajectories as tables: pandas data frames, and files made of these.

Files are written a batch of tests at a time, so memory does not grow with the campaign.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from datetime import datetime
from functools import partial
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

import numpy as np
from msgspec import to_builtins
from msgspec.json import encode

from frenetic._support.words import pip_install, simulated_time, text_cell
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import FINISHED, Column, Test, value_at
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Trajectory
from frenetic.errors import FreneticError, RoadError
from frenetic.oracle import Side
from frenetic.outcome import Outcome

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories"]

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
    moobd moobd_distance max_oob_share objective duration
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
    conditions repeat source notes fault records
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
"""Name of a table -> its columns."""

_DTYPES: Final = {
    "INTEGER": "int64",
    "REAL": "Float64",
    "TEXT": "string",
    "JSON": "object",
    "REALS": "object",
    **dict.fromkeys(("length", "step", "seconds", "elapsed", "budget_spent"), "float64"),
    "finished_at": "datetime64[ms, UTC]",
    "records": "Int64",
}
"""Kind or name of a column -> its type in pandas; names go first."""
_CATEGORIES: Final[Mapping[str, tuple[str, ...]]] = {
    "outcome": tuple(map(str, Outcome)),
    "departure_side": get_args(Side),
    "operator": (),
    "worker": (),
}
"""Name of a column -> its categories; those that there are if none are given."""
_DICTIONARIES: Final = ("conditions", "source", "notes", "fault")
TESTS_AT_ONCE: Final = 1000
"""Tests of which a file's rows are in memory together."""
_DIGITS: Final = 6  # decimals of road points: micrometres


def data_frame(
    campaign: Campaign | CampaignStore | Path | str,
    table: Table = "tests",
    *,
    outcomes: Collection[Outcome | str] = (),
) -> pd.DataFrame:
    """A campaign's tests, or the trajectories of their drives, as a pandas data frame.

    The columns are those that ``frenetic export`` writes, see `frenetic.export.TABLES`. Tests come
    in the order of telling. Outcomes, operators, sides and workers are categories; numbers that may
    be missing are nullable (``Float64``); curvatures and parents are arrays; conditions, source,
    notes and fault are dictionaries; ``finished_at`` is a time with its zone, UTC.

    Args:
        campaign: its folder, or the campaign, opened or not.
        table: ``tests``, one row per candidate that was told, or ``trajectories``, one row per
            record of a drive: 96 bytes each, 25 kB for an ordinary test.
        outcomes: only tests of these, such as ``["FAIL"]``; of all without any.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or the campaign cannot be read.
        ValueError: there is no such table or outcome.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = tuple(Outcome(outcome) for outcome in outcomes) or tuple(Outcome)
    _require_extra("a data frame")
    with opened(campaign) as store:
        if table == "trajectories":
            return _trajectories(_stored(store, wanted, with_trajectory=True))
        return _tests(_stored(store, wanted), _places(store))


def write_tables(
    folder: Path,
    store: CampaignStore,
    format: Literal["csv", "json", "parquet"],  # noqa: A002
    outcomes: Collection[Outcome],
    driven: Collection[Outcome] | None,
    on_progress: Callable[[int, int], None],
) -> None:
    """Writes the tables of a campaign as `export_campaign` describes.

    Args:
        folder: exists.
        store: the campaign.
        format: of the files.
        outcomes: of the tests.
        driven: outcomes of the tests whose trajectories are written; None for no trajectories.
        on_progress: called with the number of tests written, and of all, after each batch.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or the campaign is damaged.
        OSError: a file cannot be written.
    """
    _require_extra(f"the format {format}")
    stored = _stored(store, outcomes, with_trajectory=driven is not None)
    places, by_outcome = _places(store), store.by_outcome()
    total = sum(by_outcome[outcome] for outcome in outcomes)

    def batches() -> Iterator[tuple[list[Test], pd.DataFrame]]:
        done, is_last = 0, False
        while not is_last:
            tests = list(islice(stored, TESTS_AT_ONCE))
            yield tests, _tests(tests, places)
            done += len(tests)
            on_progress(done, total)
            is_last = len(tests) < TESTS_AT_ONCE

    if format == "json":
        _write_json(folder / "tests.jsonl", batches(), driven)
    else:
        _write_frames(folder, format, batches(), driven)


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


# From a campaign to frames


def opened(
    campaign: Campaign | CampaignStore | Path | str,
) -> AbstractContextManager[CampaignStore]:
    """A campaign, opened unless it is."""
    if isinstance(campaign, Campaign):
        campaign = campaign.folder
    if isinstance(campaign, CampaignStore):
        return nullcontext(campaign)
    return CampaignStore.open(campaign)


def _stored(
    store: CampaignStore, outcomes: Collection[Outcome], *, with_trajectory: bool = False
) -> Iterator[Test]:
    only = next(iter(outcomes)) if len(outcomes) == 1 else None
    tests = store.tests(only, with_trajectory=with_trajectory)
    return (test for test in tests if test.outcome in outcomes)


def _places(store: CampaignStore) -> dict[int, int]:
    """Id of a test -> the number of results told before it was asked."""
    return dict(store.rows("SELECT id, asked_after FROM test"))


def _tests(tests: Iterable[Test], places: Mapping[int, int]) -> pd.DataFrame:
    import pandas as pd  # an extra

    columns = TABLES["tests"]
    values: dict[str, list[Any]] = {column.name: [] for column in columns}
    paths = [(values[column.name], column.path.split(".")) for column in columns if column.path]
    for test in tests:
        for found, path in paths:
            found.append(value_at(test, path))
    roads = values["curvatures"]
    values |= {
        "asked_after": [places[number] for number in values["id"]],
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
    dtypes = {column.name: _DTYPES.get(column.name, _DTYPES[column.kind]) for column in columns}
    for name, known in _CATEGORIES.items():
        dtypes[name] = pd.CategoricalDtype(known or sorted({*values[name]} - {None}))
    return pd.DataFrame({n: pd.Series(values[n], dtype=dtype) for n, dtype in dtypes.items()})


def _trajectories(tests: Iterable[Test]) -> pd.DataFrame:
    import pandas as pd  # an extra

    driven = [(test.id, test.trajectory) for test in tests if test.trajectory is not None]
    records = [len(trajectory) for _, trajectory in driven]
    ids = np.array([number for number, _ in driven], np.int64)
    columns = {
        name: np.concatenate([np.empty(0), *(getattr(path, name) for _, path in driven)])
        for name in Trajectory.names()
    }
    return pd.DataFrame({"id": np.repeat(ids, np.array(records, np.int64)), **columns})


# From frames to files


def _write_json(
    path: Path,
    batches: Iterable[tuple[list[Test], pd.DataFrame]],
    driven: Collection[Outcome] | None,
) -> None:
    with path.open("wb") as file:
        for tests, frame in batches:
            columns = [_plain(frame[name]) for name in frame]
            for test, *row in zip(tests, *columns, strict=True):
                line = dict(zip(frame, row, strict=True)) | {"road_points": _road_points(test)}
                if driven is not None:
                    line["trajectory"] = _trajectory(test) if test.outcome in driven else None
                file.write(encode(line) + b"\n")


def _road_points(test: Test) -> list[list[float]] | None:
    """Points of the road in its place, in m; None if it is no road."""
    try:
        points: list[list[float]] = test.road.road_points.round(_DIGITS).tolist()
    except RoadError:
        return None
    return points


def _trajectory(test: Test) -> dict[str, list[float]] | None:
    if test.trajectory is None:
        return None
    return {name: getattr(test.trajectory, name).tolist() for name in Trajectory.names()}


def _write_frames(
    folder: Path,
    format: Literal["csv", "parquet"],  # noqa: A002
    batches: Iterable[tuple[list[Test], pd.DataFrame]],
    driven: Collection[Outcome] | None,
) -> None:
    from pyarrow.csv import CSVWriter  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    with ExitStack() as files:
        writers: dict[str, Any] = {}
        for tests, frame in batches:
            frames = {"tests": frame}
            if driven is not None:
                frames["trajectories"] = _trajectories(t for t in tests if t.outcome in driven)
            for table, rows in frames.items():
                found = _texts(rows) if format == "csv" else _columns(rows, TABLES[table])
                if table not in writers:
                    make = (
                        CSVWriter if format == "csv" else partial(ParquetWriter, compression="zstd")
                    )
                    path = folder / f"{table}.{format}"
                    writers[table] = files.enter_context(make(path, found.schema))
                writers[table].write_table(found)


def _texts(frame: pd.DataFrame) -> Any:
    """A frame for CSV: what is no number as text."""
    import pandas as pd  # an extra
    import pyarrow as pa  # an extra

    others = [name for name in frame if not pd.api.types.is_numeric_dtype(frame[name])]
    return pa.Table.from_pandas(_with_texts(frame, others), preserve_index=False)


def _columns(frame: pd.DataFrame, columns: Iterable[Column]) -> Any:
    """A frame for Parquet, its fields with descriptions and units."""
    import pyarrow as pa  # an extra

    frame = _with_texts(frame, [name for name in _DICTIONARIES if name in frame])
    found = pa.Schema.from_pandas(frame, preserve_index=False)
    lists = {"curvatures": pa.list_(pa.float64()), "parents": pa.list_(pa.int64())}
    own = lists | dict.fromkeys(_CATEGORIES, pa.dictionary(pa.int32(), pa.string()))
    fields = [
        pa.field(
            column.name,
            own.get(column.name, found.field(column.name).type),
            metadata={"description": column.about, "unit": column.unit},
        )
        for column in columns
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
