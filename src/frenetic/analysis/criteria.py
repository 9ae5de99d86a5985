"""Criteria of a campaign in words, with the time, speeds and radii that were driven."""

from __future__ import annotations

import numpy as np

from frenetic.campaign.store import CampaignStore


def criteria_text(store: CampaignStore) -> str:
    """Return the criteria beside the lane's, and what was driven, in words; empty without any.

    Raises:
        CampaignError: the campaign is damaged.
    """
    profile = store.setting.rules.criteria
    if not profile:
        return ""
    time, speeds, sharpest = 0.0, [np.inf, 0.0], 0.0
    for test in store.tests(with_trajectory=True, with_repeats=False):
        if test.outcome.is_driven and test.trajectory is not None and len(test.trajectory):
            time += test.result.duration or 0.0
            # The slowest speed counts only behind the start, where each drive stands.
            speed = test.trajectory.speed * 3.6
            begun = speed[int(np.argmax(speed >= 0.5 * speed.max())) :]
            speeds = [min(speeds[0], float(begun.min())), max(speeds[1], float(speed.max()))]
            sharpest = max(sharpest, float(np.abs(test.road.curvatures).max()))
    words = [profile.as_text()]
    if time > 0.0:
        least = f", radii from {1.0 / sharpest:.0f} m" if sharpest > 1e-4 else ""
        text = f"driven for {time / 60.0:.1f} min at {speeds[0]:.0f} to {speeds[1]:.0f} km/h{least}"
        if time < profile.driven_time:
            text += f", less than the {profile.driven_time / 60.0:g} min that it asks for"
        words.append(text)
    if profile.left_out:
        words.append(f"left out: {profile.left_out}")
    return "; ".join(words)
