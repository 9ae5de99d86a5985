"""Feature maps: the kinds of roads and drives that were tried, and those that fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.ticker import MaxNLocator

from frenetic._support.arrays import FloatArray, evenly, spread
from frenetic._support.words import capitalised
from frenetic.analysis.features import FEATURES, Feature, Features, features_of
from frenetic.analysis.segments import Segment
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Part, Section
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


@dataclass(frozen=True)
class MapAxis:
    """A feature of the mapped tests, cut into cells of round numbers over their own range."""

    feature: Feature
    unit: str
    """Speeds are in km/h."""
    edges: FloatArray
    """(n + 1,) of the cells, ascending."""
    cells: npt.NDArray[np.int64]
    """(tests,) of each test, from 0."""

    @property
    def title(self) -> str:
        """The feature with its unit."""
        return f"{self.feature.description}{f' ({self.unit})' if self.unit else ''}"

    @classmethod
    def of(cls, feature: Feature, measured: Sequence[Features]) -> MapAxis:
        """The axis of a feature; it has the published range if nothing is measured."""
        is_speed = feature.unit == "m/s"
        factor = 3.6 if is_speed else 1.0
        values = factor * np.array([feature.of(one) for one in measured], dtype=np.float64)
        shown = values if len(values) else factor * feature.edges[[0, -1]]
        low, high = float(shown.min()), float(shown.max())
        if feature.counts:
            edges = np.arange(round(low) - 0.5, round(high) + 1.0)
        else:
            # One value lies in the middle of a published cell.
            half = 0.0 if high - low > 1e-6 else 0.5 * factor * float(np.diff(feature.edges)[0])
            low, high = low - half, high + half
            ticks = MaxNLocator(CELLS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
            edges = np.array(ticks, dtype=np.float64)
        cells = np.searchsorted(edges, values, side="right") - 1
        unit = "km/h" if is_speed else feature.unit
        return cls(feature, unit, edges, cells.clip(0, len(edges) - 2))

    def data(self) -> dict[str, Any]:
        """What the page draws."""
        assert len(self.edges) <= len(_BINS)
        return {
            "edges": self.edges.round(6).tolist(),
            "bins": "".join(_BINS[cell] for cell in self.cells.tolist()),
        }


@dataclass(frozen=True)
class Measured:
    """The features of a test."""

    segment: Features
    whole: Features

    @classmethod
    def of(cls, segment: Segment) -> Measured:
        """The features of a segment and of the whole drive that it is part of."""
        return cls(features_of(segment), features_of(segment.whole()))


def choose_mapped(tests: Sequence[TestSummary]) -> list[TestSummary]:
    """The measured tests: all failures, and others evenly over the campaign.

    Of more than `MAPPED_FAILURES` failures, an even selection from the most severe on.
    """
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    failed = [failed[i] for i in evenly(len(failed), MAPPED_FAILURES)]
    passed = [test for test in tests if test.outcome is Outcome.PASS]
    passed = [passed[i] for i in spread(len(passed), max(MAPPED - len(failed), MAPPED_PASSED))]
    chosen = {test.id for test in (*failed, *passed)}
    return [test for test in tests if test.id in chosen]


def map_section(measured: Mapping[int, Measured], tests: Sequence[TestSummary]) -> Section:
    """The feature map.

    Args:
        measured: test -> its features, of those that have any.
        tests: all of the campaign.
    """
    title = "Feature map"
    if not measured:
        return Section("map", title, (), "Nothing was driven yet.")
    axes = []
    for feature in FEATURES.values():
        segment, whole = (
            MapAxis.of(feature, [getattr(one, scope) for one in measured.values()])
            for scope in ("segment", "whole")
        )
        axes.append(
            {
                "name": feature.name,
                "description": feature.description,
                "unit": segment.unit,
                "counts": feature.counts,
                "segment": segment.data(),
                "whole": whole.data(),
            }
        )
    failed = [test.id for test in tests if test.outcome is Outcome.FAIL]
    passed = [test.id for test in tests if test.outcome is Outcome.PASS]
    failures, passes = (sum(i in measured for i in ids) for ids in (failed, passed))
    all_driven = len(measured) == len(failed) + len(passed)
    block = Part(
        "featureMap",
        {
            "tests": tuple(measured),
            "axes": tuple(axes),
            "first": "max_curvature",
            "second": "mean_speed",
            "all_driven": all_driven,
            "all_failures": failures == len(failed),
        },
    )
    lead = "What the roads are like on which the driver fails; choose a cell to see its roads."
    if not all_driven:
        lead += f" {_mapped(failures, len(failed), passes, len(passed))}"
    return Section("map", title, (block,), lead)


def _mapped(failures: int, all_failures: int, passes: int, all_passes: int) -> str:
    """A sentence about the tests in the map."""
    parts = []
    if all_failures:
        thinned = all_failures > MAPPED_FAILURES
        parts.append(
            _some(failures, all_failures, "failure", "failures")
            + (", evenly from the most to the least severe," if thinned else "")
        )
    if all_passes:
        parts.append(_some(passes, all_passes, "test that passed", "tests that passed"))
    text = " and ".join(parts)
    spread = ", evenly over the campaign," if passes < all_passes else ""
    return f"{capitalised(text)}{spread} are mapped."


def _some(number: int, of: int, one: str, many: str) -> str:
    if number < of:
        return f"{number} of the {of} {many}"
    return f"the only {one}" if of == 1 else f"all {of} {many}"
