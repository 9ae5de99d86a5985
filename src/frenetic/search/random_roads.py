"""Random roads, as the random phase of Listing 1 draws them, or in a road class."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Annotated, TypeAlias, TypeVar

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, Positive
from frenetic.conditions.domain import Domain
from frenetic.road import MAP_SIZE, Road
from frenetic.road.classes import RoadClass
from frenetic.road.conforming import conform
from frenetic.search.conditions import draw_conditions
from frenetic.search.elements import draw_elements, random_grade
from frenetic.search.map_check import MapCheck, RoadCheck, most_frequent
from frenetic.search.operator_names import RANDOM
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE, MIN_VALUES
from frenetic.search.records import Candidate, Origin
from frenetic.search.road_families import FAMILIES
from frenetic.search.strategy import Ledger, checked_options

STEP = 10.0
"""Distance between two curvature values, in m: the paper's Section I-B."""
LENGTH_JITTER = 5
"""Values by which a road may be longer or shorter than usual: the paper's Section I-B."""
MAX_LENGTH = 30
"""Largest number of values of a road, before the jitter: the paper's Section I-B."""
MAX_REDRAWS = 10
"""Times that a refused road is drawn again (our choice)."""

_MOST_REFUSED = 1000  # random roads refused in a row before `valid` gives up (our choice)
_PROBES = 300
"""Number of random roads of which `_LEAST_VALID` have to be valid (both are our choice).

A search draws a refused road again ten times: where fewer than one in 150 is valid, it proposes
hardly any road that can be driven."""
_LEAST_VALID = 2
"""Least number of valid roads among `_PROBES` with which a search may begin."""
_ENOUGH_VALID = 10
"""Least number of valid roads among `_PROBES` of a length that is recommended (our choice)."""
_SHORTEST_RECOMMENDED = 50.0
"""Shortest length of roads that is recommended, in m (our choice)."""
_MAX_START_STRAIGHT = 10
"""Largest number of values of the straight with which a class's road begins (our choice)."""

Size: TypeAlias = Annotated[int, Meta(ge=MIN_VALUES, le=10**6)]
"""Number of values of a road."""
Jitter: TypeAlias = Annotated[int, Meta(ge=0, le=1000)]
"""Number of values by which a road may be longer or shorter."""

_Draw = TypeVar("_Draw", "FloatArray", "FloatArray | None")


