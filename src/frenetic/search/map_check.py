"""Whether a road can be driven on the map, and why roads were refused."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from typing import TypeAlias

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import MAP_MARGIN, Road
from frenetic.road.classes import RoadClass
from frenetic.road.road import placed_road
from frenetic.road.validity import LANE_WIDTH, check_layout

_NUMBER = re.compile(r"\d+(?:\.\d+)?")

RoadCheck: TypeAlias = Callable[[FloatArray, float], bool]
"""A function that returns whether a road is valid, from curvatures, (N,) 1/m, and step, m.

The answer must depend on nothing else, or a campaign cannot be replayed.
"""


class MapCheck:
    """A `RoadCheck`: whether a road fits the map in some pose and is valid there by the rules.

    Args:
        map_size: m, side of the square map.
        is_valid: A check that replaces the check by map and rules: a user's, or another `MapCheck`.
        road_class: Class whose rules the roads keep already; then the road only has to lie in the
            map and clear of itself.

    """

    def __init__(
        self, map_size: float, is_valid: RoadCheck | None, road_class: RoadClass | None = None
    ) -> None:
        self._map_size = map_size
        self._is_valid = is_valid
        self._road_class = road_class
        self._map_margin = MAP_MARGIN

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads whose centre line comes nearer than `map_margin` m to the map's edge."""
        self._map_margin = map_margin

    @property
    def built_in(self) -> MapCheck | None:
        """The check by map and rules; None if a user's check replaces it."""
        if isinstance(self._is_valid, MapCheck):
            return self._is_valid.built_in
        return self if self._is_valid is None else None

    @property
    def map_size(self) -> float:
        """Side of the square map, in m."""
        return self._map_size

    def place(self, curvatures: FloatArray, step: float) -> tuple[Road | None, str]:
        """Return a road at its place on the map, and why it is refused there.

        A user's check is not asked. The road is None if no pose fits; the text is empty if the
        road is valid.
        """
        if isinstance(self._is_valid, MapCheck):
            return self._is_valid.place(curvatures, step)
        try:
            if self._road_class is None:
                placed, verdict = placed_road(
                    curvatures, step, LANE_WIDTH, self._map_size, self._map_margin
                )
                return placed, verdict.message
            fitted = Road(curvatures, step).fitted(self._map_size, self._map_margin)
        except RoadError as error:
            return None, str(error)
        if fitted is None:
            return None, "The road does not fit the map"
        return fitted, check_layout(fitted.road_points, self._map_size).message

    def refusal(self, curvatures: FloatArray, step: float) -> str:
        """Return why map or rules refuse a road; empty if it is valid."""
        return self.place(curvatures, step)[1]

    def __call__(self, curvatures: FloatArray, step: float) -> bool:
        """Return whether a road is valid, see `RoadCheck`."""
        if self._is_valid is not None:
            return self._is_valid(curvatures, step)
        return not self.refusal(curvatures, step)


def most_frequent(reasons: Counter[str], most: int = 3) -> str:
    """Return reasons and how often they came, the most frequent first.

    Reasons that differ only in numbers count as the same.
    """
    kinds: dict[str, tuple[str, int]] = {}
    for reason, number in reasons.items():
        kind = _NUMBER.sub("#", reason)
        example, count = kinds.get(kind, (reason, 0))
        kinds[kind] = example, count + number
    ranked = sorted(kinds.values(), key=lambda kind: -kind[1])[:most]
    return ", ".join(f"{reason} ({count} times)" for reason, count in ranked)
