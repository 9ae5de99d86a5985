"""The picture of a comparison."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from frenetic.analysis.comparing import CampaignMeasures, Comparison, compare_measured
from frenetic.errors import FreneticError
from frenetic.report.comparison import draw_comparison, failure_curves


def campaign(failures: int, simulations: int = 40, first: float | None = None) -> CampaignMeasures:
    curve = np.minimum(np.arange(simulations + 1), failures)
    never = math.inf if failures == 0 else 1.0
    return CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        simulations=simulations,
        invalid=failures,
        failures=failures,
        distinct_failures=failures // 2,
        cells=failures // 3,
        simulations_to_failure=never if first is None else first,
        seconds_to_failure=never if first is None else first,
        failures_after=curve,
        is_finished=True,
    )


def comparison_of(**groups: tuple[CampaignMeasures, ...]) -> Comparison:
    return compare_measured(groups)


SIX = tuple(campaign(10 + i) for i in range(6))
FIVE = tuple(campaign(3 + i, first=2.0 + i) for i in range(5))
NEVER = tuple(campaign(0) for _ in range(5))


def svg_of(comparison: Comparison, folder: Path) -> str:
    draw_comparison(comparison, folder / "a.svg")
    return (folder / "a.svg").read_text(encoding="utf-8")


def test_curves_reach_as_far_as_all_campaigns_of_a_group() -> None:
    curves = failure_curves((campaign(5, simulations=10), campaign(5, simulations=30)))
    assert curves.shape == (2, 11)
    assert curves[0].tolist() == [0, 1, 2, 3, 4, 5, 5, 5, 5, 5, 5]


def test_groups_measures_and_findings_are_named(tmp_path: Path) -> None:
    svg = svg_of(comparison_of(frenetic=SIX, random=FIVE), tmp_path)
    for text in (
        "frenetic, 6 campaigns",
        "random, 5 campaigns",
        "distinct failures",
        "time to first failure (s)",
        "less is better; A12 ",
    ):
        assert text in svg
    assert "failures per 100" not in svg, "all have as many simulations"
    assert "none" not in re.findall(r">([^<]*)</text>", svg)


def test_what_never_failed_has_a_place_of_its_own(tmp_path: Path) -> None:
    svg = svg_of(comparison_of(some=FIVE, never=NEVER), tmp_path)
    assert "none" in re.findall(r">([^<]*)</text>", svg)


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
