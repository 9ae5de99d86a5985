"""Objectives: what a search minimises, and in which order.

An objective is a function of a drive along its road. Lower values are worse for the driver, unless
it has an attribute ``higher_is_worse`` that is true. Your own is named ``module:function``::

    def jerk(road, drive):
        return float(abs(np.diff(drive.trajectory.lateral_speed, 2)).max())

    jerk.higher_is_worse = True

An objective decides which roads a search goes on from. Whether a drive failed is the rules' matter,
and failures are parents whatever their value. How far a strategy's threshold adapts to an objective
is said by the strategy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from frenetic.errors import CampaignError, describe_raised
from frenetic.oracle import assess
from frenetic.registry import OBJECTIVES
from frenetic.road import Road
from frenetic.simulators.drive import Drive

Measure: TypeAlias = Callable[[Road, Drive], float]
"""Value of a drive along its road."""

MOOBD: Final = "moobd"
"""Name of the usual objective."""


@dataclass(frozen=True)
class Objective:
    """A named objective."""

    name: str
    """A registered name, ``package.module:function`` or ``file.py:function``."""
    measure: Measure

    @classmethod
    def load(cls, name: str) -> Objective:
        """The objective of a name.

        Raises:
            FreneticError: it cannot be loaded.
        """
        return cls(name, OBJECTIVES.load(name))

    @property
    def higher_is_worse(self) -> bool:
        """Whether a higher value is worse for the driver."""
        return bool(getattr(self.measure, "higher_is_worse", False))

    def severity(self, road: Road, drive: Drive) -> float | None:
        """What a strategy minimises, if that is not the MOOBD.

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
        return -value if self.higher_is_worse else value


def moobd(road: Road, drive: Drive) -> float:
    """Minimum oob distance, in m; lower is worse."""
    return float(assess(road, drive).oob_distance.min())


def oob_share(road: Road, drive: Drive) -> float:
    """Largest share 0..1 of the car's box outside its lane; higher is worse."""
    return float(assess(road, drive).oob_share.max())


def lateral_acceleration(road: Road, drive: Drive) -> float:
    """Largest speed times yaw rate in either direction, in m/s²; higher is worse."""
    seen = len(assess(road, drive).distance)
    path = drive.trajectory
    return float(np.abs(path.speed[:seen] * path.yaw_rate[:seen]).max())


for _measure in (oob_share, lateral_acceleration):
    _measure.higher_is_worse = True  # type: ignore[attr-defined]
