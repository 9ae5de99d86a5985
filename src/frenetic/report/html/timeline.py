"""Failures over simulations and time, beside the random expectation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, evenly
from frenetic.analysis.expectation import RandomRoads
from frenetic.analysis.failures import Clusters
from frenetic.analysis.statistics import proportion_interval
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Chart, Part, Section, Series, percent
from frenetic.report.html.tests import TestSummary
from frenetic.search.random_search import RANDOM

POINTS: Final = 1200
"""Most points of a curve."""

EXPECTED: Final = "if all roads were random"
_UNITS: Final = (("h", 3600.0), ("min", 60.0), ("s", 1.0))


def timeline_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """Failures over time; a section without blocks if nothing was tested."""
    title = "Failures over time"
    charts, caption = timeline_of(tests, clusters)
    if not charts:
        return Section("time", title, (), "Nothing was tested yet.")
    data = {"label": "Over", "charts": charts, "caption": caption}
    return Section("time", title, (Part("switch", data),))


def timeline_of(tests: Sequence[TestSummary], clusters: Clusters) -> tuple[dict[str, Chart], str]:
    """Failures over each way to count the spent budget, and a caption.

    Nothing if nothing was tested.
    """
    tested = [test for test in tests if test.outcome.is_test]
    if not tested:
        return {}, ""
    shown = evenly(len(tested), POINTS)
    failed = np.array([test.outcome is Outcome.FAIL for test in tested])
    driven = np.array([test.outcome is not Outcome.INVALID for test in tested])
    random = np.array([test.origin.operator == RANDOM for test in tested])
    place = {test.id: i for i, test in enumerate(tested)}
    first = np.zeros(len(tested), dtype=np.int64)  # failures of their kind
    for cluster in clusters:
        # A running campaign may have more failures by now.
        if places := [place[i] for i in cluster.ids if i in place]:
            first[min(places)] += 1
    found = np.cumsum(failed)[shown], np.cumsum(first)[shown]
    latest = [None, *(test.id for test in tested if test.outcome is Outcome.FAIL)]
    opened = tuple(latest[number] for number in found[0].tolist())

    failing = [test.id for test, is_it in zip(tested, failed & random, strict=True) if is_it]
    number = int((driven & random).sum())
    drawn = RandomRoads.of(number, failing, clusters) if number else None
    simulations = np.cumsum(driven)[shown]
    expected: list[FloatArray] = []  # (3, n) value, low, high of failures and distinct failures
    if drawn is not None:
        curves = drawn.failures_after(simulations), drawn.distinct_after(simulations)
        expected = [np.array([curve.value, curve.low, curve.high]) for curve in curves]

    def chart(title: str, x: npt.NDArray[Any]) -> Chart:
        across = _floats(x, 4)
        # Where no failure is like another, one line lies on the other.
        width = 6.0 if np.array_equal(*found) else 2.4
        how: dict[str, dict[str, Any]] = {
            "failures": {"role": "fail", "width": width},
            "distinct failures": {},
        }
        lines = [
            Series(name, across, _floats(values), stepped=True, **look)
            for (name, look), values in zip(how.items(), found, strict=True)
        ]
        for (name, look), values in zip(how.items(), expected, strict=False):
            middle, low, high = (_floats(one, 2) for one in values)
            dashed: dict[str, Any] = {**look, "dashed": True, "width": 1.5}
            lines.append(Series(f"{name} {EXPECTED}", across, middle, low, high, **dashed))
        return Chart(tuple(lines), title, "found so far", counts=True, tests=opened)

    charts = {"simulations": chart("simulations", simulations)}
    elapsed = [test.elapsed for test in tested]
    if None not in elapsed:
        # Results may be told in another order than timed.
        seconds = np.maximum.accumulate(np.array(elapsed, dtype=np.float64))[shown]
        unit, length = next(one for one in _UNITS if seconds[-1] >= 3.0 * one[1] or one[1] == 1.0)
        charts["wall time"] = chart(f"wall time ({unit})", seconds / length)
    return charts, _caption(drawn, bool(random.all()), clusters, int(failed.sum()))


def _caption(
    random: RandomRoads | None, all_random: bool, clusters: Clusters, failures: int
) -> str:
    distinct = (
        f"Distinct failures: failures that differ by up to {clusters.threshold:g} m are the same"
        " problem; the curve rises with the first failure of each."
    )
    if clusters.failures < failures:
        distinct += f" Compared were the {clusters.failures} most severe of {failures} failures."
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
    return f"{share} {distinct}"


def _floats(values: Any, digits: int = 0) -> tuple[float, ...]:
    return tuple(np.round(values, digits).tolist())
