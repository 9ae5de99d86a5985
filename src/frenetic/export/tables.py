"""Tests, trajectories, measures and curves of campaigns as pandas data frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, TypeAlias

import numpy as np

from frenetic._support.words import pip_install
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError, FreneticError
from frenetic.export.campaign_tables import curve_frame, measure_frame
from frenetic.export.column import CATEGORY, TableColumn
from frenetic.export.record_columns import record_columns, record_values, signals_in
from frenetic.export.table_columns import TABLES, column_of
from frenetic.export.table_rows import (
    CampaignSource,
    TableTest,
    condition_names,
    open_store,
    read_tests,
    row_of,
    test_columns,
)
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome, chosen_outcomes

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories", "measures", "curves"]


def data_frame(
    source: CampaignSource | Iterable[Path | str],
    table: Table = "tests",
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
    tests: SupportsIndex | Iterable[SupportsIndex] | None = None,
) -> pd.DataFrame:
    """Return tests, trajectories, measures or curves of campaigns as a pandas data frame.

    `frenetic.export.TABLES` lists the columns. ``frenetic export`` writes the first two tables into
    files. With several campaigns, a column ``campaign`` with their folders comes first. Tests come
    in the order in which their results were told to the strategy.

    Outcomes, sides and certainties are categories. Numbers that may be missing are nullable
    (``Float64``). Curvatures and parents are arrays. Superelevation, grade and widening are lists
    of pairs. Source, notes and fault are dictionaries. ``finished_at`` is a time in UTC. A measure
    is infinite if its event never happened, such as a first failure.

    ``frame.attrs["units"]`` has the units of the columns by name, ``frame.attrs["definitions"]``
    their meanings. Of trajectories, ``frame.attrs["cars"]`` has the box of each campaign's car in
    m: length, width, and how far the box's centre lies ahead of the centre of mass.

    Args:
        source: a campaign, open or not, its folder, a folder of several campaigns, such as a
            bench's, or a list of folders.
        table: ``tests``, with a row per candidate that has a result; ``trajectories``, with a row
            per record of a drive and all its signals, which takes 260 bytes, an ordinary test 90
            kB; ``measures``, with a row per campaign; or ``curves``, with a row per point of a
            campaign's curves.
        outcomes: one outcome, such as ``"FAIL"``, or several: only their tests are returned. Empty
            for all tests. Measures and curves are of all tests.
        tests: id of a test, or of several: only these are returned, in this order. None for all
            tests.

    Raises:
        FreneticError: pandas or pyarrow is not installed, or a campaign cannot be read or lacks a
            test.
        ValueError: the table or an outcome is unknown, or outcomes or tests are chosen for a table
            of campaigns.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = chosen_outcomes(outcomes)
    ids = None if tests is None else _ids_of(tests)
    if (outcomes or ids is not None) and table in ("measures", "curves"):
        raise ValueError(f"the table {table} is of all tests: leave out outcomes and tests")
    require_extra("a data frame")
    campaigns, are_named = campaigns_of(source)
    if table in ("measures", "curves"):
        measured = map(_measured, campaigns)
        frame = measure_frame(measured) if table == "measures" else curve_frame(measured)
    elif table == "tests":
        frame = frame_of_tests(read_tests(campaigns, wanted, ids=ids), condition_names(campaigns))
    else:
        records = read_tests(campaigns, wanted, ids=ids, with_trajectory=True, with_values=False)
        frame = frame_of_trajectories(records, signal_names(campaigns))
        frame.attrs["cars"] = cars_of(campaigns)
    frame = frame if are_named else without_campaign(frame)
    return with_descriptions(frame, [column_of(table, str(name)) for name in frame])


def _ids_of(tests: SupportsIndex | Iterable[SupportsIndex]) -> list[int]:
    """Return ids, such as numbers of a frame, as numbers of Python."""
    return [*map(index, tests)] if isinstance(tests, Iterable) else [index(tests)]


