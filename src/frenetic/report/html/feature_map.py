"""Feature maps: the kinds of roads and drives that were tried, and those that fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from frenetic._support.arrays import evenly, spread
from frenetic._support.words import capitalised
from frenetic.analysis.features import FEATURES, Features, features_of
from frenetic.analysis.segments import Segment
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Section
from frenetic.report.html.tests import TestSummary

MAPPED: Final = 3000
"""Measured tests: all failures, and others up to this number."""
MAPPED_PASSED: Final = 1000
"""Least number of measured tests that passed, if there are as many."""
MAPPED_FAILURES: Final = 10_000
"""Most measured failures: nearly always all, so that no cell hides one."""
NOT_MEASURED: Final = "."
"""Letter in place of a bin."""

_BINS: Final = "0123456789abcdefghijklmnopqrstuvwxyz"


@dataclass(frozen=True)
class MapAxis:
    """A feature, with the bin of every test."""

    name: str
    description: str
    unit: str
    edges: tuple[float, ...]
    segment: str
    """A letter per test of the page's table: its bin on the segment, or `NOT_MEASURED`."""
    whole: str
    """Likewise, on the whole road and drive."""


@dataclass(frozen=True)
class FeatureMap:
    """A map of two chosen features, with the tests in each cell."""

    kind: ClassVar[str] = "featureMap"
    axes: tuple[MapAxis, ...]
    first: str
    """Name of the first feature to the right."""
    second: str
    """Name of the first feature upwards."""
    all_driven: bool
    """Whether it holds all driven tests."""
    all_failures: bool
    """Whether it holds all failures."""


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


def map_section(
    ids: Sequence[int], measured: Mapping[int, Measured], tests: Sequence[TestSummary]
) -> Section:
    """The feature map of the tests in a page's table.

    Args:
        ids: of the tests in the table.
        measured: features of those that have any.
        tests: all of the campaign.
    """
    title = "Feature map"
    if not measured:
        return Section("map", title, (), "Nothing was driven yet.")
    axes = []
    for axis in FEATURES.values():
        assert axis.bins <= len(_BINS)
        bins = {
            i: (_BINS[axis.bin_of(found.segment)], _BINS[axis.bin_of(found.whole)])
            for i, found in measured.items()
        }
        none = (NOT_MEASURED, NOT_MEASURED)
        axes.append(
            MapAxis(
                axis.name,
                axis.description,
                axis.unit,
                tuple(round(float(edge), 6) for edge in axis.edges),
                "".join(bins.get(i, none)[0] for i in ids),
                "".join(bins.get(i, none)[1] for i in ids),
            )
        )
    failed = [test.id for test in tests if test.outcome is Outcome.FAIL]
    passed = [test.id for test in tests if test.outcome is Outcome.PASS]
    failures, passes = (sum(i in measured for i in ids) for ids in (failed, passed))
    block = FeatureMap(
        axes=tuple(axes),
        first="max_curvature",
        second="mean_speed",
        all_driven=len(measured) == len(failed) + len(passed),
        all_failures=failures == len(failed),
    )
    lead = "What the roads are like on which the driver fails; choose a cell to see its roads."
    if not block.all_driven:
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
