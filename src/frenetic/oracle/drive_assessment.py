"""The assessment of a drive, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road.profile import value_at

if TYPE_CHECKING:
    from frenetic.road import Road


DISTANCE, OFFSET, OOB_SHARE = range(3)
"""Columns of assessed records: distance along the road and lateral offset from the road's centre
line in m, and oob share."""
ASSESSMENT_SIZE: Final = 3
"""Number of these columns."""


@dataclass(frozen=True)
class Assessment:
    """Position on the road and oob share at each record of a drive, up to its last record."""

    end: int
    """How the drive ended: REACHED, LEFT_LANE, STUCK or TIMED_OUT; RUNNING if no rule ended it."""
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    oob_distance: FloatArray
    """Oob distance, (n,) in m: how far the centre of mass is inside its lane, negative outside."""
    oob_share: FloatArray
    """Share of the car's box outside the ego lane, (n,), 0..1."""

    @classmethod
    def of(cls, road: Road, end: int, rows: FloatArray) -> Assessment:
        """Return the assessment from what `assess_record` returned for each record.

        Args:
            road: the road that was driven.
            end: state of the drive at the last record.
            rows: assessed records, (n, `ASSESSMENT_SIZE`).
        """
        distance, offset, oob_share = rows.T.copy()
        half_width = 0.5 * road.lane_width
        # From the ego lane's centre line, which is half a lane to the right of the road's.
        offset = offset + half_width
        oob_distance = half_width - np.abs(offset)
        if len(road.widening):
            to_right_edge = half_width + offset + value_at(road.widening, distance)
            oob_distance = np.minimum(half_width - offset, to_right_edge)
        return cls(end, distance, offset, oob_distance, oob_share)


class DriveAssessment(NamedTuple):
    """The assessment of a drive by its own simulator, and the objects for which it holds."""

    assessment: Assessment
    """The assessment; of its oob shares only the largest is exact."""
    source: tuple[object, ...]
    """Road, rules, body of the car, and trajectory that were assessed."""

    def holds_for(self, *parts: object) -> bool:
        """Return whether the assessment was made from these very objects."""
        return all(part is assessed for part, assessed in zip(parts, self.source, strict=True))
