"""Tests, trajectories, measures and curves of campaigns as pandas data frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

import numpy as np
from msgspec import to_builtins

from frenetic._support.words import pip_install, rounded_seconds
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.columns import TEST_COLUMNS
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import SEED
from frenetic.errors import CampaignError, FreneticError
from frenetic.export.campaign_tables import curve_frame, measure_frame
from frenetic.export.record_columns import measured_values
from frenetic.export.table_columns import CONDITION, MEASURED, TABLES, column_of
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome, chosen_outcomes
from frenetic.oracle.verdict import Side
from frenetic.road import Pose, profile
from frenetic.search.change_limit import largest_change

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories", "measures", "curves"]
CampaignSource: TypeAlias = Campaign | CampaignStore | Path | str
"""A campaign, open or not, its folder, or a folder of several campaigns, such as a bench's."""
CampaignTest: TypeAlias = tuple[str, Test]
"""Folder of a campaign, and one of the campaign's tests."""

_PLAIN_COLUMNS: Final = [column for column in TEST_COLUMNS if column.parent != "pose"]
"""Columns whose values every test has; a test may have no pose."""
_plain_values: Final = attrgetter(*(column.path for column in _PLAIN_COLUMNS))
"""Function that returns a test's values of these columns."""
_KINDS: Final = {column.name: column.kind for column in TEST_COLUMNS}
"""Name of a column -> kind of its values in the database."""
_DEPARTURE: Final = ("time", "distance", "x", "y", "side")
"""Attributes of a departure that have a column."""
_KIND_DTYPES: Final = {
    "INTEGER": "int64",
    "REAL": "Float64",
    "TEXT": "string",
    "JSON": "object",
    "REALS": "object",
    "PAIRS": "object",
}
"""Kind of values in the database -> type of their column in pandas."""
_COLUMN_DTYPES: Final = {
    "campaign": "string",
    f"{CONDITION}{SEED}": "Int64",
    **dict.fromkeys(("length", "step", "seconds", "elapsed", "budget_spent"), "float64"),
    "finished_at": "datetime64[ms, UTC]",
    "records": "Int64",
}
"""Name of a column -> its type in pandas, where the type does not follow from the kind."""
_CATEGORIES: Final[Mapping[str, tuple[str, ...]]] = {
    "outcome": tuple(map(str, Outcome)),
    "departure_side": get_args(Side),
}
"""Name of a column -> its categories."""
DICTIONARY_COLUMNS: Final = ("source", "notes", "fault")
"""Columns whose values are dictionaries."""


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
    "string": str,
    "object": _plain_object,
    "datetime64[ms, UTC]": _plain_time,
}
"""Type of a column in pandas -> function that turns its values into types of JSON."""


def _dtype_of(name: str) -> str:
    """Return the type of a column of the table ``tests`` in pandas, apart from categories."""
    return _COLUMN_DTYPES.get(name) or _KIND_DTYPES[_KINDS.get(name, "REAL")]


