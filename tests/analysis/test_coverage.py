"""Coverage of a domain: hand-counted cells, and properties of any drives."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.analysis import coverage as coverage_module
from frenetic.analysis.axes import GRADE, RADIUS, axes_of, varied_axes
from frenetic.analysis.coverage import Cells, DomainCoverage, domain_coverage
from frenetic.campaign.record import Test
from frenetic.conditions.domain import Domain
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.search import Candidate, Origin
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec.terms import DriveSetting

SIMULATOR = EmbeddedSimulator()
GUSTY = Domain.from_entries(
    "gusty",
    {
        "conditions": {
            "gust": {"low": -10, "high": 10},
            "delay": {"low": 0.0, "high": 0.2, "chance": 0.25},
            "load": 150,
        }
    },
)


def setting_of(domain: Domain | None) -> DriveSetting:
    return DriveSetting(
        lane_width=4.0,
        map_size=200.0,
        map_margin=10.0,
        rules=SIMULATOR.rules,
        car=SIMULATOR.car,
        road_class=None if domain is None else domain.road_class,
        domain=domain,
    )


def bend_test(
    outcome: Outcome, radius: float = math.inf, grade: float = 0.0, **conditions: float
) -> Test:
    """Return a test of a bend in some conditions."""
    candidate = Candidate(
        1,
        np.array([0.0, 1.0 / radius, 0.0]),
        10.0,
        Origin("random"),
        conditions=conditions,
        grade=np.array([[0.0, 0.0], [20.0, grade]]),
    )
    return Test(candidate=candidate, result=Result(outcome, ""), result_number=1, budget_spent=0.0)


def coverage_of(domain: Domain, tests: Iterable[Test]) -> DomainCoverage:
    coverage = domain_coverage(setting_of(domain), tests)
    assert coverage is not None
    return coverage


def counts(cells: Cells) -> list[str]:
    pairs = zip(cells.failures.ravel(), cells.drives.ravel(), strict=True)
    return [f"{failures}/{drives}" for failures, drives in pairs]


def test_cells_counted_by_hand() -> None:
    coverage = coverage_of(
        GUSTY,
        [
            bend_test(Outcome.PASS, 14.3, gust=-10.0),
            bend_test(Outcome.FAIL, 17.9, gust=-5.0, delay=0.05),
            bend_test(Outcome.FAIL, 18.1, gust=4.0, delay=0.2),
            bend_test(Outcome.PASS, 70.0, delay=0.2),  # without an entry, the gust is 0 m/s
            bend_test(Outcome.PASS, gust=10.0),
            bend_test(Outcome.PASS, 14.3, gust=11.0),
            bend_test(Outcome.FAIL, 14.3, gust=1.0, delay=0.3),
            bend_test(Outcome.FAIL, 9.0),
            bend_test(Outcome.INVALID, 14.3, gust=1.0),
            bend_test(Outcome.ERROR, 14.3, gust=1.0),
        ],
    )
    assert (coverage.name, coverage.drives, coverage.failures, coverage.outside) == (
        "gusty",
        5,
        2,
        3,
    )
    gust, delay, radius = coverage.axes
    assert [gust.text(i) for i in range(gust.cell_count)] == [
        "-10 to -5",
        "-5 to 0",
        "0 to 5",
        "5 to 10",
    ]
    texts = ["as usual", "0 to 0.05", "0.05 to 0.1", "0.1 to 0.15", "0.15 to 0.2"]
    assert [delay.text(i) for i in range(delay.cell_count)] == texts
    assert delay.title_text(0) == "delay as usual"
    assert delay.title_text(1) == "delay 0 to 0.05 s"
    texts = ["14.29 to 18", "18 to 24", "24 to 36", "36 to 71", "71 or more"]
    assert [radius.text(i) for i in range(radius.cell_count)] == texts
    assert [counts(cells) for cells in coverage.singles] == [
        ["0/1", "1/1", "1/2", "0/1"],
        ["0/2", "0/0", "1/1", "0/0", "1/2"],
        ["1/2", "1/1", "0/0", "0/1", "0/1"],
    ]
    assert coverage.singles[0].shares == pytest.approx([0.25] * 4)
    assert coverage.singles[1].shares == pytest.approx([0.75] + [0.0625] * 4)
    pair = coverage.pairs[0]
    assert pair.axes == (gust, delay)
    assert (pair.count, pair.driven, pair.failed, pair.never_reached) == (20, 4, 2, 16)
    # Two cells with the usual delay, and two cells with another delay.
    assert pair.driven_share == pytest.approx(2 * 0.25 * 0.75 + 2 * 0.25 * 0.0625)
    texts = [gap.as_text() for gap in coverage.gaps]
    missing = coverage.gaps[texts.index("gust -5 to 0 m/s with delay as usual")]
    assert missing.share == pytest.approx(0.25 * 0.75)
    assert missing.likelihood == "1 drive in 5"
    assert missing.as_json()["cells"] == {
        "gust": {"low": -5.0, "high": 0.0},
        "delay": {"low": None, "high": None},
    }
    # Gaps within a cell that was never reached are not named again.
    assert texts.count("delay 0.1 to 0.15 s") == 1
    assert sum("delay 0.1 to 0.15 s" in text for text in texts) == 1
    document = coverage.as_json()
    assert document["axes"][1]["cells"][0] == {
        "low": None,
        "high": None,
        "share": 0.75,
        "drives": 2,
        "failures": 0,
    }
    assert document["axes"][2]["cells"][4]["high"] is None


def test_a_repeated_road_counts_once_in_the_same_conditions() -> None:
    tests = [
        bend_test(Outcome.PASS, 14.3, gust=-10.0),
        bend_test(Outcome.FAIL, 17.9, gust=-5.0, delay=0.05),
        bend_test(Outcome.FAIL, 17.9, gust=4.0, delay=0.05),
        bend_test(Outcome.FAIL, 9.0),
    ]
    coverage = coverage_of(GUSTY, [*tests, *tests[1:], tests[1]])
    assert (coverage.drives, coverage.failures, coverage.outside) == (3, 2, 1)
    assert coverage.as_json() == coverage_of(GUSTY, tests).as_json()


def test_road_axes_end_at_the_bounds_of_the_class() -> None:
    domain = Domain.from_entries("town", {"roads": "urban-50,length=400"})
    coverage = coverage_of(domain, [bend_test(Outcome.FAIL, 86.0, grade=-0.08)])
    radius, grade = coverage.singles
    assert [cells.axes[0].name for cells in (radius, grade)] == [RADIUS, GRADE]
    assert radius.axes[0].edges == (86.0, 110.0, 140.0, 220.0, 430.0, math.inf)
    assert grade.axes[0].edges == (0.0, 2.0, 4.0, 6.0, 8.0)
    assert counts(radius) == ["1/1", "0/0", "0/0", "0/0", "0/0"]
    assert counts(grade) == ["0/0", "0/0", "0/0", "1/1"]
    assert coverage.driven_share == pytest.approx(radius.shares[0] * grade.shares[3], abs=0.02)
    flat = Domain.from_entries("flat", {"roads": "urban-50,max_grade=0"})
    assert [axis.name for axis in axes_of(flat)] == [RADIUS]


def test_a_campaign_without_a_domain_has_no_coverage() -> None:
    assert domain_coverage(setting_of(None), []) is None


def test_shares_of_a_normal_distribution_and_of_a_fixed_amount() -> None:
    gust = {"low": -20, "high": 20, "mean": 0, "deviation": 10}
    domain = Domain.from_entries(
        "x", {"conditions": {"gust": gust, "delay": {"low": 0.2, "high": 0.2, "chance": 0.1}}}
    )
    coverage = coverage_of(
        domain, [bend_test(Outcome.PASS, gust=1.0), bend_test(Outcome.PASS, delay=0.2)]
    )
    # A normal distribution within two deviations: 0.4772 on each side, 0.3413 within one.
    assert coverage.singles[0].shares == pytest.approx(
        [0.1359 / 0.9545, 0.3413 / 0.9545, 0.3413 / 0.9545, 0.1359 / 0.9545], abs=1e-4
    )
    delay = coverage.axes[1]
    assert [delay.text(i) for i in range(delay.cell_count)] == ["as usual", "0.2"]
    assert coverage.singles[1].shares == pytest.approx([0.9, 0.1])
    assert counts(coverage.singles[1]) == ["0/1", "0/1"]
    assert delay.ticks == [(0.5, "usual"), (1.5, "0.2")]


def test_varied_conditions_without_a_domain_have_axes() -> None:
    fog, noise = varied_axes(
        [{"fog": 30.0, "load": 100.0}, {"fog": 80.0, "load": 100.0, "noise": 0.1, "noise_seed": 3}]
    )
    assert (fog.name, fog.has_usual, fog.edges) == (
        "fog",
        False,
        (30.0, 40.0, 50.0, 60.0, 70.0, 80.0),
    )
    assert (noise.name, noise.has_usual, noise.edges) == ("noise", True, (0.1, 0.1))


@st.composite
def domains(draw: Any) -> Domain:
    conditions: dict[str, Any] = {}
    for name, most in (("friction", 1.4), ("gust", 40.0), ("noise", 9.0)):
        if draw(st.booleans()):
            a, b, mean = (most * draw(st.integers(1, 100)) / 100.0 for _ in range(3))
            entry = {"low": min(a, b), "high": max(a, b)}
            if draw(st.booleans()):
                entry |= {"mean": mean, "deviation": 0.3 * most}
            conditions[name] = entry | {"chance": draw(st.sampled_from([1.0, 0.3]))}
    return Domain.from_entries("drawn", {"conditions": conditions})


@settings(max_examples=25, deadline=None)
@given(domains(), st.integers(0, 60), st.integers(0, 2**31))
def test_sums_of_cells_agree(domain: Domain, number: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tests = [
        bend_test(
            Outcome.FAIL if rng.random() < 0.3 else Outcome.PASS,
            15.0 / rng.random(),
            **domain.at(rng.random(domain.dimension), 200.0),
        )
        for _ in range(number)
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coverage_module, "ROADS", 20)
        coverage = coverage_of(domain, tests)
    assert (coverage.drives, coverage.outside) == (number, 0)
    assert coverage.failures == sum(test.outcome is Outcome.FAIL for test in tests)
    for cells in (*coverage.singles, *coverage.pairs):
        assert (
            cells.driven + cells.never_reached
            == cells.count
            == math.prod(a.cell_count for a in cells.axes)
        )
        assert cells.drives.sum() == number
        assert cells.failures.sum() == coverage.failures
        assert (cells.failures <= cells.drives).all()
        assert cells.failed <= cells.driven
        assert cells.shares.sum() == pytest.approx(1.0)
        assert (cells.shares >= -1e-12).all()
        assert coverage.driven_share <= cells.driven_share + 0.02
    for pair in coverage.pairs:
        for k, axis in enumerate(pair.axes):
            single = next(cells for cells in coverage.singles if cells.axes == (axis,))
            assert pair.drives.sum(axis=1 - k).tolist() == single.drives.tolist()
            assert pair.shares.sum(axis=1 - k) == pytest.approx(single.shares)
    named = {gap.cells for gap in coverage.gaps}
    assert len(named) == len(coverage.gaps)
    assert len(named) <= sum(cells.never_reached for cells in (*coverage.singles, *coverage.pairs))
    shares = [gap.share for gap in coverage.gaps]
    assert shares == sorted(shares, reverse=True)
    for axis in coverage.axes:
        assert list(axis.edges) == sorted(axis.edges)
        assert axis.cell_count <= 8
        for test in tests:
            cell = axis.find(test.candidate)
            assert cell is not None
            ends, amount = axis.limits(cell), test.candidate.conditions.get(axis.name)
            if ends is not None and amount is not None:
                assert ends[0] - 1e-9 <= amount <= ends[1] + 1e-9


def test_a_drive_in_each_pair_of_cells_covers_the_domain() -> None:
    domain = replace(GUSTY, conditions={"gust": GUSTY.conditions["gust"]})
    tests = [
        bend_test(Outcome.PASS, r, gust=g) for r in (15, 20, 30, 50, 99) for g in (-8, -3, 3, 8)
    ]
    coverage = coverage_of(domain, tests)
    assert coverage.driven_share == 1.0
    assert coverage.gaps == ()
    assert coverage.pairs[0].never_reached == 0
