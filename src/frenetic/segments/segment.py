"""The segment of a drive around the place where the car left its lane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.oracle.drive_assessment import Assessment
from frenetic.oracle.signals import LocatedDrive
from frenetic.oracle.verdict import Finding, Side, locate_drive
from frenetic.road import Road
from frenetic.segments.bends import Bend, find_bends

REACH: Final = 30.0
"""Length of a failure's segment before and after its place, in m."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Stretch of road around a place, and the drive along it; see `segment_of`."""

    road: Road
    drive: Drive
    place: float
    """Place of the finding, such as where the car left its lane, in m along the road; without a
    finding, the place where the oob distance was least."""
    side: Side | None
    """Side of the lane on which the car left; None if it stayed."""
    criterion: str | None
    """Criterion that the drive exceeded at the place, see `frenetic.oracle.Finding`; None without a
    finding."""
    start: float
    """Start of the segment, in m along the road."""
    end: float
    """End of the segment, in m along the road."""
    assessment: Assessment
    """Assessment of the whole drive, record by record."""
    first: int
    """Index of the segment's first record."""
    last: int
    """Index after the segment's last record."""

    @property
    def length(self) -> float:
        """Length of the segment along the road, in m."""
        return self.end - self.start

    @property
    def lateral_offset(self) -> FloatArray:
        """Distance left of the ego lane's centre line, (n,) in m, record by record."""
        return self.assessment.lateral_offset[self.first : self.last]

    @property
    def speed(self) -> FloatArray:
        """Speed record by record, (n,) in m/s."""
        return self.drive.trajectory.speed[self.first : self.last]

    @property
    def steering(self) -> FloatArray:
        """Angle of the front wheels, (n,) in rad, record by record."""
        return self.drive.trajectory.steering[self.first : self.last]

    @cached_property
    def curvature_samples(self) -> tuple[FloatArray, FloatArray]:
        """Distances, (k,) in m, and curvatures, (k,) in 1/m: both ends and the samples between."""
        stations = self.road.stations
        first = int(np.searchsorted(stations, self.start, "right"))
        last = max(int(np.searchsorted(stations, self.end)), first)
        distances = np.empty(last - first + 2)
        distances[0], distances[-1] = self.start, self.end
        distances[1:-1] = stations[first:last]
        return distances, self.road.curvature_at(distances)

    @cached_property
    def signals(self) -> LocatedDrive:
        """Signals of the whole drive, from which criteria are measured."""
        return locate_drive(self.road, self.drive, self.assessment)

    @property
    def bends(self) -> tuple[Bend, ...]:
        """Bends within the segment, cut at its ends, in order."""
        return find_bends(*self.curvature_samples)

    def whole(self) -> Segment:
        """Return the segment with the whole road and the whole drive."""
        n = len(self.assessment.distance)
        return replace(self, start=0.0, end=self.road.length, first=0, last=n)


def segment_of(road: Road, drive: Drive, finding: Finding | None) -> Segment:
    """Return the segment of a drive around the place of a finding, such as a departure.

    Without a finding, the place is where the oob distance is least. The segment reaches `REACH`
    before and after the place, but not beyond the road's ends. It holds the records around the
    place during which the car was within it.

    Args:
        road: road with its place on the map.
        drive: drive that was judged PASS or FAIL.
        finding: finding of the oracle or the campaign, see `Result.finding`.

    Raises:
        ValueError: the drive has no records.
    """
    if len(drive.trajectory) == 0:
        raise ValueError("a drive without records has no segment: drive the road first")
    assessment = assess(road, drive, has_all_shares=False)
    n = len(assessment.distance)
    if finding is not None:
        record = int(np.argmin(np.abs(drive.trajectory.time[:n] - finding.time)))
        place = finding.distance
    else:
        record = int(assessment.oob_distance.argmin())
        place = float(assessment.distance[record])
    place = min(max(place, 0.0), road.length)
    start, end = max(place - REACH, 0.0), min(place + REACH, road.length)
    # A record beyond the road's end belongs to the segment that reaches that end.
    along = assessment.distance.clip(0.0, road.length)
    is_before, is_after = along[:record] < start, along[record + 1 :] > end
    return Segment(
        road=road,
        drive=drive,
        place=place,
        side=None if finding is None else finding.side,
        criterion=None if finding is None else finding.criterion,
        start=start,
        end=end,
        assessment=assessment,
        first=record - int(is_before[::-1].argmax()) if is_before.any() else 0,
        last=record + 1 + int(is_after.argmax()) if is_after.any() else n,
    )