def data_frame(
    source: CampaignSource | Iterable[Path | str],
    table: Table = "tests",
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
) -> pd.DataFrame:
    """Return tests, trajectories, measures or curves of campaigns as a pandas data frame.

    `frenetic.export.TABLES` lists the columns. ``frenetic export`` writes the first two tables into
    files. With several campaigns, a column ``campaign`` with their folders comes first. Tests come
    in the order in which their results were told to the strategy.

    Outcomes and sides are categories. Numbers that may be missing are nullable (``Float64``).
    Curvatures and parents are arrays. Superelevation, grade and widening are lists of pairs.
    Source, notes and fault are dictionaries. ``finished_at`` is a time in UTC. A measure is
    infinite if its event never happened, such as a first failure.

    ``frame.attrs["units"]`` has the units of the columns by name. Of trajectories,
    ``frame.attrs["cars"]`` has the box of each campaign's car in m: length, width, and how far the
    box's centre lies ahead of the centre of mass.

    Args:
        source: a campaign, open or not, its folder, a folder of several campaigns, such as a
            bench's, or a list of folders.
        table: ``tests``, with a row per candidate that has a result; ``trajectories``, with a row
            per record of a drive, which takes 120 bytes, an ordinary test 40 kB; ``measures``, with
            a row per campaign; or ``curves``, with a row per point of a campaign's curves.
        outcomes: one outcome, such as ``"FAIL"``, or several: only their tests are returned. Empty
            for all tests. Measures and curves are of all tests.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign cannot be read.
        ValueError: the table or an outcome is unknown, or outcomes are chosen for a table of
            campaigns.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = chosen_outcomes(outcomes)
    if outcomes and table in ("measures", "curves"):
        raise ValueError(f"the table {table} is of all tests: leave out outcomes")
    require_extra("a data frame")
    campaigns, are_named = campaigns_of(source)
    if table in ("measures", "curves"):
        measured = map(_measured, campaigns)
        frame = measure_frame(measured) if table == "measures" else curve_frame(measured)
        frame = frame if are_named else frame.drop(columns="campaign")
    else:
        tests = read_tests(campaigns, wanted, with_trajectory=table == "trajectories")
        frame = frame_of(table, tests, condition_names(campaigns), are_named=are_named)
    units = {str(name): column_of(table, str(name)).unit for name in frame}
    frame.attrs["units"] = {name: unit for name, unit in units.items() if unit}
    if table == "trajectories":
        frame.attrs["cars"] = cars_of(campaigns)
    return frame


def cars_of(campaigns: Iterable[CampaignSource]) -> dict[str, dict[str, float]]:
    """Return the box of each campaign's car, see `CarBody`, by the campaign's folder.

    A campaign that does not record its car is left out.
    """
    cars: dict[str, dict[str, float]] = {}
    for campaign in campaigns:
        with open_store(campaign) as store, suppress(CampaignError):
            cars[store.folder.as_posix()] = asdict(store.setting.car)
    return cars


def require_extra(purpose: str) -> None:
    """Check that the extra ``tables`` is installed.

    Args:
        purpose: words for what needs the extra, for the message.

    Raises:
        FreneticError: the extra is not installed; the message says how to install it.
    """
    try:
        import pandas  # noqa: F401  # an extra
        import pyarrow  # noqa: F401  # an extra
    except ImportError as error:
        raise FreneticError(
            f"{purpose} needs pandas and pyarrow, and {error.name or 'one of them'} is not"
            f" installed: {pip_install('tables')}"
        ) from error


def open_store(campaign: CampaignSource) -> AbstractContextManager[CampaignStore]:
    """Return the store of a campaign as a context, which closes the store if it was not open."""
    if isinstance(campaign, Campaign):
        campaign = campaign.folder
    if isinstance(campaign, CampaignStore):
        return nullcontext(campaign)
    return CampaignStore.open(campaign)


def _measured(campaign: CampaignSource) -> CampaignMeasures:
    """Return the measures of a campaign, open or not."""
    with open_store(campaign) as store:
        store.write()
        return measure_campaign(store.folder)


def campaigns_of(
    source: CampaignSource | Iterable[Path | str],
) -> tuple[Sequence[CampaignSource], bool]:
    """Return the campaigns of a source, and whether a column has to tell them apart."""
    if isinstance(source, Campaign | CampaignStore):
        return [source], False
    if isinstance(source, Path | str):
        folders = find_campaigns(source)
        return folders, folders != [Path(source)]
    return [campaign for folder in source for campaign in find_campaigns(folder)], True


def read_tests(
    campaigns: Iterable[CampaignSource], outcomes: Collection[Outcome], *, with_trajectory: bool
) -> Iterator[CampaignTest]:
    """Yield the tests of campaigns that have one of the outcomes, each with its folder."""
    only = next(iter(outcomes)) if len(outcomes) == 1 else None
    for campaign in campaigns:
        with open_store(campaign) as store:
            name = store.folder.as_posix()
            for test in store.tests(only, with_trajectory=with_trajectory):
                if test.outcome in outcomes:
                    yield name, test


def condition_names(campaigns: Iterable[CampaignSource]) -> list[str]:
    """Return the names of the conditions that tests of the campaigns have."""
    names: dict[str, None] = {}
    for campaign in campaigns:
        with open_store(campaign) as store:
            rows = store.rows("SELECT DISTINCT key FROM test, json_each(conditions) ORDER BY key")
            names |= {name: None for (name,) in rows}
    return list(names)


def frame_of(
    table: Table, tests: Iterable[CampaignTest], conditions: Iterable[str], *, are_named: bool
) -> pd.DataFrame:
    """Return a table of tests.

    Args:
        table: name of the table.
        tests: tests with the folders of their campaigns.
        conditions: names of the conditions that get a column in the table ``tests``.
        are_named: whether a column has the folders of the campaigns.
    """
    frame = _test_frame(tests, conditions) if table == "tests" else _trajectory_frame(tests)
    return frame if are_named else frame.drop(columns="campaign")


def _test_frame(tests: Iterable[CampaignTest], conditions: Iterable[str]) -> pd.DataFrame:
    """Return the table ``tests``, with the column ``campaign``."""
    import pandas as pd  # an extra

    names = test_columns(conditions, are_named=True)
    values: dict[str, list[Any]] = {name: [] for name in names}
    for campaign, test in tests:
        row = _row_of(test)
        row["campaign"] = campaign
        for name in names:
            values[name].append(row.get(name))
    dtypes: dict[str, Any] = {name: _dtype_of(name) for name in names}
    dtypes |= {name: pd.CategoricalDtype(categories) for name, categories in _CATEGORIES.items()}
    columns = {name: pd.Series(values[name], dtype=dtype) for name, dtype in dtypes.items()}
    return pd.DataFrame(columns)


def plain_rows(
    tests: Iterable[CampaignTest], conditions: Iterable[str], *, are_named: bool
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table ``tests`` in types of JSON, with None for a missing value.

    They hold the values of the frame that `frame_of` returns, without pandas.

    Args:
        tests: tests with the folders of their campaigns.
        conditions: names of the conditions that get a column.
        are_named: whether a column has the folders of the campaigns.
    """
    plain = {name: _plain_function(name) for name in test_columns(conditions, are_named=are_named)}
    for campaign, test in tests:
        row = _row_of(test) | {"campaign": campaign}
        values = {name: row.get(name) for name in plain}
        yield {
            name: None
            if value is None or (isinstance(value, float) and math.isnan(value))
            else plain[name](value)
            for name, value in values.items()
        }


