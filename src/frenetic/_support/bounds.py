"""Types of numbers and texts with bounds that `msgspec.convert` checks, and their checks."""

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

_MOST: Final = sys.float_info.max

Finite: TypeAlias = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=_MOST)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=_MOST)]
Measured: TypeAlias = Annotated[float, Meta(ge=-1e7, le=1e7)]
"""A measured length in m or time in s: a larger number is a mistake."""
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Count: TypeAlias = Annotated[int, Meta(ge=1, le=2**63 - 1)]
Index: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Text: TypeAlias = Annotated[str, Meta(min_length=1)]


def check(values: Mapping[str, Any], of: Any) -> None:
    """Check values against the type hints of a class's fields or of a function's arguments.

    Raises:
        ValueError: a value has another type or is out of bounds; the message names the value.
    """
    converted(values, of)


def converted(values: Mapping[str, Any], of: Any) -> dict[str, Any]:
    """Return values converted to the type hints of a class's fields or a function's arguments.

    Args:
        values: values by name; names without a hint are left out.
        of: the class or the function; a field of a struct has its encoded name, too.

    Raises:
        ValueError: a value has another type or is out of bounds; the message names the value.
    """
    return {
        name: _converted(name, values[name], kind)
        for name, kind in _hints(of).items()
        if name in values
    }


def _converted(name: str, value: Any, kind: Any) -> Any:
    try:
        return convert(without_numpy(value), kind)
    except ValidationError as error:
        message = str(error)
    if not message.startswith(("Expected", "Invalid enum", "Number")):
        raise ValueError(f"{name}: {message}")
    text, _, place = message.partition(" - at `$")
    for step in re.findall(r"[.]\w+|\[\d+\]", place.partition("[...]")[0]):
        name += step
        value = value[step[1:] if step[0] == "." else int(step[1:-1])]
    raise ValueError(f"{name} is {shown(value)}: {_needed(text, kind)} is needed")


@cache
def _hints(of: Any) -> Mapping[str, Any]:
    hints = get_type_hints(of, include_extras=True)
    if isinstance(of, type) and issubclass(of, Struct):
        hints |= {item.encode_name: hints[item.name] for item in structs.fields(of)}
    return hints


_WORDS: Final = {
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


def _needed(text: str, kind: Any) -> str:
    """Return the end of msgspec's message in the words of our messages."""
    if "enum" in text:
        choices = [hint for hint in (kind, *get_args(kind)) if get_origin(hint) is Literal]
        return " or ".join(repr(value) for hint in choices for value in get_args(hint))
    for pattern, word in _WORDS.items():
        text = re.sub(pattern, word, text)
    return text


def require_count(name: str, value: float, least: int = 1) -> int:
    """Return an option that counts something as a whole number.

    Raises:
        ValueError: the value is no whole number of at least ``least``.
    """
    if not is_number(value) or value != int(value) or value < least:
        any_value: object = value  # callers may pass what the type hint forbids
        text = any_value if isinstance(any_value, numbers.Real) else shown(any_value)
        raise ValueError(f"{name} is {text}: a whole number of at least {least} is needed")
    return int(value)


def shown(value: object) -> str:
    """Return the repr of a value, at most 60 characters long."""
    try:
        text = repr(value)
    except RecursionError:
        return f"a {type(value).__name__} that is nested too deep"
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_number(value: object) -> bool:
    """Return whether a value is a finite number, of Python or numpy."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:  # a whole number may be too large for a float
        return False