class RandomRoads:
    """Draws roads as the random phase of Listing 1 does, or roads of a road class.

    A road has min(map_size // step, max_length) + U{-length_jitter .. length_jitter} values, or
    `usual_length` in place of the first term, at least 2. Each is drawn as
    `operators.next_curvature` says, or as the road's family does, see `road_families`. A road of a
    class is about as long as the class says; it consists of straights, clothoids and arcs that keep
    the rules of the class.

    The paper moves a road that sticks out of the map, and discards it if it still does not fit
    (Section I-B). It does not check whether a road is valid before it sends it to the pipeline
    (Section II). We deviate from this unless ``max_redraws=0``: a road that `is_valid` refuses is
    drawn again, up to `max_redraws` times; the last draw is always returned.

    Args:
        map_size: m, side of the square map.
        step: m between two curvature values.
        length_jitter: Largest deviation from the usual number of values.
        max_length: Largest usual number of values, before the jitter.
        usual_length: Usual number of values, before the jitter; it replaces `max_length`.
        curvature_bound: 1/m, largest absolute value.
        max_change: 1/m, largest difference of neighbouring values.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        max_redraws: How often a refused road is drawn again.
        road_class: Class of the roads; it replaces step, lengths and limits of curvature.

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
        usual_length: Size | None = None,
        curvature_bound: Positive = CURVATURE_BOUND,
        max_change: Positive = MAX_CHANGE,
        is_valid: RoadCheck | None = None,
        max_redraws: Index = MAX_REDRAWS,
        road_class: RoadClass | None = None,
    ) -> None:
        checked_options(locals(), RandomRoads.__init__)  # raises if one is out of range
        self.step = float(step)
        """Distance between two curvature values, in m."""
        self._map_size = map_size
        self._length_jitter = length_jitter
        self._usual_length = min(int(map_size // step), max_length)
        if usual_length is not None:
            self._usual_length = usual_length
        self._road_class = road_class
        self.limits = np.array([curvature_bound, max_change])
        """Bound and largest change of values, (2,) in 1/m; in a class (4,), `RoadClass.limits`."""
        if road_class is not None:
            self.step = road_class.step
            self._usual_length = length_in_class(road_class)
            self.limits = road_class.limits(self.step)
        self._map_check = MapCheck(map_size, is_valid, road_class)
        self._max_redraws = max_redraws

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer than `map_margin` m to the map's edge.

        A user's `is_valid` stays as it is.
        """
        self._map_check.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which hardly any random road is valid.

        A user's `is_valid` is not asked; with one, nothing is refused.

        Raises:
            ValueError: Fewer than 2 of 300 random roads are valid; the message says why, and
                what is allowed.

        """
        map_check = self._map_check.built_in
        if map_check is None:
            return
        valid = 0
        refusals: Counter[str] = Counter()
        for values in self._probes(self):
            if refusal := map_check.refusal(values, self.step):
                refusals[refusal] += 1
                continue
            valid += 1
            if valid == _LEAST_VALID:
                return
        reasons = most_frequent(refusals)
        few = f"fewer than {_LEAST_VALID} of {_PROBES} random roads"
        road_class, size = self._road_class, map_check.map_size
        if road_class is None:
            raise ValueError(
                f"map_size is {size:g} m, and {few} are valid there: {reasons}; another map_size is"
                " needed"
            )
        allowed = self._allowed_length(road_class, map_check)
        needed = f"length={allowed:g} or less" if allowed else "a larger map_size"
        raise ValueError(
            f"the length of {road_class.name} is {road_class.length:g} m, and with a min_radius of"
            f" {road_class.min_radius:g} m ({road_class.design_speed:g} km/h) and a map_size of"
            f" {size:g} m {few} are valid: {reasons}; {needed} is needed"
        )

    def _allowed_length(self, road_class: RoadClass, map_check: MapCheck) -> float | None:
        """Return a length in m with which the roads of a class are valid; None if there is none.

        Halves of the class's length are tried, each in whole tens of metres.
        """
        length = road_class.length / 2.0
        while length >= _SHORTEST_RECOMMENDED:
            length = math.floor(length / 10.0) * 10.0
            shorter = RandomRoads(
                map_size=self._map_size, road_class=replace(road_class, length=length)
            )
            probes = self._probes(shorter)
            valid = sum(not map_check.refusal(values, self.step) for values in probes)
            if valid >= _ENOUGH_VALID:
                return length
            length /= 2.0
        return None

    @staticmethod
    def _probes(roads: RandomRoads) -> Iterator[FloatArray]:
        """Draw `_PROBES` random roads, the same ones at every call."""
        rng = np.random.default_rng(0)  # not the search's: its draws do not depend on the probes
        return (roads.draw_once(rng) for _ in range(_PROBES))

    def draw(self, rng: np.random.Generator, family: str = RANDOM) -> FloatArray:
        """Return the curvatures of a random road, (N,) 1/m.

        Args:
            rng: Generator that draws the road.
            family: Family of a road without a class, see `FAMILIES`. If all its draws are refused,
                the usual random roads are drawn.
        """
        families = dict.fromkeys((family, RANDOM))
        return self.redraw_until_valid(
            *(partial(self.draw_once, rng, family=name) for name in families)
        )

    def valid(self, rng: np.random.Generator) -> Iterator[Road]:
        """Draw roads, fit them into the map, and yield those that are valid there.

        Raises:
            ValueError: 1000 roads in a row are invalid.

        """
        refused = 0
        while refused < _MOST_REFUSED:
            road, refusal = self._map_check.place(self.draw(rng), self.step)
            if road is not None and not refusal:
                refused = 0
                yield road
            else:
                refused += 1
        raise ValueError(
            f"map_size is {self._map_size:g} m: none of {refused} random roads fits into it"
        )

    def redraw_until_valid(self, *draws: Callable[[], _Draw]) -> _Draw:
        """Return a road that is drawn again while it is invalid and draws are left.

        The last road of all is returned without a check.

        Args:
            draws: Functions that draw a road, each called up to 1 + `max_redraws` times in turn. A
                function may be a mutation: it returns None for a road that it cannot change, and
                then this method does, too.
        """
        attempts = [draw for draw in draws for _ in range(1 + self._max_redraws)]
        for draw in attempts[:-1]:
            drawn = draw()
            if drawn is None or self.accepts(drawn):
                return drawn
        return attempts[-1]()

    def accepts(self, curvatures: FloatArray) -> bool:
        """Return whether a road of these curvatures, (N,) 1/m, is worth a test."""
        return self._max_redraws == 0 or self._map_check(curvatures, self.step)

    @property
    def has_class(self) -> bool:
        """Whether the roads have a road class."""
        return self._road_class is not None

    def conformed(self, curvatures: FloatArray) -> FloatArray:
        """Return curvatures, (N,) 1/m, changed to keep the rules of the road class, if any."""
        if self._road_class is None:
            return curvatures
        return self._road_class.conformed(curvatures, self.step)

    def grade(self, rng: np.random.Generator, curvatures: FloatArray) -> FloatArray | None:
        """Return a random grade for a road of (N,) curvatures; None in a class of flat roads.

        The grade has (k, 2) values, see `frenetic.road.Road`. Roads without a class are flat.
        """
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
        family: str = RANDOM,
    ) -> Candidate:
        """Issue a random road of a family; in a domain with random conditions.

        See `draw` for the family, and `draw_conditions` for the conditions.
        """
        values = self.draw(rng, family)
        grade = self.grade(rng, values)
        conditions = draw_conditions(rng, domain, (len(values) - 1) * self.step, is_blind=is_blind)
        origin = Origin(family)
        return ledger.issue(values, self.step, origin, grade=grade, conditions=conditions)

    @property
    def max_uniforms(self) -> int:
        """Largest number of uniform numbers that `draw_once` takes; 0 without a road class."""
        if self._road_class is None:
            return 0
        return self._usual_length + self._length_jitter + _MAX_START_STRAIGHT

    def draw_once(
        self, rng: np.random.Generator, u: FloatArray | None = None, family: str = RANDOM
    ) -> FloatArray:
        """Return a random road, (N,) 1/m, which may be invalid.

        Args:
            rng: Generator that draws the road.
            u: Uniform numbers in 0..1 for a road of a class, at least `max_uniforms`; by default
                `rng` draws them.
            family: Family of a road without a class, see `FAMILIES`.
        """
        jitter = int(rng.integers(-self._length_jitter, self._length_jitter, endpoint=True))
        count = max(MIN_VALUES, self._usual_length + jitter)
        if self._road_class is None:
            bound, max_change = self.limits.tolist()
            return FAMILIES[family](rng, count, bound, max_change)
        if u is None:
            u = rng.random(count + _MAX_START_STRAIGHT)
        # The car starts on a straight: `first` values of 0. Elements follow.
        values = np.zeros(count)
        first = 1 + int(u[-1] * _MAX_START_STRAIGHT)
        draw_elements(
            values, first=first, end=count, previous=0.0, u=u, offset=0, limits=self.limits
        )
        conform(values, self.limits, wished=np.empty_like(values))
        return values


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


def length_in_class(road_class: RoadClass) -> int:
    """Return the usual number of values of a class's roads."""
    return max(round(road_class.length / road_class.step) + 1, MIN_VALUES)
