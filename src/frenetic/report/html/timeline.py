"""Section of a page: failures over simulations, beside the expectation for random roads."""

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
"""Largest number of points of a curve; our choice."""
EXPECTED: Final = "failures if all roads were random"
"""Name of the line of the random expectation."""


def timeline_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """Return the section with the chart; it has no blocks if nothing was tested."""
    chart = timeline_of(tests, clusters)
    blocks, lead = ((), "Nothing was tested yet.") if chart is None else ((chart,), "")
    return Section("time", "Failures over simulations", blocks, lead)


def timeline_of(tests: Sequence[TestSummary], clusters: Clusters) -> Chart | None:
    """Return the chart of failures over simulations; None if nothing was tested.

    The random expectation continues the failing share of the random roads over all simulations.
    """
    tested = [test for test in tests if test.outcome.is_test]
    if not tested:
        return None
    shown = evenly(len(tested), POINTS)
    is_first = np.array([not test.is_repeat for test in tested])
    failed = is_first & np.array([test.outcome is Outcome.FAIL for test in tested])
    driven = np.array([test.outcome is not Outcome.INVALID for test in tested])
    is_random = np.array([test.is_random for test in tested])
    index = {test.id: i for i, test in enumerate(tested)}
    first = np.zeros(len(tested), dtype=np.int64)  # clusters whose first failure is the test
    for cluster in clusters:
        # A running campaign may have more failures by now.
        if indices := [index[test_id] for test_id in cluster.ids if test_id in index]:
            first[min(indices)] += 1
    failures, distinct = np.cumsum(failed)[shown], np.cumsum(first)[shown]
    failed_ids = [test.id for test, is_failed in zip(tested, failed, strict=True) if is_failed]
    simulations = np.cumsum(driven)[shown]
    x = _floats(simulations)
    # If no failure is like another, both lines are the same: the lower one shows as an edge.
    width = 6.0 if np.array_equal(failures, distinct) else 2.4
    lines = [
        Series("failures", x, _floats(failures), stepped=True, role="fail", width=width),
        Series("distinct failures", x, _floats(distinct), stepped=True),
    ]
    caption = (
        f"Distinct failures: failures that differ by up to {clusters.threshold:g} m are the same"
        " problem; the curve counts each problem from its first failure on."
    )
    if clusters.failures < failed.sum():
        caption += (
            f" Only the {clusters.failures} most severe of {failed.sum()} failures were compared."
        )
    if random_roads := int((driven & is_random & is_first).sum()):
        failing = int((failed & is_random).sum())
        low, high = proportion_interval(failing, random_roads)
        expected, lower, upper = (
            _floats(share * simulations, 2) for share in (failing / random_roads, low, high)
        )
        style: Any = {"role": "fail", "dashed": True, "width": 1.5}
        lines.append(Series(EXPECTED, x, expected, low=lower, high=upper, **style))
        caption = (
            f"Random expectation: {failing} of the {random_roads} random roads that were driven"
            f" failed ({percent(failing / random_roads)}). The dashed line continues that share"
            " over all simulations, the band its 95 % Wilson interval,"
            f" {percent(low)} to {percent(high)}. {caption}"
        )
    # A click at a point opens the latest failure.
    latest = [None, *failed_ids]
    latest_tests = tuple(latest[count] for count in failures.tolist())
    return Chart(
        tuple(lines), "simulations", "found so far", caption, counts=True, tests=latest_tests
    )


def _floats(values: Any, digits: int = 0) -> tuple[float, ...]:
    """Return rounded values of an array."""
    return tuple(np.round(values, digits).tolist())
