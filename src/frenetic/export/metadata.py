"""What describes exported tables: units and meanings of columns, and the box of the car."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from frenetic.export.column import TableColumn
from frenetic.export.table_columns import column_of

if TYPE_CHECKING:
    import pyarrow as pa

Cars: TypeAlias = Mapping[str, Mapping[str, float]]
"""Folder of a campaign -> fields of its car's `CarBody`, in m."""

DESCRIPTION: Final = "columns.json"
"""Name of the file that describes tables whose own files cannot."""
_PARQUET_KEY: Final = b"frenetic"
"""Key of our JSON in the metadata of a Parquet file."""


def described(column: TableColumn) -> dict[str, str]:
    """Return meaning and unit of a column, without empty texts."""
    return {name: text for name in ("about", "unit") if (text := getattr(column, name))}


def write_description(folder: Path, tables: Mapping[str, Iterable[str]], cars: Cars) -> None:
    """Write `DESCRIPTION`: the box of each campaign's car, and the columns of each table.

    Args:
        folder: folder of the tables' files.
        tables: name of a table -> names of its columns.
        cars: boxes of the cars.

    Raises:
        OSError: the file cannot be written.
    """
    document: dict[str, Any] = {"cars": cars}
    for table, names in tables.items():
        document[table] = {name: described(column_of(table, name)) for name in names}
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    (folder / DESCRIPTION).write_text(text, encoding="utf-8")


def described_schema(schema: pa.Schema, table: str, cars: Cars) -> pa.Schema:
    """Return a schema for Parquet whose metadata describe a table and, if it has any, the cars.

    Each field has the keys ``unit`` and ``about``, unless they are empty; the file has the key
    ``frenetic`` with JSON.
    """
    import pyarrow as pa  # an extra

    fields: Sequence[pa.Field] = [
        field.with_metadata(described(column_of(table, field.name))) for field in schema
    ]
    metadata = dict(schema.metadata or {})
    if cars:
        metadata[_PARQUET_KEY] = json.dumps({"cars": cars}).encode()
    return pa.schema(fields, metadata)
