"""How well two versions of a driver drive, as pandas data frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

from frenetic.analysis.quality_comparison import QualityComparison
from frenetic.export.tables import require_extra

if TYPE_CHECKING:
    import pandas as pd

QualityTable: TypeAlias = Literal["roads", "differences", "curves"]
"""Name of a table of a `QualityComparison`."""

_COLUMNS: Final[dict[QualityTable, tuple[str, ...]]] = {
    "roads": ("conditions", "road", "measure", "unit", "old", "new"),
    "differences": (
        *("conditions", "measure", "unit", "roads", "old", "new", "difference", "low", "high"),
        *("p", "p_corrected", "is_shown"),
    ),
    "curves": (
        *("conditions", "over", "from", "to", "measure", "unit", "roads", "old", "new"),
        *("difference", "low", "high"),
    ),
}
"""Table -> names of its columns."""


def quality_frame(
    quality: QualityComparison | Mapping[str, QualityComparison],
    table: QualityTable = "differences",
) -> pd.DataFrame:
    """Return how well two versions drive as a pandas data frame.

    Args:
        quality: comparison of two versions, such as `frenetic.rerun.back_to_back.BackToBack` has,
            or road class -> comparison, such as `frenetic.rerun.versions_by_class.VersionsByClass`
            has. Then the first column, ``class``, names the road class.
        table: ``roads``, with a row per road that both pass, measure and kind of conditions;
            ``differences``, with a row per measure and kind of conditions; or ``curves``, with a
            row per measure in each bin of speed (km/h) or radius (m).

    Raises:
        FreneticError: pandas or pyarrow is not installed.
        ValueError: the table is unknown.
    """
    if table not in get_args(QualityTable):
        raise ValueError(f"table is {table!r}: one of {', '.join(_COLUMNS)} is needed")
    require_extra("a data frame")
    import pandas as pd  # an extra

    yield_rows = {"roads": _road_rows, "differences": _difference_rows, "curves": _curve_rows}[
        table
    ]
    if not isinstance(quality, Mapping):
        return pd.DataFrame(list(yield_rows(quality)), columns=list(_COLUMNS[table]))
    rows = [{"class": name, **row} for name, each in quality.items() for row in yield_rows(each)]
    return pd.DataFrame(rows, columns=["class", *_COLUMNS[table]])


def _road_rows(quality: QualityComparison) -> Iterator[dict[str, Any]]:
    """Yield the values of each road that both pass; roads are numbered from 0."""
    for difference in quality.differences:
        measure = difference.measure
        for drives in quality.drives:
            if drives.conditions != difference.conditions:
                continue
            for number, (old, new) in enumerate(drives.pairs):
                if measure.name in old.values and measure.name in new.values:
                    yield {
                        "conditions": drives.conditions,
                        "road": number,
                        "measure": measure.name,
                        "unit": measure.unit,
                        "old": old.values[measure.name],
                        "new": new.values[measure.name],
                    }


def _difference_rows(quality: QualityComparison) -> Iterator[dict[str, Any]]:
    """Yield the difference by each measure in each kind of conditions."""
    for difference in quality.differences:
        shift = difference.difference
        yield {
            **{name: getattr(difference, name) for name in ("conditions", "roads", "old", "new")},
            "measure": difference.measure.name,
            "unit": difference.measure.unit,
            "difference": shift.value,
            "low": shift.low,
            "high": shift.high,
            **{name: getattr(difference, name) for name in ("p", "p_corrected", "is_shown")},
        }


def _curve_rows(quality: QualityComparison) -> Iterator[dict[str, Any]]:
    """Yield the points of each measure over speed and radius in each kind of conditions."""
    for drives, axis, measure, points in quality.curves():
        for point in points:
            yield {
                "conditions": drives.conditions,
                "over": axis,
                "from": point.low,
                "to": point.high,
                "measure": measure.name,
                "unit": measure.unit,
                **{name: getattr(point, name) for name in ("roads", "old", "new")},
                "difference": point.difference.value,
                "low": point.difference.low,
                "high": point.difference.high,
            }
