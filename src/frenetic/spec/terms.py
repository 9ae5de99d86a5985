"""What holds for every drive of a run: map, lanes, roads and conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final, Self

from msgspec import convert

from frenetic._support.bounds import NotNegative, Positive, check
from frenetic._support.scalars import take_numpy_scalars, without_numpy
from frenetic.conditions.condition import require_allowed
from frenetic.conditions.domain import Domain
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import LANE_WIDTH, MAP_MARGIN, MAP_SIZE
from frenetic.road.classes import RoadClass
from frenetic.road.road_values import MAX_COORDINATE, checked_lane_width
from frenetic.simulators.conditions import check_conditions, rules_in


@dataclass(frozen=True, kw_only=True)
class Terms:
    """Map, lanes, roads and conditions of a run's drives.

    Raises:
        ValueError: a field is of another kind or out of its bounds; the map is too small for its
            margin, or too large; or a condition is unknown or has an amount that is not allowed.
    """

    map_size: Positive = MAP_SIZE
    """Side of the square map into which roads are fitted, in m."""
    map_margin: NotNegative = MAP_MARGIN
    """Distance that a road's centre line keeps from the map's edge, in m."""
    lane_width: Positive = LANE_WIDTH
    """Width of each of the two lanes, in m."""
    road_class: RoadClass | None = None
    """Class whose rules valid roads keep; None for the competition's rules."""
    domain: Domain | None = None
    """Domain from which the conditions of the drives are drawn; None for the usual conditions."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Name of a condition -> its amount in every drive, see `frenetic.conditions`."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        object.__setattr__(self, "conditions", without_numpy(self.conditions))
        check(vars(self), Terms)
        checked_lane_width(self.lane_width)
        if not self.map_size > 2.0 * self.map_margin:
            raise ValueError(
                f"map_size is {self.map_size:g}: more than twice the margin of"
                f" {self.map_margin:g} m is needed"
            )
        if self.map_size > MAX_COORDINATE:
            raise ValueError(
                f"map_size is {self.map_size:g}: at most {MAX_COORDINATE:g} m are allowed"
            )
        check_conditions(self.conditions)
        require_allowed(self.conditions)

    @classmethod
    def of_class(cls, road_class: RoadClass | None, **others: Any) -> Self:
        """Return the terms for roads of a class, with the map and lanes of the class by default.

        Args:
            road_class: the class; None for the competition's roads.
            others: further fields, which win.
        """
        defaults: dict[str, Any] = {}
        if road_class is not None:
            defaults = {"map_size": road_class.map_size, "lane_width": road_class.lane_width}
        return cls(road_class=road_class, **{**defaults, **others})

    def conditions_of(self, conditions: Mapping[str, float]) -> dict[str, float]:
        """Return all conditions of a drive, whose own conditions win."""
        return {**self.conditions, **conditions}


_REQUIRED: Final = ("lane_width", "map_size", "map_margin")
"""Entries that each record of a setting has, though they have defaults in Python."""


@dataclass(frozen=True, kw_only=True)
class DriveSetting(Terms):
    """The terms of a campaign's drives, with its simulator's rules and car."""

    rules: Rules
    """Rules of the drives, apart from a speed limit among the conditions."""
    car: CarBody
    """Box of the simulator's car."""

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> Self:
        """Return the setting in a campaign's configuration, whose other entries are not read.

        Raises:
            ValueError: an entry is missing or wrong; the message names it.
        """
        if missing := [name for name in _REQUIRED if name not in config]:
            # The words of msgspec, which finds entries without default that are missing.
            raise ValueError(f"Object missing required field `{missing[0]}`")
        names = {item.name for item in fields(cls)}
        return convert({name: value for name, value in config.items() if name in names}, cls)

    @property
    def terms(self) -> Terms:
        """The terms alone, without rules and car."""
        return Terms(**{item.name: getattr(self, item.name) for item in fields(Terms)})

    def rules_in(self, conditions: Mapping[str, float]) -> Rules:
        """Return the rules of a drive in its own conditions, which may hold a speed limit."""
        return rules_in(self.conditions_of(conditions), self.rules)
