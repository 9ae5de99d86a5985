"""The columns of exported tables: name, unit and meaning of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from frenetic.analysis.measures import MEASURES
from frenetic.campaign.columns import TEST_COLUMNS
from frenetic.conditions.condition import known_conditions
from frenetic.oracle.drive import Trajectory

CONDITION: Final = "condition_"
"""Beginning of the names of conditions' columns."""


@dataclass(frozen=True)
class TableColumn:
    """A column of an exported table."""

    name: str
    about: str
    """Meaning of the values, for people."""
    unit: str = ""
    """Unit of the values; empty for a text, a share or a number."""


_CAMPAIGN: Final = TableColumn("campaign", "folder of the campaign")
_TEST_ORDER: Final = """
    id result_number outcome reason operator parents generation
    length max_curvature largest_change curvatures step x y heading
    superelevation grade widening speed_limits
    moobd moobd_distance max_oob_share objective duration distance
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
    repeat source notes fault records
"""
_LEFT: Final = "where the car left its lane"
_DERIVED: Final = (
    TableColumn("length", "length of the road", "m"),
    TableColumn("max_curvature", "largest curvature of the road, without its sign", "1/m"),
    TableColumn("largest_change", "largest change of curvature from value to value", "1/m"),
    TableColumn("departure_time", "simulated time at which the car left its lane", "s"),
    TableColumn("departure_distance", f"distance along the road to {_LEFT}", "m"),
    TableColumn("departure_x", f"coordinate on the map {_LEFT}", "m"),
    TableColumn("departure_y", f"coordinate on the map {_LEFT}", "m"),
    TableColumn("departure_side", "side on which the car left its lane"),
)
"""Columns of tests that follow from values of the database."""
_TEST_COLUMNS: Final = {
    column.name: column
    for column in (
        *(TableColumn(column.name, column.about, column.unit) for column in TEST_COLUMNS),
        *_DERIVED,
    )
}
MEASURED: Final = (
    TableColumn("distance", "distance along the road", "m"),
    TableColumn("lateral_offset", "distance left of the ego lane's centre line", "m"),
    TableColumn("oob_share", "share of the car's box outside the ego lane"),
)
"""Columns of a trajectory's records that follow from its road; missing after the drive's end."""
RECORDED: Final = (
    TableColumn("time", "simulated time since the start", "s"),
    TableColumn("x", "coordinate of the centre of mass on the map", "m"),
    TableColumn("y", "coordinate of the centre of mass on the map", "m"),
    TableColumn("heading", "heading, counter-clockwise from +x", "rad"),
    TableColumn("speed", "speed along the car", "m/s"),
    TableColumn("lateral_speed", "speed across the car, positive to the left", "m/s"),
    TableColumn("yaw_rate", "yaw rate, positive to the left", "rad/s"),
    TableColumn("steering", "angle of the front wheels, positive to the left", "rad"),
    TableColumn("steering_input", "angle that the driver asked for", "rad"),
    TableColumn("throttle", "position of the throttle pedal that the driver asked for, 0..1"),
    TableColumn("brake", "position of the brake pedal that the driver asked for, 0..1"),
)
"""Columns of a stored trajectory."""
COLUMNS: Final[Mapping[str, tuple[TableColumn, ...]]] = MappingProxyType(
    {
        "tests": tuple(_TEST_COLUMNS[name] for name in _TEST_ORDER.split()),
        "trajectories": (TableColumn("id", "id of the test"), *RECORDED, *MEASURED),
        "measures": (
            TableColumn("seed", "seed of the search"),
            TableColumn("simulations", "number of drives"),
            TableColumn("is_finished", "whether the budget was spent"),
            *(
                TableColumn(name, measure.definition, measure.unit)
                for name, measure in MEASURES.items()
            ),
        ),
        "curves": (
            TableColumn("curve", "name of the curve"),
            TableColumn("x", "number of simulations, or radius"),
            TableColumn("y", "number of failures"),
        ),
    }
)
"""Name of a table -> its columns."""
TABLES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {table: tuple(column.name for column in columns) for table, columns in COLUMNS.items()}
)
"""Name of a table -> names of its columns.

With several campaigns a column ``campaign`` comes first. In the table ``tests`` a column for each
condition that some test has, such as ``condition_friction``, comes last.
"""

assert tuple(column.name for column in RECORDED) == Trajectory.names()


def column_of(table: str, name: str) -> TableColumn:
    """Return the column of this name in a table, which may be a campaign or a condition."""
    known = {column.name: column for column in (_CAMPAIGN, *COLUMNS[table])}
    if name in known:
        return known[name]
    condition = known_conditions().get(name.removeprefix(CONDITION))
    if condition is None:
        return TableColumn(name, "")
    return TableColumn(name, condition.about, condition.unit)
