"""Results of the strategy's operators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from frenetic._support.words import counted, signed
from frenetic.analysis.failures import Clusters
from frenetic.analysis.statistics import proportion_interval
from frenetic.outcome import Outcome
from frenetic.report.html.blocks import Column, Part, Section, Table, round_numbers, tick_text
from frenetic.report.html.tests import TestSummary
from frenetic.search.operators import DOES

FEW: Final = 10
"""Drives of an operator below which its share says little: its interval spans most of the scale."""

_COLUMNS: Final = (
    Column("operator"),
    Column("what it does", text="To the values of the roads from which it makes one"),
    Column("tests", True, "Roads that it proposed and that were tested, refused ones included"),
    Column("failures", True),
    Column("of those driven", True, "Share of its drives that failed, 95 % Wilson interval"),
    Column("distinct", True, "Distinct failures with at least one failure of it"),
    Column("found first", True, "Distinct failures whose first failure is its"),
    Column("change of MOOBD", True, "Mean of a road's MOOBD minus the lowest of its parents'"),
)


def operator_results(tests: Sequence[TestSummary], clusters: Clusters) -> list[dict[str, Any]]:
    """The results of every operator, in the order of their names, ``random`` first.

    ``share`` and its Wilson interval are in percent of the drives; ``distinct`` counts clusters
    with a failure of it, ``first`` those whose first failure is its; ``change`` is the mean of
    MOOBD minus the parents' lowest, in m.
    """
    by_id = {test.id: test for test in tests}
    operators: dict[str, list[TestSummary]] = {}
    for test in tests:
        if test.outcome.is_test:
            operators.setdefault(test.origin.operator, []).append(test)
    found = [
        [by_id[i].origin.operator for i in sorted(cluster.ids) if i in by_id]
        for cluster in clusters
    ]
    rows = []
    for name, own in sorted(operators.items(), key=lambda item: (item[0] != "random", item[0])):
        failures = sum(test.outcome is Outcome.FAIL for test in own)
        driven = sum(test.outcome.is_driven for test in own)
        shares = (failures / driven, *proportion_interval(failures, driven)) if driven else ()
        changes = []
        for test in own:
            known = [by_id[i].moobd for i in test.origin.parents if i in by_id]
            before = [moobd for moobd in known if moobd is not None]
            if test.moobd is not None and before:
                changes.append(test.moobd - min(before))
        rows.append(
            {
                "name": name,
                "tests": len(own),
                "driven": driven,
                "failures": failures,
                "shares": [100.0 * share for share in shares],
                "distinct": sum(name in members for members in found),
                "first": sum(members[:1] == [name] for members in found),
                "change": sum(changes) / len(changes) if changes else None,
            }
        )
    return rows


def operators_section(tests: Sequence[TestSummary], clusters: Clusters) -> Section:
    """A table of the operators, and a bar chart of the share of failures of each."""
    results = operator_results(tests, clusters)
    title = "Operators"
    if not results:
        return Section("operators", title, (), "Nothing was tested yet.")
    table = Table(
        _COLUMNS,
        tuple(_row(one) for one in results),
        "Change of MOOBD: mean of a road's MOOBD minus the lowest of its parents'; below zero,"
        " the operator's roads are worse for the driver than what they were made from."
        " Distinct: distinct failures with at least one failure of this operator; found first:"
        " those whose first failure is its.",
        faint=tuple(one["driven"] < FEW for one in results),
    )
    lead = "Which operators of the strategy paid off."
    if any(one["name"] in DOES for one in results):
        lead += " A road is a row of values: its curvatures, from one end to the other."
    return Section("operators", title, (*_bars(results), table), lead)


def _row(one: dict[str, Any]) -> tuple[str, ...]:
    share = "{:.0f} % ({:.0f}–{:.0f})".format(*one["shares"]) if one["shares"] else "–"
    change = "–" if one["change"] is None else f"{one['change']:+.2f} m".replace("-", "−")
    numbers = str(one["tests"]), str(one["failures"]), share, str(one["distinct"])
    return one["name"], DOES.get(one["name"], "–"), *numbers, str(one["first"]), change


def _bars(results: Sequence[dict[str, Any]]) -> list[Part]:
    """The share of each operator's drives that failed; all places are in percent of the scale."""
    driven = [one for one in results if one["driven"]]
    ticks = round_numbers(0.0, max([1e-9, *(one["shares"][2] for one in driven)]))
    digits = 1 if ticks[-1] >= 10.0 else 2
    rows = []
    for one in driven:
        does, drives = DOES.get(one["name"], ""), counted(one["driven"], "drive")
        value, low, high = (signed(share, digits) for share in one["shares"])
        rows.append(
            {
                "name": one["name"],
                "note": f"{does}; {drives}" if does else drives,
                "faint": one["driven"] < FEW,
                "value": value,
                "title": f"{one['name']}: {value}, interval {low} to {high}",
                "places": [round(100.0 * share / ticks[-1], 2) for share in one["shares"]],
            }
        )
    pale = f" Pale: fewer than {FEW} drives, which say little."
    caption = "Share of each operator's drives that failed, with its 95 % Wilson interval."
    data = {
        "title": "drives that failed (%)",
        "rows": rows,
        "ticks": [(100.0 * tick / ticks[-1], tick_text(tick)) for tick in ticks],
        "caption": caption + (pale if any(row["faint"] for row in rows) else ""),
    }
    return [Part("bars", data)] if rows else []
