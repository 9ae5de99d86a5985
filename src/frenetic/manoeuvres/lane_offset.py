"""Manoeuvre on a straight road: the car starts beside the lane's centre."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from msgspec import Meta

from frenetic._support.bounds import check
from frenetic.conditions.condition import MAX_START_OFFSET, START, START_SPEED
from frenetic.manoeuvres.manoeuvre import (
    CAR,
    OFFSET,
    RUN_OUT,
    STEADY_OFFSET,
    Graph,
    Hold,
    Line,
    ManoeuvreDrive,
    Measures,
    QuantityName,
)
from frenetic.manoeuvres.response import response_names, response_quantities, step_response
from frenetic.road import Road

_STEP: Final = 10.0  # [m] between two curvature samples of the straight; our choice
_START_SPEED: Final = QuantityName("start_speed", CAR, "km/h")


@dataclass
class LaneOffset:
    """A start beside the lane's centre: how the driver leads the car back to the centre.

    The car starts at the speed limit if its simulator can, otherwise at rest: then the times
    contain the acceleration.
    """

    name: ClassVar[str] = "lane-offset"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (
        _START_SPEED,
        *response_names(OFFSET),
        STEADY_OFFSET,
    )

    offset: Annotated[float, Meta(ge=-MAX_START_OFFSET, le=MAX_START_OFFSET)] = 0.5
    """Distance of the start to the left of the lane's centre, in m; not 0."""
    hold: Hold = 10.0
    """Driving time that is measured, in s at the speed limit."""

    def __post_init__(self) -> None:
        check(vars(self), LaneOffset)
        if self.offset == 0.0:
            raise ValueError("offset is 0: a distance from the lane's centre is needed")

    def conditions(self, speed: float) -> Mapping[str, float]:
        """Return the conditions of the drive: the start beside the centre, at a speed.

        Args:
            speed: speed limit, in m/s.
        """
        return {START: self.offset, START_SPEED: 3.6 * speed}

    def road(self, speed: float, lane_width: float) -> Road:
        """Return the straight road.

        Args:
            speed: speed limit, in m/s.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: the road is too long.
        """
        samples = int((self.hold * speed + RUN_OUT) / _STEP) + 2
        return Road([0.0] * samples, _STEP, lane_width=lane_width)

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return the step response of the lateral offset."""
        end_time = drive.time_at(self.hold * drive.speed)
        if end_time is None:
            return Measures.missing(self.QUANTITIES, drive.end_text)
        records = drive.between(0.0, end_time)
        time, offset = drive.time[records], drive.offset[records]
        response = step_response(time, offset, step_time=0.0, start=self.offset, asked=0.0)
        quantities = (
            _START_SPEED.measured(3.6 * drive.located.path.speed[0]),
            *response_quantities(response, OFFSET, "m"),
            drive.steady_offset(end_time),
        )
        lines = Line("lane", time, np.zeros_like(time)), Line("car", time, offset)
        graph = Graph("time since the start (s)", "lateral offset (m)", lines)
        return Measures(quantities, (graph,))
