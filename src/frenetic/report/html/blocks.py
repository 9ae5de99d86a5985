"""The parts of a page: sections of blocks, as plain data.

Texts are plain: nothing in them is HTML.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from math import isfinite
from typing import Any, ClassVar, Final, Literal, Protocol, TypeAlias

Role: TypeAlias = Literal["accent", "fail", "pass", "invalid", "error", "quiet"]
"""Meaning of a colour; the page chooses the colour, light or dark."""


class Block(Protocol):
    """A part of a section: a dataclass with the name of the function that draws it."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph:
    """A text."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True)
class Fact:
    """A name with its value."""

    name: str
    value: str


@dataclass(frozen=True)
class Facts:
    """Names and values, one below the other."""

    kind: ClassVar[str] = "facts"
    facts: tuple[Fact, ...]
    title: str = ""
    folded: bool = False
    """Whether it is folded until its title is clicked."""


@dataclass(frozen=True)
class Command:
    """A command line that can be copied."""

    kind: ClassVar[str] = "command"
    line: str
    text: str = ""
    """Its effect."""


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    title: str
    is_number: bool = False
    text: str = ""
    """Explanation, shown on demand."""


@dataclass(frozen=True)
class Table:
    """Rows of texts; columns of numbers are right-aligned."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    links: tuple[str | None, ...] = ()
    """Relative address of the link in each row's first text, as many as rows, or none."""
    tall: bool = False
    """Whether it scrolls."""
    faint: tuple[bool, ...] = ()
    """Whether a row fades, since little stands behind it; as many as rows, or none."""


@dataclass(frozen=True)
class Series:
    """A line through points, with a band around it if there is one."""

    name: str
    x: tuple[float, ...]
    """Ascending."""
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    """Lower edge of the band, as many as points, or none."""
    high: tuple[float, ...] = ()
    role: Role = "accent"
    dashed: bool = False
    stepped: bool = False
    """Whether the value holds until the next point."""


@dataclass(frozen=True)
class Chart:
    """Lines over a number."""

    kind: ClassVar[str] = "chart"
    series: tuple[Series, ...]
    x_title: str
    y_title: str
    caption: str = ""


@dataclass(frozen=True)
class Bars:
    """A bar for each name, with an interval if there is one."""

    kind: ClassVar[str] = "bars"
    names: tuple[str, ...]
    values: tuple[float | None, ...]
    title: str
    """Name of the values, with their unit."""
    low: tuple[float | None, ...] = ()
    """Lower ends of the intervals, as many as names, or none."""
    high: tuple[float | None, ...] = ()
    role: Role = "fail"
    caption: str = ""
    notes: tuple[str, ...] = ()
    """Small text under each name, as many as names, or none."""
    faint: tuple[bool, ...] = ()
    """Whether a bar fades, since little stands behind it; as many as names, or none."""


@dataclass(frozen=True)
class Picture:
    """A picture that is part of the page."""

    kind: ClassVar[str] = "picture"
    source: str
    """A ``data:`` URI: the page can load nothing else."""
    text: str
    """Description for readers who cannot see it."""
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A headline with blocks under it."""

    id: str
    """Letters, digits and hyphens; each once in a page."""
    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    """A sentence or two under the headline."""


_PLAIN: Final = frozenset({int, str, bool, type(None)})


def percent(share: float) -> str:
    """A share 0..1 in percent, in the form of a page's texts."""
    return f"{100.0 * share:.1f}\u00a0%"


def to_json(value: Any) -> Any:
    """A dataclass and its contents as JSON; numbers that are not finite become null."""
    if is_dataclass(value) and not isinstance(value, type):
        found = {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
        kind = getattr(value, "kind", None)
        return found if kind is None else {"kind": kind, **found}
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, StrEnum):
        return str(value)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Mapping):
        return {str(name): to_json(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        if set(map(type, value)) <= _PLAIN:
            return value  # most of a page is long columns
        return [to_json(item) for item in value]
    raise TypeError(f"{value!r} is a {type(value).__name__}, which a page cannot hold")
