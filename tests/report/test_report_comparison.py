"""The picture of a comparison."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.metrics import CampaignMeasures
from frenetic.campaign.counts import Counts
from frenetic.errors import FreneticError
from frenetic.report import plot
from frenetic.report.comparison import draw_comparison, draw_measure, look_of


def campaign(failures: int, simulations: int = 40, first: float | None = None) -> CampaignMeasures:
    """With its failures one after the other from the first simulation, or a later one, on."""
    start = 1 if first is None else int(first)
    curve = np.clip(np.arange(simulations + 1) - start + 1, 0, failures)
    return CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        counts=Counts(invalid=failures),
        failures_after=curve,
        distinct_after=curve // 2,
        is_finished=True,
        competition_sparseness=10.0 + failures if failures > 1 else -math.inf,
    )


def comparison_of(**groups: tuple[CampaignMeasures, ...]) -> Comparison:
    return compare_measured(groups)


SIX = tuple(campaign(10 + i) for i in range(6))
FIVE = tuple(campaign(3 + i, first=2.0 + i) for i in range(5))
NEVER = tuple(campaign(0) for _ in range(5))


def svg_of(comparison: Comparison, folder: Path) -> str:
    draw_comparison(comparison, folder / "a.svg")
    return (folder / "a.svg").read_text(encoding="utf-8")


def test_groups_measures_and_findings_are_named(tmp_path: Path) -> None:
    svg = svg_of(comparison_of(frenetic=SIX, random=FIVE), tmp_path)
    for text in (
        "frenetic, 6 campaigns",
        "random, 5 campaigns",
        "distinct failures",
        "simulations to first failure",
        "less is better; A12 ",
    ):
        assert text in svg
    assert "none" not in re.findall(r">([^<]*)</text>", svg)


def test_what_never_failed_has_a_place_of_its_own(tmp_path: Path) -> None:
    svg = svg_of(comparison_of(some=FIVE, never=NEVER), tmp_path)
    never = {"first failure", "sparseness"}
    assert re.findall(r">([^<]*)</text>", svg).count("none") == len(never)


@pytest.mark.parametrize(
    "groups",
    [
        {"a": SIX[:1], "b": FIVE[:4]},
        {"a": NEVER, "b": NEVER},
        {"a": (campaign(0, simulations=0),), "b": (campaign(2, simulations=3),)},
        {chr(97 + i) * 60: FIVE for i in range(9)},
    ],
    ids=["few", "never", "empty", "many"],
)
def test_whatever_there_is_can_be_drawn(
    groups: dict[str, tuple[CampaignMeasures, ...]], tmp_path: Path
) -> None:
    svg = svg_of(compare_measured(groups), tmp_path)
    assert svg.count("campaigns</text>") + svg.count("campaign</text>") == len(groups)
    if len(groups) == 2 and len(groups["a"]) < 5:
        assert "too few repeats to tell" in svg


@pytest.mark.parametrize("value", [0.0, 0.25, 3.0])
def test_a_measure_that_is_equal_everywhere_has_an_axis_from_zero(value: float) -> None:
    comparison = comparison_of(a=SIX, b=FIVE)
    (measured,) = (one for one in comparison.measures if one.measure.name == "cells")
    equal = {name: (value,) * len(values) for name, values in measured.values.items()}
    axes = Figure().add_subplot()
    draw_measure(axes, replace(measured, values=equal))
    ticks = axes.get_xticks().tolist()
    assert 2 <= len(ticks) <= 7
    assert ticks[0] == 0.0
    assert ticks[-1] == pytest.approx(value or 1.0, rel=0.35)
    assert -0.1 * (value or 1.0) < axes.get_xlim()[0] < 0.0  # room for the points
    assert axes.get_xlim()[1] > value


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_same_comparison_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    pictures = []
    for number in (1, 2):
        path = tmp_path / f"{number}.{suffix}"
        draw_comparison(comparison_of(a=SIX, b=FIVE, c=NEVER), path)
        pictures.append(path.read_bytes())
    assert pictures[0] == pictures[1]
    assert len(list(tmp_path.iterdir())) == 2


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FreneticError, match="must end with"):
        draw_comparison(comparison_of(a=SIX, b=FIVE), tmp_path / "a.gif")


def test_more_groups_than_colours_differ_in_their_lines_and_markers() -> None:
    assert len({look_of(group) for group in range(28)}) == 28
    groups = comparison_of(**{f"group {i}": FIVE for i in range(9)})
    curves = plot(groups, Figure().add_subplot()).lines
    shown = {(line.get_color(), line.get_linestyle()) for line in curves}
    assert len(shown) == 9
