"""Comparisons of sample campaigns, for the tests of the comparison page."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.spaces import SPACES
from frenetic.analysis.unlike import UnlikeFailures
from frenetic.campaign.counts import Counts


def campaign(folder: Path, distinct: int, simulations: int = 60) -> CampaignMeasures:
    """Return measures of a campaign: its failures follow each other, every second is distinct."""
    curve = np.clip(np.arange(simulations + 1) - 3, 0, 2 * distinct)
    return CampaignMeasures(
        folder=folder,
        seed=distinct,
        counts=Counts(invalid=distinct, min_moobd=-0.1 * distinct),
        failures_after=curve,
        distinct_after=(curve + 1) // 2,
        is_finished=True,
        cells=7,
        unlike_roads=distinct // 2,
        competition_sparseness=25.0 + distinct if distinct > 1 else -math.inf,
        unlike={
            name: UnlikeFailures(2 * distinct, np.linspace(0.1, 2.0, max(0, 2 * distinct - 1)))
            for name in SPACES
        },
    )


def comparison(folder: Path, **groups: list[int]) -> Comparison:
    """Compare groups of campaigns with these numbers of distinct failures."""
    measured = {
        name: tuple(campaign(folder / f"{name}-{i}", n) for i, n in enumerate(numbers))
        for name, numbers in groups.items()
    }
    return compare_measured(measured, shared={"driver": "Planner"})


LOW, HIGH = [1, 2, 3, 4, 5, 6, 7], [11, 12, 13, 14, 15, 16, 17]
"""Distinct failures of the campaigns of two groups."""


def three_groups(folder: Path) -> Comparison:
    """Compare groups called low, high and never; two of their campaigns have a report."""
    for name in ("high-0", "low-1"):
        (folder / name).mkdir()
        (folder / name / "report.html").write_text("<!doctype html><title>x</title>")
    return comparison(folder, low=LOW, high=HIGH, never=[0] * 7)
