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
from frenetic.export.record_columns import DECIMALS, measured_multiples, measured_values
from frenetic.export.table_columns import MEASURED
from frenetic.export.tables import CampaignTest, frame_of
from frenetic.oracle.drive import Trajectory

RowWriter: TypeAlias = Callable[[Sequence[CampaignTest]], object]
"""Function that appends the trajectories of tests to an open file."""

_NAMES: Final = Trajectory.names()
_ALL_NAMES: Final = (*_NAMES, *(column.name for column in MEASURED))
_DECIMALS: Final = np.array(
    [*(round(-math.log10(RESOLUTIONS[name])) for name in _NAMES), *[DECIMALS] * len(MEASURED)]
)
"""Number of decimals of each column of a trajectory."""

_REPEATED: Final = ("id", "time", "steering_input", "throttle", "brake", "oob_share")
"""Columns with few different values, for which Parquet keeps a dictionary: for the others it would
take a third of the time, and more bytes."""


def _multiples(test: Test) -> IntArray:
    """Return the columns of a trajectory, (14, n), in units of their last decimal."""
    assert test.trajectory is not None, "the caller has looked"
    return np.concatenate((to_steps(test.trajectory), measured_multiples(test)))


@contextmanager
def _json_file(path: Path, *, are_named: bool, cars: Cars) -> Iterator[RowWriter]:  # noqa: ARG001
    """Yield a function that appends trajectories to a file, as a JSON object per record and line.

    Args:
        path: path without suffix.
        are_named: whether the rows have the folder of their campaign.
        cars: boxes of the campaigns' cars, for the metadata of a format that has any.
    """
    between = [f',"{name}":'.encode() for name in _ALL_NAMES]
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(tests: Sequence[CampaignTest]) -> None:
            for campaign, test in tests:
                if test.trajectory:
                    first = {"campaign": campaign, "id": test.id} if are_named else {"id": test.id}
                    separators = [encode(first)[:-1] + between[0], *between[1:], b"}\n"]
                    file.write(
                        decimal_rows(
                            _multiples(test),
                            _DECIMALS,
                            separators,
                            has_exponents=False,
                            missing=b"null",
                        )
                    )

        yield write


@contextmanager
def _csv_file(path: Path, *, are_named: bool, cars: Cars) -> Iterator[RowWriter]:  # noqa: ARG001
    """Yield a function that appends trajectories to a CSV file, see `_json_file`.

    No spreadsheet reads a text in it as a formula.
    """
    names = ["campaign", "id", *_ALL_NAMES] if are_named else ["id", *_ALL_NAMES]
    between = [b","] * (len(_ALL_NAMES) - 1)
    with path.with_suffix(".csv").open("wb") as file:
        file.write(_csv_line(names))

        def write(tests: Sequence[CampaignTest]) -> None:
            for campaign, test in tests:
                if test.trajectory:
                    cells = [text_cell(campaign), test.id] if are_named else [test.id]
                    separators = [_csv_line(cells)[:-1] + b",", *between, b"\n"]
                    file.write(
                        decimal_rows(_multiples(test), _DECIMALS, separators, has_exponents=True)
                    )

        yield write


def _csv_line(cells: Sequence[object]) -> bytes:
    """Return a line of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()


@contextmanager
def _parquet_file(path: Path, *, are_named: bool, cars: Cars) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a Parquet file, see `_json_file`."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    empty = frame_of("trajectories", (), (), are_named=are_named)
    inferred = pa.Schema.from_pandas(empty, preserve_index=False)
    schema = described_schema(inferred, "trajectories", cars)
    repeated = [name for name in (*_REPEATED, "campaign") if name in schema.names]
    with ParquetWriter(
        path.with_suffix(".parquet"), schema, compression="zstd", use_dictionary=repeated
    ) as file:

        def write(tests: Sequence[CampaignTest]) -> None:
            driven = [
                (campaign, test.id, test.trajectory, measured_values(test))
                for campaign, test in tests
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
"""Format -> function of a path without suffix, `are_named` and `cars` that opens a file."""
