"""Continuations: the rest of a road, after the place where the car left its lane, as a new test."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from frenetic.criteria.criterion import LANE
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.search.conditions import moved_along
from frenetic.search.operator_names import REST
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger

MIN_REST_TIME = 10.0
"""Least driving time on the rest of a road that becomes a test, at full speed, in s (our choice).

Full speed is the design speed of a road class, or the speed limit on a map's road."""


class RoadContinuations:
    """Continue roads after the place where the car left its lane.

    In a road class the rest of such a road becomes a test of its own: the car is put back on the
    lane, at rest, at the road's next value. So one long road shows several failing places.

    Args:
        road_class: Class of the roads; None: the competition's roads are not continued.

    """

    def __init__(self, road_class: RoadClass | None) -> None:
        self._road_class = road_class
        # Roads, each with the index of the first value of its rest.
        self._waiting: deque[tuple[Candidate, int]] = deque()

    def note_result(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Note a road's result; if the car left its lane, the rest waits if it is long enough."""
        finding = evaluation.finding
        if self._road_class is None or finding is None or finding.side is None:
            return
        if finding.criterion != LANE:  # other criteria do not end a drive
            return
        first = max(math.ceil(finding.distance / candidate.step), 1)
        rest_length = (len(candidate.curvatures) - 1 - first) * candidate.step
        if rest_length >= MIN_REST_TIME * self._road_class.design_speed / 3.6:
            self._waiting.append((candidate, first))

    def issue(self, ledger: Ledger) -> Candidate | None:
        """Issue the rest of the road that has waited longest; return None if no road waits."""
        if not self._waiting:
            return None
        road, first = self._waiting.popleft()
        start = first * road.step
        profiles: dict[str, Any] = {
            name: profile.piece_of(name, values, start)
            for name in profile.NAMES
            if (values := getattr(road, name)) is not None
        }
        return ledger.issue(
            road.curvatures[first:],
            road.step,
            Origin(REST, (road.id,), road.origin.generation),
            notes={REST: {"of": road.id, "from": start}},
            conditions=moved_along(road.conditions, -start),
            **profiles,
        )
