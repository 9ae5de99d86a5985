"""The columns of a drive's trace: name, unit and meaning of each, and how it is measured."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.criteria.criterion import SIGNALS, Signal, signal_named
from frenetic.export.table_columns import CONDITION, MEASURED, RECORDED, TableColumn, column_of
from frenetic.oracle.notes import TOLD, DriverNotes
from frenetic.oracle.signals import LocatedDrive, series
from frenetic.road import profile
from frenetic.road.geometry import headings_at

_DIGITS: Final = ".9g"  # of a written number: stored places have up to 8 digits (our choice)
NOTE: Final = "note_"
"""Beginning of the names of columns that are a driver's notes."""
_TOLD_UNITS: Final = {
    "lateral_offset": "m",
    "heading_error": "rad",
    "speed": "m/s",
    "yaw_rate": "rad/s",
    "steering": "rad",
    "speed_limit": "m/s",
}
"""What a driver is told, beside the time -> its unit."""
SIGNAL: Final = "signal_"
"""Beginning of the names of columns that are another package's signals."""


@dataclass(frozen=True, eq=False)
class TracedDrive:
    """A drive as its trace shows it: its records up to the last one that counts."""

    located: LocatedDrive
    """The records with their positions on the road."""
    oob_distance: FloatArray
    """Distance of the centre of mass to the lane's edge, (n,) in m, negative outside."""
    oob_share: FloatArray
    """Share of the car's box outside the ego lane, (n,), 0..1."""
    notes: DriverNotes | None = None
    """What the driver was told and noted; None if it was not kept."""


_Measure: TypeAlias = Callable[[TracedDrive], FloatArray]
"""Function that returns a column's values, (n,)."""


def heading_error(traced: TracedDrive) -> FloatArray:
    """Return the heading relative to the road's beside the car, (n,) in rad, from -π to π."""
    road, path = traced.located.road, traced.located.path
    road_heading = headings_at(road.table, road.sub_step, traced.located.distance)
    turn: FloatArray = np.remainder(path.heading - road_heading + np.pi, 2.0 * np.pi) - np.pi
    return turn


def slip_angle(traced: TracedDrive) -> FloatArray:
    """Return the angle from the car's axis to its velocity, (n,) in rad."""
    path = traced.located.path
    return np.arctan2(path.lateral_speed, np.abs(path.speed))


def speed_limit(traced: TracedDrive) -> FloatArray:
    """Return the speed limit beside the car, (n,) in km/h."""
    limits = traced.located.rules.speed_limits_on(traced.located.road)
    return profile.steps_at(limits, np.maximum(traced.located.distance, 0.0))


def lane_width(traced: TracedDrive) -> FloatArray:
    """Return the width of the ego lane beside the car, (n,) in m."""
    road = traced.located.road
    return road.lane_width + profile.value_at(road.widening, traced.located.distance)


def _recorded(name: str, traced: TracedDrive) -> FloatArray:
    """Return a column of the trajectory, (n,)."""
    values: FloatArray = getattr(traced.located.path, name)
    return values


def _profile_value(name: str, traced: TracedDrive) -> FloatArray:
    """Return the values of a profile of the road beside the car, (n,)."""
    return profile.value_at(getattr(traced.located.road, name), traced.located.distance)


_FOLLOWING: Final[tuple[tuple[TableColumn, _Measure], ...]] = (
    (
        TableColumn("oob_distance", "distance to the ego lane's edge, negative outside", "m"),
        lambda traced: traced.oob_distance,
    ),
    (
        TableColumn("heading_error", "heading relative to the road's, positive to the left", "rad"),
        heading_error,
    ),
    (
        TableColumn("slip_angle", "from the car's axis to its velocity, left positive", "rad"),
        slip_angle,
    ),
    (
        TableColumn("road_curvature", "curvature of the centre line, positive to the left", "1/m"),
        lambda traced: traced.located.road.curvature_at(traced.located.distance),
    ),
    (
        TableColumn("grade", "slope along the road, positive rises"),
        partial(_profile_value, "grade"),
    ),
    (
        TableColumn("superelevation", "slope across the road, positive falls to the right"),
        partial(_profile_value, "superelevation"),
    ),
    (TableColumn("lane_width", "width of the ego lane", "m"), lane_width),
    (TableColumn("speed_limit", "speed limit", "km/h"), speed_limit),
)
"""Columns that follow from road and drive; values of the road are those beside the car."""
_OTHER_COLUMNS: Final = {"yaw_rate", "deceleration", "duration", "lateral_offset"}
"""Signals that are columns with another unit, sign or name, such as the time."""


