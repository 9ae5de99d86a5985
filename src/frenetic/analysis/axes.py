"""Axes of a coverage: ranges of conditions and of properties of roads, cut into cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic.conditions.condition import condition_named, condition_names
from frenetic.conditions.domain import Domain
from frenetic.road.classes import RoadClass
from frenetic.search.operators import CURVATURE_BOUND
from frenetic.search.records import Candidate

RADIUS: Final = "min_radius"
"""Name of the axis of a road's least radius, in m."""
GRADE: Final = "max_grade"
"""Name of the axis of a road's steepest grade, in %."""

_RADIUS_CELLS: Final = 5
"""Number of cells of the least radius (our choice)."""
_MAX_WIDTHS: Final = 6.5
"""Largest length of another range, in widths of its inner cells (our choice)."""
_ROUND_WIDTHS: Final = (1.0, 2.0, 2.5, 5.0, 10.0)
"""Widths of inner cells, each times a power of 10 (our choice)."""
_WIDTH_TOLERANCE: Final = 0.999
"""Share of a width that a round width must have: a rounding error must not lead to the next."""
_LEAST_END_CELL: Final = 0.499
"""Least width of the first and the last cell, in widths of inner cells: half, less a tolerance."""
_EDGE_TOLERANCE: Final = 1e-3
"""Share of the range by which a value may miss the first or the last edge (our choice)."""


