"""A drive with its verdict, as pictures show it, and the record on which they focus."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import capitalised
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, signal_named
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.drive_assessment import Assessment
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.report.style import OUTCOME_COLOURS
from frenetic.road import Road
from frenetic.segments.evidence import Evidence, evidence_of_drive
from frenetic.segments.passing import PassingDrives

KMH: Final = 3.6
"""Km/h in one m/s."""


@dataclass(frozen=True)
class JudgedDrive:
    """A drive with its verdict, and its records up to the one at which a rule ended it."""

    road: Road
    drive: Drive
    result: Result
    distance: FloatArray
    """Distance along the road at each record, (n,) in m."""
    oob_distance: FloatArray
    """Oob distance at each record, (n,) in m."""
    xy: FloatArray
    """Place of the centre of mass on the map at each record, (n, 2) in m."""
    heading: FloatArray
    """Heading at each record, (n,) in rad."""
    speed: FloatArray
    """Speed along the car at each record, (n,) in km/h."""
    passing: PassingDrives | None = None
    """Passing drives of the same driver, if they are known."""

    def __len__(self) -> int:
        return len(self.distance)

    @cached_property
    def mistake(self) -> Evidence | None:
        """The driver's first mistake before a failure; None if there is none."""
        return evidence_of_drive(self.road, self.drive, self.result, self.passing)


def road_of(drive: Drive, road: Road | None) -> Road:
    """Return ``road``, or by default the road that the drive knows.

    Raises:
        ValueError: ``road`` is None, and the drive does not know its road.
    """
    driven_road = drive.road if road is None else road
    if driven_road is None:
        raise ValueError("the drive does not know its road: give it, as in plot(drive, road=road)")
    return driven_road


def judge_drive(
    road: Road, thing: Drive | Test, passing: PassingDrives | None = None
) -> JudgedDrive:
    """Judge a drive for its picture; the drive of a test keeps the campaign's verdict.

    Stored records are rounded, so a new verdict could differ from the campaign's at a limit.
    """
    drive = thing if isinstance(thing, Drive) else thing.drive
    assert drive is not None, "the test was not driven"
    rows = drive.trajectory.to_rows()
    not_finite = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(not_finite):  # a simulator that broke may leave such records at the end
        drive = replace(drive, trajectory=Trajectory.from_rows(rows[: not_finite[0]]))
    trajectory = drive.trajectory
    assessment = (
        assess(road, drive)
        if len(trajectory)
        else Assessment(0, *(np.empty(0) for _ in range(4)))  # nothing was recorded
    )
    n = len(assessment.distance)
    result = judge(road, drive) if isinstance(thing, Drive) else thing.result
    return JudgedDrive(
        road=road,
        drive=drive,
        result=result,
        distance=assessment.distance,
        oob_distance=assessment.oob_distance,
        # Matplotlib cannot draw places that are too far away.
        xy=np.clip(np.column_stack([trajectory.x[:n], trajectory.y[:n]]), -1e6, 1e6),
        heading=trajectory.heading[:n],
        speed=trajectory.speed[:n] * KMH,
        passing=passing,
    )


@dataclass(frozen=True)
class Focus:
    """The record of a drive that a picture shows in its close-up."""

    record: int
    """Index of the record."""
    headline: str
    """Headline of the close-up."""
    label: str
    """Text beside the mark on the road; empty for no text."""
    colour: str
    """Colour of mark, label and headline."""


def focus_of(judged: JudgedDrive) -> Focus | None:
    """Return the focus of a drive; None without records.

    The focus is the departure, or else the gravest finding. Without both it is the least oob
    distance of a drive that passed, and the last record of another drive.
    """
    if not len(judged):
        return None
    result, last = judged.result, len(judged) - 1
    colour = OUTCOME_COLOURS[result.outcome]
    if result.departure is not None:
        return Focus(last, "Departure", f"departure to the {result.departure.side}", colour)
    if result.finding is not None and result.finding.criterion != DRIVER:
        times = judged.drive.trajectory.time[: len(judged)]
        record = int(np.argmin(np.abs(times - result.finding.time)))
        words = signal_named(result.finding.criterion).words
        return Focus(record, capitalised(words), words, colour)
    if result.outcome is Outcome.PASS:
        worst = int(np.argmin(judged.oob_distance))
        return Focus(worst, "Smallest oob distance", "", colour)
    return Focus(last, "Where it ended", f"ended at {judged.distance[last]:.0f} m", colour)
