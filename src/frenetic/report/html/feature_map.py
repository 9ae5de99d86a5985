"""Feature maps: the kinds of roads and drives that were tried, and those that fail."""

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
from frenetic.analysis.features import FEATURES, Feature, Features
from frenetic.oracle.outcome import Outcome
from frenetic.report.html.page import DataBlock, Section, proper
from frenetic.report.html.tests import TestSummary

MAPPED: Final = 3000
"""Measured tests: all failures, and others up to this number."""
MAPPED_PASSED: Final = 1000
"""Least number of measured tests that passed, if there are as many."""
MAPPED_FAILURES: Final = 10_000
"""Most measured failures: nearly always all, so that no cell hides one."""
CELLS: Final = 10
"""Approximate number of cells on an axis."""

_BINS: Final = "0123456789abcdefghijklmnopqrstuvwxyz"


def cells_of(
    feature: Feature, measured: Sequence[Features]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Cut the range of a feature into cells of round numbers, and put tests into them.

    Returns:
        (n + 1,) edges of the cells, ascending; and (tests,) the cell of each test, from 0. If
        nothing is measured, the edges divide the published range.
    """
    factor = 3.6 if feature.unit == "m/s" else 1.0
    values = factor * np.array([features[feature.name] for features in measured], dtype=np.float64)
    shown = values if len(values) else factor * feature.edges[[0, -1]]
    low, high = float(shown.min()), float(shown.max())
    if feature.is_count:
        edges = np.arange(round(low) - 0.5, round(high) + 1.0)
    else:
        # One value lies in the middle of a published cell.
        half = 0.0 if high - low > 1e-6 else 0.5 * factor * float(np.diff(feature.edges)[0])
        ticks = MaxNLocator(CELLS, steps=[1, 2, 2.5, 5, 10]).tick_values(low - half, high + half)
        edges = np.array(ticks, dtype=np.float64)
    cells = np.searchsorted(edges, values, side="right") - 1
    return edges, cells.clip(0, len(edges) - 2)


def choose_mapped(tests: Sequence[tuple[int, str, float | None]]) -> set[int]:
    """Return ids of the measured tests: all failures, and others evenly over the campaign.

    Of more than `MAPPED_FAILURES` failures, an even selection from the most severe on.

    Args:
        tests: id, outcome and MOOBD of each test, in the order of the results.
    """
    failed = sorted((row for row in tests if row[1] == Outcome.FAIL), key=_severity)
    failed = [failed[i] for i in evenly(len(failed), MAPPED_FAILURES)]
    passed = [row for row in tests if row[1] == Outcome.PASS]
    passed = [passed[i] for i in spread(len(passed), max(MAPPED - len(failed), MAPPED_PASSED))]
    return {row[0] for row in (*failed, *passed)}


def _severity(row: tuple[int, str, float | None]) -> tuple[float, int]:
    return row[2] or 0.0, row[0]


def map_section(
    measured: Mapping[int, Features],
    tests: Sequence[TestSummary],
    cells: Mapping[Axis, Sequence[int | None]] = MappingProxyType({}),
) -> Section:
    """Return the feature map.

    Args:
        measured: test -> the features of the test's segment; tests without a segment are left out.
        tests: all tests of the campaign.
        cells: axis of a condition or of roads -> the cell of each measured test, or None.
    """
    title = "Feature map"
    if not measured:
        return Section("map", title, (), "Nothing was driven yet.")
    axes: list[dict[str, Any]] = []
    for feature in FEATURES.values():
        if feature.name == "length":  # all segments are about as long
            continue
        edges, places = cells_of(feature, list(measured.values()))
        assert len(edges) <= len(_BINS)
        axis: dict[str, Any] = {
            "name": feature.name,
            "description": feature.description,
            "unit": "km/h" if feature.unit == "m/s" else feature.unit,
            "counts": feature.is_count,
            "edges": edges.round(6).tolist(),
            "bins": "".join(_BINS[place] for place in places.tolist()),
        }
        axes.append(axis)
    axes += [_axis(axis, places) for axis, places in cells.items()]
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
    }
    lead = (
        "Features of road and drive from 30 m before to 30 m after the worst place. Choose a cell"
        " to see its roads."
    )
    if not all_driven:
        mapped = f"{sum(failed)} of {len(failed)} failures, {sum(passed)} of {len(passed)} others"
        lead += f" The map shows {mapped}, evenly over the campaign."
    return Section("map", title, (DataBlock("featureMap", data),), lead)


def _axis(axis: Axis, cells: Sequence[int | None]) -> dict[str, Any]:
    """Return an axis of a condition or of roads."""
    bins = "".join("." if cell is None else _BINS[cell] for cell in cells)
    return {
        "name": axis.name,
        "description": capitalised(axis.title),
        "unit": axis.unit,
        "counts": False,
        "texts": [proper(capitalised(axis.title_text(i))) for i in range(axis.cell_count)],
        "ticks": [(place, proper(text)) for place, text in axis.ticks],
        "bins": bins,
    }
