"""Section of a page: the feature map, which shows what roads and drives were tried and fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.ticker import MaxNLocator

from frenetic._support.arrays import FloatArray, evenly, spread
from frenetic._support.words import capitalised
from frenetic.analysis.axes import Axis
from frenetic.oracle.outcome import Outcome
from frenetic.report.html.page import DataBlock, Section, proper
from frenetic.report.html.tests import TestSummary
from frenetic.segments.features import FEATURES, Feature, Features

MAPPED: Final = 3000
"""Number of tests in the map up to which passed tests are added to the failures; our choice."""
MAPPED_PASSED: Final = 1000
"""Least number of passed tests in the map, if there are as many; our choice."""
MAPPED_FAILURES: Final = 10_000
"""Largest number of failures in the map: nearly always all, so none is hidden; our choice."""
CELLS: Final = 10
"""Approximate number of cells on an axis; our choice."""

_CELL_LETTERS: Final = "0123456789abcdefghijklmnopqrstuvwxyz"
"""Letters that stand for the cells of an axis, one per test, in the data of the script."""


def cells_of(
    feature: Feature, measured: Sequence[Features]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Divide the range of a feature into cells with round edges, and return each test's cell.

    Args:
        feature: the feature.
        measured: features of each test; speeds become km/h.

    Returns:
        Edges of the n cells, (n + 1,), ascending, and the cell of each test, (tests,), counted from
        0. Without tests the edges divide the published range.
    """
    factor = 3.6 if feature.unit == "m/s" else 1.0
    values = factor * np.array([features[feature.name] for features in measured], dtype=np.float64)
    in_range = values if len(values) else factor * feature.edges[[0, -1]]
    low, high = float(in_range.min()), float(in_range.max())
    if feature.is_count:
        edges = np.arange(round(low) - 0.5, round(high) + 1.0)
    else:
        # If all values are equal, they are in the middle of a range as wide as a published cell.
        half = 0.0 if high - low > 1e-6 else 0.5 * factor * float(np.diff(feature.edges)[0])
        ticks = MaxNLocator(CELLS, steps=[1, 2, 2.5, 5, 10]).tick_values(low - half, high + half)
        edges = np.array(ticks, dtype=np.float64)
    cells = np.searchsorted(edges, values, side="right") - 1
    return edges, cells.clip(0, len(edges) - 2)


def choose_mapped(tests: Sequence[tuple[int, str, float | None]]) -> set[int]:
    """Return the ids of the tests in the map: all failures, and passed tests evenly in time.

    Of more than `MAPPED_FAILURES` failures, the map has a selection that is even in severity.

    Args:
        tests: id, outcome and MOOBD of each test, in the order of the results.
    """
    failed = sorted((row for row in tests if row[1] == Outcome.FAIL), key=_severity)
    failed = [failed[i] for i in evenly(len(failed), MAPPED_FAILURES)]
    passed = [row for row in tests if row[1] == Outcome.PASS]
    passed = [passed[i] for i in spread(len(passed), max(MAPPED - len(failed), MAPPED_PASSED))]
    return {row[0] for row in (*failed, *passed)}


def _severity(row: tuple[int, str, float | None]) -> tuple[float, int]:
    """Return MOOBD and id of a test, by which failures are sorted."""
    return row[2] or 0.0, row[0]


def map_section(
    measured: Mapping[int, Features],
    tests: Sequence[TestSummary],
    cells: Mapping[Axis, Sequence[int | None]] = MappingProxyType({}),
) -> Section:
    """Return the section with the feature map.

    Args:
        measured: id of a test -> features of the test's segment; tests without one are left out.
        tests: all tests of the campaign.
        cells: axis of a condition or of roads -> cell of each measured test; None outside the axis.
    """
    title = "Feature map"
    if not measured:
        return Section("map", title, (), "Nothing was driven yet.")
    axes: list[dict[str, Any]] = []
    for feature in FEATURES.values():
        if feature.name == "length":  # all segments are about as long
            continue
        edges, feature_cells = cells_of(feature, list(measured.values()))
        assert len(edges) <= len(_CELL_LETTERS)
        axis: dict[str, Any] = {
            "name": feature.name,
            "description": feature.description,
            "unit": "km/h" if feature.unit == "m/s" else feature.unit,
            "counts": feature.is_count,
            "edges": edges.round(6).tolist(),
            "bins": "".join(_CELL_LETTERS[cell] for cell in feature_cells.tolist()),
        }
        axes.append(axis)
    axes += [_axis(axis, axis_cells) for axis, axis_cells in cells.items()]
    failed, passed = (
        [test.id in measured for test in tests if test.outcome is outcome and not test.is_repeat]
        for outcome in (Outcome.FAIL, Outcome.PASS)
    )
    all_driven = all(failed) and all(passed)
    data: dict[str, Any] = {
        "tests": list(measured),
        "axes": axes,
        "first": "max_curvature",
        "second": "mean_speed",
        "all_driven": all_driven,
        "all_failures": all(failed),
        "weights": {"failed": _weight(failed), "passed": _weight(passed)},
    }
    lead = (
        "Features of road and drive from 30 m before to 30 m after the worst place. Choose a cell"
        " to see its roads."
    )
    if not all_driven:
        mapped = f"{sum(failed)} of {len(failed)} failures, {sum(passed)} of {len(passed)} others"
        lead += f" The map shows {mapped}, evenly over the campaign."
    return Section("map", title, (DataBlock("featureMap", data),), lead)


def _weight(is_mapped: Sequence[bool]) -> float:
    """Return for how many tests each mapped test of an outcome stands, evenly over the campaign."""
    return len(is_mapped) / max(sum(is_mapped), 1)


def _axis(axis: Axis, cells: Sequence[int | None]) -> dict[str, Any]:
    """Return an axis of a condition or of roads, and the cells of the tests, for the script."""
    letters = "".join("." if cell is None else _CELL_LETTERS[cell] for cell in cells)
    return {
        "name": axis.name,
        "description": capitalised(axis.title),
        "unit": axis.unit,
        "counts": False,
        "texts": [proper(capitalised(axis.title_text(i))) for i in range(axis.cell_count)],
        "ticks": [(position, proper(text)) for position, text in axis.ticks],
        "bins": letters,
    }
