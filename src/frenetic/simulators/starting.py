"""The start of a car, for simulators that can place it off the lane's centre."""

from __future__ import annotations

import math
from typing import Final

MAX_START_OFFSET: Final = 2.0
"""Largest distance of a start from the ego lane's centre, in m: to the lane's edge."""
MAX_START_HEADING: Final = math.pi / 4.0
"""Largest angle of a start against the road, in rad."""


class StartingPlace:
    """Base of simulators with the place of a car's start as two checked attributes."""

    _start_offset = 0.0
    _start_heading = 0.0

    @property
    def start_offset(self) -> float:
        """Distance of the car's start to the left of the ego lane's centre, in m."""
        return self._start_offset

    @start_offset.setter
    def start_offset(self, offset: float) -> None:
        self._start_offset = _within(offset, MAX_START_OFFSET, "start_offset", "m")

    @property
    def start_heading(self) -> float:
        """Angle of the car's start to the left of the road's direction, in rad."""
        return self._start_heading

    @start_heading.setter
    def start_heading(self, heading: float) -> None:
        self._start_heading = _within(heading, MAX_START_HEADING, "start_heading", "rad")


def _within(value: float, most: float, name: str, unit: str) -> float:
    if not abs(value) <= most:
        raise ValueError(
            f"{name} is {value}: a number from {-most:.3g} to {most:.3g} {unit} is needed"
        )
    return float(value)