@dataclass(frozen=True)
class Axis:
    """Range of a condition, or of a property of roads, cut into cells."""

    name: str
    """Name of a condition, `RADIUS` or `GRADE`."""
    title: str
    """Name for people."""
    unit: str
    """Unit; empty without a unit."""
    edges: tuple[float, ...]
    """Edges of the cells, ascending; a value on an inner edge belongs to the cell above. The last
    edge may be infinite."""
    has_usual: bool = False
    """Whether the first cell is "as usual", for drives without an amount."""

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.edges) - 1 + self.has_usual

    def limits(self, cell: int) -> tuple[float, float] | None:
        """Return the ends of a cell, numbered from 0; None for "as usual"."""
        i = cell - self.has_usual
        return None if i < 0 else (self.edges[i], self.edges[i + 1])

    def text(self, cell: int) -> str:
        """Return the range of a cell as text, without the unit."""
        limits = self.limits(cell)
        if limits is None:
            return "as usual"
        low, high = map(_edge_text, limits)
        if limits[1] == math.inf:
            return f"{low} or more"
        return low if low == high else f"{low} to {high}"

    def title_text(self, cell: int) -> str:
        """Return a cell with title and unit as text, such as ``gust 0 to 10 m/s``."""
        unit = f" {self.unit}" if self.unit and self.limits(cell) is not None else ""
        return f"{self.title} {self.text(cell)}{unit}"

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Labels for edges and "usual", each with its position on the axis, counted in cells."""
        usual = [(0.5, "usual")] if self.has_usual else []
        if self.edges[0] == self.edges[1]:
            return [*usual, (self.cell_count - 0.5, _edge_text(self.edges[0]))]
        return usual + [(i + self.has_usual, _edge_text(edge)) for i, edge in enumerate(self.edges)]

    def find(self, candidate: Candidate) -> int | None:
        """Return the cell of a candidate; None if the candidate lies outside."""
        value = self._value(candidate)
        if value is None:
            return 0 if self.has_usual else None
        low, high = self.edges[0], self.edges[-1]
        tolerance = _EDGE_TOLERANCE * (high - low if math.isfinite(high) else low)
        if not low - tolerance <= value <= high + tolerance:
            return None
        i = int(np.searchsorted(self.edges, value, side="right")) - 1
        return min(max(i, 0), len(self.edges) - 2) + self.has_usual

    def _value(self, candidate: Candidate) -> float | None:
        """Return the value of a candidate on this axis; None for "as usual"."""
        if self.name == RADIUS:
            sharpest = float(np.abs(candidate.curvatures).max())
            return 1.0 / sharpest if sharpest > 0.0 else math.inf
        if self.name == GRADE:
            return 0.0 if candidate.grade is None else 100.0 * np.abs(candidate.grade[:, 1]).max()
        amount = candidate.conditions.get(self.name)
        if amount is None and not self.has_usual:
            return condition_named(self.name).no_effect  # an amount without effect is not recorded
        return amount


def _edge_text(edge: float) -> str:
    """Return an edge as text, with at most six digits."""
    return "∞" if edge == math.inf else f"{edge:.6g}"


def axes_of(domain: Domain) -> list[Axis]:
    """Return the axes of a domain: its conditions that vary, then properties of its roads."""
    axes = [
        _condition_axis(name, amounts.low, amounts.high, has_usual=amounts.chance < 1.0)
        for name, amounts in domain.conditions.items()
        if amounts.low < amounts.high or amounts.chance < 1.0
    ]
    return axes + _road_axes(domain.road_class)


def varied_axes(conditions: Sequence[Mapping[str, float]]) -> list[Axis]:
    """Return the axes of the conditions in which drives differ, over the amounts that occur.

    Args:
        conditions: conditions of each drive: name -> amount.
    """
    axes = []
    names = (name for drive_conditions in conditions for name in condition_names(drive_conditions))
    for name in dict.fromkeys(names):
        amounts = [
            drive_conditions[name] for drive_conditions in conditions if name in drive_conditions
        ]
        low, high, has_usual = min(amounts), max(amounts), len(amounts) < len(conditions)
        if low < high or has_usual:
            axes.append(_condition_axis(name, low, high, has_usual=has_usual))
    return axes


def _condition_axis(name: str, low: float, high: float, *, has_usual: bool) -> Axis:
    """Return the axis of a condition from a least to a largest amount."""
    unit = condition_named(name).unit
    return Axis(name, title=name, unit=unit, edges=_round_edges(low, high), has_usual=has_usual)


def _road_axes(road_class: RoadClass | None) -> list[Axis]:
    """Return the axes of the roads of a class, or of the competition's roads for None.

    These are the least radius, in cells of about equal curvature, and the grade if roads have any.
    """
    least = 1.0 / (CURVATURE_BOUND if road_class is None else road_class.max_curvature)
    inner = (
        float(f"{least * _RADIUS_CELLS / (_RADIUS_CELLS - i):.2g}") for i in range(1, _RADIUS_CELLS)
    )
    axes = [Axis(RADIUS, "least radius", "m", (float(f"{least:.4g}"), *inner, math.inf))]
    if road_class is not None and road_class.max_grade > 0.0:
        edges = _round_edges(0.0, 100.0 * road_class.max_grade)
        axes.append(Axis(GRADE, "steepest grade", "%", edges))
    return axes


def _round_edges(low: float, high: float) -> tuple[float, ...]:
    """Return the ends of a range and round numbers between them: three to seven cells.

    Inner cells have the same width; the first and the last are half to one and a half times as
    wide.
    """
    if low == high:
        return low, high
    least_width = (high - low) / _MAX_WIDTHS
    power = 10.0 ** math.floor(math.log10(least_width))
    width = power * next(
        width for width in _ROUND_WIDTHS if width * power >= _WIDTH_TOLERANCE * least_width
    )
    first, last = low + _LEAST_END_CELL * width, high - _LEAST_END_CELL * width
    multiples = range(math.ceil(first / width), math.floor(last / width) + 1)
    return low, *(float(f"{multiple * width:.12g}") for multiple in multiples), high


def limits_json(axis: Axis, cell: int) -> dict[str, float | None]:
    """Return the ends of a cell as JSON: null for "as usual", and for an infinite upper end."""
    low, high = axis.limits(cell) or (None, None)
    return {"low": low, "high": None if high == math.inf else high}
