"""Measures of a drive: the worst values of signals, for criteria and for reports."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from frenetic._support.words import rounded_seconds
from frenetic.criteria.criterion import SIGNALS, Criterion, signal_named
from frenetic.oracle.signals import Measurement, measure, worst
from frenetic.oracle.verdict import locate_drive

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive
    from frenetic.road import Road


def measure_criteria(road: Road, drive: Drive, criteria: Iterable[Criterion]) -> list[Measurement]:
    """Return the worst value in a drive for each criterion.

    Criteria are left out if their window is longer than the drive.

    Raises:
        FreneticError: a signal cannot be measured.
    """
    located = locate_drive(road, drive)
    measurements = (measure(criterion, located) for criterion in criteria)
    return [measurement for measurement in measurements if measurement is not None]


def measures_json(road: Road, drive: Drive) -> list[dict[str, Any]]:
    """Return the worst value of every signal in a drive, with its limit if it has one, for JSON.

    Raises:
        FreneticError: a signal cannot be measured.
    """
    located = locate_drive(road, drive)
    limits = {criterion.signal: criterion for criterion in drive.rules.criteria.criteria}
    rows = []
    for name in {**SIGNALS, **limits}:
        measurement, limit = worst(name, located), limits.get(name)
        if measurement is None:
            continue
        rows.append(
            {
                "signal": name,
                "unit": signal_named(name).unit,
                "value": measurement.value,
                "side": measurement.side,
                "time": rounded_seconds(float(located.path.time[measurement.record])),
                "distance": measurement.distance,
                "window": measurement.criterion.window,
                "limit": None if limit is None else limit.limit,
                "clause": "" if limit is None else limit.clause,
                "kept": None if limit is None else measurement.margin >= 0.0,
            }
        )
    return rows
