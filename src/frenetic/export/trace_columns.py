"""The columns of a drive's trace: name, unit and meaning of each, and how it is measured."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Self, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.criteria.criterion import SIGNALS, CriteriaSet, Signal, signal_named
from frenetic.export.column import TableColumn, condition_column
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.notes import OBSERVED, DriverNotes
from frenetic.oracle.signals import LocatedDrive, series
from frenetic.road import Road, profile
from frenetic.road.geometry import headings_at

_DIGITS: Final = ".9g"  # of a written number: stored places have up to 8 digits (our choice)
NOTE: Final = "note_"
"""Beginning of the names of columns that are a driver's notes."""
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
    records: IntArray
    """Index of each of these records in the drive, (n,)."""
    notes: DriverNotes | None = None
    """What the driver was told and noted; None if it was not kept."""

    @classmethod
    def of(cls, road: Road, drive: Drive) -> Self:
        """Return a drive on a road as its trace shows it.

        Left out are records after the one that ended the drive, and a record with the time of the
        record before.

        Args:
            road: the road.
            drive: a drive with records, whose times and places are numbers.
        """
        assessment = assess(road, drive)
        times = drive.trajectory.time[: len(assessment.distance)]
        is_later = np.diff(times, prepend=-np.inf) > 0.0
        return cls(
            LocatedDrive.of(road, drive, assessment.distance, assessment.lateral_offset),
            assessment.oob_distance[is_later],
            assessment.oob_share[is_later],
            np.flatnonzero(is_later),
            drive.notes,
        )


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


def _profile_value(name: str, traced: TracedDrive) -> FloatArray:
    """Return the values of a profile of the road beside the car, (n,)."""
    return profile.value_at(getattr(traced.located.road, name), traced.located.distance)


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
assert tuple(column.name for column in RECORDED) == Trajectory.names()

_FOLLOWING: Final[tuple[tuple[TableColumn, _Measure], ...]] = (
    (
        TableColumn("distance", "distance along the road", "m"),
        lambda traced: traced.located.distance,
    ),
    (
        TableColumn("lateral_offset", "distance left of the ego lane's centre line", "m"),
        lambda traced: traced.located.lateral_offset,
    ),
    (
        TableColumn("oob_share", "share of the car's box outside the ego lane"),
        lambda traced: traced.oob_share,
    ),
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


_DERIVED: Final[tuple[tuple[TableColumn, _Measure], ...]] = (
    *_FOLLOWING,
    *(
        _signal_column(name, signal)
        for name, signal in SIGNALS.items()
        if name not in _OTHER_COLUMNS
    ),
)
DERIVED: Final = tuple(column for column, _ in _DERIVED)
"""Columns of every trace that follow from road and drive: its places and signals."""
TRACE_COLUMNS: Final = (*RECORDED, *DERIVED)
"""Columns of every trace.

Columns follow for signals of other packages, for what the driver was told and noted, if that is
known, and for conditions.
"""


def signals_of_others(criteria: CriteriaSet) -> tuple[str, ...]:
    """Return the names of the signals among some criteria that come from other packages."""
    names = (criterion.signal for criterion in criteria.criteria)
    return tuple(name for name in names if name not in SIGNALS)


def other_column(signal: str) -> TableColumn:
    """Return the column of another package's signal."""
    return _signal_column(f"{SIGNAL}{signal}", signal_named(signal))[0]


def derived_values(traced: TracedDrive, signals: Sequence[str]) -> FloatArray:
    """Return the values of `DERIVED`, then of signals of other packages, (k, n).

    Values that are no number, such as a mean over a window that begins before the drive, are NaN.

    Args:
        traced: the drive.
        signals: names of signals of other packages; those without a criterion in this drive are
            NaN.

    Raises:
        FreneticError: the function of another package's signal raised an error.
    """
    values = np.full((len(_DERIVED) + len(signals), len(traced.records)), np.nan)
    judged = signals_of_others(traced.located.rules.criteria)
    with np.errstate(all="ignore"):  # another simulator's records may be no numbers
        for row, (_, measure) in enumerate(_DERIVED):
            values[row] = measure(traced)
        for row, name in enumerate(signals, len(_DERIVED)):
            if name in judged:
                values[row] = series(name, traced.located, signal_named(name).window)
    values[~np.isfinite(values)] = np.nan
    return values


def measure_columns(
    traced: TracedDrive, conditions: Mapping[str, float]
) -> tuple[tuple[TableColumn, ...], FloatArray]:
    """Return the columns of a drive's trace and their values, (k, n); NaN for a missing value.

    Args:
        traced: the drive.
        conditions: conditions of the drive; each has a column, whose values are all the same.

    Raises:
        FreneticError: the function of another package's signal raised an error.
    """
    signals, path = signals_of_others(traced.located.rules.criteria), traced.located.path
    recorded = [getattr(path, column.name) for column in RECORDED]
    note_columns, noted = _noted_columns(traced.notes, path.time)
    amounts = [np.full(len(traced.records), amount) for amount in conditions.values()]
    columns = (
        *TRACE_COLUMNS,
        *map(other_column, signals),
        *note_columns,
        *map(condition_column, conditions),
    )
    values = np.stack([*recorded, *derived_values(traced, signals), *noted, *amounts])
    values[~np.isfinite(values)] = np.nan
    return columns, values


def _noted_columns(
    notes: DriverNotes | None, times: FloatArray
) -> tuple[list[TableColumn], list[FloatArray]]:
    """Return the columns of what a driver was told and noted, and their values, (n,) each."""
    if notes is None:
        return [], []
    columns = [
        TableColumn(f"told_{name}", f"{name.replace('_', ' ')} that the driver was told", unit)
        for name, unit in [*OBSERVED.items()][1:]  # without the time
    ]
    columns += [
        TableColumn(f"{NOTE}{name}", f"{name}, noted by the driver") for name in notes.names
    ]
    return columns, list(notes.at(times).T[1:])


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
