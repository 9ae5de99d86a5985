"""The strategy that measures margins: on each road it scans a quantity's range, then bisects.

On each road the usual drive comes first. A road that passes it is driven at `SCANNED` amounts over
the whole range, and then between the least failing amount and the passing amount before it. The
scan finds failures below a range that passes, since failing need not be monotonic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

import numpy as np

from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import SEED, known_conditions, without
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.margin_quantities import RADIUS, MarginQuantity
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.search.conditions import draw_conditions
from frenetic.search.operator_names import RANDOM
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Evaluation, Origin, SourceTest
from frenetic.search.strategy import Ledger, SearchEnded, Strategy

SCANNED: Final = 6
"""Number of amounts, evenly over the range, that are driven on each road; our choice."""
MOST_DRIVES: Final = 14
"""Largest number of drives on a road per quantity: usual, scanned, and up to 7 of a bisection."""
OPERATOR: Final = "margin"
"""Operator in the origin of roads that come from another campaign."""
_MAX_REDRAWS: Final = 1000
"""Largest number of roads that are drawn in a row until one is valid; our choice."""
_LEAST_RADIUS: Final = 2.0
"""Least radius of a road of any size, as a multiple of the lane's width; our choice."""
_LEAST_CLOTHOID: Final = 1.0
"""Least parameter of a clothoid of a road of any size, in m; our choice."""
_LEAST_CREST: Final = 1.0
"""Least radius of a crest or sag of a road of any size, in m; our choice."""
_SEEDS: Final = 2**31
"""Number of seeds from which the seed of noise is drawn; our choice."""


@dataclass(frozen=True, eq=False)
class MarginRoad:
    """A road on which margins are measured."""

    candidate: Candidate
    """Road and usual conditions; the id is preliminary."""
    place: float
    """Place of a condition such as a gust along the road, in m."""
    seed: int
    """Seed of random conditions such as noise."""

    @property
    def test(self) -> int:
        """Id of the test from which the road comes; 0 for a random road."""
        source = self.candidate.source
        return 0 if source is None else source.test

    def at_test(self, candidate: Candidate, campaign: str) -> MarginRoad:
        """Return the road of a campaign's test, with this road's place and seed."""
        source = SourceTest(campaign, candidate.id)
        return replace(self, candidate=replace(candidate, origin=Origin(OPERATOR), source=source))

    @classmethod
    def draw(cls, rng: np.random.Generator, candidate: Candidate) -> MarginRoad:
        """Return the road with a random place and seed."""
        place = round(float(rng.random()) * candidate.length, 1)
        return cls(candidate, place, int(rng.integers(_SEEDS)))

    def at(self, quantity: MarginQuantity, share: float) -> Candidate:
        """Return the candidate for the drive at a share of a quantity's range."""
        if quantity.condition == RADIUS.name:
            return _scaled(self.candidate, quantity.amount(share))
        return replace(self.candidate, conditions=self._conditions(quantity, share))

    def _conditions(self, quantity: MarginQuantity, share: float) -> dict[str, float]:
        """Return the conditions of the drive at a share of a quantity's range."""
        name = quantity.condition
        recorded = self.candidate.conditions
        conditions = without(recorded, name)
        if share <= 0.0:
            return conditions
        conditions[name] = quantity.amount(share)
        for place in known_conditions().values():
            if place.place_of == name:
                conditions[place.name] = recorded.get(place.name, self.place)
        if quantity.declaration.is_seeded:
            conditions[SEED] = recorded.get(SEED, self.seed)
        return conditions


def _scaled(candidate: Candidate, factor: float) -> Candidate:
    """Return a candidate whose road is smaller by a factor, with lanes and slopes as they are.

    The smaller road follows a straight, so that the whole is about as long as before and the car
    comes as fast. Places of conditions such as gusts stay on the same bends.
    """
    if factor == 1.0:
        return candidate
    step = candidate.step * factor
    straight = round((1.0 - factor) * candidate.length / step)  # steps of the straight
    start = straight * step
    profiles = {
        name: values * (factor, 1.0) + (start, 0.0)
        for name in profile.NAMES
        if (values := getattr(candidate, name)) is not None
    }
    places = [name for name, known in known_conditions().items() if known.place_of]
    conditions = {
        name: start + factor * amount if name in places else amount
        for name, amount in candidate.conditions.items()
    }
    curvatures = np.concatenate([np.zeros(straight), candidate.curvatures / factor])
    return replace(
        candidate,
        curvatures=curvatures,
        step=step,
        points=None,  # the road lies elsewhere on the map
        conditions=conditions,
        **profiles,
    )


