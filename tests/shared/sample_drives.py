"""Sample drives, in which a test decides where the car is."""

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
    """Return a drive with a record every ``period`` s.

    Args:
        road: the road.
        places: m along the road.
        offsets: m to the left of the lane's centre.
        speeds: m/s.
        steering: rad.
        period: s.
    """
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
    """Return the segment of a drive that leaves the lane at a place, drifting over the last 12 m.

    Args:
        road: the road.
        place: m along the road.
        side: side of the lane.
        speeds: m/s at the start and at the place, linear in between.
        swing: m to the left halfway to the place.
    """
    places = np.arange(0.0, place + 0.25, 0.5)
    sign = 1.0 if side == "left" else -1.0
    offsets = sign * 2.8 * np.clip((places - place + 12.0) / 12.0, 0.0, 1.0) ** 2
    offsets += swing * np.sin(np.pi * places / place)
    speed = np.linspace(*speeds, len(places)).tolist()
    departing_drive = drive(road, places.tolist(), offsets.tolist(), speed, period=0.05)
    time = float(departing_drive.trajectory.time[-1])
    x, y = float(departing_drive.trajectory.x[-1]), float(departing_drive.trajectory.y[-1])
    return segment_of(road, departing_drive, departure(time, place, x, y, side))


def departure(time: float, distance: float, x: float, y: float, side: Side = "left") -> Finding:
    """Return the finding of a car that leaves its lane."""
    return Finding("lane", 0.6, 0.5, side, time, distance, x, y)
