"""Replacing numpy's numbers by Python's, since JSON and SQLite know only these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any


def is_numpy_scalar(value: object) -> bool:
    """Return whether a value is a numpy scalar, such as ``np.int64(3)``."""
    return type(value).__module__ == "numpy" and getattr(value, "shape", None) == ()


def without_numpy(value: Any) -> Any:
    """Return a value with numpy scalars replaced by Python's, also within a mapping."""
    if isinstance(value, Mapping):
        return {name: without_numpy(item) for name, item in value.items()}
    return value.item() if is_numpy_scalar(value) else value


def take_numpy_scalars(record: Any) -> None:
    """Replace numpy scalars in the fields of a frozen dataclass by Python's numbers.

    It is called in ``__post_init__``. Kernels are compiled for Python's numbers, too.
    """
    for item in fields(record):
        value = getattr(record, item.name)
        if is_numpy_scalar(value):
            object.__setattr__(record, item.name, value.item())
