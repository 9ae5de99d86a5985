"""Blocks that show groups side by side: a table, curves, spreads, and pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Group:
    """What is held against others, in a colour of its own."""

    name: str
    colour: int
    """From 0; the page repeats its colours, lighter or dashed, where they do not suffice."""


@dataclass(frozen=True)
class GroupColumn:
    """A measure of all groups."""

    title: str
    better: str
    """``more``, ``less`` or ``neither``."""
    topic: str = ""
    """A title over neighbouring columns that share it."""
    text: str = ""
    """What it is, for those who ask."""


@dataclass(frozen=True)
class GroupCell:
    """What a measure is for a group."""

    value: str
    note: str = ""
    """Under the value, smaller."""
    strength: float = 0.0
    """0..1, how much it stands out from its column."""


@dataclass(frozen=True)
class GroupTable:
    """A row per group, a column per measure."""

    kind: ClassVar[str] = "groupTable"
    title: str
    groups: tuple[Group, ...]
    columns: tuple[GroupColumn, ...]
    rows: tuple[tuple[GroupCell, ...], ...]
    """One per group, with a cell per column."""
    caption: str = ""


@dataclass(frozen=True)
class GroupCurve:
    """What the campaigns of a group came to, over what was spent."""

    group: Group
    x: tuple[float, ...]
    median: tuple[float, ...]
    low: tuple[float, ...] = ()
    """First quartile, as many as points, or none."""
    high: tuple[float, ...] = ()
    """Third quartile, likewise."""
    singles: tuple[tuple[float, ...], ...] = ()
    """Each campaign, where they are too few for quartiles."""


@dataclass(frozen=True)
class CurvePanel:
    """A chart with a curve per group."""

    title: str
    curves: tuple[GroupCurve, ...]


@dataclass(frozen=True)
class Curves:
    """Charts with a legend that they share; the first is the largest."""

    kind: ClassVar[str] = "curves"
    x_title: str
    panels: tuple[CurvePanel, ...]
    caption: str = ""


@dataclass(frozen=True)
class Spread:
    """The values of a group."""

    group: Group
    values: tuple[float | None, ...]
    """One per campaign, ascending; None for what is worse than any number."""
    texts: tuple[str, ...]
    """The same, for people."""
    median: str
    """For people."""
    quartiles: tuple[float | None, float | None, float | None] | None
    """First, median and third; None if there are too few values."""


@dataclass(frozen=True)
class SpreadPanel:
    """How a measure is distributed in each group."""

    title: str
    note: str
    none_is_low: bool
    """Whether what is worse than any number stands left of all, not right."""
    spreads: tuple[Spread, ...]


@dataclass(frozen=True)
class Spreads:
    """A point per campaign over a box from quartile to quartile, panel by panel."""

    kind: ClassVar[str] = "spreads"
    panels: tuple[SpreadPanel, ...]
    caption: str = ""


@dataclass(frozen=True)
class Pair:
    """Two groups, compared."""

    first: Group
    second: Group
    a12: float
    effect: str
    p: str
    p_corrected: str
    verdict: str
    better: int
    """1 if the first is shown to be better, 2 if the second is, 0 if neither is."""


@dataclass(frozen=True)
class PairsBy:
    """All pairs, compared by a measure."""

    title: str
    note: str
    pairs: tuple[Pair, ...]


@dataclass(frozen=True)
class Pairs:
    """Pairs of groups, compared by a measure that the reader chooses."""

    kind: ClassVar[str] = "pairs"
    measures: tuple[PairsBy, ...]
    caption: str = ""
