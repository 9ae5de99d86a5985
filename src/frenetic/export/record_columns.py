"""The columns of a trajectory's records that follow from its road, see `MEASURED`."""

from __future__ import annotations

from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.campaign.record import Test
from frenetic.export.decimal_text import MISSING
from frenetic.export.table_columns import MEASURED
from frenetic.oracle.assessment import assess

DECIMALS: Final = 4
"""Number of decimals of the columns: 0.1 mm, as coordinates are stored."""
_SCALE: Final = 10.0**DECIMALS


def measured_multiples(test: Test) -> IntArray:
    """Return the columns of a test's records, (3, n), in units of their last decimal.

    They are measured on the stored trajectory. `MISSING` stands for a value after the end of the
    drive, and for all values if the campaign does not record road or car.

    Args:
        test: a test with its trajectory, which has n records.
    """
    assert test.trajectory is not None, "the test was read with its trajectory"
    multiples = np.full((len(MEASURED), len(test.trajectory)), MISSING, np.int64)
    if test.pose is None or test.setting is None or test.drive is None:
        return multiples
    assessment = assess(test.road, test.drive)
    columns = (assessment.distance, assessment.lateral_offset, assessment.oob_share)
    multiples[:, : len(assessment.distance)] = np.rint(np.stack(columns) * _SCALE)
    return multiples


def measured_values(test: Test) -> FloatArray:
    """Return the columns of a test's records, (3, n), as numbers; NaN for a missing value."""
    multiples = measured_multiples(test)
    values: FloatArray = np.where(multiples == MISSING, np.nan, multiples / _SCALE)
    return values
