"""Which tests are in the feature map of a report, and what it says of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from frenetic.analysis.features import FEATURES as AXES
from frenetic.outcome import Outcome
from frenetic.report.html import feature_map
from frenetic.report.html.blocks import Part
from frenetic.report.html.feature_map import MapAxis, Measured, choose_mapped, map_section
from frenetic.report.html.tests import TestSummary
from frenetic.search import Origin

FEATURES = {
    "length": 60.0,
    "max_curvature": 0.03,
    "direction_coverage": 0.2,
    "bends": 2,
    "mean_speed": 15.0,
    "std_speed": 1.0,
    "std_steering": 0.1,
    "mean_offset": 0.0,
    "extreme_offset": 0.5,
}


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"MAPPED": 30, "MAPPED_PASSED": 10, "MAPPED_FAILURES": 40}.items():
        monkeypatch.setattr(feature_map, name, value)


def made(failures: int, passes: int) -> list[TestSummary]:
    """Tests, those that failed first, each more severe than the one before."""
    return [
        TestSummary(
            i,
            Outcome.FAIL if i <= failures else Outcome.PASS,
            -i / 100.0 if i <= failures else 1.0,
            float(i),
            Origin("random"),
        )
        for i in range(1, failures + passes + 1)
    ]


def numbers(tests: list[TestSummary]) -> tuple[int, int]:
    """How many failed and how many passed."""
    failed = sum(test.outcome is Outcome.FAIL for test in tests)
    return failed, len(tests) - failed


def section_of(tests: list[TestSummary]) -> tuple[str, Mapping[str, Any]]:
    """The lead and the block's data."""
    ids = [test.id for test in choose_mapped(tests)]
    section = map_section(dict.fromkeys(ids, Measured(FEATURES, FEATURES)), tests)
    (block,) = section.blocks
    assert isinstance(block, Part)
    return section.lead, block.data


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("failures", "passes", "mapped"),
    [(5, 20, (5, 20)), (5, 90, (5, 25)), (29, 90, (29, 10)), (40, 3, (40, 3)), (0, 90, (0, 30))],
)
def test_all_failures_are_mapped_and_passes_thinned(
    failures: int, passes: int, mapped: tuple[int, int]
) -> None:
    tests = made(failures, passes)
    chosen = choose_mapped(tests)
    assert numbers(chosen) == mapped
    assert chosen == [test for test in tests if test in chosen]
    passed = [i for i, test in enumerate(tests[failures:]) if test in chosen]
    gaps = np.diff([-1, *passed, passes])
    assert max(gaps) <= 3 * passes / len(passed) + 1  # evenly over the campaign


@pytest.mark.usefixtures("small")
def test_few_others_are_mapped_when_the_campaign_has_grown() -> None:
    before, after = ({test.id for test in choose_mapped(made(0, n))} for n in (200, 210))
    assert len(before - after) <= 3


@pytest.mark.usefixtures("small")
def test_of_too_many_failures_some_of_every_severity_are_mapped() -> None:
    tests = made(1000, 0)
    moobds = [test.moobd for test in choose_mapped(tests) if test.moobd is not None]
    assert len(moobds) == 40
    assert min(moobds) == -10.0
    assert max(moobds) == -0.01
    assert 18 <= sum(moobd < -5.0 for moobd in moobds) <= 22


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("failures", "passes", "text"),
    [
        (
            25,
            90,
            "All 25 failures and 10 of the 90 tests that passed, evenly over the campaign, are"
            " mapped.",
        ),
        (
            1,
            90,
            "The only failure and 29 of the 90 tests that passed, evenly over the campaign, are"
            " mapped.",
        ),
        (0, 90, "30 of the 90 tests that passed, evenly over the campaign, are mapped."),
        (
            50,
            1,
            "40 of the 50 failures, evenly from the most to the least severe, and the only test"
            " that passed are mapped.",
        ),
    ],
)
def test_it_is_said_what_is_mapped(failures: int, passes: int, text: str) -> None:
    lead, block = section_of(made(failures, passes))
    assert lead.endswith(f"to see its roads. {text}")
    assert not block["all_driven"]
    assert block["all_failures"] is (failures < 50)


@pytest.mark.usefixtures("small")
def test_of_a_map_of_everything_nothing_is_said() -> None:
    lead, block = section_of(made(10, 20))
    assert lead.endswith("to see its roads.")
    assert block["all_driven"]
    assert block["all_failures"]


@pytest.mark.parametrize(
    ("name", "values", "shown"),
    [
        ("max_curvature", [0.021, 0.034, 0.07], (0.021, 0.07)),
        ("mean_speed", [10.0, 15.0, 15.0], (36.0, 54.0)),
        ("bends", [1, 2, 4], (0.5, 4.5)),
        ("mean_offset", [0.1, 0.1], (-0.05, 0.25)),
        ("mean_speed", [], (0.0, 90.0)),
    ],
)
def test_an_axis_has_the_range_of_its_values(
    name: str, values: list[Any], shown: tuple[float, float]
) -> None:
    changes: list[Any] = [{name: value} for value in values]
    axis = MapAxis.of(AXES[name], [FEATURES | change for change in changes])
    steps = np.diff(axis.edges)
    assert steps == pytest.approx(steps[0])
    assert 4 <= len(steps) <= 12
    assert shown[0] - steps[0] < axis.edges[0] <= shown[0] + 1e-9
    assert shown[1] - 1e-9 <= axis.edges[-1] < shown[1] + steps[0]
    factor = 3.6 if name == "mean_speed" else 1.0
    for value, cell in zip(values, axis.cells.tolist(), strict=True):
        assert axis.edges[cell] <= factor * value <= axis.edges[cell + 1]
