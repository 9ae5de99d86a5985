"""Feature maps: which kinds of roads and drives were tried, and which of them fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from frenetic.analysis.features import FEATURES, Features, features_of
from frenetic.analysis.segments import Segment
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Section
from frenetic.report.html.told import Told

MAPPED: Final = 3000
"""Tests that are measured at most."""
NOT_MEASURED: Final = "."
"""In place of a bin."""

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
    """Two features to choose, and what was found in each cell of theirs."""

    kind: ClassVar[str] = "featureMap"
    axes: tuple[MapAxis, ...]
    first: str
    """Name of the feature to the right, to begin with."""
    second: str
    """Upwards."""


@dataclass(frozen=True)
class Measured:
    """The features of a test."""

    segment: Features
    whole: Features

    @classmethod
    def of(cls, segment: Segment) -> Measured:
        """The features of a segment and of the whole drive that it is part of."""
        return cls(features_of(segment), features_of(segment.whole()))


def choose_mapped(tests: Sequence[Told], limit: int = MAPPED) -> list[Told]:
    """The tests that are measured: the most severe failures, then others evenly over time."""
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    # Half of the places at least are for those that passed, if there are so many.
    passed = [test for test in tests if test.outcome is Outcome.PASS]
    failed = failed[: max(limit // 2, limit - len(passed))]
    room = min(limit - len(failed), len(passed))
    places = np.linspace(0, len(passed) - 1, room).round().astype(int) if room else ()
    chosen = {test.id for test in failed} | {passed[i].id for i in places}
    return [test for test in tests if test.id in chosen]


def map_section(
    ids: Sequence[int], measured: Mapping[int, Measured], tests: Sequence[Told]
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
    driven = sum(test.outcome.is_driven for test in tests)
    lead = "What the roads are like on which the driver fails; choose a cell to see its roads."
    if len(measured) < driven:
        lead += (
            f" {len(measured)} of the {driven} tests that were driven are shown: the most severe"
            " failures, and others evenly over the campaign."
        )
    return Section("map", title, (FeatureMap(tuple(axes), "max_curvature", "mean_speed"),), lead)
