"""Lists of a campaign's tests: filtered by outcome, features and conditions, and sorted."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Final

from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import condition_named, known_conditions
from frenetic.errors import UnknownNameError
from frenetic.oracle.outcome import Outcome, chosen_outcomes
from frenetic.segments.features import FEATURES, Features

ORDERS: Final = ("severity", "tested", "duration")
"""Orders that need no features: lowest MOOBD first, order of the results, longest drive first."""


def list_tests(
    store: CampaignStore,
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
    within: Mapping[str, tuple[float, float]] | None = None,
    sort: str = "severity",
) -> list[tuple[Test, Features]]:
    """Return the tests of a campaign, filtered and sorted; ties stay in the order of the results.

    Tests come without their trajectories, each with those features and conditions by which the list
    is filtered and sorted. A test without the value by which the list is sorted comes last.
    Features describe the segment around the departure, or else around the least oob distance. For
    a condition that a test lacks, the amount without effect counts.

    Args:
        store: the campaign.
        outcomes: outcome of the tests, such as ``"FAIL"``, or several; by default all outcomes.
        within: ranges of the tests' features and conditions by name, both ends included.
        sort: one of `ORDERS`, or a feature or condition, the largest first.

    Raises:
        CampaignError: the campaign is damaged.
        UnknownNameError: no order, feature or condition has this name.
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
    listed = [
        (test, values)
        for test in store.tests(with_segments=not FEATURES.keys().isdisjoint(names))
        if test.outcome in wanted and _lies_within(values := _values(test, names), within)
    ]
    return sorted(listed, key=lambda row: _sort_key(row[0], row[1], sort))


def _lies_within(values: Features, within: Mapping[str, tuple[float, float]]) -> bool:
    """Return whether values lie in their ranges; a missing value lies in no range."""
    return all(low <= values.get(name, math.nan) <= high for name, (low, high) in within.items())


def _values(test: Test, names: Collection[str]) -> Features:
    """Return the named features and conditions that a test has."""
    values: dict[str, float] = {}
    if test.segment_values is not None:
        values |= test.segment_values.features
    for name in names:
        if name not in FEATURES:
            amount = test.candidate.conditions.get(name, condition_named(name).no_effect)
            if amount is not None:
                values[name] = amount
    return values


def _sort_key(test: Test, values: Features, sort: str) -> float:
    """Return a number that is smaller for a test that comes earlier in the list."""
    if sort == "tested":
        return test.result_number
    if sort == "severity":
        return math.inf if test.moobd is None else test.moobd
    value = test.result.duration if sort == "duration" else values.get(sort)
    return math.inf if value is None else -value
