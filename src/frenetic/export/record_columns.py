"""The columns of a trajectory's records that follow from its road, see `DERIVED`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.export.column import TableColumn
from frenetic.export.decimal_text import MISSING
from frenetic.export.trace_columns import (
    DERIVED,
    TracedDrive,
    derived_values,
    other_column,
    signals_of_others,
)

_DECIMALS: Final = 4
"""Number of decimals of most columns: 0.1 mm, as coordinates are stored."""
_UNIT_DECIMALS: Final = {"rad": 5, "1/m": 6}
"""Unit -> number of decimals of its columns: 1e-5 rad, as headings are stored; our choice."""
_LARGEST: Final = 2.0**53
"""Largest value in units of the last decimal: up to it a float64 holds each of them."""


def record_columns(signals: Iterable[str]) -> tuple[TableColumn, ...]:
    """Return `DERIVED`, then the columns of signals of other packages."""
    return (*DERIVED, *map(other_column, signals))


def decimals_of(columns: Iterable[TableColumn]) -> IntArray:
    """Return the number of decimals to which the values of each column are rounded, (k,)."""
    return np.array([_UNIT_DECIMALS.get(column.unit, _DECIMALS) for column in columns], np.int64)


def signals_in(store: CampaignStore) -> tuple[str, ...]:
    """Return the names of the signals of other packages by which a campaign judges its drives.

    A campaign that does not record its rules has none.
    """
    with suppress(CampaignError):
        return signals_of_others(store.setting.rules.criteria)
    return ()


def record_multiples(test: Test, signals: Sequence[str]) -> IntArray:
    """Return the `record_columns` of a test, (k, n), in units of their last decimal.

    They are measured on the stored trajectory. `MISSING` stands for a missing value, such as a
    value after the end of the drive, and for all values if the campaign does not record road or
    car.

    Args:
        test: a test with its trajectory, which has n records.
        signals: names of signals of other packages.

    Raises:
        FreneticError: the function of another package's signal raised an error.
    """
    assert test.trajectory is not None, "the test was read with its trajectory"
    decimals = decimals_of(record_columns(signals))
    multiples = np.full((len(decimals), len(test.trajectory)), MISSING, np.int64)
    if test.pose is None or test.setting is None or test.drive is None or not multiples.size:
        return multiples
    traced = TracedDrive.of(test.road, test.drive)
    scaled = derived_values(traced, signals) * 10.0 ** decimals[:, np.newaxis]
    is_number = np.abs(scaled) <= _LARGEST  # NaN is not
    whole = np.rint(np.where(is_number, scaled, 0.0)).astype(np.int64)
    multiples[:, traced.records] = np.where(is_number, whole, MISSING)
    return multiples


def record_values(test: Test, signals: Sequence[str]) -> FloatArray:
    """Return the `record_columns` of a test, (k, n), as numbers; NaN for a missing value."""
    multiples = record_multiples(test, signals)
    scale = 10.0 ** decimals_of(record_columns(signals))[:, np.newaxis]
    values: FloatArray = np.where(multiples == MISSING, np.nan, multiples / scale)
    return values
