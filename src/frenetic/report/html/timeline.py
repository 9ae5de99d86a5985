"""Failures over simulations, tests and time, beside the random expectation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, evenly
from frenetic.analysis.expectation import RandomRoads
from frenetic.analysis.failures import Clusters
from frenetic.analysis.statistics import proportion_interval
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Chart, Section, Series, Switch, percent
from frenetic.report.html.tests import TestSummary
from frenetic.search.random_search import RANDOM

POINTS: Final = 1200
"""Most points of a curve."""

EXPECTED: Final = "if all roads were random"

_UNITS: Final = (("h", 3600.0), ("min", 60.0), ("s", 1.0))


@dataclass(frozen=True)
class Expectation:
    """Failures and distinct failures to expect of random roads: (3, n) value, low, high each."""

    failures: FloatArray
    distinct: FloatArray


@dataclass(frozen=True)
class Axis:
    """One way to count the spent budget."""

    name: str
    title: str
    x: FloatArray
    """(n,)"""
    expected: Expectation | None


@dataclass(frozen=True)
class Timeline:
    """Failures found so far over the spent budget."""

    failures: npt.NDArray[np.int64]
    """(n,)"""
    distinct: npt.NDArray[np.int64]
    """(n,)"""
    latest: tuple[int | None, ...]
    """Id of the latest failure up to each point; None before the first."""
    axes: tuple[Axis, ...]
    caption: str

    def charts(self) -> Iterator[Chart]:
        """A chart for each way to count."""
        is_hidden = np.array_equal(self.failures, self.distinct)
        for axis in self.axes:
            x = _floats(axis.x, 4)
            # Where no failure is like another, one line lies on the other.
            lines = [
                Series(
                    "failures",
                    x,
                    _floats(self.failures),
                    role="fail",
                    stepped=True,
                    width=6.0 if is_hidden else 2.4,
                ),
                Series("distinct failures", x, _floats(self.distinct), stepped=True),
            ]
            if axis.expected is not None:
                for name, role, values in (
                    ("failures", "fail", axis.expected.failures),
                    ("distinct failures", "accent", axis.expected.distinct),
                ):
                    value, low, high = (_floats(one, 2) for one in values)
                    lines.append(
                        Series(
                            f"{name} {EXPECTED}",
                            x,
                            value,
                            low,
                            high,
                            role=role,
                            dashed=True,
                            width=1.5,
                        )
                    )
            yield Chart(
                tuple(lines),
                axis.title,
                "found so far",
                name=axis.name,
                counts=True,
                tests=self.latest,
            )


def timeline_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """Failures over time; a section without blocks if nothing was tested."""
    timeline = timeline_of(tests, clusters)
    if timeline is None:
        return Section("time", "Failures over time", (), "Nothing was tested yet.")
    switch = Switch("Over", tuple(timeline.charts()), timeline.caption)
    return Section("time", "Failures over time", (switch,))


def timeline_of(tests: Sequence[TestSummary], clusters: Clusters) -> Timeline | None:
    """Failures over the budget; None if nothing was tested."""
    tested = [test for test in tests if test.outcome.is_test]
    if not tested:
        return None
    shown = evenly(len(tested), POINTS)
    failed = np.array([test.outcome is Outcome.FAIL for test in tested])
    driven = np.array([test.outcome is not Outcome.INVALID for test in tested])
    simulations = np.cumsum(driven)[shown]
    numbers = np.arange(1, len(tested) + 1)[shown]
    random = np.array([test.origin.operator == RANDOM for test in tested])
    failing = [test.id for test, is_it in zip(tested, failed & random, strict=True) if is_it]
    drawn, drawn_and_driven = (
        RandomRoads.of(number, failing, clusters) if number else None
        for number in (int(random.sum()), int((driven & random).sum()))
    )
    expected = _expectation(drawn_and_driven, simulations)
    axes = [
        Axis("simulations", "simulations", simulations.astype(np.float64), expected),
        Axis(
            "tests",
            "tests, roads that were refused included",
            numbers.astype(np.float64),
            _expectation(drawn, numbers),
        ),
    ]
    elapsed = [test.elapsed for test in tested]
    if None not in elapsed:
        # Results may be told in another order than timed.
        seconds = np.maximum.accumulate(np.array(elapsed, dtype=np.float64))[shown]
        unit, length = next(one for one in _UNITS if seconds[-1] >= 3.0 * one[1] or one[1] == 1.0)
        axes.append(Axis("wall time", f"wall time ({unit})", seconds / length, expected))
    return Timeline(
        failures=np.cumsum(failed)[shown],
        distinct=_distinct(tested, clusters, shown),
        latest=_latest(tested, shown),
        axes=tuple(axes),
        caption=_caption(drawn_and_driven, bool(random.all()), clusters)
        + _compared(clusters, int(failed.sum())),
    )


def _expectation(random: RandomRoads | None, counts: npt.NDArray[np.int64]) -> Expectation | None:
    if random is None:
        return None
    failures, distinct = (
        np.array([curve.value, curve.low, curve.high])
        for curve in (random.failures_after(counts), random.distinct_after(counts))
    )
    return Expectation(failures, distinct)


def _distinct(
    tested: Sequence[TestSummary], clusters: Clusters, shown: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    place = {test.id: i for i, test in enumerate(tested)}
    found = np.zeros(len(tested), dtype=np.int64)
    for cluster in clusters:
        # A running campaign may have more failures by now.
        places = [place[i] for i in cluster.ids if i in place]
        if places:
            found[min(places)] += 1
    return np.cumsum(found)[shown]


def _latest(tested: Sequence[TestSummary], shown: npt.NDArray[np.int64]) -> tuple[int | None, ...]:
    found: list[int | None] = []
    for test in tested:
        before = found[-1] if found else None
        found.append(test.id if test.outcome is Outcome.FAIL else before)
    return tuple(found[i] for i in shown.tolist())


def _caption(random: RandomRoads | None, all_random: bool, clusters: Clusters) -> str:
    distinct = (
        f"Distinct failures: failures that differ by up to {clusters.threshold:g} m are the same"
        " problem; the curve rises with the first failure of each."
    )
    if random is None:
        return f"No candidate was random, so there is no random expectation. {distinct}"
    low, high = proportion_interval(random.failures, random.roads)
    share = (
        f"Random expectation: {random.failures} of the {random.roads} random roads that were driven"
        f" failed ({percent(random.failures / random.roads)}), {len(random.found)} distinct"
        " failures. The line of failures continues that share over all simulations, the band the"
        f" 95 % Wilson interval of the share, {percent(low)} to {percent(high)}. The line of"
        " distinct failures is what that many of these roads find on average, and beyond"
        f" {random.roads} an estimate by how many distinct failures they found once and twice (Chao"
        " et al. 2014), rather too low beyond two or three times as many. The bands hold what is"
        " not known of the expectation, not the scatter of the counts."
    )
    if all_random:
        share += " Here all candidates are random."
    return f"{share} Over tests, roads that were refused count, too. {distinct}"


def _compared(clusters: Clusters, failures: int) -> str:
    if clusters.failures >= failures:
        return ""
    return f" Compared were the {clusters.failures} most severe of {failures} failures."


def _floats(values: npt.NDArray[np.int64] | FloatArray, digits: int = 0) -> tuple[float, ...]:
    rounded: list[float] = np.round(values, digits).tolist()
    return tuple(rounded)
