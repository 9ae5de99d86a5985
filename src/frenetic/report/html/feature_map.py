"""Feature maps: the kinds of roads and drives that were tried, and those that fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from matplotlib.ticker import MaxNLocator

from frenetic._support.arrays import FloatArray, evenly, spread
from frenetic._support.words import capitalised
from frenetic.analysis.coverage import Axis
from frenetic.analysis.features import FEATURES, Feature, Features, features_of
from frenetic.analysis.segments import Segment
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Part, Section, proper
from frenetic.report.html.tests import TestSummary

MAPPED: Final = 3000
"""Measured tests: all failures, and others up to this number."""
MAPPED_PASSED: Final = 1000
"""Least number of measured tests that passed, if there are as many."""
MAPPED_FAILURES: Final = 10_000
"""Most measured failures: nearly always all, so that no cell hides one."""
CELLS: Final = 10
"""About as many cells has an axis."""

_BINS: Final = "0123456789abcdefghijklmnopqrstuvwxyz"


def cells_of(
    feature: Feature, measured: Sequence[Features]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """A feature of some tests, cut into cells of round numbers over its own range.

    Returns:
        (n + 1,) edges of the cells, ascending; and (tests,) the cell of each test, from 0. The
        edges are those of the published range if nothing is measured.
    """
    factor = 3.6 if feature.unit == "m/s" else 1.0
    values = factor * np.array([feature.of(one) for one in measured], dtype=np.float64)
    shown = values if len(values) else factor * feature.edges[[0, -1]]
    low, high = float(shown.min()), float(shown.max())
    if feature.counts:
        edges = np.arange(round(low) - 0.5, round(high) + 1.0)
    else:
        # One value lies in the middle of a published cell.
        half = 0.0 if high - low > 1e-6 else 0.5 * factor * float(np.diff(feature.edges)[0])
        ticks = MaxNLocator(CELLS, steps=[1, 2, 2.5, 5, 10]).tick_values(low - half, high + half)
        edges = np.array(ticks, dtype=np.float64)
    cells = np.searchsorted(edges, values, side="right") - 1
    return edges, cells.clip(0, len(edges) - 2)


def measure(segment: Segment) -> dict[str, Features]:
    """The features of a segment, and of the whole drive that it is part of."""
    return {"segment": features_of(segment), "whole": features_of(segment.whole())}


class _Judged(Protocol):
    @property
    def id(self) -> int: ...
    @property
    def outcome(self) -> str: ...
    @property
    def moobd(self) -> float | None: ...


_Test = TypeVar("_Test", bound=_Judged)


def choose_mapped(tests: Sequence[_Test]) -> list[_Test]:
    """The measured tests: all failures, and others evenly over the campaign.

    Of more than `MAPPED_FAILURES` failures, an even selection from the most severe on.
    """
    failed = sorted(
        (test for test in tests if test.outcome == Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    failed = [failed[i] for i in evenly(len(failed), MAPPED_FAILURES)]
    passed = [test for test in tests if test.outcome == Outcome.PASS]
    passed = [passed[i] for i in spread(len(passed), max(MAPPED - len(failed), MAPPED_PASSED))]
    chosen = {test.id for test in (*failed, *passed)}
    return [test for test in tests if test.id in chosen]


def map_section(
    measured: Mapping[int, Mapping[str, Features]],
    tests: Sequence[TestSummary],
    cells: Mapping[Axis, Sequence[int | None]] = MappingProxyType({}),
) -> Section:
    """The feature map.

    Args:
        measured: test -> its features by `measure`, of those that have any.
        tests: all of the campaign.
        cells: axis of a condition or of roads -> the cell of each measured test, if it has one.
    """
    title = "Feature map"
    if not measured:
        return Section("map", title, (), "Nothing was driven yet.")
    axes: list[dict[str, Any]] = []
    for feature in FEATURES.values():
        axis: dict[str, Any] = {
            "name": feature.name,
            "description": feature.description,
            "unit": "km/h" if feature.unit == "m/s" else feature.unit,
            "counts": feature.counts,
        }
        for scope in ("segment", "whole"):
            edges, places = cells_of(feature, [one[scope] for one in measured.values()])
            assert len(edges) <= len(_BINS)
            bins = "".join(_BINS[place] for place in places.tolist())
            axis[scope] = {"edges": edges.round(6).tolist(), "bins": bins}
        axes.append(axis)
    axes += [_axis(axis, found) for axis, found in cells.items()]
    failed, passed = (
        [test.id in measured for test in tests if test.outcome is outcome]
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
    lead = "What the roads are like on which the driver fails; choose a cell to see its roads."
    if not all_driven:
        lead += f" {_mapped(failed, passed)}"
    return Section("map", title, (Part("featureMap", data),), lead)


def _axis(axis: Axis, cells: Sequence[int | None]) -> dict[str, Any]:
    """An axis whose cells are the same for segments and whole drives."""
    bins = "".join("." if cell is None else _BINS[cell] for cell in cells)
    return {
        "name": axis.name,
        "description": capitalised(axis.title),
        "unit": axis.unit,
        "counts": False,
        "texts": [proper(capitalised(axis.words(i))) for i in range(axis.size)],
        "ticks": [(place, proper(text)) for place, text in axis.ticks],
        "whole": {"bins": bins},
    }


def _mapped(failed: Sequence[bool], passed: Sequence[bool]) -> str:
    """A sentence about the tests in the map."""
    parts = []
    if failed:
        thinned = len(failed) > MAPPED_FAILURES
        text = _some(failed, "failure", "failures")
        parts.append(f"{text}, evenly from the most to the least severe," if thinned else text)
    if passed:
        parts.append(_some(passed, "test that passed", "tests that passed"))
    over = "" if all(passed) else ", evenly over the campaign,"
    return f"{capitalised(' and '.join(parts))}{over} are mapped."


def _some(mapped: Sequence[bool], one: str, many: str) -> str:
    if not all(mapped):
        return f"{sum(mapped)} of the {len(mapped)} {many}"
    return f"the only {one}" if len(mapped) == 1 else f"all {len(mapped)} {many}"