@dataclass
class AmountSearch:
    """Search for the least failing amount of a quantity on a road."""

    road: MarginRoad
    """The road."""
    quantity: MarginQuantity
    """The quantity."""
    failed: dict[float, bool] = field(default_factory=dict)
    """Share of the range that was driven -> whether the drive failed."""
    drives: dict[float, int] = field(default_factory=dict)
    """Share of the range that was driven -> id of the drive."""
    awaited: int = 1
    """Number of drives without a result, the usual drive among them."""

    @property
    def least_failing(self) -> float | None:
        """Least share of the range that failed; None if none failed."""
        return min((share for share, failed in self.failed.items() if failed), default=None)

    @property
    def passing(self) -> float | None:
        """Largest share that passed below all that failed; None if the usual drive failed."""
        failing = self.least_failing
        passed = [share for share, failed in self.failed.items() if not failed]
        return max((s for s in passed if failing is None or s < failing), default=None)

    @property
    def passes_again(self) -> float | None:
        """Least share that passed above a failing one; None if there is none."""
        failing = self.least_failing
        passed = [share for share, failed in self.failed.items() if not failed]
        return min((s for s in passed if failing is not None and s > failing), default=None)

    def next_shares(self) -> list[float]:
        """Return the shares of the range to drive next; empty once the amount is known."""
        if self.failed[0.0]:
            return []
        if len(self.failed) == 1:
            return [i / SCANNED for i in range(1, SCANNED + 1)]
        failing, passing = self.least_failing, self.passing
        if failing is None:
            return []
        assert passing is not None
        if self.quantity.is_resolved(passing, failing):
            return []
        return [0.5 * (passing + failing)]


@dataclass
class _WantedDrive:
    """A drive that is wanted, and the searches that wait for its result."""

    candidate: Candidate
    """Road and conditions; the id is preliminary."""
    searches: list[tuple[AmountSearch, float]]
    """Searches, each with the share of its range that the drive stands for."""


class MarginSearch(Strategy):
    """Strategy that measures at which amounts a driver begins to fail, road by road.

    A drive in which the simulator broke is proposed again.

    Args:
        quantities: what is measured.
        random_roads: roads that were drawn at random.
        demanding_roads: further roads, on which the driver came near failing.
        options: values that distinguish the search from others.
    """

    BEHAVIOUR: Final = 1
    expects_failures: ClassVar[bool] = True

    def __init__(
        self,
        quantities: Sequence[MarginQuantity],
        random_roads: Sequence[MarginRoad],
        demanding_roads: Sequence[MarginRoad],
        options: Mapping[str, Any],
    ) -> None:
        self.options = dict(options)
        self.random_searches = _searches(quantities, random_roads)
        """MarginQuantity -> its searches on the random roads, in the order of the roads."""
        self.demanding_searches = _searches(quantities, demanding_roads)
        """MarginQuantity -> its searches on the demanding roads, in the order of the roads."""
        self._ledger = Ledger()
        self._drives = deque[_WantedDrive]()  # wanted and not proposed
        self._in_flight: dict[
            int, _WantedDrive
        ] = {}  # id of a candidate without result -> its drive
        usual: dict[tuple[int, frozenset[tuple[str, float]]], _WantedDrive] = {}
        for searches in zip(*self.random_searches.values(), strict=True):
            self._want_usual(searches, usual)
        for searches in zip(*self.demanding_searches.values(), strict=True):
            self._want_usual(searches, usual)

    def _want_usual(
        self,
        searches: Iterable[AmountSearch],
        usual: dict[tuple[int, frozenset[tuple[str, float]]], _WantedDrive],
    ) -> None:
        """Want the usual drive of a road once for all searches with equal usual conditions.

        Args:
            searches: searches on the road, one for each quantity.
            usual: usual drives of all roads by road and conditions, to which drives are added.
        """
        for search in searches:
            candidate = search.road.at(search.quantity, 0.0)
            key = id(search.road), frozenset(candidate.conditions.items())
            if key not in usual:
                usual[key] = _WantedDrive(candidate, [])
                self._drives.append(usual[key])
            usual[key].searches.append((search, 0.0))

    @property
    def is_begun(self) -> bool:
        """Whether a drive was proposed."""
        return self._ledger.issued > 0

    @property
    def is_complete(self) -> bool:
        """Whether all amounts are known."""
        return not self._drives and not self._in_flight

    def ask(self) -> Candidate | None:
        """Return the next drive; None while the next drives depend on results."""
        if not self._drives:
            if self._in_flight:
                return None
            raise SearchEnded("all margins are measured")
        drive = self._drives.popleft()
        road = drive.candidate
        candidate = self._ledger.issue(
            road.curvatures,
            road.step,
            road.origin,
            road.points,
            conditions=road.conditions,
            repeat=road.repeat,
            source=road.source,
            **{name: getattr(road, name) for name in profile.NAMES},
        )
        self._in_flight[candidate.id] = drive
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of a drive; further drives of its searches may follow from it.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        candidate = self._ledger.settle(evaluation)
        drive = self._in_flight.pop(candidate.id)
        if evaluation.outcome is Outcome.ERROR:
            repeated = replace(candidate, repeat=candidate.repeat + 1)
            self._drives.append(_WantedDrive(repeated, drive.searches))
            return
        for search, share in drive.searches:
            search.failed[share] = evaluation.outcome is Outcome.FAIL
            search.drives[share] = candidate.id
            search.awaited -= 1
            if not search.awaited:
                shares = search.next_shares()
                search.awaited = len(shares)
                self._drives += [
                    _WantedDrive(search.road.at(search.quantity, i), [(search, i)]) for i in shares
                ]


