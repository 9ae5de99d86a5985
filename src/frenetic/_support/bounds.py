"""Kinds of numbers, with the bounds that `msgspec.convert` checks, and their check."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Final, Literal, TypeAlias, get_args, get_origin, get_type_hints

from msgspec import Meta, ValidationError, convert

from frenetic._support.scalars import without_numpy

_MOST: Final = sys.float_info.max

Finite: TypeAlias = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=_MOST)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=_MOST)]
Measured: TypeAlias = Annotated[float, Meta(ge=-1e7, le=1e7)]
"""A length in m, a time in s: what is larger is a mistake."""
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Count: TypeAlias = Annotated[int, Meta(ge=1, le=2**63 - 1)]
Index: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Text: TypeAlias = Annotated[str, Meta(min_length=1)]


def check(values: Mapping[str, Any], of: Any) -> None:
    """Checks values by the hints of a class's fields or of a function's arguments.

    Raises:
        ValueError: one is of another kind or out of its bounds; the message names it.
    """
    for name, kind in _hints(of).items():
        if name in values:
            try:
                convert(without_numpy(values[name]), kind)
            except ValidationError as error:
                text = f"{name} is {repr(values[name])[:60]}: {_needed(str(error), kind)} is needed"
                raise ValueError(text) from None


@cache
def _hints(of: Any) -> Mapping[str, Any]:
    return get_type_hints(of, include_extras=True)


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
    """The end of msgspec's message in our words."""
    if "enum" in text:
        choices = [one for one in (kind, *get_args(kind)) if get_origin(one) is Literal]
        return " or ".join(repr(value) for one in choices for value in get_args(one))
    for pattern, word in _WORDS.items():
        text = re.sub(pattern, word, text)
    return text
