"""Criteria of a campaign in words, with the time, speeds and radii that were driven."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic.campaign.store import CampaignStore

_STRAIGHT: Final = 1e-4
"""Curvature up to which a road counts as straight, in 1/m: a radius of 10 km (our choice)."""


def criteria_text(store: CampaignStore) -> str:
    """Return the criteria beside leaving the lane in words, and the time, speeds and radii driven.

    The text is empty without such criteria.

    Raises:
        CampaignError: the campaign is damaged.
    """
    criteria = store.setting.rules.criteria
    if not criteria:
        return ""
    parts = [criteria.as_text()]
    if driven := _driven_text(store, criteria.driven_time):
        parts.append(driven)
    if criteria.left_out:
        parts.append(f"left out: {criteria.left_out}")
    return "; ".join(parts)


def _driven_text(store: CampaignStore, needed_time: float) -> str:
    """Return the time, speeds and radii that were driven in words; empty without a drive.

    Args:
        store: the campaign.
        needed_time: driving time that the criteria ask for, in s.
    """
    time, slowest, fastest, sharpest = 0.0, math.inf, 0.0, 0.0
    for test in store.tests(with_segments=True, with_repeats=False):
        if (values := test.segment_values) is not None:
            time += test.result.duration or 0.0
            slowest = min(slowest, 3.6 * values.slowest)
            fastest = max(fastest, 3.6 * values.fastest)
            sharpest = max(sharpest, float(np.abs(test.candidate.curvatures).max()))
    if time == 0.0:
        return ""
    text = f"driven for {time / 60.0:.1f} min at {slowest:.0f} to {fastest:.0f} km/h"
    if sharpest > _STRAIGHT:
        text += f", radii from {1.0 / sharpest:.0f} m"
    if time < needed_time:
        text += f", less than the {needed_time / 60.0:g} min that the criteria ask for"
    return text
