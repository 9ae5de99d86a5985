"""Reading JSON and TOML that somebody else wrote: every mistake is a `ValueError` of one line.

Values that are nested too deep for recursive code are refused.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from typing import Any, Final, TypeVar, overload

import msgspec

T = TypeVar("T")


class BeyondLimitsError(ValueError):
    """A text that is nested too deep, or with a number that is too large."""


MAX_DEPTH: Final = 100
"""Largest depth of nested lists and objects (our choice); a driver in ten wrappers has about 20."""
_MAX_MESSAGE: Final = 300
"""Largest number of characters of a message (our choice)."""
_TOO_DEEP: Final = f"it is nested more than {MAX_DEPTH} levels deep"
_TOO_LARGE: Final = "a number has thousands of digits"
_LONG_KEY: Final = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}"""
)
"""Pattern of a key of TOML with `MAX_DEPTH` dots, for which `tomllib` would take much memory: it
grows with the square of their number. The pattern also matches such a key within a text."""


@overload
def read_json(text: str | bytes) -> Any: ...
@overload
def read_json(text: str | bytes, kind: type[T]) -> T: ...
def read_json(text: str | bytes, kind: Any = None) -> Any:
    """Return the value of a JSON text.

    Args:
        text: the JSON, as UTF-8 if it is bytes.
        kind: type of the value, as for `msgspec.convert`; None for any type.

    Raises:
        ValueError: the text is no JSON or no UTF-8, a value has another type, the nesting is too
            deep, or a number has thousands of digits.
    """
    if kind is None:
        return _read(json.loads, text)
    return _read(lambda decoded: msgspec.json.decode(decoded, type=kind), text)


def read_toml(data: bytes) -> dict[str, Any]:
    """Return the entries of a TOML file.

    Raises:
        ValueError: the data are no TOML or no UTF-8, the nesting is too deep, or a number has
            thousands of digits.
    """
    entries: dict[str, Any] = _read(_parse_toml, data)
    return entries


def _parse_toml(text: str) -> dict[str, Any]:
    """Parse a text, but refuse long keys before."""
    if _LONG_KEY.search(text):
        raise BeyondLimitsError(_TOO_DEEP)
    return tomllib.loads(text)


def _check_depth(value: object) -> None:
    """Check how deep lists, objects and records are nested.

    Raises:
        BeyondLimitsError: they are nested more than `MAX_DEPTH` levels deep.
    """
    level: list[Any] = [value]
    for depth in range(MAX_DEPTH + 1):
        inner: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                inner += item.values()
            elif isinstance(item, (list, tuple)):
                inner += item
            elif isinstance(item, msgspec.Struct):
                inner += msgspec.structs.astuple(item)
            else:
                continue
            if depth == MAX_DEPTH:
                raise BeyondLimitsError(_TOO_DEEP)
        level = inner


def _read(parse: Callable[[str], Any], text: str | bytes) -> Any:
    """Parse a text and check its depth; raise the errors that `read_json` lists."""
    try:
        text = text if isinstance(text, str) else text.decode("utf-8-sig")
        # Each level of JSON opens a bracket; keys of TOML open levels by dots, too.
        is_flat = text.count("[") + text.count("{") + text.count(".") <= MAX_DEPTH
        value = parse(text)
    except BeyondLimitsError:
        raise
    except RecursionError:
        raise BeyondLimitsError(_TOO_DEEP) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"it is no UTF-8 text: {error.reason} at byte {error.start}") from None
    except (ValueError, OverflowError, MemoryError) as error:
        if "integer string conversion" in str(error):
            raise BeyondLimitsError(_TOO_LARGE) from None
        raise ValueError(" ".join(str(error).split())[:_MAX_MESSAGE]) from None
    if not is_flat:
        _check_depth(value)
    return value
