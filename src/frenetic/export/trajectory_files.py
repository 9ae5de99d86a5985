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

from frenetic._support.printable import text_cell
from frenetic.campaign.trajectory_codec import RESOLUTIONS, to_steps
from frenetic.export.decimal_text import decimal_rows
from frenetic.export.tables import CampaignTest, frame_of
from frenetic.oracle.drive import Trajectory

RowWriter: TypeAlias = Callable[[Sequence[CampaignTest]], object]
"""Function that appends the trajectories of tests to an open file."""

_NAMES: Final = Trajectory.names()
_DECIMALS: Final = np.array([round(-math.log10(RESOLUTIONS[name])) for name in _NAMES])
"""Number of decimals of each column of a stored trajectory."""

_REPEATED: Final = ("id", "time", "steering_input", "throttle", "brake")
"""Columns with few different values, for which Parquet keeps a dictionary: for the others it would
take a third of the time, and more bytes."""


@contextmanager
def _json_file(path: Path, *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a file, as a JSON object per record and line.

    Args:
        path: path without suffix.
        are_named: whether the rows have the folder of their campaign.
    """
    between = [f',"{name}":'.encode() for name in _NAMES]
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(tests: Sequence[CampaignTest]) -> None:
            for campaign, test in tests:
                if test.trajectory:
                    first = {"campaign": campaign, "id": test.id} if are_named else {"id": test.id}
                    separators = [encode(first)[:-1] + between[0], *between[1:], b"}\n"]
                    file.write(
                        decimal_rows(
                            to_steps(test.trajectory), _DECIMALS, separators, has_exponents=False
                        )
                    )

        yield write


@contextmanager
def _csv_file(path: Path, *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a CSV file, see `_json_file`.

    No spreadsheet reads a text in it as a formula.
    """
    names = ["campaign", "id", *_NAMES] if are_named else ["id", *_NAMES]
    between = [b","] * (len(_NAMES) - 1)
    with path.with_suffix(".csv").open("wb") as file:
        file.write(_csv_line(names))

        def write(tests: Sequence[CampaignTest]) -> None:
            for campaign, test in tests:
                if test.trajectory:
                    cells = [text_cell(campaign), test.id] if are_named else [test.id]
                    separators = [_csv_line(cells)[:-1] + b",", *between, b"\n"]
                    file.write(
                        decimal_rows(
                            to_steps(test.trajectory), _DECIMALS, separators, has_exponents=True
                        )
                    )

        yield write


def _csv_line(cells: Sequence[object]) -> bytes:
    """Return a line of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()


@contextmanager
def _parquet_file(path: Path, *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends trajectories to a Parquet file, see `_json_file`."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    empty = frame_of("trajectories", (), (), are_named=are_named)
    schema = pa.Schema.from_pandas(empty, preserve_index=False)
    repeated = [name for name in (*_REPEATED, "campaign") if name in schema.names]
    with ParquetWriter(
        path.with_suffix(".parquet"), schema, compression="zstd", use_dictionary=repeated
    ) as file:

        def write(tests: Sequence[CampaignTest]) -> None:
            driven = [
                (campaign, test.id, test.trajectory) for campaign, test in tests if test.trajectory
            ]
            if not driven:
                return
            counts = [len(trajectory) for *_, trajectory in driven]
            ids = np.repeat([test_id for _, test_id, _ in driven], counts)
            columns = [pa.array(ids, pa.int64())]
            for name in _NAMES:
                values = np.concatenate([getattr(trajectory, name) for *_, trajectory in driven])
                columns.append(pa.array(values))
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
"""Format -> function of a path without suffix and of `are_named` that opens a file."""
