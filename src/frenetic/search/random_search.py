"""Random roads: how both Frenetic searches begin, and the baseline that a search has to beat."""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, Positive
from frenetic.conditions.domain import Domain
from frenetic.criteria.criterion import LANE
from frenetic.errors import RoadError
from frenetic.road import MAP_MARGIN, MAP_SIZE, Road, profile
from frenetic.road.classes import RoadClass
from frenetic.road.conforming import conform
from frenetic.road.validity import check_layout
from frenetic.search.conditions import drawn, moved_along
from frenetic.search.elements import draw_elements, random_grade
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE, MIN_VALUES, random_curvatures
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, Strategy, options_of

STEP = 10.0  # [m] between two values, the paper's Section I-B
LENGTH_JITTER = 5  # values, the paper's Section I-B
MAX_LENGTH = 30  # values, before the jitter, the paper's Section I-B
MAX_REDRAWS = 10  # ours
_MOST_REFUSED = 1000  # roads in a row that may not fit into the map; ours
_PROBES = 300
"""Number of random roads of which `_LEAST_VALID` have to be valid; both are ours.

A search draws a refused road again ten times: where fewer than one in 150 is valid, it proposes
hardly any road that can be driven."""
_LEAST_VALID = 2  # roads of `_PROBES`
_ENOUGH_VALID = 10  # roads of `_PROBES`, for a length that is recommended; ours
_SHORTEST = 50.0  # [m], shortest length that is recommended; ours
TO_GO_ON = 10.0
"""Driving time at the design speed that the rest of a road has to last, in s; ours."""
_STRAIGHTEST = 10  # values of the longest straight at the start of a class's road; ours

_NUMBERS = re.compile(r"\d+(?:\.\d+)?")

RANDOM = "random"
"""The operator that a random road's origin names."""
REST = "rest"
"""The operator of the rest of a road behind the place where the car left its lane."""
EARLIER = "earlier"
"""The operator of a road that an earlier campaign drove."""
GIVEN = "given"
"""The operator of a stretch of a real road, from which the search starts."""

RoadCheck: TypeAlias = Callable[[FloatArray, float], bool]
"""A function that returns whether a road is valid, from curvatures, (N,) 1/m, and step, m.

The answer must depend on nothing else, or a campaign cannot be replayed.
"""
Size: TypeAlias = Annotated[int, Meta(ge=MIN_VALUES, le=10**6)]
"""Number of values of a road."""
Jitter: TypeAlias = Annotated[int, Meta(ge=0, le=1000)]

_Draw = TypeVar("_Draw", "FloatArray", "FloatArray | None")


class MapCheck:
    """A `RoadCheck`: whether a road fits the map in some pose and is valid there by the rules.

    Args:
        map_size: m, side of the square map.
        is_valid: A user's check, which replaces this one.
        road_class: Class whose rules the roads keep already; then only the map is checked.

    """

    def __init__(
        self, map_size: float, is_valid: RoadCheck | None, road_class: RoadClass | None = None
    ) -> None:
        self._map_size = map_size
        self._is_valid = is_valid
        self._road_class = road_class
        self._map_margin = MAP_MARGIN

    def keep_map_margin(self, map_margin: float) -> None:
        """Have centre lines keep so many m from the map's edge."""
        self._map_margin = map_margin

    @property
    def rules(self) -> MapCheck | None:
        """The innermost check, by map and rules; None if a user's check replaces it."""
        if isinstance(self._is_valid, MapCheck):
            return self._is_valid.rules
        return self if self._is_valid is None else None

    @property
    def map_size(self) -> float:
        """Side of the square map, in m."""
        return self._map_size

    def refusal(self, curvatures: FloatArray, step: float) -> str:
        """Return what map and rules have against a road; empty if it is valid."""
        try:
            road = Road(curvatures, step)
            if self._road_class is None:
                return road.placed(self._map_size, self._map_margin)[1].message
            fitted = road.fitted(self._map_size, self._map_margin)
        except RoadError as error:
            return str(error)
        if fitted is None:
            return "The road does not fit the map"
        return check_layout(fitted.road_points, self._map_size).message

    def __call__(self, curvatures: FloatArray, step: float) -> bool:
        """Return whether a road is valid, see `RoadCheck`."""
        if self._is_valid is not None:
            return self._is_valid(curvatures, step)
        try:
            road = Road(curvatures, step)
            if self._road_class is None:
                return road.placed(self._map_size, self._map_margin)[1].valid
            fitted = road.fitted(self._map_size, self._map_margin)
        except RoadError:
            return False
        return fitted is not None and check_layout(fitted.road_points, self._map_size).valid


