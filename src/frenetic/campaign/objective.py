"""Objectives: what a search makes as bad for the driver as it can.

An objective is a function of a drive along its road. Lower values are worse for the driver, unless
the function has an attribute ``higher_is_worse`` that is true. Its attribute ``place_of`` may be
another function of road and drive: it returns where along the road the value was reached, in m.
Your own objective is named ``module:function``::

    def jerk(road, drive):
        return float(abs(np.diff(drive.trajectory.lateral_speed, 2)).max())

    jerk.higher_is_worse = True

An objective decides which roads a search changes next. It does not decide whether a drive failed:
the rules do, and a failing road is a parent whatever its value. Each strategy's own text says how
its threshold adapts to an objective.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.words import lane_words
from frenetic.criteria.criterion import SIGNALS, signal_named
from frenetic.errors import CampaignError, describe_raised
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.oracle.measures import measure_criteria
from frenetic.oracle.signals import Measurement, worst
from frenetic.oracle.verdict import locate_drive
from frenetic.parts.registry import OBJECTIVES
from frenetic.road import Road
from frenetic.search.records import Evaluation

Measure: TypeAlias = Callable[[Road, Drive], float]
"""Function that returns the value of a drive along its road."""

MOOBD: Final = "moobd"
"""Name of the default objective, the minimum oob distance."""
CRITERIA: Final = "criteria"
"""Name of the objective whose value is the least margin to a criterion."""
OOB_SHARE: Final = "oob-share"
"""Name of the objective whose value is the largest share of the car outside its lane."""


@dataclass(frozen=True)
class Objective:
    """An objective with its name."""

    name: str
    """A registered name, ``package.module:function`` or ``file.py:function``."""
    measure: Measure
    """The function of the objective."""

    @classmethod
    def load(cls, name: str) -> Objective:
        """Return the objective of a name.

        Raises:
            FreneticError: the objective cannot be loaded.
        """
        return cls(name, OBJECTIVES.load(name))

    @property
    def higher_is_worse(self) -> bool:
        """Whether a higher value is worse for the driver."""
        return bool(getattr(self.measure, "higher_is_worse", False))

    def value_of(self, evaluation: Evaluation) -> float | None:
        """Return the function's value of a test; None for the MOOBD or without a drive."""
        minimised = evaluation.objective
        return None if minimised is None else self._turned(minimised)

    def worse(self, value: float, other: float) -> float:
        """Return the one of two values that is worse for the driver."""
        return max(value, other) if self.higher_is_worse else min(value, other)

    def place(self, road: Road, drive: Drive) -> float | None:
        """Return where along the road the value was reached, in m; None if that is not known."""
        place_of = getattr(self.measure, "place_of", None)
        return None if place_of is None else place_of(road, drive)

    def fitness(self, road: Road, drive: Drive) -> float | None:
        """Return the value that a strategy minimises; None for the MOOBD.

        Raises:
            CampaignError: the function raised, or its value is no finite number.
        """
        if self.name == MOOBD:
            return None
        try:
            value = float(self.measure(road, drive))
        except Exception as error:
            raise CampaignError(
                f"the objective {self.name} raised {describe_raised(error)}"
            ) from error
        if not math.isfinite(value):
            raise CampaignError(f"the objective {self.name} is {value}: a finite number is needed")
        return self._turned(value)

    def _turned(self, value: float) -> float:
        """Turn the function's value into one that a strategy minimises, or back."""
        return -value if self.higher_is_worse else value


def moobd(road: Road, drive: Drive) -> float:
    """Return the minimum oob distance of a drive, in m; lower is worse."""
    return float(assess(road, drive).oob_distance.min())


def oob_share(road: Road, drive: Drive) -> float:
    """Return the largest share of the car's box outside its lane, from 0 to 1; higher is worse."""
    return float(assess(road, drive).oob_share.max())


oob_share.higher_is_worse = True  # type: ignore[attr-defined]


def criteria(road: Road, drive: Drive) -> float:
    """Return the least margin to a criterion, as a share of its signal's scale; lower is worse.

    The lane counts as a criterion, whose margin is the MOOBD in m.
    """
    return nearest_margin(road, drive).share


class Margin(NamedTuple):
    """The margin of a drive to a criterion; margins are ordered by their shares."""

    share: float
    """Share of the signal's scale, negative beyond the limit; for the lane the MOOBD in m."""
    distance: float
    """Distance along the road where the margin was least, in m."""
    text: str
    """The signal's value and its limit, in words."""


def nearest_margin(road: Road, drive: Drive) -> Margin:
    """Return the least margin of a drive to a criterion, the lane included."""
    assessment = assess(road, drive)
    least = int(np.argmin(assessment.oob_distance))
    moobd, distance = float(assessment.oob_distance[least]), float(assessment.distance[least])
    nearest = Margin(moobd, distance, f"the car's centre {lane_words(moobd, road.lane_width)}")
    for measure in measure_criteria(road, drive, drive.rules.criteria.criteria):
        nearest = min(nearest, Margin(measure.share, measure.distance, measure.text()))
    return nearest


criteria.place_of = (  # type: ignore[attr-defined]
    lambda road, drive: nearest_margin(road, drive).distance
)


class WorstSignal:
    """The objective whose value is the worst value of a signal in a drive.

    The signal is measured in the window of the drive's criterion for it, or else in the signal's
    usual window, see `frenetic.criteria.criterion`. The value is 0 for a drive that is shorter than
    the window.

    Args:
        name: name of the signal.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.higher_is_worse = not signal_named(name).is_least

    def _worst(self, road: Road, drive: Drive) -> Measurement | None:
        return worst(self.name, locate_drive(road, drive))

    def __call__(self, road: Road, drive: Drive) -> float:
        """Return the signal's worst value in a drive."""
        measurement = self._worst(road, drive)
        return 0.0 if measurement is None else measurement.value

    def place_of(self, road: Road, drive: Drive) -> float | None:
        """Return where along the road the value was reached, in m; None for a short drive."""
        measurement = self._worst(road, drive)
        return None if measurement is None else measurement.distance


def __getattr__(name: str) -> Measure:
    """Return the objective of a built-in signal, which the registry names as this module's."""
    if name in SIGNALS:
        return WorstSignal(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
