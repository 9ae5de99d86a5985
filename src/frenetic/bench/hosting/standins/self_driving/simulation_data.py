"""Records of a drive."""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, float, float]


class SimulationDataRecord(NamedTuple):
    """One moment of a drive; places in m on the map, z is the height of its ground."""

    timer: float
    """Simulated time, in s."""
    pos: Vector
    """Place of the centre of mass, in m."""
    dir: Vector
    """Unit vector along the car."""
    vel: Vector
    """m/s."""
    steering: float
    """Degrees, positive to the left."""
    steering_input: float
    brake: float
    """0..1."""
    brake_input: float
    throttle: float
    """0..1."""
    throttle_input: float
    wheelspeed: float
    """m/s."""
    vel_kmh: int
    """km/h."""
    is_oob: bool
    """Whether more of the car is outside its lane than the tolerance."""
    oob_counter: int
    """Number of times it has gone out so far."""
    max_oob_percentage: float
    """Largest share 0..1 outside since it last went out."""
    oob_distance: float
    """Lane half-width minus the distance to the lane's centre line, in m."""
    oob_percentage: float
    """Share 0..1 of the car's box outside its lane."""
