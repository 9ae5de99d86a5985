"""Values that JSON can hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

JSONValue: TypeAlias = (
    "bool | int | float | str | Sequence[JSONValue] | Mapping[str, JSONValue] | None"
)
"""A value that JSON can hold."""


def plain(value: object) -> object:
    """A read-only mapping or sequence as `json.dumps` takes it, for its ``default``."""
    return dict(value) if isinstance(value, Mapping) else list(value)  # type: ignore[call-overload]
