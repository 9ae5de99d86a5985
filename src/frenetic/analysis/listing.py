"""A campaign's tests in a list: chosen by outcome and features, in a useful order."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final

from frenetic.analysis.features import FEATURES, Features, features_of
from frenetic.analysis.segments import segment_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import UnknownNameError
from frenetic.outcome import Outcome

ORDERS: Final = ("severity", "tested", "duration")
"""Orders that need no features: lowest MOOBD first, in the order of the results, longest first."""


def list_tests(
    store: CampaignStore,
    *,
    outcomes: Collection[Outcome | str] = (),
    within: Mapping[str, tuple[float, float]] | None = None,
    sort: str = "severity",
) -> list[tuple[Test, Features | None]]:
    """The tests of a campaign in a chosen order; equal ones stay in the order of the results.

    They come without their trajectories. A test without the value by which the list is sorted comes
    last. Features are those of the segment around the place of departure, or else of the least oob
    distance, None if the list asks for none or nothing was driven; they take about a millisecond a
    test.

    Args:
        store: the campaign.
        outcomes: only tests of these; all without any.
        within: only tests whose features lie in these ranges, both ends included.
        sort: one of `ORDERS`, or a feature, of which the largest comes first.

    Raises:
        CampaignError: the campaign is damaged.
        UnknownNameError: there is no such order or feature.
        ValueError: there is no such outcome, or a range ends below its start.
    """
    within = {} if within is None else within
    wanted = {Outcome(outcome) for outcome in outcomes} or set(Outcome)
    asked = [*within, *([] if sort in ORDERS else [sort])]
    for name in asked:
        if name not in FEATURES:
            raise UnknownNameError(
                f"no feature or order is called {name!r}: choose from"
                f" {', '.join([*ORDERS, *FEATURES])}"
            )
    for name, (low, high) in within.items():
        if low > high:
            raise ValueError(f"{name} from {low:g} to {high:g}: the lower end comes first")
    tests = (
        (record, _features(store, record) if asked else None)
        for record in store.tests()
        if record.outcome in wanted
    )
    chosen = [
        (record, features)
        for record, features in tests
        if all(low <= _value(features, name) <= high for name, (low, high) in within.items())
    ]
    return sorted(chosen, key=lambda test: _place(test[0], test[1], sort))


def _features(store: CampaignStore, record: Test) -> Features | None:
    if not record.outcome.is_driven:
        return None
    test = store.test(record.id)
    if test.drive is None or not len(test.drive.trajectory):
        return None
    return features_of(segment_of(test.road, test.drive, test.result.finding))


def _value(features: Features | None, name: str) -> float:
    """A feature; NaN without it, which no range holds."""
    return math.nan if features is None else features[name]


def _place(record: Test, features: Features | None, sort: str) -> float:
    """A number that is smaller for a test that comes earlier."""
    if sort == "tested":
        return record.told
    if sort == "severity":
        return math.inf if record.moobd is None else record.moobd
    value = record.result.duration if sort == "duration" else _value(features, sort)
    return math.inf if value is None or math.isnan(value) else -value
