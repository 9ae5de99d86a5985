"""A wet stretch of the road and a gust across it: what they do to the car while it is there.

On the stretch the tyres have a share of their friction. The gust blows across the car over a
stretch of its own, weak at its ends and strongest in its middle, in proportion to
``(1 - cos) / 2``. With its speed w and the car's v, it pushes with

    F = ρ / 2 * SIDE_AREA * w * sqrt(v² + w²)

at the centre of mass: the force of the air that meets the car, in proportion to the sine of the
angle at which it does, as it is nearly for cars up to 30°. It does not turn the car.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road.geometry import project_near, reach_of
from frenetic.simulators.embedded.single_track import LATERAL_SPEED, SPEED, X, Y
from frenetic.simulators.embedded.vehicle import (
    AHEAD,
    AIR_DENSITY,
    IS_TILTED,
    LEFT,
    MASS,
    PULL_LEFT,
    TURN,
    Vehicle,
)

WET_LENGTH: Final = 40.0
"""Length of a wet stretch, in m."""
GUST_LENGTH: Final = 60.0
"""Length of the road along which a gust blows, in m."""
SIDE_AREA: Final = 5.0
"""Side-force coefficient times frontal area, in m²; our choice, a family car's in wind tunnels."""
_WET_AT, _GUST_AT, _GUST, _VEHICLE = range(4)
NONE: Final = np.empty(0)
"""Array of the weather without a wet stretch and without a gust."""


def weather_array(
    vehicle: Vehicle, wet: float, gust: float, wet_at: float, gust_at: float
) -> FloatArray:
    """Return the weather as the kernels take it.

    Args:
        vehicle: The car.
        wet: Friction on the wet stretch, as a share of the road's; 1 for none.
        gust: m/s, to the left; 0 for none.
        wet_at: m along the road, the stretch's middle.
        gust_at: m along the road, the gust's middle.
    """
    if wet == 1.0 and gust == 0.0:
        return NONE
    there = replace(vehicle, friction=wet * vehicle.friction)
    return np.concatenate([[wet_at, gust_at, gust], there.to_array()])


@njit(error_model="numpy")
def place_of(table: FloatArray, ds: float, state: FloatArray, s: float) -> float:
    """Return the place along the road, in m, of a car that was at ``s`` a short time ago."""
    reach = reach_of(0.1 * math.hypot(state[SPEED], state[LATERAL_SPEED]))
    now: float = project_near(table, ds, state[X], state[Y], s, reach)[0]
    return now


@njit(error_model="numpy")
def grip_at(weather: FloatArray, vehicle: FloatArray, s: float) -> FloatArray:
    """Return the car's parameters at a place along the road, wet or not."""
    if abs(s - weather[_WET_AT]) <= 0.5 * WET_LENGTH:
        wet: FloatArray = weather[_VEHICLE:]
        return wet
    return vehicle


@njit(error_model="numpy")
def in_gust(weather: FloatArray, ground: FloatArray, state: FloatArray, s: float) -> FloatArray:
    """Return the car's parameters at a place along the road, pushed by the gust."""
    away = abs(s - weather[_GUST_AT]) / GUST_LENGTH
    if weather[_GUST] == 0.0 or away >= 0.5:
        return ground
    wind = weather[_GUST] * 0.5 * (1.0 + math.cos(2.0 * math.pi * away))
    pushed = ground.copy()
    if not pushed[IS_TILTED]:
        pushed[IS_TILTED] = pushed[AHEAD] = pushed[LEFT] = pushed[TURN] = 1.0
    force = 0.5 * AIR_DENSITY * SIDE_AREA * wind * math.hypot(state[SPEED], wind)
    pushed[PULL_LEFT] += force / ground[MASS]
    return pushed
