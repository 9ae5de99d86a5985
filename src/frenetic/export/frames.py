"""Tables by pyarrow: Parquet files and pandas data frames, with the extra ``tables``.

`frenetic.export.text` writes CSV and JSON lines without it, for light installations; pyarrow's own
CSV formats numbers differently.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from frenetic.campaign.campaign import Campaign
from frenetic.campaign.store import CampaignStore
from frenetic.errors import FreneticError
from frenetic.export.tables import (
    ALL,
    TABLES,
    Batch,
    Column,
    Kind,
    Lists,
    Values,
    batches_of_tests,
    batches_of_trajectories,
    number_of_tests,
)
from frenetic.outcome import Outcome

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories"]

_COMPRESSION: Final = "zstd"


@contextmanager
def _needing_extra(what: str) -> Iterator[None]:
    """Turns a failed import into an error that says how to install the extra ``tables``."""
    try:
        yield
    except ImportError as error:
        raise FreneticError(
            f"{what} needs pandas and pyarrow, and {error.name or 'one of them'} is not installed:"
            ' pip install "frenetic-roads[tables]"'
        ) from error


def write_parquet(path: Path, columns: tuple[Column, ...], batches: Iterable[Batch]) -> None:
    """Writes a table, a row group per batch.

    Args:
        path: of the file.
        columns: of the table. Their units and descriptions go into the fields' metadata.
        batches: its rows.

    Raises:
        FreneticError: pyarrow is not installed.
        OSError: the file cannot be written.
    """
    with _needing_extra("Parquet"):
        import pyarrow.parquet as pq  # an extra
    with pq.ParquetWriter(path, _schema(columns), compression=_COMPRESSION) as writer:
        for batch in batches:
            writer.write_batch(_to_arrow(batch), row_group_size=len(batch))


def data_frame(
    campaign: Campaign | CampaignStore | Path | str,
    table: Table = "tests",
    *,
    outcomes: Collection[Outcome | str] = (),
) -> pd.DataFrame:
    """A campaign's tests, or the trajectories of their drives, as a pandas data frame.

    The columns are those that ``frenetic export`` writes, see `TESTS` and `TRAJECTORIES` in
    `frenetic.export.tables`. Tests come in the order of telling. Outcomes, operators, sides and
    workers are categories; numbers that may be missing are nullable (``Float64``); curvatures and
    parents are arrays; ``finished_at`` is a time with its zone, UTC.

    Args:
        campaign: itself, opened or not, or its folder.
        table: ``tests``, one row per candidate that was told, or ``trajectories``, one row per
            record of a drive: 96 bytes each, 25 kB for an ordinary test.
        outcomes: only tests of these, such as ``["FAIL"]``; of all without any.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or the campaign cannot be read.
        ValueError: there is no such table or outcome.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = tuple(Outcome(outcome) for outcome in outcomes) or ALL
    with _needing_extra("a data frame"):
        import pandas as pd  # an extra
        import pyarrow as pa  # an extra
    if not isinstance(campaign, CampaignStore):
        folder = campaign.folder if isinstance(campaign, Campaign) else campaign
        with CampaignStore.open(folder) as store:
            return data_frame(store, table, outcomes=wanted)
    number_of_tests(campaign)  # which knows an outcome that there is not
    columns = TABLES[table]
    batches = batches_of_tests if table == "tests" else batches_of_trajectories
    rows = pa.Table.from_batches(map(_to_arrow, batches(campaign, wanted)), _schema(columns))
    frame = rows.unify_dictionaries().to_pandas(
        types_mapper={pa.string(): pd.StringDtype()}.get, self_destruct=True
    )
    for column in columns:
        if column.kind in (Kind.WHOLES, Kind.REALS):
            frame[column.name] = frame[column.name].map(np.array)  # which may be written to
        elif column.kind is Kind.CHOICE:
            choices = frame[column.name].cat
            known = [*map(str, column.choices)] or sorted(choices.categories)
            frame[column.name] = choices.set_categories(known)
    nullable = [c.name for c in columns if c.kind is Kind.REAL and c.optional]
    return frame.astype(dict.fromkeys(nullable, "Float64"))


def _schema(columns: tuple[Column, ...]) -> Any:
    import pyarrow as pa  # an extra

    return pa.schema([_field(column) for column in columns])


def _field(column: Column) -> Any:
    import pyarrow as pa  # an extra

    kinds = {
        Kind.WHOLE: pa.int64(),
        Kind.REAL: pa.float64(),
        Kind.TEXT: pa.string(),
        Kind.CHOICE: pa.dictionary(pa.int32(), pa.string()),
        Kind.MOMENT: pa.timestamp("ms", tz="UTC"),
        Kind.WHOLES: pa.list_(pa.int64()),
        Kind.REALS: pa.list_(pa.float64()),
    }
    about = {"description": column.description}
    if column.unit:
        about["unit"] = column.unit
    return pa.field(column.name, kinds[column.kind], nullable=column.optional, metadata=about)


def _to_arrow(batch: Batch) -> Any:
    """A batch as a `pyarrow.RecordBatch`."""
    import pyarrow as pa  # an extra

    arrays = [_array(column, batch.values[column.name]) for column in batch.columns]
    return pa.record_batch(arrays, schema=_schema(batch.columns))


def _array(column: Column, values: Values) -> Any:
    import pyarrow as pa  # an extra

    if isinstance(values, Lists):
        return pa.ListArray.from_arrays(values.offsets.astype(np.int32), values.values)
    if column.kind is Kind.CHOICE:
        return pa.array(values, pa.string()).dictionary_encode()
    # NaN is the only missing number.
    return pa.array(values, _field(column).type, from_pandas=column.optional)
