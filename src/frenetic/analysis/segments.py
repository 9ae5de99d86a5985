"""Segments of stored tests."""

from __future__ import annotations

from collections.abc import Iterator

from frenetic.campaign.reader import Order
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.segments.segment import Segment


def segments_of(
    store: CampaignStore,
    outcome: Outcome | None = None,
    *,
    order_by: Order = "result_number",
    limit: int | None = None,
    with_repeats: bool = True,
) -> Iterator[tuple[Test, Segment]]:
    """Yield the driven tests of a campaign with their segments; tests without records are left out.

    Args:
        store: the campaign.
        outcome: PASS or FAIL for tests with this outcome only; None for both.
        order_by: order of the tests, as for `CampaignStore.tests`.
        limit: most tests to read.
        with_repeats: whether repeated roads are included, as for `CampaignStore.tests`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    tests = store.tests(outcome, order_by, limit, with_trajectory=True, with_repeats=with_repeats)
    for test in tests:
        if test.outcome.is_driven and test.segment is not None:
            yield test, test.segment
