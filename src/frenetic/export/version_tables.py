"""What changed between two versions of a driver, road by road, as a pandas data frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from frenetic.campaign.record import Test
from frenetic.export.column import CATEGORY, TableColumn
from frenetic.export.failure_values import cause_of_test, cause_text, without_side
from frenetic.export.tables import frame_of_rows, require_extra
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.back_to_back import BackToBack
from frenetic.rerun.stability import Change

if TYPE_CHECKING:
    import pandas as pd

_OUTCOMES: Final = tuple(map(str, Outcome))
_VERSIONS: Final = ("old", "new")
_ROADS: Final = ("fresh", "known")

VERSION_COLUMNS: Final = (
    TableColumn("roads", "fresh random roads, or known failing ones", "", CATEGORY, _ROADS),
    TableColumn("campaign", "folder of the campaign that holds the road", dtype="string"),
    TableColumn("id", "id of the old version's test in this campaign", dtype="int64"),
    TableColumn(
        "change", "change of the outcome from old to new", "", CATEGORY, tuple(map(str, Change))
    ),
    *(
        column
        for version in _VERSIONS
        for column in (
            TableColumn(
                f"{version}_outcome",
                f"outcome with the {version} version",
                "",
                CATEGORY,
                _OUTCOMES,
            ),
            TableColumn(
                f"{version}_cause", f"what the {version} version did wrong first", dtype="string"
            ),
            TableColumn(
                f"{version}_moobd", f"minimum oob distance with the {version} version", "m"
            ),
            TableColumn(
                f"{version}_duration", f"simulated time of the {version} version's drive", "s"
            ),
        )
    ),
)
"""Columns of `versions_frame`."""


def versions_frame(result: BackToBack) -> pd.DataFrame:
    """Return what changed between two versions of a driver, with a row per road.

    Fresh roads come first; the answer rests on them. ``frame.attrs`` has units and definitions of
    the columns, see `frenetic.data_frame`.

    Args:
        result: comparison of two versions, see `frenetic.rerun.back_to_back.back_to_back`.

    Raises:
        FreneticError: pandas or pyarrow is not installed.
    """
    require_extra("a data frame")
    return frame_of_rows(VERSION_COLUMNS, _rows(result))


def _rows(result: BackToBack) -> Iterator[dict[str, Any]]:
    """Yield the row of each road."""
    for roads, paired in zip(_ROADS, (result.fresh, result.known), strict=True):
        for pair in paired.pairs:
            yield {
                "roads": roads,
                "campaign": paired.folder.as_posix(),
                "id": pair.old.id,
                "change": str(pair.change),
                **_values_of(pair.old, "old"),
                **_values_of(pair.new, "new"),
            }


def _values_of(test: Test, version: str) -> dict[str, Any]:
    """Return the values of a version's drive."""
    return {
        f"{version}_outcome": str(test.outcome),
        f"{version}_cause": cause_text(without_side(cause_of_test(test))),
        f"{version}_moobd": test.moobd,
        f"{version}_duration": test.result.duration,
    }
