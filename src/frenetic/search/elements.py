"""Random sequences of straights, clothoids and arcs, and random grades: roads of a road class."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road import profile

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

# The values are our choice. An element is a straight or an arc, with the clothoid that leads to it.
_STRAIGHT_SHARE = 0.15  # share of straights among the elements
_OTHER_SIDE_SHARE = 0.75  # share of bends that turn the other way than the bend before
_MIN_CURVATURE_SHARE = 0.2  # curvature of the gentlest bend, as a share of the bound
_MIN_CHANGE_SHARE = 0.5  # change of curvature along the longest clothoid, as a share of the limit
_MAX_ARC_FACTOR = 4.0  # length of the longest arc, as a multiple of the shortest
_NUMBERS_PER_ELEMENT = 4  # uniform random numbers that an element takes
_GRADE_LENGTHS = (100.0, 500.0)  # [m] least and largest length of a random grade


@njit(interpret_first=0.2)
def draw_elements(
    values: FloatArray,
    first: int,
    end: int,
    previous: float,
    u: FloatArray,
    offset: int,
    limits: FloatArray,
) -> None:
    """Draw curvatures as straights, clothoids and arcs that continue from a curvature.

    Args:
        values: Curvatures in 1/m; those with the indices first..end-1 are overwritten.
        first: Index of the first value to draw.
        end: Index after the last value to draw.
        previous: Curvature before the first value, in 1/m.
        u: Uniform random numbers in 0..1: from index `offset` on, one for each value.
        offset: Index of the first random number.
        limits: (4,), see `frenetic.road.classes.RoadClass.limits`.
    """
    bound, max_change, min_arc = limits[0], limits[1], limits[2]
    i = first
    now = previous
    side = 1.0 if now >= 0.0 else -1.0
    while i < end:
        # The last elements share the last numbers.
        at = min(offset + i - first, len(u) - _NUMBERS_PER_ELEMENT)
        target = 0.0
        if now == 0.0 or u[at] >= _STRAIGHT_SHARE:
            share = (u[at] - _STRAIGHT_SHARE) / (1.0 - _STRAIGHT_SHARE)
            side = -side if share < _OTHER_SIDE_SHARE else side
            target = (
                side * bound * (_MIN_CURVATURE_SHARE + (1.0 - _MIN_CURVATURE_SHARE) * u[at + 1])
            )
        change = max_change * (_MIN_CHANGE_SHARE + (1.0 - _MIN_CHANGE_SHARE) * u[at + 2])
        clothoid = max(math.ceil(abs(target - now) / change), 1)  # number of its values
        arc = int(min_arc * (1.0 + (_MAX_ARC_FACTOR - 1.0) * u[at + 3]))  # number of its values
        for k in range(1, clothoid + arc + 1):
            if i < end:
                values[i] = now + (target - now) * k / clothoid if k < clothoid else target
                i += 1
        now = target


def random_grade(
    rng: np.random.Generator, road_class: RoadClass, length: float
) -> FloatArray | None:
    """Return a random grade along ``length`` m; None in a class of flat roads.

    The grade is a profile, (k, 2) of distances in m and slopes, see `frenetic.road.profile`.
    """
    if road_class.max_grade == 0.0:
        return None
    step = road_class.step
    grades = np.empty(round(length / step) + 1)
    i = 0
    while i < len(grades):
        count = max(int(rng.uniform(*_GRADE_LENGTHS) / step), 1)
        grades[i : i + count] = rng.uniform(-1.0, 1.0) * road_class.max_grade
        i += count
    conformed = road_class.conformed_grades(grades, step)
    return profile.thinned(np.column_stack([np.arange(len(conformed)) * step, conformed]))
