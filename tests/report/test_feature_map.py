"""The feature map of a report: which tests it shows, and its axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from frenetic.analysis.axes import Axis
from frenetic.oracle.outcome import Outcome
from frenetic.report.html import DataBlock, feature_map
from frenetic.report.html.feature_map import cells_of, choose_mapped, map_section
from frenetic.report.html.tests import TestSummary
from frenetic.segments.features import FEATURES as AXES

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
    "lateral_acceleration": 3.0,
    "lateral_jerk": 2.0,
}


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets a map hold few tests."""
    for name, value in {"MAPPED": 30, "MAPPED_PASSED": 10, "MAPPED_FAILURES": 40}.items():
        monkeypatch.setattr(feature_map, name, value)


def sample_tests(failures: int, passes: int) -> list[TestSummary]:
    """Return failures, each more severe than the one before, then passes."""
    kinds = [(Outcome.FAIL, -i / 100.0) for i in range(1, failures + 1)]
    kinds += [(Outcome.PASS, 1.0)] * passes
    return [
        TestSummary(i, outcome, moobd, True, {})
        for i, (outcome, moobd) in enumerate(kinds, start=1)
    ]


def chosen_of(tests: list[TestSummary]) -> list[TestSummary]:
    """Return the tests that the map shows."""
    chosen = choose_mapped([(test.id, test.outcome, test.moobd) for test in tests])
    return [test for test in tests if test.id in chosen]


@pytest.mark.parametrize(
    ("failures", "passes", "mapped"),
    [(5, 20, (5, 20)), (5, 90, (5, 25)), (29, 90, (29, 10)), (0, 90, (0, 30)), (50, 1, (40, 1))],
)
def test_the_map_shows_failures_thins_passes_and_counts_both(
    failures: int, passes: int, mapped: tuple[int, int]
) -> None:
    tests = sample_tests(failures, passes)
    chosen = chosen_of(tests)
    failed = sum(test.outcome is Outcome.FAIL for test in chosen)
    assert (failed, len(chosen) - failed) == mapped
    passed = [i for i, test in enumerate(tests[failures:]) if test in chosen]
    gaps = np.diff([-1, *passed, passes])
    assert max(gaps) <= 3 * passes / len(passed) + 1  # evenly over the campaign
    measured = {test.id: FEATURES for test in chosen}
    section = map_section(measured, tests)
    (block,) = section.blocks
    assert isinstance(block, DataBlock)
    note = f"{mapped[0]} of {failures} failures, {mapped[1]} of {passes} others"
    assert (note in section.lead) is (mapped != (failures, passes))
    assert block.data["all_driven"] is (mapped == (failures, passes))
    assert block.data["all_failures"] is (failures < 50)
    weights = block.data["weights"]  # mapped tests, each as often as its weight, are all tests
    assert weights["failed"] * mapped[0] == pytest.approx(failures)
    assert weights["passed"] * mapped[1] == pytest.approx(passes)


def test_conditions_are_axes_and_drives_beyond_them_have_no_cell() -> None:
    gust = Axis("gust", "gust", "m/s", (-10.0, 0.0, 10.0), has_usual=True)
    tests = sample_tests(1, 3)
    measured = {test.id: FEATURES for test in tests}
    (block,) = map_section(measured, tests, {gust: [2, None, 0, 1]}).blocks
    assert isinstance(block, DataBlock)
    axis = block.data["axes"][-1]
    assert axis["name"] == "gust"
    assert axis["texts"] == ["Gust as usual", "Gust \u221210 to 0 m/s", "Gust 0 to 10 m/s"]
    assert axis["ticks"] == [(0.5, "usual"), (1, "\u221210"), (2, "0"), (3, "10")]
    assert axis["bins"] == "2.01"


def test_a_longer_campaign_keeps_most_of_the_mapped_passes() -> None:
    before, after = ({test.id for test in chosen_of(sample_tests(0, n))} for n in (200, 210))
    assert len(before - after) <= 3


def test_a_map_of_too_many_failures_shows_every_severity() -> None:
    moobds = [test.moobd or 0.0 for test in chosen_of(sample_tests(1000, 0))]
    assert (len(moobds), min(moobds), max(moobds)) == (40, -10.0, -0.01)
    assert 18 <= sum(moobd < -5.0 for moobd in moobds) <= 22


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
    edges, cells = cells_of(AXES[name], [FEATURES | change for change in changes])
    steps = np.diff(edges)
    assert steps == pytest.approx(steps[0])
    assert 4 <= len(steps) <= 12
    assert shown[0] - steps[0] < edges[0] <= shown[0] + 1e-9
    assert shown[1] - 1e-9 <= edges[-1] < shown[1] + steps[0]
    factor = 3.6 if name == "mean_speed" else 1.0
    for value, cell in zip(values, cells.tolist(), strict=True):
        assert edges[cell] <= factor * value <= edges[cell + 1]
