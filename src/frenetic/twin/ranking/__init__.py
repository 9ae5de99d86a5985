"""Ranking: which of many roads to drive first in a slow simulator, by drives in a fast one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.road.files import FoundRoads, find_roads
    from frenetic.twin.ranking.ranking import Prospect, RankedRoad, Twin, rank

__getattr__ = lazy_names(
    __name__,
    {
        "frenetic.twin.ranking.ranking": ("Prospect", "RankedRoad", "Twin", "rank"),
        "frenetic.road.files": ("FoundRoads", "find_roads"),
    },
)

__all__ = ["FoundRoads", "Prospect", "RankedRoad", "Twin", "find_roads", "rank"]
