"""The declaration of an exported table's column: name, meaning, unit and type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from frenetic.conditions.condition import SEED, known_conditions

CONDITION: Final = "condition_"
"""Beginning of the names of conditions' columns."""
INTEGER: Final = "Int64"
"""Type of whole numbers in pandas, of which some may be missing."""
CATEGORY: Final = "category"
"""Type of texts in pandas of which there are few."""


@dataclass(frozen=True)
class TableColumn:
    """A column of an exported table."""

    name: str
    about: str
    """Meaning of the values, for people."""
    unit: str = ""
    """Unit of the values; empty for a text, a share or a number."""
    dtype: str = "Float64"
    """Type of the values in pandas."""
    categories: tuple[str, ...] = ()
    """All texts that a column of the type `CATEGORY` may hold."""


def condition_column(name: str) -> TableColumn:
    """Return the column of a condition, also of one that is not installed."""
    condition = known_conditions().get(name)
    column, dtype = f"{CONDITION}{name}", INTEGER if name == SEED else "Float64"
    if condition is None:
        about = "seed of the random conditions" if name == SEED else ""
        return TableColumn(column, about, dtype=dtype)
    return TableColumn(column, condition.about, condition.unit, dtype)
