"""Tables as Parquet files, for pandas, DuckDB, Polars and whatever reads Arrow."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic.export.columns import Column, Kind
from frenetic.export.extras import needing_tables
from frenetic.export.tables import Batch, Lists, Values

_COMPRESSION: Final = "zstd"


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
    with needing_tables("Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    schema = pa.schema([_field(column) for column in columns])
    with pq.ParquetWriter(path, schema, compression=_COMPRESSION) as writer:
        for batch in batches:
            arrays = [_array(column, batch.values[column.name]) for column in columns]
            writer.write_batch(pa.record_batch(arrays, schema=schema), row_group_size=len(batch))


def _field(column: Column) -> Any:
    import pyarrow as pa

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


def _array(column: Column, values: Values) -> Any:
    import pyarrow as pa

    if isinstance(values, Lists):
        return pa.ListArray.from_arrays(values.offsets.astype(np.int32), values.values)
    if column.kind is Kind.CHOICE:
        return pa.array(values, pa.string()).dictionary_encode()
    # NaN is a missing number, and there is no other one.
    return pa.array(values, _field(column).type, from_pandas=column.optional)
