"""Tables of campaigns as JSON, CSV and Parquet files.

A file is written batch by batch of the tests, so memory does not grow with the campaign.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from msgspec.json import encode

from frenetic._support.printable import text_cell
from frenetic.export.metadata import described_schema, write_description
from frenetic.export.table_columns import TABLES
from frenetic.export.tables import (
    DICTIONARY_COLUMNS,
    CampaignSource,
    campaigns_of,
    cars_of,
    condition_names,
    frame_of,
    open_store,
    read_tests,
    require_extra,
)
from frenetic.export.trajectory_files import TRAJECTORY_FILES, RowWriter
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile

if TYPE_CHECKING:
    import pandas as pd

TESTS_AT_ONCE: Final = 500
"""Number of tests of a batch, whose frames are in memory together; our choice."""
FrameWriter: TypeAlias = "Callable[[pd.DataFrame], object]"
"""Function that appends a frame to an open file."""


def write_tables(
    folder: Path,
    source: CampaignSource,
    format: str,  # noqa: A002
    outcomes: Collection[Outcome],
    driven: Collection[Outcome] | None,
    on_progress: Callable[[int, int], None],
) -> None:
    """Write the tables of campaigns as files, see `frenetic.export.export_campaign`.

    Args:
        folder: an existing folder.
        source: one campaign or several.
        format: format of the files.
        outcomes: outcomes of the tests.
        driven: outcomes of the tests whose trajectories are written; None for no trajectories.
        on_progress: called after each batch with the number of written tests and the number of all
            tests.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign is damaged.
        OSError: a file cannot be written.
    """
    require_extra(f"the format {format}")
    campaigns, are_named = campaigns_of(source)
    conditions = condition_names(campaigns)
    cars = cars_of(campaigns)
    done = total = 0
    for campaign in campaigns:
        with open_store(campaign) as store:
            total += sum(
                number for outcome, number in store.by_outcome().items() if outcome in outcomes
            )
    tests = read_tests(campaigns, outcomes, with_trajectory=driven is not None)
    with ExitStack() as files:
        write_frame: FrameWriter | None = None
        write_trajectories: RowWriter = len  # writes nothing
        if driven is not None:
            trajectory_file = TRAJECTORY_FILES[format]
            write_trajectories = files.enter_context(
                trajectory_file(folder / "trajectories", are_named=are_named, cars=cars)
            )
        while True:
            batch = list(islice(tests, TESTS_AT_ONCE))
            frame = frame_of("tests", batch, conditions, are_named=are_named)
            if write_frame is None:  # the first frame says which columns the file has
                write_frame = files.enter_context(_FILES[format](folder / "tests", frame))
                if format != "parquet":  # which holds it in its own files
                    names = {"tests": tuple(map(str, frame))}
                    if driven is not None:
                        first = ("campaign",) if are_named else ()
                        names["trajectories"] = (*first, *TABLES["trajectories"])
                    write_description(folder, names, cars)
            write_frame(frame)
            write_trajectories([item for item in batch if item[1].outcome in (driven or ())])
            done += len(batch)
            on_progress(done, max(done, total))  # the campaign may grow meanwhile
            if len(batch) < TESTS_AT_ONCE:
                return


@contextmanager
def _json_file(path: Path, _: pd.DataFrame) -> Iterator[FrameWriter]:
    """Yield a function that appends frames to a file, as a JSON object per row and line."""
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(frame: pd.DataFrame) -> None:
            for row in zip(*(_plain(frame[name]) for name in frame), strict=True):
                file.write(encode(dict(zip(frame, row, strict=True))) + b"\n")

        yield write


@contextmanager
def _csv_file(path: Path, first: pd.DataFrame) -> Iterator[FrameWriter]:
    """Yield a function that appends frames to a CSV file.

    No spreadsheet reads a text in it as a formula.
    """
    import pandas as pd  # an extra

    texts = [name for name in first if not pd.api.types.is_numeric_dtype(first[name])]
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        first[:0].to_csv(file, index=False)
        yield lambda frame: _with_texts(frame, texts).to_csv(
            file, index=False, header=False, lineterminator="\n"
        )


@contextmanager
def _parquet_file(path: Path, first: pd.DataFrame) -> Iterator[FrameWriter]:
    """Yield a function that appends frames to a Parquet file."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    texts = [name for name in DICTIONARY_COLUMNS if name in first]
    numbers = pa.list_(pa.float64())
    lists = {"curvatures": numbers, "parents": pa.list_(pa.int64())}
    lists |= dict.fromkeys(profile.NAMES, pa.list_(numbers))
    inferred = pa.Schema.from_pandas(_with_texts(first, texts), preserve_index=False)
    fields = [pa.field(item.name, lists.get(item.name, item.type)) for item in inferred]
    schema = described_schema(pa.schema(fields, inferred.metadata), "tests", {})
    with ParquetWriter(path.with_suffix(".parquet"), schema, compression="zstd") as file:
        yield lambda frame: file.write_table(
            pa.Table.from_pandas(_with_texts(frame, texts), schema, preserve_index=False)
        )


_FILES: Final[Mapping[str, Callable[[Path, pd.DataFrame], AbstractContextManager[FrameWriter]]]] = {
    "json": _json_file,
    "csv": _csv_file,
    "parquet": _parquet_file,
}
"""Format -> function of a path without suffix and the first frame that opens a file."""


def _with_texts(frame: pd.DataFrame, names: Iterable[str]) -> pd.DataFrame:
    """Return a frame with some columns as texts; lists and dictionaries become JSON."""
    import pandas as pd  # an extra

    texts = {name: [_cell(value) for value in _plain(frame[name])] for name in names}
    return frame.assign(**{name: pd.array(cells, dtype="string") for name, cells in texts.items()})


def _cell(value: Any) -> str | None:
    """Return a value in types of JSON as a text; None for a missing value."""
    if value is None:
        return None
    return text_cell(value) if isinstance(value, str) else json.dumps(value)


def _plain(values: pd.Series[Any]) -> list[Any]:
    """Return the values of a column in types of JSON; None for a missing value."""
    return [_plain_value(value) for value in values.to_numpy(object, na_value=None)]


def _plain_value(value: Any) -> Any:
    """Return a value in types of JSON: an array as a list, a time as ISO 8601."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.isoformat(timespec="milliseconds") if isinstance(value, datetime) else value