def _signal_column(name: str, signal: Signal) -> tuple[TableColumn, _Measure]:
    """Return the column of a signal in its default window."""
    about = signal.about
    if signal.window:
        about += f", over the last {signal.window:g} s"
    column = TableColumn(name, about, signal.unit)
    return column, lambda traced: series(signal.name, traced.located, signal.window)


_COLUMNS: Final[tuple[tuple[TableColumn, _Measure], ...]] = (
    *((column, partial(_recorded, column.name)) for column in RECORDED),
    *zip(
        MEASURED,
        (
            lambda traced: traced.located.distance,
            lambda traced: traced.located.lateral_offset,
            lambda traced: traced.oob_share,
        ),
        strict=True,
    ),
    *_FOLLOWING,
    *(
        _signal_column(name, signal)
        for name, signal in SIGNALS.items()
        if name not in _OTHER_COLUMNS
    ),
)
TRACE_COLUMNS: Final = tuple(column for column, _ in _COLUMNS)
"""Columns of every trace.

Columns follow for signals of other packages, for what the driver was told and noted, if that is
known, and for conditions.
"""


def measure_columns(
    traced: TracedDrive, conditions: Mapping[str, float]
) -> tuple[tuple[TableColumn, ...], FloatArray]:
    """Return the columns of a drive's trace and their values, (k, n).

    Values that are no number, such as a mean over a window that begins before the drive, are NaN.

    Args:
        traced: the drive.
        conditions: conditions of the drive; each has a column, whose values are all the same.

    Raises:
        FreneticError: the function of another package's signal raised an error.
    """
    criteria = traced.located.rules.criteria.criteria
    others = [name for criterion in criteria if (name := criterion.signal) not in SIGNALS]
    measured = [
        *_COLUMNS,
        *(_signal_column(f"{SIGNAL}{name}", signal_named(name)) for name in others),
    ]
    columns = [column for column, _ in measured]
    with np.errstate(all="ignore"):  # another simulator's records may be no numbers
        values = [measure(traced) for _, measure in measured]
    if traced.notes is not None:
        told, noted = _noted_columns(traced.notes, traced.located.path.time)
        columns += told
        values += noted
    for name, amount in conditions.items():
        columns.append(column_of("tests", f"{CONDITION}{name}"))
        values.append(np.full(len(traced.oob_share), amount))
    table = np.stack(values)
    table[~np.isfinite(table)] = np.nan
    return tuple(columns), table


def _noted_columns(
    notes: DriverNotes, times: FloatArray
) -> tuple[list[TableColumn], list[FloatArray]]:
    """Return the columns of what a driver was told and noted, and their values, (n,) each."""
    columns = [
        TableColumn(f"told_{name}", f"{name.replace('_', ' ')} that the driver was told", unit)
        for name, unit in _TOLD_UNITS.items()
    ]
    columns += [
        TableColumn(f"{NOTE}{name}", f"{name}, noted by the driver") for name in notes.names
    ]
    rows = notes.at(times).T
    told = [rows[TOLD.index(name)] for name in _TOLD_UNITS]
    return columns, [*told, *rows[len(TOLD) :]]


def field_name(column: TableColumn) -> str:
    """Return the name of a column in a file, which ends with the unit.

    Examples: ``time_s``, ``lateral_acceleration_m_per_s2``, ``road_curvature_per_m``.
    """
    unit = column.unit.replace("°", "deg").replace("²", "2").replace("³", "3")
    unit = unit.removeprefix("1").replace("/", "_per_")
    suffix = re.sub(r"\W+", "_", unit).strip("_")
    return f"{column.name}_{suffix}" if suffix else column.name


def number_text(value: float) -> str:
    """Return a value as files hold it, with 9 digits; empty for NaN."""
    return "" if value != value else format(value, _DIGITS)
