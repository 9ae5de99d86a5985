"""A campaign's tables as pandas data frames."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from frenetic.campaign.store import CampaignStore
from frenetic.export.columns import TABLES, Column, Kind
from frenetic.export.extras import needing_tables
from frenetic.export.tables import (
    ALL,
    Lists,
    Values,
    batches_of_tests,
    batches_of_trajectories,
    join,
    number_of_tests,
)
from frenetic.oracle import Side
from frenetic.outcome import Outcome

if TYPE_CHECKING:
    import pandas as pd

Table: TypeAlias = Literal["tests", "trajectories"]


def data_frame(
    campaign: CampaignStore | Path | str,
    table: Table = "tests",
    *,
    outcomes: Collection[Outcome | str] = (),
) -> pd.DataFrame:
    """A campaign's tests, or the trajectories of their drives, as a pandas data frame.

    The columns are those that ``frenetic export`` writes, see `TESTS` and `TRAJECTORIES` in
    `frenetic.export.columns`. Tests come in the order of telling. Outcomes, operators, sides and
    workers are categories; numbers that may be missing are nullable (``Float64``); curvatures and
    parents are arrays; ``finished_at`` is a time with its zone, UTC.

    Args:
        campaign: its folder, or the opened campaign.
        table: ``tests``, one row per candidate that was told, or ``trajectories``, one row per
            record of a drive: 96 bytes each, 25 kB for an ordinary test.
        outcomes: only tests of these, such as ``["FAIL"]``; of all without any.

    Raises:
        FreneticError: pandas is not installed, or the campaign cannot be read.
        ValueError: there is no such table or outcome.
    """
    if table not in TABLES:
        raise ValueError(f"table is {table!r}: one of {', '.join(TABLES)} is needed")
    wanted = tuple(Outcome(outcome) for outcome in outcomes) or ALL
    with needing_tables("a data frame"):
        import pandas as pd
    if not isinstance(campaign, CampaignStore):
        with CampaignStore.open(Path(campaign)) as store:
            return data_frame(store, table, outcomes=wanted)
    number_of_tests(campaign)  # which knows an outcome that there is not
    batches = batches_of_tests if table == "tests" else batches_of_trajectories
    rows = join(TABLES[table], batches(campaign, wanted))
    return pd.DataFrame(
        {column.name: _series(column, rows.values[column.name]) for column in rows.columns}
    )


def _series(column: Column, values: Values) -> Any:
    """The values as pandas keeps them."""
    import pandas as pd

    match column.kind:
        case Kind.REAL if column.optional:
            missing = np.isnan(values)  # type: ignore[arg-type]
            return pd.arrays.FloatingArray(np.where(missing, 0.0, values), missing)  # type: ignore[arg-type]
        case Kind.CHOICE:
            return pd.Categorical(values, categories=_categories(column, values))
        case Kind.TEXT:
            return pd.array(values, dtype="string")
        case Kind.MOMENT:
            return pd.DatetimeIndex(values).tz_localize("UTC")
        case Kind.WHOLES | Kind.REALS:
            assert isinstance(values, Lists)
            return np.fromiter(values, dtype=object, count=len(values))
        case _:
            return values


def _categories(column: Column, values: Values) -> list[str]:
    """All that a value may be, or else all that there is."""
    known = {"outcome": list(map(str, Outcome)), "departure_side": list(get_args(Side))}
    assert isinstance(values, list)
    return known.get(column.name) or sorted({value for value in values if value is not None})
