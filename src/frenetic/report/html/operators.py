"""Results of the strategy's operators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from frenetic._support.words import counted
from frenetic.analysis.failures import Clusters
from frenetic.analysis.statistics import proportion_interval
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Bars, Column, Section, Table
from frenetic.report.html.tests import TestSummary
from frenetic.search.operators import DOES

FEW: Final = 10
"""Drives of an operator below which its share says little: its interval spans most of the scale."""


@dataclass(frozen=True)
class OperatorResult:
    """Results of one operator's candidates."""

    name: str
    tests: int
    """Tests without dropped ones."""
    driven: int
    """Drives that ended with PASS or FAIL."""
    failures: int
    distinct: int
    """Clusters with at least one of its failures."""
    first: int
    """Clusters whose first failure comes from it."""
    change: float | None
    """Mean of MOOBD minus the parents' lowest, in m; None if there is nothing to compare."""

    @property
    def share(self) -> float | None:
        """Share 0..1 of the drives that failed."""
        return self.failures / self.driven if self.driven else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Wilson's 95 % interval of the share."""
        return proportion_interval(self.failures, self.driven) if self.driven else None


def operator_results(tests: Sequence[TestSummary], clusters: Clusters) -> list[OperatorResult]:
    """The results of every operator, in the order of their names, ``random`` first."""
    by_id = {test.id: test for test in tests}
    operators: dict[str, list[TestSummary]] = {}
    for test in tests:
        if test.outcome.is_test:
            operators.setdefault(test.origin.operator, []).append(test)
    found_by: dict[str, int] = dict.fromkeys(operators, 0)
    first_by: dict[str, int] = dict.fromkeys(operators, 0)
    for cluster in clusters:
        members = [by_id[i] for i in cluster.ids if i in by_id]
        for name in {test.origin.operator for test in members}:
            found_by[name] += 1
        if members:
            first_by[min(members, key=lambda test: test.id).origin.operator] += 1
    return [
        OperatorResult(
            name=name,
            tests=len(own),
            driven=sum(test.outcome.is_driven for test in own),
            failures=sum(test.outcome is Outcome.FAIL for test in own),
            distinct=found_by[name],
            first=first_by[name],
            change=_change(own, by_id),
        )
        for name, own in sorted(operators.items(), key=lambda item: (item[0] != "random", item[0]))
    ]


def _change(tests: Sequence[TestSummary], by_id: Mapping[int, TestSummary]) -> float | None:
    changes = []
    for test in tests:
        parents = [by_id[i].moobd for i in test.origin.parents if i in by_id]
        known = [moobd for moobd in parents if moobd is not None]
        if test.moobd is not None and known:
            changes.append(test.moobd - min(known))
    return sum(changes) / len(changes) if changes else None


def operators_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """A table of the operators, and a bar chart of the share of failures of each."""
    results = operator_results(tests, clusters)
    title = "Operators"
    if not results:
        return Section("operators", title, (), "Nothing was tested yet.")
    columns = (
        Column("operator"),
        Column("what it does", text="To the values of the roads from which it makes one"),
        Column("tests", True, "Roads that it proposed and that were tested, refused ones included"),
        Column("failures", True),
        Column("of those driven", True, "Share of its drives that failed, 95 % Wilson interval"),
        Column("distinct", True, "Distinct failures with at least one failure of it"),
        Column("found first", True, "Distinct failures whose first failure is its"),
        Column("change of MOOBD", True, "Mean of a road's MOOBD minus the lowest of its parents'"),
    )
    rows = tuple(
        (
            one.name,
            DOES.get(one.name, "–"),
            str(one.tests),
            str(one.failures),
            _share(one),
            str(one.distinct),
            str(one.first),
            "–" if one.change is None else f"{one.change:+.2f} m".replace("-", "−"),
        )
        for one in results
    )
    drivers = [one for one in results if one.driven]
    intervals = [one.interval or (0.0, 1.0) for one in drivers]
    few = tuple(one.driven < FEW for one in drivers)
    blocks = (
        Bars(
            names=tuple(one.name for one in drivers),
            values=tuple(100.0 * (one.share or 0.0) for one in drivers),
            title="drives that failed (%)",
            low=tuple(100.0 * low for low, _ in intervals),
            high=tuple(100.0 * high for _, high in intervals),
            caption="Share of each operator's drives that failed, with its 95 % Wilson interval."
            + (f" Pale: fewer than {FEW} drives, which say little." if any(few) else ""),
            notes=tuple(_note(one) for one in drivers),
            faint=few,
        ),
        Table(
            columns,
            rows,
            "Change of MOOBD: mean of a road's MOOBD minus the lowest of its parents'; below zero,"
            " the operator's roads are worse for the driver than what they were made from."
            " Distinct: distinct failures with at least one failure of this operator; found first:"
            " those whose first failure is its.",
            faint=tuple(one.driven < FEW for one in results),
        ),
    )
    lead = "Which operators of the strategy paid off."
    if any(one.name in DOES for one in results):
        lead += " A road is a row of values: its curvatures, from one end to the other."
    return Section("operators", title, blocks, lead)


def _note(one: OperatorResult) -> str:
    """The operator's effect and its drives."""
    does = DOES.get(one.name, "")
    return f"{does}; {counted(one.driven, 'drive')}" if does else counted(one.driven, "drive")


def _share(one: OperatorResult) -> str:
    if one.share is None or one.interval is None:
        return "–"
    low, high = one.interval
    return f"{100.0 * one.share:.0f} % ({100.0 * low:.0f}–{100.0 * high:.0f})"
