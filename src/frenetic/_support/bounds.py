"""Types of numbers and texts with bounds, and checks of values against such types."""

from __future__ import annotations

import math
import numbers
import re
import sys
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Final, Literal, TypeAlias, get_args, get_origin, get_type_hints

from msgspec import Meta, Struct, ValidationError, convert, structs

from frenetic._support.scalars import without_numpy

_MAX_FLOAT: Final = sys.float_info.max
_MAX_INT64: Final = 2**63 - 1
"""Largest whole number that SQLite and MessagePack can hold."""
_MAX_MEASURED: Final = 1e7
"""Largest measured length in m, or time in s: a larger number is a mistake (our choice)."""
_MAX_REPR: Final = 60
"""Largest number of characters of a value in a message (our choice)."""

Finite: TypeAlias = Annotated[float, Meta(ge=-_MAX_FLOAT, le=_MAX_FLOAT)]
"""A number other than infinity and NaN."""
Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=_MAX_FLOAT)]
"""A finite number above 0."""
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=_MAX_FLOAT)]
"""A finite number of at least 0."""
Measured: TypeAlias = Annotated[float, Meta(ge=-_MAX_MEASURED, le=_MAX_MEASURED)]
"""A measured length in m or time in s."""
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
"""A number from 0 to 1."""
Count: TypeAlias = Annotated[int, Meta(ge=1, le=_MAX_INT64)]
"""A whole number of at least 1."""
Index: TypeAlias = Annotated[int, Meta(ge=0, le=_MAX_INT64)]
"""A whole number of at least 0."""
Text: TypeAlias = Annotated[str, Meta(min_length=1)]
"""A text that is not empty."""


def check(values: Mapping[str, Any], declaration: Any) -> None:
    """Check values against the type hints of a class's fields or of a function's arguments.

    Args:
        values: values by name; names without a hint are not checked.
        declaration: the class or the function.

    Raises:
        ValueError: a value has another type or is out of bounds; the message names the value.
    """
    converted(values, declaration)


def converted(values: Mapping[str, Any], declaration: Any) -> dict[str, Any]:
    """Return values converted to the type hints of a class's fields or a function's arguments.

    Args:
        values: values by name; names without a hint are left out. A field of a struct may have its
            name in Python or its encoded name.
        declaration: the class or the function.

    Raises:
        ValueError: a value has another type or is out of bounds; the message names the value.
    """
    return {
        name: _converted(name, values[name], hint)
        for name, hint in _type_hints(declaration).items()
        if name in values
    }


def _converted(name: str, value: Any, hint: Any) -> Any:
    """Return a value converted to a type hint.

    Raises:
        ValueError: msgspec refuses the value; its message is put into our words.
    """
    try:
        return convert(without_numpy(value), hint)
    except ValidationError as error:
        message = str(error)
    if not message.startswith(("Expected", "Invalid enum", "Number")):
        raise ValueError(f"{name}: {message}")  # of a class's own check
    # A message about an inner value ends with its path, as in "... - at `$.limits[0]`".
    text, _, path = message.partition(" - at `$")
    for step in re.findall(r"[.]\w+|\[\d+\]", path.partition("[...]")[0]):
        name += step
        value = value[step[1:] if step[0] == "." else int(step[1:-1])]
    raise ValueError(f"{name} is {short_repr(value)}: {_needed(text, hint)} is needed")


@cache
def _type_hints(declaration: Any) -> Mapping[str, Any]:
    """Return name -> type hint with bounds, of a class's fields or a function's arguments."""
    hints = get_type_hints(declaration, include_extras=True)
    if isinstance(declaration, type) and issubclass(declaration, Struct):
        hints |= {item.encode_name: hints[item.name] for item in structs.fields(declaration)}
    return hints


_REPLACEMENTS: Final = {
    r"^Expected |, got .*| \| null|`": "",
    r"[<>]= -?1\.79\S+": "that is finite",
    r"Number out of range": "a number that is finite",
    r"\bfloat\b": "a number",
    r"\bint\b": "a whole number",
    r"\bstr\b": "a text",
    r"\bbool\b": "true or false",
    r"\bobject\b": "names with values",
    r"\bCallable\b": "a function",
    r"\barray\b": "a list",
    r" \| ": " or ",
    r"\.0\b": "",
}
"""Pattern in msgspec's messages -> our words for it; applied in this order."""


def _needed(text: str, hint: Any) -> str:
    """Return what is needed, in our words.

    Args:
        text: message of msgspec without the path, such as "Expected `float` >= 0.0".
        hint: type hint that the value does not suit.
    """
    if "enum" in text:  # msgspec does not name the choices of a `Literal`
        literals = [part for part in (hint, *get_args(hint)) if get_origin(part) is Literal]
        return " or ".join(repr(value) for literal in literals for value in get_args(literal))
    for pattern, words in _REPLACEMENTS.items():
        text = re.sub(pattern, words, text)
    return text


def require_count(name: str, value: float, least: int = 1) -> int:
    """Return a count as a whole number, such as 3 for 3.0.

    Args:
        name: name of the option, for the message.
        value: its value.
        least: least number allowed.

    Raises:
        ValueError: the value is no whole number of at least ``least``.
    """
    if not is_number(value) or value != int(value) or value < least:
        any_value: object = value  # callers may pass what the type hint forbids
        text = any_value if isinstance(any_value, numbers.Real) else short_repr(any_value)
        raise ValueError(f"{name} is {text}: a whole number of at least {least} is needed")
    return int(value)


def short_repr(value: object) -> str:
    """Return the repr of a value, cut to `_MAX_REPR` characters."""
    try:
        text = repr(value)
    except RecursionError:
        return f"a {type(value).__name__} that is nested too deep"
    return text if len(text) <= _MAX_REPR else f"{text[: _MAX_REPR - 3]}..."


def is_number(value: object) -> bool:
    """Return whether a value is a finite number, of Python or numpy."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:  # a whole number may be too large for a float
        return False
