"""Cautions: conclusions that the counts of a campaign do not support."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from frenetic._support.words import counted
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.search.road_families import FAMILIES

_MIN_RANDOM_ROADS: Final = 10  # least number of random roads for a caution (our choice)
_DOUBTFUL_SHARE: Final = 0.95  # failing share of random roads that calls for a caution (our choice)
_ERROR: Final = 0.05  # chance that the share of failing roads is larger than the text says


def caution(store: CampaignStore) -> str:
    """Return warnings of conclusions that the counts do not support; empty if there are none.

    - Nearly all random roads fail: the roads may not be the cause.
    - Nothing fails: rare failures are still possible.
    - Nothing fails, in less time than the criteria ask for: the criteria show nothing yet.

    A drive on a random road that a fault of the driver ended does not count.
    """
    return "; ".join(filter(None, (_random_roads_caution(store), _time_caution(store))))


def _time_caution(store: CampaignStore) -> str:
    """Return a warning if nothing failed, in less time than the criteria ask for."""
    rules: Any = store.config.get("rules") or {}
    criteria = rules.get("criteria", {})
    needed_time = criteria.get("driven_time", 0.0)
    if not needed_time or store.by_outcome()[Outcome.FAIL]:
        return ""
    rows = store.rows("SELECT id, duration FROM test WHERE outcome = 'PASS'")
    repeats = store.repeats()
    driven_time = sum(duration or 0.0 for number, duration in rows if number not in repeats)
    if driven_time >= needed_time:
        return ""
    return f"{driven_time:.0f} s were driven, and {criteria['name']} asks for {needed_time:.0f} s"


def _random_roads_caution(store: CampaignStore) -> str:
    """Return a warning if nearly all random roads failed, or nothing did."""
    rows = store.rows(
        "SELECT id, outcome, operator FROM test WHERE fault IS NULL AND outcome IN ('PASS', 'FAIL')"
    )
    repeats = store.repeats()
    counts = Counter(
        outcome
        for number, outcome, operator in rows
        if operator in FAMILIES and number not in repeats
    )
    failed, driven = counts["FAIL"], counts.total()
    if driven < _MIN_RANDOM_ROADS:
        return ""
    if not store.by_outcome()[Outcome.FAIL]:
        # If this share of roads failed, all driven ones would pass with a chance of `_ERROR`.
        largest_share = 1.0 - _ERROR ** (1.0 / driven)
        return (
            f"{counted(driven, 'random road')} passed, so fewer than {100.0 * largest_share:.2g} %"
            " of such roads fail, with 95 % confidence; rarer failures take more roads"
        )
    if failed < _DOUBTFUL_SHARE * driven:
        return ""
    return (
        f"{failed} of {driven} random roads fail: it may be the car, the speed or the code between"
        " driver and simulator, rather than the roads; see how a straight road is driven first"
    )
