"""Lists of a campaign's tests: filtered by outcome, features and conditions, and sorted."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Final

from frenetic.analysis.features import FEATURES, Features, features_of
from frenetic.analysis.segments import segment_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import condition_named, known_conditions
from frenetic.errors import UnknownNameError
from frenetic.oracle.outcome import Outcome, chosen_outcomes

ORDERS: Final = ("severity", "tested", "duration")
"""Orders that need no features: lowest MOOBD first, in the order of the results, longest first."""


def list_tests(
    store: CampaignStore,
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
    within: Mapping[str, tuple[float, float]] | None = None,
    sort: str = "severity",
) -> list[tuple[Test, Features]]:
    """Return the tests of a campaign in an order; equal tests stay in the order of the results.

    Tests come without their trajectories, each with those features and conditions by which the list
    is filtered and sorted. A test without the value by which the list is sorted comes last.
    Features belong to the segment around the departure, or else around the least oob distance; they
    take about a millisecond a test. A condition that a test lacks has the amount without effect.

    Args:
        store: the campaign.
        outcomes: outcome of the tests, such as ``"FAIL"``, or several; by default all outcomes.
        within: ranges of the tests' features and conditions by name, both ends included.
        sort: one of `ORDERS`, or a feature or condition, the largest first.

    Raises:
        CampaignError: the campaign is damaged.
        UnknownNameError: an order, feature or condition is unknown.
        ValueError: an outcome is unknown, or a range ends below its start.
    """
    within = {} if within is None else within
    wanted = chosen_outcomes(outcomes)
    names = [*within, *([] if sort in ORDERS else [sort])]
    for name in names:
        if name not in FEATURES and name not in known_conditions():
            raise UnknownNameError(
                f"no feature, condition or order is called {name!r}: choose from"
                f" {', '.join([*ORDERS, *FEATURES, *known_conditions()])}"
            )
    for name, (low, high) in within.items():
        if low > high:
            raise ValueError(f"{name} from {low:g} to {high:g}: the lower end comes first")
    tests = (
        (record, _values(store, record, names))
        for record in store.tests()
        if record.outcome in wanted
    )
    chosen = [
        (record, values)
        for record, values in tests
        if all(low <= values.get(name, math.nan) <= high for name, (low, high) in within.items())
    ]
    return sorted(chosen, key=lambda test: _sort_key(test[0], test[1], sort))


def _values(store: CampaignStore, record: Test, names: Collection[str]) -> Features:
    """Return the named features and conditions that a test has."""
    values: dict[str, float] = {}
    if not FEATURES.keys().isdisjoint(names) and record.outcome.is_driven:
        test = store.test(record.id)
        if test.drive is not None and len(test.drive.trajectory):
            values |= features_of(segment_of(test.road, test.drive, test.result.finding))
    for name in names:
        if name not in FEATURES:
            amount = record.candidate.conditions.get(name, condition_named(name).nothing)
            if amount is not None:
                values[name] = amount
    return values


def _sort_key(record: Test, values: Features, sort: str) -> float:
    """Return a number that is smaller for a test that comes earlier."""
    if sort == "tested":
        return record.result_number
    if sort == "severity":
        return math.inf if record.moobd is None else record.moobd
    value = record.result.duration if sort == "duration" else values.get(sort)
    return math.inf if value is None else -value
