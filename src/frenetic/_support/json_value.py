"""Values that JSON can hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from frenetic._support.scalars import is_numpy_scalar, without_numpy

JSONValue: TypeAlias = (
    "bool | int | float | str | Sequence[JSONValue] | Mapping[str, JSONValue] | None"
)
"""A value that JSON can hold."""


def plain(value: object) -> object:
    """Return a mapping, sequence or numpy number in a type that `json.dumps` knows.

    It is the argument ``default`` of `json.dumps`, which is called with values of other types.

    Raises:
        ValueError: the value has another type.
    """
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Sequence):
        return list(value)
    if is_numpy_scalar(value):
        return without_numpy(value)
    raise ValueError(f"{value!r} is a {type(value).__name__}, which JSON does not know")
