"""The rows of the table ``tests``: what campaigns store of each test, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from msgspec import to_builtins

from frenetic._support.words import rounded_seconds
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.columns import TEST_COLUMNS
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.stored_spec import stored_conditions
from frenetic.errors import CampaignError
from frenetic.export.column import CONDITION
from frenetic.export.failure_values import FailureAnalysis
from frenetic.export.table_columns import SEGMENT, TABLES, column_of
from frenetic.oracle.outcome import Outcome
from frenetic.road import Pose, profile
from frenetic.search.change_limit import largest_change
from frenetic.segments.values import SegmentValues

CampaignSource: TypeAlias = Campaign | CampaignStore | Path | str
"""A campaign, open or not, its folder, or a folder of several campaigns, such as a bench's."""


class TableTest(NamedTuple):
    """A test of a campaign, as tables need it."""

    campaign: str
    """Folder of the campaign."""
    test: Test
    """The test, with its trajectory for the table ``trajectories``, else with the values of its
    segment."""
    conditions: Mapping[str, float] = MappingProxyType({})
    """Conditions of the drive."""
    failure: Mapping[str, Any] = MappingProxyType({})
    """Values of the `FAILURE_COLUMNS` that the campaign's analysis gives."""


_PLAIN_COLUMNS: Final = [column for column in TEST_COLUMNS if column.parent != "pose"]
"""Columns whose values every test has; a test may have no pose."""
_plain_values: Final = attrgetter(*(column.path for column in _PLAIN_COLUMNS))
"""Function that returns a test's values of these columns."""
_DEPARTURE: Final = ("time", "distance", "x", "y", "side")
"""Attributes of a departure that have a column."""
DICTIONARY_COLUMNS: Final = ("source", "notes", "fault")
"""Columns whose values are dictionaries."""


def open_store(campaign: CampaignSource) -> AbstractContextManager[CampaignStore]:
    """Return the store of a campaign as a context, which closes the store if it was not open."""
    if isinstance(campaign, Campaign):
        campaign = campaign.folder
    if isinstance(campaign, CampaignStore):
        return nullcontext(campaign)
    return CampaignStore.open(campaign)


def read_tests(
    campaigns: Iterable[CampaignSource],
    outcomes: Collection[Outcome],
    *,
    ids: Sequence[int] | None = None,
    with_trajectory: bool = False,
    with_values: bool = True,
) -> Iterator[TableTest]:
    """Yield the tests of campaigns that have one of the outcomes.

    The analysis of a campaign's failures is made once, before its first failure is yielded.

    Args:
        campaigns: the campaigns.
        outcomes: outcomes of the tests.
        ids: ids of the tests; None for all tests.
        with_trajectory: whether the tests have their trajectories.
        with_values: whether the tests have what only the table ``tests`` needs: the values of their
            segments, conditions, and the analysis of failures.

    Raises:
        CampaignError: a campaign is damaged, or lacks a test.
    """
    only = next(iter(outcomes)) if len(outcomes) == 1 else None
    for campaign in campaigns:
        with open_store(campaign) as store:
            name, common = store.folder.as_posix(), _common_conditions(store) if with_values else {}
            analysis: FailureAnalysis | None = None
            tests = (
                store.tests(only, with_trajectory=with_trajectory, with_segments=with_values)
                if ids is None
                else _tests_with_ids(store, ids, with_trajectory=with_trajectory)
            )
            for test in tests:
                if test.outcome not in outcomes:
                    continue
                if not with_values:
                    yield TableTest(name, test)
                    continue
                failure: dict[str, Any] = {}
                if test.outcome is Outcome.FAIL:
                    analysis = analysis or FailureAnalysis.of(store)
                    failure = analysis.values_of(test)
                yield TableTest(name, test, {**common, **test.candidate.conditions}, failure)


def _tests_with_ids(
    store: CampaignStore, ids: Iterable[int], *, with_trajectory: bool
) -> Iterator[Test]:
    """Yield the tests with these ids, with the values of their segments."""
    for test_id in ids:
        store.test(test_id, with_trajectory=False)  # its error names the tests that there are
        yield from store.tests_with_ids([test_id], with_trajectory=with_trajectory)


def _common_conditions(store: CampaignStore) -> dict[str, float]:
    """Return the conditions of all drives of a campaign; none if it does not record them."""
    with suppress(CampaignError):
        return stored_conditions(store)
    return {}


def condition_names(campaigns: Iterable[CampaignSource]) -> list[str]:
    """Return the names of the conditions of drives of the campaigns."""
    names: dict[str, None] = {}
    for campaign in campaigns:
        with open_store(campaign) as store:
            names |= dict.fromkeys(_common_conditions(store))
            rows = store.rows("SELECT DISTINCT key FROM test, json_each(conditions) ORDER BY key")
            names |= {name: None for (name,) in rows}
    return list(names)


