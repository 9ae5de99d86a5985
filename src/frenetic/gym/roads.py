"""The roads of an environment: random ones, or drawn from a given list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.ranking.roads import find_roads
from frenetic.road import MAP_SIZE, Road
from frenetic.search.random_search import RandomRoads

_MOST_DRAWN = 1000  # random roads for a drive


class RoadSource:
    """Gives a road for every drive.

    Args:
        given: roads to draw from, each of them a `Road`, a road file, a folder of road files, or a
            campaign's folder, which stands for the roads that failed there. None: random roads, as
            the strategy `random` proposes them, fitted into the map and valid.
        map_size: m, side of the map of random roads.

    Raises:
        FreneticError: a file or folder holds no road, or the list is empty.
        ValueError: `map_size` is out of range.
    """

    def __init__(
        self, given: Sequence[Road | Path | str] | None, map_size: float = MAP_SIZE
    ) -> None:
        self._roads = None if given is None else given_roads(given)
        self._map_size = map_size
        # Refused roads are drawn again here, where they are placed anyway.
        self._random = RandomRoads(map_size=map_size, max_redraws=0)

    def draw(self, rng: np.random.Generator) -> Road:
        """A road.

        Raises:
            ValueError: no road fits the map.
        """
        if self._roads is not None:
            return self._roads[int(rng.integers(len(self._roads)))]
        for _ in range(_MOST_DRAWN):
            road, verdict = Road(self._random.draw(rng), self._random.step).placed(self._map_size)
            if road is not None and verdict:
                return road
        raise ValueError(
            f"map_size is {self._map_size:g} m: none of {_MOST_DRAWN} random roads fits into it"
        )


def given_roads(given: Sequence[Road | Path | str]) -> list[Road]:
    """The roads of a list, see `RoadSource`, in its order.

    Raises:
        FreneticError: a file or folder holds no road, or the list is empty.
    """
    if isinstance(given, (str, Path, Road)):
        raise FreneticError(f"roads is {given!r}: a list is needed, such as [{given!r}]")
    roads: list[Road] = []
    for one in given:
        if isinstance(one, Road):
            roads.append(one)
        elif (Path(one) / DATABASE).exists():
            roads += _failed(Path(one))
        else:
            found = find_roads([Path(one)])
            roads += [named.road for named in found.roads]
    if not roads:
        raise FreneticError("roads is an empty list: at least one road is needed, or None")
    return roads


def _failed(folder: Path) -> list[Road]:
    """The roads that failed in a campaign."""
    with CampaignStore.open(folder) as store:
        roads = [test.road for test in store.tests(Outcome.FAIL)]
    if not roads:
        raise FreneticError(f"no road failed in the campaign {folder}")
    return roads