def _is_missing(value: Any) -> bool:
    """Return whether a value is None or NaN, which pandas takes for missing."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def test_columns(conditions: Iterable[str], *, are_named: bool) -> tuple[str, ...]:
    """Return the names of the columns of the table ``tests``, in order.

    Args:
        conditions: names of the conditions that get a column.
        are_named: whether a column has the folders of the campaigns.
    """
    first = ("campaign",) if are_named else ()
    return (*first, *TABLES["tests"], *(f"{CONDITION}{name}" for name in conditions))


def _plain_function(name: str) -> Callable[[Any], Any]:
    """Return the function that turns a column's values into types of JSON."""
    return str if name in _CATEGORIES else _PLAIN_FUNCTIONS[_dtype_of(name)]


def _row_of(test: Test) -> dict[str, Any]:
    """Return the row of a test: name of a column -> value."""
    row = {
        column.name: value
        for column, value in zip(_PLAIN_COLUMNS, _plain_values(test), strict=True)
    }
    row |= {name: getattr(test.pose, name, None) for name in Pose._fields}
    candidate, departure = test.candidate, test.departure
    curvatures = candidate.curvatures
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
    row |= {f"{CONDITION}{name}": amount for name, amount in candidate.conditions.items()}
    # A road has also the profiles that follow from its class; a refused candidate may have no road.
    has_road = test.pose is not None and len(curvatures) > 1 and _has_profiles(test)
    for name in profile.NAMES:
        pairs = getattr(test.road if has_road else candidate, name)
        row[name] = None if pairs is None else pairs.tolist() or None
    return row


def _has_profiles(test: Test) -> bool:
    """Return whether a test's road may have profiles, of its own or of its class."""
    of_class = test.setting is None or test.setting.road_class is not None
    return of_class or any(getattr(test.candidate, name) is not None for name in profile.NAMES)


def _trajectory_frame(tests: Iterable[CampaignTest]) -> pd.DataFrame:
    """Return the table ``trajectories``, with the column ``campaign``."""
    import pandas as pd  # an extra

    driven = [
        (folder, test.id, test.trajectory, measured_values(test))
        for folder, test in tests
        if test.trajectory
    ]
    lengths = np.array([len(trajectory) for *_, trajectory, _ in driven], np.int64)
    folders = pd.Series([folder for folder, *_ in driven], dtype="string")
    ids = np.array([test_id for _, test_id, *_ in driven], np.int64)
    columns = {
        name: np.concatenate([np.empty(0), *(getattr(records, name) for *_, records, _ in driven)])
        for name in Trajectory.names()
    }
    columns |= {
        column.name: np.concatenate([np.empty(0), *(measured[k] for *_, measured in driven)])
        for k, column in enumerate(MEASURED)
    }
    campaigns = folders.repeat(lengths).reset_index(drop=True)
    return pd.DataFrame({"campaign": campaigns, "id": np.repeat(ids, lengths), **columns})
