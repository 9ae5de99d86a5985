"""Trajectories of campaigns as JSON, CSV and Parquet files, written drive by drive without frames.

The files have the rows and columns of the table ``trajectories``, see `frenetic.export.TABLES`.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from msgspec.json import encode

from frenetic._support.arrays import IntArray
from frenetic._support.printable import text_cell
from frenetic.campaign.record import Test
from frenetic.campaign.trajectory_codec import RESOLUTIONS, to_steps
from frenetic.export.decimal_text import decimal_rows
from frenetic.export.metadata import Cars, described_schema
from frenetic.export.record_columns import (
    decimals_of,
    record_columns,
    record_multiples,
    record_values,
)
from frenetic.export.table_rows import TableTest
from frenetic.export.tables import frame_of_trajectories, without_campaign
from frenetic.oracle.drive import Trajectory

RowWriter: TypeAlias = Callable[[Sequence[TableTest]], object]
"""Function that appends the trajectories of tests to an open file."""

_NAMES: Final = Trajectory.names()
_STORED_DECIMALS: Final = [round(-math.log10(RESOLUTIONS[name])) for name in _NAMES]
"""Number of decimals of each column of a stored trajectory."""

_REPEATED: Final = (
    *("campaign", "id", "time", "steering_input", "throttle", "brake", "oob_share"),
    *("grade", "superelevation", "lane_width", "speed_limit", "stop"),
)
"""Columns with few different values, for which Parquet keeps a dictionary: for the others it would
take a third of the time, and more bytes."""


def _names_of(signals: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a trajectory's columns."""
    return (*_NAMES, *(column.name for column in record_columns(signals)))


def _decimals_of(signals: Sequence[str]) -> IntArray:
    """Return the number of decimals of each column of a trajectory."""
    return np.array([*_STORED_DECIMALS, *decimals_of(record_columns(signals))], np.int64)


def _multiples(test: Test, signals: Sequence[str]) -> IntArray:
    """Return the columns of a trajectory, (k, n), in units of their last decimal."""
    assert test.trajectory is not None, "the caller has looked"
    return np.concatenate((to_steps(test.trajectory), record_multiples(test, signals)))


@contextmanager
def _json_file(
    path: Path,
    signals: Sequence[str],
    *,
    are_named: bool,
    cars: Cars,  # noqa: ARG001
) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a file, as a JSON object per record and line.

    Args:
        path: path without suffix.
        signals: names of other packages' signals that get a column.
        are_named: whether the rows have the folder of their campaign.
        cars: boxes of the campaigns' cars, for the metadata of a format that has any.
    """
    between = [f',"{name}":'.encode() for name in _names_of(signals)]
    decimals = _decimals_of(signals)
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(tests: Sequence[TableTest]) -> None:
            for campaign, test, *_ in tests:
                if test.trajectory:
                    first = {"campaign": campaign, "id": test.id} if are_named else {"id": test.id}
                    separators = [encode(first)[:-1] + between[0], *between[1:], b"}\n"]
                    file.write(
                        decimal_rows(
                            _multiples(test, signals),
                            decimals,
                            separators,
                            has_exponents=False,
                            missing=b"null",
                        )
                    )

        yield write


@contextmanager
def _csv_file(
    path: Path,
    signals: Sequence[str],
    *,
    are_named: bool,
    cars: Cars,  # noqa: ARG001
) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a CSV file, see `_json_file`.

    No spreadsheet reads a text in it as a formula.
    """
    columns, decimals = _names_of(signals), _decimals_of(signals)
    names = ["campaign", "id", *columns] if are_named else ["id", *columns]
    between = [b","] * (len(columns) - 1)
    with path.with_suffix(".csv").open("wb") as file:
        file.write(_csv_line(names))

        def write(tests: Sequence[TableTest]) -> None:
            for campaign, test, *_ in tests:
                if test.trajectory:
                    cells = [text_cell(campaign), test.id] if are_named else [test.id]
                    separators = [_csv_line(cells)[:-1] + b",", *between, b"\n"]
                    multiples = _multiples(test, signals)
                    file.write(decimal_rows(multiples, decimals, separators, has_exponents=True))

        yield write


def _csv_line(cells: Sequence[object]) -> bytes:
    """Return a line of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()


@contextmanager
def _parquet_file(
    path: Path, signals: Sequence[str], *, are_named: bool, cars: Cars
) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a Parquet file, see `_json_file`."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    empty = frame_of_trajectories((), signals)
    empty = empty if are_named else without_campaign(empty)
    inferred = pa.Schema.from_pandas(empty, preserve_index=False)
    schema = described_schema(inferred, "trajectories", cars)
    repeated = [name for name in _REPEATED if name in schema.names]
    with ParquetWriter(
        path.with_suffix(".parquet"), schema, compression="zstd", use_dictionary=repeated
    ) as file:

        def write(tests: Sequence[TableTest]) -> None:
            driven = [
                (campaign, test.id, test.trajectory, record_values(test, signals))
                for campaign, test, *_ in tests
                if test.trajectory
            ]
            if not driven:
                return
            counts = [len(trajectory) for *_, trajectory, _ in driven]
            ids = np.repeat([test_id for _, test_id, *_ in driven], counts)
            columns = [pa.array(ids, pa.int64())]
            for name in _NAMES:
                values = np.concatenate([getattr(records, name) for *_, records, _ in driven])
                columns.append(pa.array(values))
            measured = np.concatenate([values for *_, values in driven], axis=1)
            columns += [pa.array(values, from_pandas=True) for values in measured]  # NaN is null
            if are_named:
                names = np.repeat(np.array([campaign for campaign, *_ in driven], object), counts)
                columns.insert(0, pa.array(names, schema.field("campaign").type))
            file.write_table(pa.Table.from_arrays(columns, schema=schema))

        yield write


TRAJECTORY_FILES: Final[Mapping[str, Callable[..., AbstractContextManager[RowWriter]]]] = {
    "json": _json_file,
    "csv": _csv_file,
    "parquet": _parquet_file,
}
"""Format -> function of a path without suffix, signals, `are_named`, `cars` that opens a file."""
