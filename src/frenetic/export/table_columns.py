"""The columns of exported tables: name, unit, meaning and type of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final, get_args

from frenetic.analysis.cause_trials import Certainty
from frenetic.analysis.measures import MEASURES
from frenetic.campaign.columns import TEST_COLUMNS, Column
from frenetic.export.column import CATEGORY, CONDITION, INTEGER, TableColumn, condition_column
from frenetic.export.trace_columns import SIGNAL, TRACE_COLUMNS, other_column
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Side
from frenetic.segments.features import FEATURES
from frenetic.segments.segment import REACH

SEGMENT: Final = "segment_"
"""Beginning of the names of columns about the road and the drive around a test's place."""

_CAMPAIGN: Final = TableColumn("campaign", "folder of the campaign", dtype="string")
_KIND_DTYPES: Final = {
    "INTEGER": "int64",
    "REAL": "Float64",
    "TEXT": "string",
    "JSON": "object",
    "REALS": "object",
    "PAIRS": "object",
}
"""Kind of values in the database -> type of their column in pandas."""
_STORED_DTYPES: Final = {
    **dict.fromkeys(("step", "seconds", "elapsed", "budget_spent"), "float64"),
    "finished_at": "datetime64[ms, UTC]",
    "records": INTEGER,
}
"""Name of a column of the database -> type in pandas, where it does not follow from the kind."""
_SIDES: Final = get_args(Side)
_PLACE: Final = "the place of the failure, or else where the car was nearest to its lane's edge"
_LEFT: Final = "where the car left its lane"


def _stored_column(column: Column) -> TableColumn:
    """Return the column of a value of the database."""
    dtype = _STORED_DTYPES.get(column.name) or _KIND_DTYPES[column.kind]
    plain = TableColumn(column.name, column.about, column.unit, dtype)
    if column.name == "outcome":
        return replace(plain, dtype=CATEGORY, categories=tuple(map(str, Outcome)))
    return plain


_ROAD_COLUMNS: Final = (
    TableColumn("length", "length of the road", "m", "float64"),
    TableColumn("max_curvature", "largest curvature of the road, without its sign", "1/m"),
    TableColumn("largest_change", "largest change of curvature from value to value", "1/m"),
)
"""Columns of tests that follow from the curvatures."""
DEPARTURE_COLUMNS: Final = (
    TableColumn("departure_time", "simulated time at which the car left its lane", "s"),
    TableColumn("departure_distance", f"distance along the road to {_LEFT}", "m"),
    TableColumn("departure_x", f"coordinate on the map {_LEFT}", "m"),
    TableColumn("departure_y", f"coordinate on the map {_LEFT}", "m"),
    TableColumn("departure_side", "side on which the car left its lane", "", CATEGORY, _SIDES),
)
"""Columns of tests in which the car left its lane."""
FAILURE_COLUMNS: Final = (
    TableColumn("criterion", "criterion by which the drive failed, such as lane", dtype="string"),
    TableColumn("cause", "what the driver did wrong first", dtype="string"),
    TableColumn("cause_side", "side to which the bends of the cause turn", "", CATEGORY, _SIDES),
    TableColumn(
        "cause_certainty",
        "how sure the cause is after trials: certain, likely or doubtful",
        "",
        CATEGORY,
        tuple(map(str, Certainty)),
    ),
    TableColumn(
        "distinct_failure",
        "number of the distinct failure in its campaign, from 1, as frenetic show lists them",
        dtype=INTEGER,
    ),
    TableColumn("minimised_length", "length of the road that was minimised", "m"),
)
"""Columns of tests that failed; their values are missing for others."""
SEGMENT_COLUMNS: Final = (
    TableColumn("place", f"distance along the road to {_PLACE}", "m"),
    TableColumn("place_speed", "speed at the place", "m/s"),
    TableColumn(
        f"{SEGMENT}least_radius", f"least radius of the road within {REACH:g} m of the place", "m"
    ),
    *(
        TableColumn(
            f"{SEGMENT}{feature.name}",
            f"{feature.description[0].lower()}{feature.description[1:]} within {REACH:g} m of the"
            " place",
            feature.unit,
        )
        for feature in FEATURES.values()
    ),
    TableColumn("slowest", "least speed of the drive once it was half of the largest", "m/s"),
    TableColumn("fastest", "largest speed of the drive", "m/s"),
)
"""Columns of tests that were driven, about the road and the drive around their place."""
_TEST_COLUMNS: Final = {
    column.name: column
    for column in (
        *map(_stored_column, TEST_COLUMNS),
        *_ROAD_COLUMNS,
        *DEPARTURE_COLUMNS,
        *FAILURE_COLUMNS,
        *SEGMENT_COLUMNS,
    )
}
_TEST_ORDER: Final = (
    *["id", "result_number", "outcome", "reason", "operator", "parents", "generation"],
    *["length", "max_curvature", "largest_change", "curvatures", "step", "x", "y", "heading"],
    *["superelevation", "grade", "widening", "speed_limits"],
    *["moobd", "moobd_distance", "max_oob_share", "objective", "duration", "distance"],
    *(column.name for column in DEPARTURE_COLUMNS),
    *(column.name for column in FAILURE_COLUMNS),
    *(column.name for column in SEGMENT_COLUMNS),
    *["seconds", "elapsed", "attempts", "worker", "budget_spent", "finished_at"],
    *["repeat", "source", "notes", "fault", "records"],
)
_RECORD_COLUMNS: Final = tuple(replace(column, dtype="float64") for column in TRACE_COLUMNS)
"""Columns of the records of trajectories; NaN stands for a missing value."""
COLUMNS: Final[Mapping[str, tuple[TableColumn, ...]]] = MappingProxyType(
    {
        "tests": tuple(_TEST_COLUMNS[name] for name in _TEST_ORDER),
        "trajectories": (TableColumn("id", "id of the test", dtype="int64"), *_RECORD_COLUMNS),
        "measures": (
            TableColumn("seed", "seed of the search", dtype=INTEGER),
            TableColumn("simulations", "number of drives", dtype="int64"),
            TableColumn("is_finished", "whether the budget was spent", dtype="bool"),
            *(
                TableColumn(name, measure.definition, measure.unit)
                for name, measure in MEASURES.items()
            ),
        ),
        "curves": (
            TableColumn("curve", "name of the curve", dtype="string"),
            TableColumn("x", "number of simulations, or radius", dtype="float64"),
            TableColumn("y", "number of failures", dtype="int64"),
        ),
    }
)
"""Name of a table -> its columns."""
TABLES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {table: tuple(column.name for column in columns) for table, columns in COLUMNS.items()}
)
"""Name of a table -> names of its columns.

With several campaigns a column ``campaign`` comes first. In the table ``tests`` a column for each
condition of some drive, such as ``condition_friction``, comes last; in ``trajectories`` a column
for each signal of another package by which drives are judged, such as ``signal_roll``.
"""


def column_of(table: str, name: str) -> TableColumn:
    """Return the column of this name in a table, which may be a campaign, condition or signal."""
    known = {column.name: column for column in (_CAMPAIGN, *COLUMNS[table])}
    if name in known:
        return known[name]
    if name.startswith(CONDITION):
        return condition_column(name.removeprefix(CONDITION))
    return other_column(name.removeprefix(SIGNAL))