class RandomRoads:
    """Draws roads as the random phase of Listing 1 does, or roads of a road class.

    A road has min(map_size // step, max_length) + U{-length_jitter .. length_jitter} values, at
    least 2, each drawn as `operators.next_curvature` says. In a class it is about as long as the
    class says, of clothoids and arcs that keep its rules.

    The paper moves a road that sticks out of the map, and discards it if it still does not fit
    (Section I-B). It does not check whether a road is valid before it sends it to the pipeline
    (Section II). Our deviation, which ``max_redraws=0`` turns off: a road that `is_valid` refuses
    is drawn again, up to `max_redraws` times; the last draw is always returned.

    Args:
        map_size: m, side of the square map.
        step: m between two curvature values.
        length_jitter: Largest deviation from the usual number of values.
        max_length: Largest usual number of values, before the jitter.
        curvature_bound: 1/m, largest absolute value.
        max_change: 1/m, largest difference of neighbouring values.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        max_redraws: How often a refused road is drawn again; the paper checks none.
        road_class: Takes the place of step, lengths and limits of curvature.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    def __init__(
        self,
        *,
        map_size: Positive = MAP_SIZE,
        step: Positive = STEP,
        length_jitter: Jitter = LENGTH_JITTER,
        max_length: Size = MAX_LENGTH,
        curvature_bound: Positive = CURVATURE_BOUND,
        max_change: Positive = MAX_CHANGE,
        is_valid: RoadCheck | None = None,
        max_redraws: Index = MAX_REDRAWS,
        road_class: RoadClass | None = None,
    ) -> None:
        options_of(locals(), RandomRoads.__init__)
        self.step = float(step)
        self._map_size = map_size
        self._length_jitter = length_jitter
        self._usual_length = min(int(map_size // step), max_length)
        self._road_class = road_class
        self.limits = np.array([curvature_bound, max_change])
        """Bound and largest change of values, both in 1/m; of a class, its `limits`."""
        if road_class is not None:
            self.step = road_class.step
            self._usual_length = usual_length(road_class)
            self.limits = road_class.limits(self.step)
        self._is_valid = MapCheck(map_size, is_valid, road_class)
        self._max_redraws = max_redraws

    def keep_map_margin(self, map_margin: float) -> None:
        """Check roads with a map margin, in m, unless an `is_valid` replaces the check."""
        self._is_valid.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which hardly a random road is valid; a user's check is not asked.

        Raises:
            ValueError: Fewer than 2 of 300 random roads are valid; the message says why, and
                what is allowed.

        """
        rules = self._is_valid.rules
        if rules is None:
            return
        refusals: Counter[str] = Counter()
        for values in self._probes(self):
            refusals[rules.refusal(values, self.step)] += 1
            if refusals[""] == _LEAST_VALID:
                return
        del refusals[""]
        reasons = most_frequent(refusals)
        few = f"fewer than {_LEAST_VALID} of {_PROBES} random roads"
        road_class, size = self._road_class, rules.map_size
        if road_class is None:
            raise ValueError(
                f"map_size is {size:g} m, and {few} are valid there: {reasons}; another map_size is"
                " needed"
            )
        allowed = self._allowed_length(road_class, rules)
        needed = f"length={allowed:g} or less" if allowed else "a larger map_size"
        raise ValueError(
            f"the length of {road_class.name} is {road_class.length:g} m, and with a min_radius of"
            f" {road_class.min_radius:g} m ({road_class.design_speed:g} km/h) and a map_size of"
            f" {size:g} m {few} are valid: {reasons}; {needed} is needed"
        )

    def _allowed_length(self, road_class: RoadClass, rules: MapCheck) -> float | None:
        """Return a length of the class in m with which roads are valid, None if there is none."""
        length = road_class.length / 2.0
        while length >= _SHORTEST:
            length = math.floor(length / 10.0) * 10.0
            shorter = RandomRoads(
                map_size=self._map_size, road_class=replace(road_class, length=length)
            )
            valid = sum(not rules.refusal(values, self.step) for values in self._probes(shorter))
            if valid >= _ENOUGH_VALID:
                return length
            length /= 2.0
        return None

    @staticmethod
    def _probes(roads: RandomRoads) -> Iterator[FloatArray]:
        """Return `_PROBES` random roads, always the same."""
        rng = np.random.default_rng(0)  # the search's own draws stay as they are
        return (roads.draw_once(rng) for _ in range(_PROBES))

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return the curvatures of a random road, (N,) 1/m."""
        return self.redraw_until_valid(lambda: self.draw_once(rng))

    def valid(self, rng: np.random.Generator) -> Iterator[Road]:
        """Draw roads, fit them into the map, and yield those that are valid there.

        Raises:
            ValueError: 1000 roads in a row do not fit.

        """
        refused = 0
        while refused < _MOST_REFUSED:
            road, verdict = Road(self.draw(rng), self.step).placed(self._map_size)
            if road is not None and verdict.valid:
                refused = 0
                yield road
            else:
                refused += 1
        raise ValueError(
            f"map_size is {self._map_size:g} m: none of {refused} random roads fits into it"
        )

    def redraw_until_valid(self, draw: Callable[[], _Draw]) -> _Draw:
        """Return the road that `draw` returns, drawn again while it is invalid and draws are left.

        None, from an operator that does not apply, is returned at once.
        """
        drawn = draw()
        for _ in range(self._max_redraws):
            if drawn is None or self.accepts(drawn):
                break
            drawn = draw()
        return drawn

    def accepts(self, curvatures: FloatArray) -> bool:
        """Return whether a road of these curvatures, (N,) 1/m, is worth a test."""
        return self._max_redraws == 0 or self._is_valid(curvatures, self.step)

    def conformed(self, curvatures: FloatArray) -> FloatArray:
        """Return the values, (N,) 1/m, bent to keep the rules of the road class."""
        if self._road_class is None:
            return curvatures
        return self._road_class.conformed(curvatures, self.step)

    def grade(self, rng: np.random.Generator, curvatures: FloatArray) -> FloatArray | None:
        """Return a random grade, (k, 2), for a road of (N,) curvatures; None for a flat road."""
        if self._road_class is None:
            return None
        return random_grade(rng, self._road_class, (len(curvatures) - 1) * self.step)

    def issue(
        self,
        rng: np.random.Generator,
        ledger: Ledger,
        domain: Domain | None = None,
        *,
        is_blind: bool = False,
    ) -> Candidate:
        """Issue a random road, in a domain with conditions, see `conditions.drawn`."""
        values = self.draw(rng)
        grade = self.grade(rng, values)
        conditions = drawn(rng, domain, (len(values) - 1) * self.step, is_blind=is_blind)
        origin = Origin(RANDOM)
        return ledger.issue(values, self.step, origin, grade=grade, conditions=conditions)

    @property
    def numbers(self) -> int:
        """Largest number of uniform numbers that `draw_once` takes; 0 without a road class."""
        if self._road_class is None:
            return 0
        return self._usual_length + self._length_jitter + _STRAIGHTEST

    def draw_once(self, rng: np.random.Generator, u: FloatArray | None = None) -> FloatArray:
        """Return a random road, (N,) 1/m, which may be invalid.

        Args:
            rng: Generator that draws the road.
            u: Uniform numbers for a road of a class, see `numbers`; drawn by default.
        """
        jitter = int(rng.integers(-self._length_jitter, self._length_jitter, endpoint=True))
        count = max(MIN_VALUES, self._usual_length + jitter)
        bound, max_change = self.limits[:2].tolist()
        if self._road_class is None:
            return random_curvatures(rng, count, bound=bound, max_change=max_change)
        values = np.zeros(count)
        if u is None:
            u = rng.random(count + _STRAIGHTEST)
        straight = int(u[-1] * _STRAIGHTEST)  # values of it at the start
        draw_elements(values, 1 + straight, count, 0.0, u, 0, self.limits)
        conform(values, self.limits, np.empty_like(values))
        return values


def most_frequent(reasons: Counter[str], most: int = 3) -> str:
    """Return reasons and how often they came, the most frequent first.

    Reasons that differ in numbers alone count as one.
    """
    kinds: dict[str, tuple[str, int]] = {}
    for reason, number in reasons.items():
        kind = _NUMBERS.sub("#", reason)
        example, count = kinds.get(kind, (reason, 0))
        kinds[kind] = example, count + number
    ranked = sorted(kinds.values(), key=lambda kind: -kind[1])[:most]
    return ", ".join(f"{reason} ({count} times)" for reason, count in ranked)


def size_and_step(
    map_size: float | None, step: float | None, road_class: RoadClass | None
) -> tuple[float, float]:
    """Return the side of the map and the step in m, by default the class's or the usual values.

    Raises:
        ValueError: The step differs from the class's.
    """
    if road_class is None:
        return MAP_SIZE if map_size is None else map_size, STEP if step is None else step
    if step not in (None, road_class.step):
        raise ValueError(
            f"step is {step!r}: {road_class.step:g} m are needed, as its road class says"
        )
    return road_class.map_size if map_size is None else map_size, road_class.step


def usual_length(road_class: RoadClass) -> int:
    """Return the usual number of values of a class's roads."""
    return max(round(road_class.length / road_class.step) + 1, MIN_VALUES)


