"""Coverage of a domain: which cells of its conditions and roads were driven, alone and in pairs.

The range of each condition, and of the least radius and the grade of roads, is cut into cells. A
drive lies in the cells of its conditions and of its whole road, wherever the drive ended.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.counts import FirstTests
from frenetic.campaign.record import Test
from frenetic.conditions.condition import condition_named, named
from frenetic.conditions.domain import Domain
from frenetic.oracle.outcome import Outcome
from frenetic.road.classes import RoadClass
from frenetic.search.operator_names import RANDOM
from frenetic.search.operators import CURVATURE_BOUND
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Origin
from frenetic.spec.terms import DriveSetting

RADIUS: Final = "min_radius"
"""Name of the axis of a road's least radius, in m."""
GRADE: Final = "max_grade"
"""Name of the axis of a road's steepest grade, in %."""
ROADS: Final = 500
"""Number of random roads that stand for a domain's roads (our choice)."""
DRAWN: Final = 10_000
"""Number of random drives that estimate the share of covered drives (our choice)."""

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
_RARE: Final = 1e-4
"""Share of the drives below which a gap's likelihood has no number (our choice)."""


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
            return condition_named(self.name).nothing  # an amount without effect is not recorded
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
    names = (name for drive_conditions in conditions for name in named(drive_conditions))
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


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of an axis, or of a pair of axes, with the drives in each."""

    axes: tuple[Axis, ...]
    """Axis, or pair of axes."""
    shares: FloatArray
    """Share of the domain's drives in each cell, (n,) or (n, m)."""
    drives: npt.NDArray[np.int64]
    """Number of drives in each cell, (n,) or (n, m)."""
    failures: npt.NDArray[np.int64]
    """Number of failures in each cell, (n,) or (n, m)."""

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.drives.size

    @property
    def driven(self) -> int:
        """Number of cells with a drive."""
        return int(np.count_nonzero(self.drives))

    @property
    def failed(self) -> int:
        """Number of cells with a failure."""
        return int(np.count_nonzero(self.failures))

    @property
    def never_reached(self) -> int:
        """Number of cells without a drive."""
        return self.count - self.driven

    @property
    def driven_share(self) -> float:
        """Share of the domain's drives in cells with a drive."""
        return min(float(self.shares[self.drives > 0].sum()), 1.0)

    def as_json(self) -> dict[str, Any]:
        """Return the counts as a JSON object."""
        return {
            "axes": [axis.name for axis in self.axes],
            "cells": self.count,
            "driven": self.driven,
            "failed": self.failed,
            "never_reached": self.never_reached,
            "driven_share": self.driven_share,
        }


@dataclass(frozen=True)
class Gap:
    """Cell of an axis, or of a pair of axes, without a drive."""

    cells: tuple[tuple[Axis, int], ...]
    """Axis, or pair of axes, each with the number of the cell."""
    share: float
    """Share of the domain's drives in the cell."""

    @property
    def likelihood(self) -> str:
        """Share of the domain's drives in words."""
        if self.share < _RARE:
            return "less than 1 drive in 10,000"
        return f"1 drive in {round(float(f'{1.0 / self.share:.2g}')):,}"

    def as_text(self) -> str:
        """Return the cells as text, such as ``friction 0.1 to 0.2 with delay as usual``."""
        return " with ".join(axis.title_text(cell) for axis, cell in self.cells)

    def as_json(self) -> dict[str, Any]:
        """Return the gap as a JSON object, see `limits_json`."""
        cells = {axis.name: limits_json(axis, cell) for axis, cell in self.cells}
        return {"cells": cells, "share": self.share}


def limits_json(axis: Axis, cell: int) -> dict[str, float | None]:
    """Return the ends of a cell as JSON: null for "as usual", and for an infinite upper end."""
    low, high = axis.limits(cell) or (None, None)
    return {"low": low, "high": None if high == math.inf else high}


