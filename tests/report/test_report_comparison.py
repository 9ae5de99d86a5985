"""The picture of a comparison."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.metrics import CampaignMeasures
from frenetic.campaign.counts import Counts
from frenetic.errors import FreneticError
from frenetic.report import plot
from frenetic.report.comparison import draw_comparison


def campaign(failures: int, simulations: int = 40, first: int = 1) -> CampaignMeasures:
    """With its failures one after the other from a simulation on."""
    curve = np.clip(np.arange(simulations + 1) - first + 1, 0, failures)
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
FIVE = tuple(campaign(3 + i, first=2 + i) for i in range(5))
NEVER = tuple(campaign(0) for _ in range(5))


def texts_of(comparison: Comparison, folder: Path) -> list[str]:
    draw_comparison(comparison, folder / "a.svg")
    return re.findall(r">([^<]*)</text>", (folder / "a.svg").read_text(encoding="utf-8"))


def test_groups_measures_and_findings_are_named(tmp_path: Path) -> None:
    texts = texts_of(comparison_of(frenetic=SIX, random=FIVE), tmp_path)
    wanted = {"frenetic, 6 campaigns", "random, 5 campaigns", "distinct failures"}
    assert wanted | {"simulations to first failure"} <= set(texts)
    assert any(text.startswith("less is better; A12 ") for text in texts)
    assert "none" not in texts
    never = texts_of(comparison_of(some=FIVE, never=NEVER), tmp_path)
    assert never.count("none") == len({"first failure", "sparseness"})


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
    texts = texts_of(compare_measured(groups), tmp_path)
    assert sum(text.endswith(("campaigns", "campaign")) for text in texts) == len(groups)
    is_few = len(groups["a"]) < 5 if "a" in groups else False
    assert any("too few repeats to tell" in text for text in texts) is is_few


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_same_comparison_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    path, pictures = tmp_path / f"a.{suffix}", set()
    for _ in range(2):
        draw_comparison(comparison_of(a=SIX, b=FIVE, c=NEVER), path)
        pictures.add(path.read_bytes())
    assert len(pictures) == len(list(tmp_path.iterdir())) == 1
    with pytest.raises(FreneticError, match="must end with"):
        draw_comparison(comparison_of(a=SIX, b=FIVE), tmp_path / "a.gif")


def test_curves_are_medians_in_lines_of_their_own() -> None:
    groups = comparison_of(**{f"group {i}": FIVE if i else SIX for i in range(9)})
    curves = plot(groups, Figure().add_subplot()).lines
    assert len({(line.get_color(), line.get_linestyle()) for line in curves}) == 9
    best = next(line for line in curves if str(line.get_label()).startswith("group 0"))
    found = np.median([one.failures_after for one in SIX], axis=0)
    assert np.asarray(best.get_ydata()).tolist() == found.tolist()
