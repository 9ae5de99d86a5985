"""The passing drives of a campaign, with which its drivers' mistakes are compared."""

from __future__ import annotations

from typing import Final

from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.segments.passing import PassingDrives

_MOST_DRIVES: Final = 50  # largest number of drives that are compared, the first ones (our choice)


def passing_drives(store: CampaignStore) -> PassingDrives | None:
    """Return the first passing drives of a campaign; None for fewer than three.

    Raises:
        CampaignError: the campaign is damaged.
    """
    tests = store.tests(Outcome.PASS, limit=_MOST_DRIVES, with_trajectory=True, with_repeats=False)
    return PassingDrives.of(test.segment for test in tests if test.segment is not None)
