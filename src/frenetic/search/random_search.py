"""Random search: the baseline that a search has to beat."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from frenetic._support.bounds import Index, Positive
from frenetic.conditions.domain import Domain
from frenetic.road.classes import RoadClass
from frenetic.search.continuations import RoadContinuations
from frenetic.search.map_check import RoadCheck
from frenetic.search.random_roads import MAX_LENGTH, MAX_REDRAWS, RandomRoads, Size, size_and_step
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.strategy import Ledger, Strategy, checked_options


class RandomSearch(Strategy):
    """A `Strategy` that proposes random roads and learns nothing.

    `RandomRoads` draws the roads. With the same seed, the random phase of
    ``Frenetic2021(max_redraws=10)`` has the same roads; the random roads of `Frenetic` are longer.
    If the car leaves its lane on a road of a road class, the rest of this road is proposed next,
    see `RoadContinuations`.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        step: m between two curvature values.
        max_length: Largest usual number of values; a road has up to five more or fewer.
        usual_length: Usual number of values; by default the map's side divided by the step, at most
            `max_length`.
        is_valid: Refuses roads that are not worth a test, see `RandomRoads`.
        max_redraws: How often a refused road is drawn again.
        road_class: Class of the roads, see `Strategy.road_class`.
        domain: Domain from which roads and conditions are drawn, see `Strategy.domain`.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the proposals, which campaigns record; increase it when they change."""

    def __init__(
        self,
        *,
        seed: Index,
        map_size: Positive | None = None,
        step: Positive | None = None,
        max_length: Size = MAX_LENGTH,
        usual_length: Size | None = None,
        is_valid: RoadCheck | None = None,
        max_redraws: Index = MAX_REDRAWS,
        road_class: RoadClass | None = None,
        domain: Domain | None = None,
    ) -> None:
        map_size, step = size_and_step(map_size, step, road_class)
        # Before other local variables exist: locals() has to hold the arguments alone, of which map
        # size and step are no longer None.
        self.options = checked_options(locals(), RandomSearch.__init__)
        self.road_class, self.domain = road_class, domain
        self._rng = np.random.default_rng(seed)
        self._roads = RandomRoads(
            map_size=map_size,
            step=step,
            max_length=max_length,
            usual_length=usual_length,
            is_valid=is_valid,
            max_redraws=max_redraws,
            road_class=road_class,
        )
        # Numbers the candidates, and knows which of them still lack a result.
        self._ledger = Ledger()
        self._continuations = RoadContinuations(road_class)

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer than `map_margin` m to the map's edge.

        A user's `is_valid` stays as it is.
        """
        self._roads.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which hardly any road is valid.

        Raises:
            ValueError: Hardly any road is valid, see `RandomRoads.require_valid_roads`.

        """
        self._roads.require_valid_roads()

    def ask(self) -> Candidate:
        """Return the rest of a road on which the car left its lane, if one waits, or a new road."""
        rest_of_road = self._continuations.issue(self._ledger)
        if rest_of_road is not None:
            return rest_of_road
        return self._roads.issue(self._rng, self._ledger, self.domain)

    def tell(self, evaluation: Evaluation) -> None:
        """Learn a candidate's result; if the car left its lane, the rest of the road may come next.

        Raises:
            ValueError: The candidate was never asked, or was told already, or a number of the
                evaluation is not finite; see `Ledger.settle`.

        """
        candidate = self._ledger.settle(evaluation)
        self._continuations.note_result(candidate, evaluation)
