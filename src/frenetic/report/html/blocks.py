"""The parts of a page: sections of blocks, as plain data.

Texts are plain: nothing in them is HTML.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from math import floor, isfinite, log10
from typing import Any, ClassVar, Final, Literal, Protocol, TypeAlias

from matplotlib.ticker import MaxNLocator

from frenetic._support.words import signed

Role: TypeAlias = Literal["accent", "fail", "pass", "invalid", "error", "quiet"]
"""Meaning of a colour; the page chooses the colour, light or dark."""


class Block(Protocol):
    """A part of a section: a dataclass with the name of what draws it.

    That is a macro of ``templates/blocks.html``, or a function of the page's script.
    """

    @property
    def kind(self) -> str:
        """The name."""


@dataclass(frozen=True)
class Part:
    """A block of our own pages."""

    kind: str
    data: Mapping[str, Any]
    """What is drawn: texts, numbers, and tuples, mappings or dataclasses of them."""


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
    role: str = "accent"
    """A `Role`, or ``group-0`` to ``group-7``."""
    dashed: bool = False
    stepped: bool = False
    """Whether the value holds until the next point."""
    width: float = 2.0
    """Width of the line, in pixels."""
    singles: tuple[tuple[float, ...], ...] = ()
    """Thin lines beside it, each with as many points."""


@dataclass(frozen=True)
class Chart:
    """Lines over a number."""

    kind: ClassVar[str] = "chart"
    series: tuple[Series, ...]
    x_title: str
    y_title: str
    caption: str = ""
    name: str = ""
    """Name among the charts of a `Switch`."""
    counts: bool = False
    """Whether both axes begin at 0, and the upper one has whole numbers."""
    tests: tuple[int | None, ...] = ()
    """Id of the test that a click at each point of the first line opens, or none."""


@dataclass(frozen=True)
class Switch:
    """Charts of which one is shown at a time."""

    kind: ClassVar[str] = "switch"
    label: str
    """Word before the buttons."""
    charts: tuple[Chart, ...]
    caption: str = ""


@dataclass(frozen=True)
class Scale:
    """A scale of round numbers along a track, in percent of its width."""

    low: float
    high: float
    ticks: tuple[float, ...]
    first: float = 0.0
    """Place of the lower end, in percent."""
    last: float = 100.0
    """Place of the upper end, in percent."""

    @classmethod
    def of(cls, values: Iterable[float | None], *, most: int = 5, fits: bool = True) -> Scale:
        """The scale of some values; it begins and ends at round numbers if it ``fits``."""
        known = [value for value in values if value is not None]
        low, high = min(known), max(known)
        ticks = [
            float(tick) for tick in MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high)
        ]
        if fits:
            return cls(min(low, ticks[0]), max(high, ticks[-1]), tuple(ticks))
        return cls(low, high, tuple(tick for tick in ticks if low <= tick <= high))

    def at(self, value: float) -> float:
        """Place of a value, in percent."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.first + share * (self.last - self.first), 2)


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

    @property
    def scale(self) -> Scale:
        """The scale of all bars, from 0 or below."""
        return Scale.of([0.0, 1e-9, *self.values, *self.low, *self.high])

    def text(self, value: float | None) -> str:
        """A value, with as many digits as the largest needs."""
        most = max(abs(self.scale.low), abs(self.scale.high))
        return signed(value, max(1, 2 - floor(log10(most))))


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
        if isinstance(value, Part):
            return {"kind": value.kind, **found["data"]}
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
