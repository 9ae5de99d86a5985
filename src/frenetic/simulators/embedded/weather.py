"""A wet stretch of the road and a gust across the road: their effect on a car that is there.

On the wet stretch the tyres have a share of their friction. The gust blows across the car on
another stretch: its speed rises from 0 at the stretch's ends to its largest value in the middle, as
``(1 + cos) / 2`` of the distance to the middle. A gust of speed w pushes a car of speed v with

    F = ρ / 2 * SIDE_AREA * w * sqrt(v² + w²)

at the centre of mass. That is the force of the air that meets the car, in proportion to the sine
of the angle at which the air meets it, which is nearly right for cars up to 30°. The gust does not
turn the car.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, hypotenuse
from frenetic.road.geometry import project_near, reach_of
from frenetic.simulators.embedded.single_track import LATERAL_SPEED, SPEED, X, Y
from frenetic.simulators.embedded.vehicle import (
    AIR_DENSITY,
    MASS,
    PULL_LEFT,
    Vehicle,
)

WET_LENGTH: Final = 40.0
"""Length of a wet stretch, in m; our choice."""
GUST_LENGTH: Final = 60.0
"""Length of the stretch on which a gust blows, in m; our choice."""
SIDE_AREA: Final = 5.0
"""Side-force coefficient times frontal area, in m²; our choice, a family car's in wind tunnels."""
# Indices of the weather array: middles of the stretches, speed of the gust, and the first of the
# car's parameters on the wet stretch.
_WET_AT, _GUST_AT, _GUST, _VEHICLE = range(4)


def weather_array(
    vehicle: Vehicle, wet: float, gust: float, wet_at: float, gust_at: float
) -> FloatArray | None:
    """Return the weather as the kernels take it; None without a wet stretch and a gust.

    Args:
        vehicle: The car.
        wet: Friction on the wet stretch, as a share of the road's; 1 for no wet stretch.
        gust: Largest speed of the gust in m/s, positive to the left; 0 for no gust.
        wet_at: Distance of the wet stretch's middle along the road, in m.
        gust_at: Distance of the gust's middle along the road, in m.
    """
    if wet == 1.0 and gust == 0.0:
        return None
    on_wet = replace(vehicle, friction=wet * vehicle.friction)
    return np.concatenate([[wet_at, gust_at, gust], on_wet.to_array()])


@njit(error_model="numpy")
def distance_of(table: FloatArray, ds: float, state: FloatArray, s: float) -> float:
    """Return the distance of a car along the road, in m; 0.1 s ago at most it was at ``s``."""
    reach = reach_of(0.1 * hypotenuse(state[SPEED], state[LATERAL_SPEED]))
    now: float = project_near(table, ds, state[X], state[Y], s, reach)[0]
    return now


@njit(error_model="numpy")
def grip_at(weather: FloatArray, vehicle: FloatArray, s: float) -> FloatArray:
    """Return the car's parameters at ``s`` m along the road, on the wet stretch or not."""
    if abs(s - weather[_WET_AT]) <= 0.5 * WET_LENGTH:
        wet: FloatArray = weather[_VEHICLE:]
        return wet
    return vehicle


@njit(error_model="numpy")
def in_gust(weather: FloatArray, ground: FloatArray, state: FloatArray, s: float) -> FloatArray:
    """Return the car's parameters at ``s`` m along the road, with the push of the gust there.

    Args:
        weather: see `weather_array`.
        ground: The car's parameters on the road there, see `on_slopes`.
        state: (7,) state of the car.
        s: Distance of the car along the road, in m.
    """
    away = abs(s - weather[_GUST_AT]) / GUST_LENGTH
    if weather[_GUST] == 0.0 or away >= 0.5:
        return ground
    wind = weather[_GUST] * 0.5 * (1.0 + cosine(2.0 * math.pi * away))
    pushed = ground.copy()
    force = 0.5 * AIR_DENSITY * SIDE_AREA * wind * hypotenuse(state[SPEED], wind)
    pushed[PULL_LEFT] += force / ground[MASS]
    return pushed