def _searches(
    quantities: Sequence[MarginQuantity], roads: Sequence[MarginRoad]
) -> dict[MarginQuantity, list[AmountSearch]]:
    """Return quantity -> its searches on these roads."""
    return {quantity: [AmountSearch(road, quantity) for road in roads] for quantity in quantities}


def in_any_size(tester: RoadTester, road_class: RoadClass) -> RoadTester:
    """Return a tester whose roads may be smaller than the rules of their class allow.

    Such roads need the profiles of their class, see `with_class_profiles`.
    """
    relaxed = replace(
        road_class,
        name=f"{road_class.name}, any radius",
        min_radius=_LEAST_RADIUS * road_class.lane_width,
        min_clothoid=_LEAST_CLOTHOID,
        min_arc=0.0,
        min_straight=0.0,
        min_crest=_LEAST_CREST,
        min_sag=_LEAST_CREST,
        widening=0.0,
    )
    return replace(tester, terms=replace(tester.terms, road_class=relaxed))


def with_class_profiles(roads: Iterable[MarginRoad], road_class: RoadClass) -> list[MarginRoad]:
    """Return roads with the superelevation and widening that their class gives them."""
    profiled = []
    for road in roads:
        candidate = road.candidate
        profiles = {
            name: values
            for name, values in road_class.profiles(candidate.curvatures, candidate.step).items()
            if getattr(candidate, name) is None
        }
        profiled.append(replace(road, candidate=replace(candidate, **profiles)))
    return profiled


def draw_roads(tester: RoadTester, count: int, seed: int) -> list[MarginRoad]:
    """Return random roads that the tester can drive, in conditions of its domain, if it has one.

    More roads with the same seed begin with the same roads.

    Raises:
        ValueError: none of `_MAX_REDRAWS` roads in a row is valid.
    """
    terms = tester.terms
    rng = np.random.default_rng(seed)
    roads = RandomRoads(map_size=terms.map_size, road_class=terms.road_class)
    drawn: list[MarginRoad] = []
    refused = 0
    while len(drawn) < count:
        values = roads.draw_once(rng)
        grade = roads.grade(rng, values)
        conditions = draw_conditions(rng, terms.domain, (len(values) - 1) * roads.step)
        candidate = Candidate(
            1, values, roads.step, Origin(RANDOM), conditions=conditions, grade=grade
        )
        road, verdict = tester.fit_road(candidate)
        if road is not None and verdict.valid:
            drawn.append(MarginRoad.draw(rng, candidate))
            refused = 0
            continue
        refused += 1
        if refused == _MAX_REDRAWS:
            raise ValueError(
                f"none of {refused} random roads is valid on a map of {terms.map_size:g} m:"
                f" {verdict.message}"
            )
    return drawn
