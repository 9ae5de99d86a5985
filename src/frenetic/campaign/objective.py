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
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from frenetic.errors import CampaignError, describe_raised
from frenetic.oracle import assess
from frenetic.registry import OBJECTIVES
from frenetic.road import Road
from frenetic.search.records import Evaluation
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

    def value_of(self, evaluation: Evaluation) -> float | None:
        """Value of a test as the function gives it; None for the MOOBD, or if it was not driven."""
        severity = evaluation.objective
        return None if severity is None else self._turned(severity)

    def worse(self, one: float, other: float) -> float:
        """The value of two that is worse for the driver."""
        return max(one, other) if self.higher_is_worse else min(one, other)

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
        return self._turned(value)

    def _turned(self, value: float) -> float:
        """A value as what is minimised, and back."""
        return -value if self.higher_is_worse else value


def in_words(config: Mapping[str, Any], values: Mapping[int, float]) -> str:
    """What a campaign minimised, its threshold, and its best values in the order of the tests.

    Args:
        config: of the campaign.
        values: id of a test -> value, ascending; empty for the MOOBD.
    """
    name = str(config.get("objective", MOOBD))
    is_higher = config.get("higher_is_worse") is True
    known = OBJECTIVES.built_in.get(name)
    order = f"{'higher' if is_higher else 'lower'} is worse"
    text = f"{name}: {known[1] if known else order}"
    strategy = config.get("strategy")
    options = strategy.get("options") if isinstance(strategy, Mapping) else None
    threshold = options.get("threshold") if isinstance(options, Mapping) else None
    if isinstance(threshold, int | float):
        text += f", threshold {threshold:g}"
    elif isinstance(options, Mapping) and "random_roads" in options:
        text += ", threshold adapts to the driver"
    if not values:
        return text
    best = (np.maximum if is_higher else np.minimum).accumulate(list(values.values()))
    places = sorted({max(len(best) // 10, 1), max(len(best) // 2, 1), len(best)})
    first = list(values)[int(np.argmax(best == best[-1]))]
    course = ", ".join(f"{best[place - 1]:.3g} after {place}" for place in places)
    return f"{text}; best {course} drives, in test {first}"


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
