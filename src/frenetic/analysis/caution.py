"""Cautions: conclusions that the counts of a campaign do not support."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from frenetic._support.words import counted
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome

_FEWEST_ROADS: Final = 10  # random roads for a caution; ours
_DOUBTFUL_SHARE: Final = 0.95  # failing share of random roads that calls for a caution; ours
_UNSURE: Final = 0.05  # 1 - confidence of the largest failing share


def caution(store: CampaignStore) -> str:
    """Warn of conclusions that the counts do not support, in a sentence; mostly empty.

    - Nearly all random roads fail: then the roads may not be the cause.
    - No random road fails: then rare failures are still possible.
    - Nothing failed in less time than the criteria ask for: then the criteria show nothing.

    Faults of the driver do not count as failures here.
    """
    return "; ".join(filter(None, (_random_roads_caution(store), _time_caution(store))))


def _time_caution(store: CampaignStore) -> str:
    """Warn if nothing failed in less time than the criteria ask for."""
    rules: Any = store.config.get("rules") or {}
    criteria = rules.get("criteria", {})
    needed = criteria.get("driven_time", 0.0)
    if not needed or store.by_outcome()[Outcome.FAIL]:
        return ""
    rows = store.rows("SELECT id, duration FROM test WHERE outcome = 'PASS'")
    repeats = store.repeats()
    driven = sum(duration or 0.0 for number, duration in rows if number not in repeats)
    if driven >= needed:
        return ""
    return f"{driven:.0f} s were driven, and {criteria['name']} asks for {needed:.0f} s"


def _random_roads_caution(store: CampaignStore) -> str:
    """Warn if nearly all random roads failed, or none did."""
    rows = store.rows(
        "SELECT id, outcome FROM test WHERE operator = 'random' AND fault IS NULL AND outcome IN"
        " ('PASS', 'FAIL')"
    )
    repeats = store.repeats()
    counts = Counter(outcome for number, outcome in rows if number not in repeats)
    failed, driven = counts["FAIL"], counts.total()
    if driven < _FEWEST_ROADS:
        return ""
    if not store.by_outcome()[Outcome.FAIL]:
        most = 1.0 - _UNSURE ** (1.0 / driven)
        return (
            f"{counted(driven, 'random road')} passed, so fewer than {100.0 * most:.2g} % of such"
            " roads fail, with 95 % confidence; rarer failures take more roads"
        )
    if failed < _DOUBTFUL_SHARE * driven:
        return ""
    return (
        f"{failed} of {driven} random roads fail: it may be the car, the speed or the code between"
        " driver and simulator, rather than the roads; see how a straight road is driven first"
    )
