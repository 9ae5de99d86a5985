"""The parts of a page: sections of blocks, as plain data.

Texts are plain: nothing in them is HTML.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

from matplotlib.ticker import MaxNLocator

Role: TypeAlias = Literal["accent", "fail", "pass", "invalid", "error", "quiet"]
"""Meaning of a colour; the page chooses the colour, light or dark."""


@dataclass(frozen=True)
class Part:
    """A block of our own pages."""

    kind: str
    """Name of what draws it: a macro of ``templates/blocks.html``, or a function of the script."""
    data: Mapping[str, Any]
    """What is drawn: texts, numbers, and lists, mappings or dataclasses of them."""


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
    counts: bool = False
    """Whether both axes begin at 0, and the upper one has whole numbers."""
    tests: tuple[int | None, ...] = ()
    """Id of the test that a click at each point of the first line opens, or none."""


@dataclass(frozen=True)
class Tile:
    """A headline number."""

    label: str
    value: str
    note: str = ""
    role: Role | None = None
    """None for a number that is neither good nor bad, and for 0."""


@dataclass(frozen=True)
class Headline:
    """The top of a page."""

    kind: ClassVar[str] = "headline"
    title: str
    lead: str
    warning: str
    """A warning, for example that the campaign is unfinished. Mostly empty."""
    tiles: tuple[Tile, ...]
    facts: tuple[Fact, ...]


Block: TypeAlias = Part | Paragraph | Facts | Table | Chart | Headline


@dataclass(frozen=True)
class Section:
    """A headline with blocks under it."""

    id: str
    """Letters, digits and hyphens; each once in a page."""
    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    """A sentence or two under the headline."""


def command(line: str, text: str) -> Part:
    """A command line that can be copied, and its effect."""
    return Part("command", {"line": line, "text": text})


def percent(share: float) -> str:
    """A share 0..1 in percent, in the form of a page's texts."""
    return f"{100.0 * share:.1f}\u00a0%"


def round_numbers(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers from below ``low`` to above ``high``, at most so many steps."""
    ticks = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [float(tick) for tick in ticks]


def tick_text(value: float) -> str:
    """A number at an axis."""
    return proper(f"{value:.6g}")


def proper(text: str) -> str:
    """A text whose negative numbers have a proper minus sign."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)
