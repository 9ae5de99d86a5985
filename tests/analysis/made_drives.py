"""Drives that are made by hand: the car is where a test puts it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frenetic.analysis import Segment, segment_of
from frenetic.oracle.verdict import Finding, Side
from frenetic.road import Road
from frenetic.simulators import Drive, Trajectory


def drive(
    road: Road,
    places: Sequence[float],
    offsets: Sequence[float] | float = 0.0,
    speeds: Sequence[float] | float = 10.0,
    steering: Sequence[float] | float = 0.0,
    *,
    period: float = 1.0,
) -> Drive:
    """A record every ``period`` s: places in m along the road, offsets in m left of the lane."""
    n = len(places)
    poses = [road.pose_at(place) for place in places]
    heading = np.array([pose.heading for pose in poses])
    lateral = np.broadcast_to(offsets, n) - 0.5 * road.lane_width
    zeros = np.zeros(n)
    return Drive(
        Trajectory(
            time=period * np.arange(float(n)),
            x=np.array([pose.x for pose in poses]) - lateral * np.sin(heading),
            y=np.array([pose.y for pose in poses]) + lateral * np.cos(heading),
            heading=heading,
            speed=np.broadcast_to(speeds, n).astype(float),
            lateral_speed=zeros,
            yaw_rate=zeros,
            steering=np.broadcast_to(steering, n).astype(float),
            steering_input=zeros,
            throttle=zeros,
            brake=zeros,
        )
    )


def departing(
    road: Road,
    place: float,
    side: Side = "left",
    *,
    speeds: tuple[float, float] = (15.0, 10.0),
    swing: float = 0.0,
) -> Segment:
    """The segment of a drive that leaves the lane at a place, drifting off over the last 12 m.

    Args:
        road: the road.
        place: m along the road.
        side: of the lane.
        speeds: m/s at the start and at the place, linear in between.
        swing: m to the left in the middle of the way.
    """
    places = np.arange(0.0, place + 0.25, 0.5)
    sign = 1.0 if side == "left" else -1.0
    offsets = sign * 2.8 * np.clip((places - place + 12.0) / 12.0, 0.0, 1.0) ** 2
    offsets += swing * np.sin(np.pi * places / place)
    speed = np.linspace(*speeds, len(places)).tolist()
    made = drive(road, places.tolist(), offsets.tolist(), speed, period=0.05)
    time = float(made.trajectory.time[-1])
    x, y = float(made.trajectory.x[-1]), float(made.trajectory.y[-1])
    return segment_of(road, made, departure(time, place, x, y, side))


def departure(time: float, distance: float, x: float, y: float, side: Side = "left") -> Finding:
    """The finding of a car that leaves its lane."""
    return Finding("lane", 0.6, 0.5, side, time, distance, x, y)