def with_descriptions(frame: pd.DataFrame, columns: Iterable[TableColumn]) -> pd.DataFrame:
    """Return a frame, to whose ``attrs`` units and definitions of its columns are added."""
    columns = list(columns)
    frame.attrs["units"] = {column.name: column.unit for column in columns if column.unit}
    frame.attrs["definitions"] = {column.name: column.about for column in columns if column.about}
    return frame


def without_campaign(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame without the column ``campaign``."""
    return frame.drop(columns="campaign")


def cars_of(campaigns: Iterable[CampaignSource]) -> dict[str, dict[str, float]]:
    """Return the box of each campaign's car, see `CarBody`, by the campaign's folder.

    A campaign that does not record its car is left out.
    """
    cars: dict[str, dict[str, float]] = {}
    for campaign in campaigns:
        with open_store(campaign) as store, suppress(CampaignError):
            cars[store.folder.as_posix()] = asdict(store.setting.car)
    return cars


def signal_names(campaigns: Iterable[CampaignSource]) -> tuple[str, ...]:
    """Return the names of other packages' signals by which campaigns judge their drives."""
    names: dict[str, None] = {}
    for campaign in campaigns:
        with open_store(campaign) as store:
            names |= dict.fromkeys(signals_in(store))
    return tuple(names)


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


def frame_of_tests(tests: Iterable[TableTest], conditions: Iterable[str]) -> pd.DataFrame:
    """Return the table ``tests``, with the column ``campaign``.

    Args:
        tests: the tests.
        conditions: names of the conditions that get a column.
    """
    columns = [column_of("tests", name) for name in test_columns(conditions, are_named=True)]
    return frame_of_rows(columns, map(row_of, tests))


def frame_of_rows(
    columns: Sequence[TableColumn], rows: Iterable[Mapping[str, Any]]
) -> pd.DataFrame:
    """Return rows as a frame, with units and definitions of the columns.

    Args:
        columns: columns of the frame.
        rows: name of a column -> value, of each row; other names are left out.
    """
    import pandas as pd  # an extra

    values: dict[str, list[Any]] = {column.name: [] for column in columns}
    for row in rows:
        for name, cells in values.items():
            cells.append(row.get(name))
    frame = pd.DataFrame(
        {column.name: pd.Series(values[column.name], dtype=_dtype(column)) for column in columns}
    )
    return with_descriptions(frame, columns)


def _dtype(column: TableColumn) -> Any:
    """Return the type of a column in pandas."""
    import pandas as pd  # an extra

    is_category = column.dtype == CATEGORY
    return pd.CategoricalDtype(column.categories) if is_category else column.dtype


def frame_of_trajectories(tests: Iterable[TableTest], signals: Sequence[str]) -> pd.DataFrame:
    """Return the table ``trajectories``, with the column ``campaign``.

    Args:
        tests: tests with their trajectories; tests without records are left out.
        signals: names of other packages' signals that get a column.
    """
    import pandas as pd  # an extra

    driven = [
        (item.campaign, item.test.id, item.test.trajectory, record_values(item.test, signals))
        for item in tests
        if item.test.trajectory
    ]
    lengths = np.array([len(trajectory) for *_, trajectory, _ in driven], np.int64)
    folders = pd.Series([folder for folder, *_ in driven], dtype="string")
    ids = np.array([test_id for _, test_id, *_ in driven], np.int64)
    columns = {
        name: np.concatenate([np.empty(0), *(getattr(records, name) for *_, records, _ in driven)])
        for name in Trajectory.names()
    }
    columns |= {
        column.name: np.concatenate([np.empty(0), *(values[k] for *_, values in driven)])
        for k, column in enumerate(record_columns(signals))
    }
    campaigns = folders.repeat(lengths).reset_index(drop=True)
    return pd.DataFrame({"campaign": campaigns, "id": np.repeat(ids, lengths), **columns})