class RoadContinuations:
    """Continue roads behind the place where the car left its lane.

    In a road class the rest of such a road becomes a test of its own: the car is put back on the
    lane, at rest, at the road's next value. So one long road shows several failing places.

    Args:
        road_class: Class of the roads; None: the competition's roads are not continued.

    """

    def __init__(self, road_class: RoadClass | None) -> None:
        self._road_class = road_class
        self._waiting: deque[tuple[Candidate, int]] = deque()

    def see(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Remember the rest of a driven road, if it is long enough to drive fast on it."""
        finding = evaluation.finding
        if self._road_class is None or finding is None or finding.side is None:
            return
        if finding.criterion != LANE:  # other criteria do not end a drive
            return
        first = max(math.ceil(finding.distance / candidate.step), 1)
        left = (len(candidate.curvatures) - 1 - first) * candidate.step
        if left >= TO_GO_ON * self._road_class.design_speed / 3.6:
            self._waiting.append((candidate, first))

    def issue(self, ledger: Ledger) -> Candidate | None:
        """Issue the rest of the road that has waited longest; return None if no road waits."""
        if not self._waiting:
            return None
        road, first = self._waiting.popleft()
        start = first * road.step
        profiles = {
            name: profile.piece_of(name, values, start)
            for name in profile.NAMES
            if (values := getattr(road, name)) is not None
        }
        origin = Origin(REST, (road.id,), road.origin.generation)
        notes = {REST: {"of": road.id, "from": start}}
        fields: dict[str, Any] = {
            "notes": notes,
            "conditions": moved_along(road.conditions, -start),
        }
        return ledger.issue(road.curvatures[first:], road.step, origin, **fields, **profiles)


class RandomSearch(Strategy):
    """A `Strategy` that proposes random roads and learns nothing.

    `RandomRoads` draws its roads: 187 m long in the mean on the map of 200 m. With the same seed,
    the random phase of ``Frenetic2021(max_redraws=10)`` has the same roads. The random roads of
    `Frenetic` are longer, 275 m in the mean. In a road class the search goes on with the
    `RoadContinuations` of failing roads.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        step: m between two curvature values.
        max_length: Largest usual number of values; a road has up to five more or fewer.
        is_valid: Refuses roads that are not worth a test, see `RandomRoads`.
        max_redraws: How often a refused road is drawn again; the paper checks none.
        road_class: Class of the roads, see `Strategy.road_class`.
        domain: Domain from which roads and conditions are drawn, see `Strategy.domain`.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its proposals change; campaigns record it."""

    def __init__(
        self,
        *,
        seed: Index,
        map_size: Positive | None = None,
        step: Positive | None = None,
        max_length: Size = MAX_LENGTH,
        is_valid: RoadCheck | None = None,
        max_redraws: Index = MAX_REDRAWS,
        road_class: RoadClass | None = None,
        domain: Domain | None = None,
    ) -> None:
        map_size, step = size_and_step(map_size, step, road_class)
        self.options = options_of(locals(), RandomSearch.__init__)
        self.road_class, self.domain = road_class, domain
        self._rng = np.random.default_rng(seed)
        self._roads = RandomRoads(
            map_size=map_size,
            step=step,
            max_length=max_length,
            is_valid=is_valid,
            max_redraws=max_redraws,
            road_class=road_class,
        )
        self._ledger = Ledger()
        self._rests = RoadContinuations(road_class)

    def keep_map_margin(self, map_margin: float) -> None:
        """Take only roads for valid that keep so many m from the map's edge.

        An `is_valid` of your own stays as it is.
        """
        self._roads.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which no road is valid, see `RandomRoads.require_valid_roads`."""
        self._roads.require_valid_roads()

    def ask(self) -> Candidate:
        """Return a random road."""
        rest = self._rests.issue(self._ledger)
        return rest or self._roads.issue(self._rng, self._ledger, self.domain)

    def tell(self, evaluation: Evaluation) -> None:
        """Settle the candidate; nothing is learnt.

        Raises:
            ValueError: See `Ledger.settle`.

        """
        self._rests.see(self._ledger.settle(evaluation), evaluation)
