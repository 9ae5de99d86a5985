"""Tables of campaigns as JSON, CSV and Parquet files.

A file is written batch by batch of the tests, so memory does not grow with the campaign.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.json import encode

from frenetic._support.printable import text_cell
from frenetic.export.metadata import described_schema, write_description
from frenetic.export.table_columns import TABLES
from frenetic.export.table_rows import (
    DICTIONARY_COLUMNS,
    CampaignSource,
    TableTest,
    condition_names,
    open_store,
    plain_rows,
    read_tests,
    test_columns,
)
from frenetic.export.tables import (
    campaigns_of,
    cars_of,
    frame_of_tests,
    require_extra,
    signal_names,
    without_campaign,
)
from frenetic.export.trace_columns import SIGNAL
from frenetic.export.trajectory_files import TRAJECTORY_FILES, RowWriter
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TESTS_AT_ONCE: Final = 500
"""Number of tests of a batch, whose frames are in memory together; our choice."""


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
        FreneticError: Parquet is meant and pandas or pyarrow is not installed, or a campaign is
            damaged.
        OSError: a file cannot be written.
    """
    if format == "parquet":
        require_extra("the format parquet")
    campaigns, are_named = campaigns_of(source)
    conditions = condition_names(campaigns)
    signals, cars = signal_names(campaigns), cars_of(campaigns)
    if format != "parquet":  # which holds it in its own files
        names = {"tests": test_columns(conditions, are_named=are_named)}
        if driven is not None:
            first = ("campaign",) if are_named else ()
            others = (f"{SIGNAL}{name}" for name in signals)
            names["trajectories"] = (*first, *TABLES["trajectories"], *others)
        write_description(folder, names, cars)
    done = total = 0
    for campaign in campaigns:
        with open_store(campaign) as store:
            total += sum(
                number for outcome, number in store.by_outcome().items() if outcome in outcomes
            )
    tests = read_tests(campaigns, outcomes, with_trajectory=driven is not None)
    with ExitStack() as files:
        test_file = _TEST_FILES[format]
        write_tests = files.enter_context(
            test_file(folder / "tests", conditions, are_named=are_named)
        )
        write_trajectories: RowWriter = len  # writes nothing
        if driven is not None:
            trajectory_file = TRAJECTORY_FILES[format]
            write_trajectories = files.enter_context(
                trajectory_file(folder / "trajectories", signals, are_named=are_named, cars=cars)
            )
        while True:
            batch = list(islice(tests, TESTS_AT_ONCE))
            write_tests(batch)
            write_trajectories([item for item in batch if item.test.outcome in (driven or ())])
            done += len(batch)
            on_progress(done, max(done, total))  # the campaign may grow meanwhile
            if len(batch) < TESTS_AT_ONCE:
                return


@contextmanager
def _json_file(path: Path, conditions: Sequence[str], *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends tests to a file, as a JSON object per row and line.

    Args:
        path: path without suffix.
        conditions: names of the conditions that get a column.
        are_named: whether the rows have the folder of their campaign.
    """
    with path.with_suffix(".jsonl").open("wb") as file:

        def write(tests: Sequence[TableTest]) -> None:
            for row in plain_rows(tests, conditions, are_named=are_named):
                file.write(encode(row) + b"\n")

        yield write


@contextmanager
def _csv_file(path: Path, conditions: Sequence[str], *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends tests to a CSV file, see `_json_file`.

    No spreadsheet reads a text in it as a formula.
    """
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(test_columns(conditions, are_named=are_named))

        def write(tests: Sequence[TableTest]) -> None:
            for row in plain_rows(tests, conditions, are_named=are_named):
                writer.writerow(
                    value if value is None or isinstance(value, int | float) else _cell(value)
                    for value in row.values()
                )

        yield write


@contextmanager
def _parquet_file(path: Path, conditions: Sequence[str], *, are_named: bool) -> Iterator[RowWriter]:
    """Yield a function that appends tests to a Parquet file, see `_json_file`."""
    import pyarrow as pa  # an extra
    from pyarrow.parquet import ParquetWriter  # an extra

    with ExitStack() as opened:
        file: ParquetWriter | None = None

        def write(tests: Sequence[TableTest]) -> None:
            nonlocal file
            frame = frame_of_tests(tests, conditions)
            frame = frame if are_named else without_campaign(frame)
            texts = [name for name in DICTIONARY_COLUMNS if name in frame]
            plain = _with_texts(frame, texts)
            if file is None:  # the first frame says which columns the file has
                parquet = path.with_suffix(".parquet")
                file = opened.enter_context(
                    ParquetWriter(parquet, _parquet_schema(plain), compression="zstd")
                )
            file.write_table(pa.Table.from_pandas(plain, file.schema, preserve_index=False))

        yield write


def _parquet_schema(frame: pd.DataFrame) -> pa.Schema:
    """Return the schema of the table ``tests``, with units and meanings of the columns."""
    import pyarrow as pa  # an extra

    numbers = pa.list_(pa.float64())
    lists = {"curvatures": numbers, "parents": pa.list_(pa.int64())}
    lists |= dict.fromkeys(profile.NAMES, pa.list_(numbers))
    inferred = pa.Schema.from_pandas(frame, preserve_index=False)
    fields = [pa.field(item.name, lists.get(item.name, item.type)) for item in inferred]
    return described_schema(pa.schema(fields, inferred.metadata), "tests", {})


_TEST_FILES: Final[Mapping[str, Callable[..., AbstractContextManager[RowWriter]]]] = {
    "json": _json_file,
    "csv": _csv_file,
    "parquet": _parquet_file,
}
"""Format -> function of a path without suffix, conditions and `are_named` that opens a file."""


def _with_texts(frame: pd.DataFrame, names: Iterable[str]) -> pd.DataFrame:
    """Return a frame with some columns as texts; dictionaries become JSON."""
    import pandas as pd  # an extra

    texts = {
        name: [_cell(value) for value in frame[name].to_numpy(object, na_value=None)]
        for name in names
    }
    return frame.assign(**{name: pd.array(cells, dtype="string") for name, cells in texts.items()})


def _cell(value: Any) -> str | None:
    """Return a value in types of JSON as a text; None for a missing value."""
    if value is None:
        return None
    return text_cell(value) if isinstance(value, str) else json.dumps(value)
