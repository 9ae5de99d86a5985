"""Section of a page: failures over simulations, beside the random expectation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import evenly
from frenetic.analysis.clusters import Clusters
from frenetic.analysis.statistics import proportion_interval
from frenetic.oracle.outcome import Outcome
from frenetic.report.html.page import Chart, Section, Series, percent
from frenetic.report.html.tests import TestSummary

POINTS: Final = 1200
"""Most points of a curve."""
EXPECTED: Final = "failures if all roads were random"


def timeline_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """Return failures over simulations; a section without blocks if nothing was tested."""
    chart = timeline_of(tests, clusters)
    blocks, lead = ((), "Nothing was tested yet.") if chart is None else ((chart,), "")
    return Section("time", "Failures over simulations", blocks, lead)


def timeline_of(tests: Sequence[TestSummary], clusters: Clusters) -> Chart | None:
    """Return failures over simulations; None if nothing was tested.

    The random expectation continues the failing share of the random roads over all simulations.
    """
    tested = [test for test in tests if test.outcome.is_test]
    if not tested:
        return None
    shown = evenly(len(tested), POINTS)
    is_first = np.array([not test.is_repeat for test in tested])
    failed = is_first & np.array([test.outcome is Outcome.FAIL for test in tested])
    driven = np.array([test.outcome is not Outcome.INVALID for test in tested])
    random = np.array([test.is_random for test in tested])
    place = {test.id: i for i, test in enumerate(tested)}
    first = np.zeros(len(tested), dtype=np.int64)  # failures of their kind
    for cluster in clusters:
        # A running campaign may have more failures by now.
        if places := [place[i] for i in cluster.ids if i in place]:
            first[min(places)] += 1
    failures, distinct = np.cumsum(failed)[shown], np.cumsum(first)[shown]
    latest = [None, *(test.id for test, counts in zip(tested, failed, strict=True) if counts)]
    simulations = np.cumsum(driven)[shown]
    across = _floats(simulations)
    # Where no failure is like another, one line lies on the other.
    width = 6.0 if np.array_equal(failures, distinct) else 2.4
    lines = [
        Series("failures", across, _floats(failures), stepped=True, role="fail", width=width),
        Series("distinct failures", across, _floats(distinct), stepped=True),
    ]
    caption = (
        f"Distinct failures: failures that differ by up to {clusters.threshold:g} m are the same"
        " problem; the curve counts each problem from its first failure on."
    )
    if clusters.failures < failed.sum():
        caption += (
            f" Only the {clusters.failures} most severe of {failed.sum()} failures were compared."
        )
    if drawn := int((driven & random & is_first).sum()):
        failing = int((failed & random).sum())
        low, high = proportion_interval(failing, drawn)
        middle, least, most = (_floats(s * simulations, 2) for s in (failing / drawn, low, high))
        look: Any = {"role": "fail", "dashed": True, "width": 1.5}
        lines.append(Series(EXPECTED, across, middle, least, most, **look))
        caption = (
            f"Random expectation: {failing} of the {drawn} random roads that were driven failed"
            f" ({percent(failing / drawn)}). The dashed line continues that share over all"
            f" simulations, the band its 95 % Wilson interval, {percent(low)} to {percent(high)}."
            f" {caption}"
        )
    tests_at = tuple(latest[number] for number in failures.tolist())
    return Chart(tuple(lines), "simulations", "found so far", caption, counts=True, tests=tests_at)


def _floats(values: Any, digits: int = 0) -> tuple[float, ...]:
    return tuple(np.round(values, digits).tolist())