@dataclass(frozen=True, eq=False)
class DomainCoverage:
    """Coverage of a domain by a campaign's drives."""

    name: str
    """Name of the domain."""
    drives: int
    """Number of drives in the domain."""
    failures: int
    """Number of failures in the domain."""
    outside: int
    """Number of drives outside the domain, which count nowhere else."""
    singles: tuple[Cells, ...]
    """Cells of each axis."""
    pairs: tuple[Cells, ...]
    """Cells of each pair of axes."""

    @property
    def axes(self) -> list[Axis]:
        """All axes."""
        return [cells.axes[0] for cells in self.singles]

    @cached_property
    def driven_share(self) -> float:
        """Share of the domain's drives whose cells, and pairs of cells, were all driven.

        The share is counted among `DRAWN` random drives, the same ones each time.
        """
        rng = np.random.default_rng(0)
        drawn = {
            cells.axes[0].name: rng.choice(cells.count, DRAWN, p=cells.shares / cells.shares.sum())
            for cells in self.singles
        }
        is_driven = np.ones(DRAWN, dtype=bool)
        for cells in (*self.singles, *self.pairs):
            is_driven &= cells.drives[tuple(drawn[axis.name] for axis in cells.axes)] > 0
        return float(is_driven.mean())

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """Cells without a drive, the most probable first.

        A pair of cells is left out if one of its two cells alone has no drive.
        """
        gaps = [
            Gap(tuple(zip(cells.axes, index, strict=True)), float(cells.shares[tuple(index)]))
            for cells in (*self.singles, *self.pairs)
            for index in np.argwhere(cells.drives == 0).tolist()
        ]
        single_gaps = {gap.cells[0] for gap in gaps if len(gap.cells) == 1}
        listed = (gap for gap in gaps if len(gap.cells) == 1 or single_gaps.isdisjoint(gap.cells))
        return tuple(sorted(listed, key=lambda gap: -gap.share))

    def as_text(self) -> str:
        """Return the coverage in words: of the pairs of cells, or of the cells of a single axis."""
        parts, kind = (self.pairs, "pairs of cells") if self.pairs else (self.singles, "cells")
        driven, count = sum(cells.driven for cells in parts), sum(cells.count for cells in parts)
        failed = sum(cells.failed for cells in parts)
        return (
            f"{driven} of {count} {kind} driven, {failed} with failures, {count - driven} never"
            f" reached; {100.0 * self.driven_share:.0f} % of the domain's drives lie only in driven"
            f" {kind}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the coverage as a JSON object."""
        return {
            "domain": self.name,
            "drives": self.drives,
            "failures": self.failures,
            "outside": self.outside,
            "driven_share": self.driven_share,
            "axes": [
                {
                    "name": axis.name,
                    "unit": axis.unit,
                    "cells": [
                        {
                            **limits_json(axis, i),
                            "share": float(cells.shares[i]),
                            "drives": int(cells.drives[i]),
                            "failures": int(cells.failures[i]),
                        }
                        for i in range(axis.cell_count)
                    ],
                }
                for cells in self.singles
                for axis in cells.axes
            ],
            "pairs": [cells.as_json() for cells in self.pairs],
            "never_reached": [gap.as_json() for gap in self.gaps],
        }


def domain_coverage(setting: DriveSetting, tests: Iterable[Test]) -> DomainCoverage | None:
    """Return the coverage of a campaign's domain by its tests; None without a domain.

    Shares of conditions follow from their distributions, shares of roads from `ROADS` random ones.
    All axes count as independent. A road that was driven again in the same conditions counts once.

    Args:
        setting: setting of the campaign, ``store.setting``.
        tests: tests of the campaign, ``store.tests()``.
    """
    if setting.domain is None:
        return None
    domain = replace(setting.domain, road_class=setting.road_class)
    axes = axes_of(domain)
    rows, has_failed, outside, first_tests = [], [], 0, FirstTests()
    for test in tests:
        if not (test.outcome.is_driven and first_tests.add(test.candidate, test.outcome)):
            continue
        row = [axis.find(test.candidate) for axis in axes]
        if None in row:
            outside += 1
        else:
            rows.append(row)
            has_failed.append(test.outcome is Outcome.FAIL)
    roads = _random_roads(setting)
    drive_cells = _DriveCells(
        axes,
        shares=[_shares(axis, domain, roads) for axis in axes],
        cells=np.array(rows, dtype=np.int64).reshape(-1, len(axes)),
        has_failed=np.array(has_failed, dtype=bool),
    )
    return DomainCoverage(
        domain.name,
        drives=len(rows),
        failures=sum(has_failed),
        outside=outside,
        singles=tuple(drive_cells.count(i) for i in range(len(axes))),
        pairs=tuple(drive_cells.count(i, j) for i, j in combinations(range(len(axes)), 2)),
    )


@dataclass(frozen=True, eq=False)
class _DriveCells:
    """The cells in which each drive of a campaign lies."""

    axes: Sequence[Axis]
    """Axes of the domain."""
    shares: Sequence[FloatArray]
    """Share of the domain's drives in each cell, (cells,) for each axis."""
    cells: npt.NDArray[np.int64]
    """Number of the cell of each drive on each axis, (drives, axes)."""
    has_failed: npt.NDArray[np.bool_]
    """Whether each drive failed, (drives,)."""

    def count(self, *indices: int) -> Cells:
        """Return the drives counted by the cells of one axis or of two, given by their indices."""
        shares = [self.shares[i] for i in indices]
        return Cells(
            axes=tuple(self.axes[i] for i in indices),
            shares=shares[0] if len(shares) == 1 else np.outer(*shares),
            drives=self._count_drives(self.cells, indices),
            failures=self._count_drives(self.cells[self.has_failed], indices),
        )

    def _count_drives(
        self, cells: npt.NDArray[np.int64], indices: Sequence[int]
    ) -> npt.NDArray[np.int64]:
        shape = tuple(self.axes[i].cell_count for i in indices)
        flat = np.ravel_multi_index([cells[:, i] for i in indices], shape)
        return np.bincount(flat, minlength=math.prod(shape)).reshape(shape)


def _random_roads(setting: DriveSetting) -> list[Candidate]:
    """Return `ROADS` roads, drawn as the strategy ``random`` does, the same ones each time."""
    rng = np.random.default_rng(0)
    roads = RandomRoads(map_size=setting.map_size, road_class=setting.road_class)
    roads.keep_map_margin(setting.map_margin)
    drawn = (roads.draw(rng) for _ in range(ROADS))
    return [
        Candidate(
            id=1,
            curvatures=values,
            step=roads.step,
            origin=Origin(RANDOM),
            grade=roads.grade(rng, values),
        )
        for values in drawn
    ]


def _shares(axis: Axis, domain: Domain, roads: Sequence[Candidate]) -> FloatArray:
    """Return the share of the domain's drives in each cell of an axis, (n,)."""
    if axis.name in (RADIUS, GRADE):
        cells = np.array([axis.find(road) for road in roads])
        shares: FloatArray = np.bincount(cells, minlength=axis.cell_count) / len(roads)
        return shares
    amounts = domain.conditions[axis.name]
    usual = [1.0 - amounts.chance] if axis.has_usual else []
    if amounts.low == amounts.high:
        return np.array([*usual, amounts.chance])
    return np.array([*usual, *np.diff([amounts.share(edge) for edge in axis.edges])])