def test_columns(conditions: Iterable[str], *, are_named: bool) -> tuple[str, ...]:
    """Return the names of the columns of the table ``tests``, in order.

    Args:
        conditions: names of the conditions that get a column.
        are_named: whether a column has the folders of the campaigns.
    """
    first = ("campaign",) if are_named else ()
    return (*first, *TABLES["tests"], *(f"{CONDITION}{name}" for name in conditions))


def plain_rows(
    tests: Iterable[TableTest], conditions: Iterable[str], *, are_named: bool
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table ``tests`` in types of JSON, with None for a missing value.

    They hold the values of the frame that `data_frame` returns, without pandas.

    Args:
        tests: the tests.
        conditions: names of the conditions that get a column.
        are_named: whether a column has the folders of the campaigns.
    """
    names = test_columns(conditions, are_named=are_named)
    plain = {name: _PLAIN_FUNCTIONS[column_of("tests", name).dtype] for name in names}
    for test in tests:
        row = row_of(test)
        values = {name: row.get(name) for name in plain}
        yield {
            name: None
            if value is None or (isinstance(value, float) and math.isnan(value))
            else plain[name](value)
            for name, value in values.items()
        }


def _plain_time(text: str) -> str | None:
    """Return a time in UTC as ISO 8601 with milliseconds; None for an empty text."""
    if not text:
        return None
    return datetime.fromisoformat(text).astimezone(UTC).isoformat(timespec="milliseconds")


def _plain_object(value: Any) -> Any:
    """Return an array as a list, another value as it is."""
    return value.tolist() if isinstance(value, np.ndarray) else value


_PLAIN_FUNCTIONS: Final[Mapping[str, Callable[[Any], Any]]] = {
    **dict.fromkeys(("int64", "Int64"), int),
    **dict.fromkeys(("float64", "Float64"), float),
    **dict.fromkeys(("string", "category"), str),
    "object": _plain_object,
    "datetime64[ms, UTC]": _plain_time,
}
"""Type of a column in pandas -> function that turns its values into types of JSON."""


def row_of(item: TableTest) -> dict[str, Any]:
    """Return the row of a test: name of a column -> value, without some missing values."""
    test = item.test
    row = {
        column.name: value
        for column, value in zip(_PLAIN_COLUMNS, _plain_values(test), strict=True)
    }
    row |= {name: getattr(test.pose, name, None) for name in Pose._fields}
    candidate, departure, finding = test.candidate, test.departure, test.result.finding
    curvatures = candidate.curvatures
    row["campaign"] = item.campaign
    row["outcome"] = str(test.outcome)
    row["duration"] = rounded_seconds(test.result.duration)
    row["curvatures"] = np.array(curvatures)
    row["parents"] = np.array(candidate.origin.parents, np.int64)
    row["length"] = max(len(curvatures) - 1, 0) * candidate.step
    row["largest_change"] = largest_change(curvatures) if len(curvatures) else None
    row["max_curvature"] = np.abs(curvatures).max() if len(curvatures) else None
    for name in DICTIONARY_COLUMNS:
        row[name] = (to_builtins(row[name]) or None) if row[name] else None
    if departure is not None:
        row |= {f"departure_{name}": getattr(departure, name) for name in _DEPARTURE}
        row["departure_time"] = rounded_seconds(departure.time)
    if finding is not None:
        row["criterion"] = finding.criterion
    if (values := test.stored_values or test.measure()) is not None:
        row |= _segment_values(values)
    row |= item.failure
    row |= {f"{CONDITION}{name}": amount for name, amount in item.conditions.items()}
    # A road has also the profiles that follow from its class; a refused candidate may have no road.
    has_road = test.pose is not None and len(curvatures) > 1 and _has_profiles(test)
    for name in profile.NAMES:
        pairs = getattr(test.road if has_road else candidate, name)
        row[name] = None if pairs is None else pairs.tolist() or None
    return row


def _segment_values(values: SegmentValues) -> dict[str, float]:
    """Return the values of the `SEGMENT_COLUMNS` of a driven test, without a missing radius."""
    row = {
        "place": values.place,
        "place_speed": values.speeds[-1],
        "slowest": values.slowest,
        "fastest": values.fastest,
        **{f"{SEGMENT}{name}": value for name, value in values.features.items()},
    }
    if curvature := values.features["max_curvature"]:
        row[f"{SEGMENT}least_radius"] = 1.0 / curvature
    return row


def _has_profiles(test: Test) -> bool:
    """Return whether a test's road may have profiles, of its own or of its class."""
    of_class = test.setting is None or test.setting.road_class is not None
    return of_class or any(getattr(test.candidate, name) is not None for name in profile.NAMES)
