"""Straights, clothoids and arcs in a row: random roads of a road class."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road import profile

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

# All values are ours.
_STRAIGHT = 0.15  # share of straights among the elements
_OTHER_SIDE = 0.75  # share of bends that turn the other way than the one before
_GENTLEST = 0.2  # curvature of the gentlest bend, as a share of the sharpest's
_SLOWEST = 0.5  # change of curvature along the longest clothoid, as a share of the quickest
_LONGEST = 4.0  # length of the longest arc, as a multiple of the shortest
_NUMBERS = 4  # uniform random numbers that an element takes
_GRADE_LENGTHS = (100.0, 500.0)  # [m] from one grade to the next


@njit()
def draw_elements(
    values: FloatArray,
    first: int,
    end: int,
    previous: float,
    u: FloatArray,
    offset: int,
    limits: FloatArray,
) -> None:
    """Draw values first..end-1, 1/m, as clothoids and arcs that continue from a curvature.

    Args:
        values: Room for the values.
        first: Index of the first value.
        end: Index behind the last value.
        previous: 1/m, the value before the first.
        u: Uniform random numbers, from index `offset` on one for each value.
        offset: Index of the first number.
        limits: (4,), see `frenetic.road.classes.RoadClass.limits`.
    """
    bound, change, arc = limits[0], limits[1], limits[2]
    i = first
    now = previous
    side = 1.0 if now >= 0.0 else -1.0
    while i < end:
        at = min(offset + i - first, len(u) - _NUMBERS)
        target = 0.0
        if now == 0.0 or u[at] >= _STRAIGHT:
            share = (u[at] - _STRAIGHT) / (1.0 - _STRAIGHT)
            side = -side if share < _OTHER_SIDE else side
            target = side * bound * (_GENTLEST + (1.0 - _GENTLEST) * u[at + 1])
        quick = change * (_SLOWEST + (1.0 - _SLOWEST) * u[at + 2])
        count = max(math.ceil(abs(target - now) / quick), 1)
        lasting = int(arc * (1.0 + (_LONGEST - 1.0) * u[at + 3]))
        for k in range(1, count + lasting + 1):
            if i < end:
                values[i] = now + (target - now) * k / count if k < count else target
                i += 1
        now = target


def random_grade(
    rng: np.random.Generator, road_class: RoadClass, length: float
) -> FloatArray | None:
    """Return a random grade along ``length`` m, (k, 2); None in a class of flat roads."""
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
