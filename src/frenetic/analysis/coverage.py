"""Coverage of a domain: which cells of its conditions and roads were driven, alone and in pairs.

The ranges of conditions, and of the least radius and the grade of roads, are cut into cells, see
`frenetic.analysis.axes`. A drive lies in the cells of its conditions and of its whole road,
wherever the drive ended.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.analysis.axes import GRADE, RADIUS, Axis, axes_of, limits_json
from frenetic.campaign.counts import FirstTests
from frenetic.campaign.record import Test
from frenetic.conditions.domain import Domain
from frenetic.oracle.outcome import Outcome
from frenetic.search.operator_names import RANDOM
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Origin
from frenetic.spec.terms import DriveSetting

ROADS: Final = 500
"""Number of random roads that stand for a domain's roads (our choice)."""
DRAWN: Final = 10_000
"""Number of random drives that estimate the share of covered drives (our choice)."""

_RARE: Final = 1e-4
"""Share of the drives below which a gap's likelihood has no number (our choice)."""


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
        """Return the number of drives in each cell of some axes."""
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
