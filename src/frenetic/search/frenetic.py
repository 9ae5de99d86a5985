"""Our search: quality diversity over the paper's roads, in the measure of distinct failures."""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Count, Index, Positive, Share
from frenetic.conditions.domain import Domain
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.search.approach import SIZE, lower_squares, nearest_square
from frenetic.search.archive import FAR, LEFT, RIGHT, Archive, places_of
from frenetic.search.conditions import changed, drawn, inherited
from frenetic.search.failing import FailureModel
from frenetic.search.operators import MIN_VALUES
from frenetic.search.random_search import (
    EARLIER,
    GIVEN,
    LENGTH_JITTER,
    MAX_LENGTH,
    MapCheck,
    RandomRoads,
    Rests,
    RoadCheck,
    Size,
    size_and_step,
    usual_length,
)
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.speed_model import SpeedModel
from frenetic.search.strategy import Ledger, Strategy, options_of
from frenetic.search.variation import MIRROR, OF_FAILURES, OPERATORS, PARAMETERS, SPLICE, draw_child

_ROAD_PER_MAP = 1.45  # m of road for each m of the map's side
_MORE_VALUES = 6  # than the longest random road has
_POOL_AGE = 20  # drives for which a pool of parents serves
_RECENT = 1500  # drives from which the threshold is taken
_QUANTILE = 0.2
_CLOSING_QUANTILE = 0.03  # while no failure is known
_LEAST_POOL = 5  # parents then
_NEAR = -0.3  # [m]; a MOOBD below this is a near miss for any driver
_TOURNAMENT = 24
_FAILURE, _NEAR_MISS = 3.0, 1.5  # worth of a failure and, at most, of a near miss
_USE, _SUCCESS = 0.3, 0.15  # cost of a child, less what a new failure gives back
_KNOWN = 0.6  # cost of a known failure's first child
_LIKELY_OF = 6  # children of which the one is taken that most likely fails
_LOOKS = 40  # drives that foresight may take for one road
_TRIED_LAST = 50  # children by which chosen with and without foresight are compared
_TRUST = 3.0  # power of the shares of new failures among them
_LEAST_CONTROLS = 0.05  # share of children that are chosen without foresight, and with it
_NOTHING_NEW, _NEW = 1.0, 2.0  # [m] of difference from the known failures
_POWER = 2.5  # of an operator's success
_TRIED = 2.0  # earlier roads that count as driven, with a new failure each, before the first is
_LEAST_SHARE = 0.5  # of earlier roads among the first ones
_NEW_GRADE = 0.25  # share of children with a grade of their own, in a road class
_RANDOM_SHARE = 0.05  # of random roads after the first ones
_BLIND_SHARE = 0.5  # of them in a domain while no failure is known: conditions give no sign
_SAME = 1.6  # [m] least difference that a child is expected to have from the known failures
_REDRAWS = 36  # of a road or child that is refused
_PARENTS = 8  # that are tried before a random road is proposed
_FRESH = 0.45  # share of children of failures whose road is new but for what leads to the place
_RUN_UP = 4.6  # s of driving at the design speed that lead to it
_IN_OTHERS = 0.5  # share of children of a near miss that are its road in other conditions

CONDITIONS = "conditions"
"""The operator of a road in other conditions."""


@runtime_checkable
class Foresight(Protocol):
    """Tells what the driver under test will do on a road that it has not driven."""

    @property
    def is_ready(self) -> bool:
        """Whether it can tell."""

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Learn from a drive."""

    def foresee(self, candidate: Candidate) -> Evaluation | None:
        """What the driver will do; None where nothing would be driven."""

    def facts(self) -> Mapping[str, Any]:
        """What it has to tell of itself, see `Strategy.facts`."""


class _Child(NamedTuple):
    """A road that is proposed if nothing speaks against it."""

    row: int
    """Of its parent's place in the archive."""
    operator: int | None
    """Its number; None for the parent's road in other conditions."""
    curvatures: FloatArray
    own: Mapping[str, Any]
    """Grade and conditions."""
    side: int
    """Side on which it is expected to fail."""
    vector: FloatArray | None
    """The approach with which it is expected to; None if it is not told."""


class Frenetic(Strategy):
    """A `Strategy` that looks for failures unlike the known ones, for any driver.

    1. *Random roads*: `random_roads` of them at first, or for `random_budget` of the budget if that
       is less; later one in twenty.
    2. *Archive*: of each drive the place where the car left its lane or came nearest to it, and the
       next such place, with its `approach`: road, offsets and speeds before it.
    3. *Parent*: any failure or near miss, which is one of the worst fifth of the recent drives, or
       more than 0.3 m outside the lane; before the first failure, one of the worst 3 %. The best of
       24 is taken: near failing, far from the known failures, and seldom used.
    4. *Child*: an operator of `variation` changes the road around that place. Each is chosen in
       proportion to a power of the share of new failures that it has brought, counted apart for
       parents that failed and others.
    5. *Refusal*: where the child is expected to fail as a known failure did, another one is drawn,
       up to 36 times, then another parent taken. Expected are the child's own road, the
       parent's offsets, and the parent's speeds with the change that a `SpeedModel` predicts, from
       5 m before the parent's place to 15 m after it. Until a child is told, it counts as failing
       where it is expected to.
    6. *Foresight*, if there is any: children are looked at, up to 40 of them, until one will fail
       2 m from all known failures. How often it chooses follows from what it has brought in the
       last drives, against choice without it.

    Of a failure's children, nearly half have a new road but for the 90 m before the place and 30 m
    after it, in a road class 4.6 s of driving and a third of that.

    A failure is new if it differs from all known ones by 2 m, in part if it does by 1 m.

    With several candidates outstanding, each decision follows from the results told by then and
    from what the others are expected to do.

    *Warm start* (`start_from`): for `random_budget` of the budget, roads of earlier campaigns are
    driven again, severe and unlike each other first, each with a chance that is the share of new
    failures among those before it, and at least one half in place of the first random roads. What
    they do now counts, not what they did. The speed model learns from their earlier drives.

    *Real roads* (`start_from`, too): stretches of them are driven first, as they are.

    *Road classes*: roads are as long as the class says; behind a place where the car left its lane
    the drive goes on, see `frenetic.search.random_search.Rests`.

    `Frenetic2021` is the search of the paper.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        random_budget: Share of the budget that the first random roads may take, 0..1, and those
            of earlier campaigns.
        random_roads: Number of the first random roads.
        likely: Whether failures are parents first, and of six children the one is driven that will
            most likely fail: for those who count failures, alike or not.
        step: m between two curvature values.
        max_length: Largest usual number of values of a road; it has up to five more or fewer.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        road_class: Class of the roads, see `Strategy.road_class`; it takes the place of step and
            lengths.
        domain: Domain of roads and conditions, see `Strategy.domain`: then a child has its parent's
            conditions, and of one that did not fail another one is the same road in others. Until
            the first failure, half of the random roads have a condition that few drives have.
        foresight: Tells what the driver will do on a child's road.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 5
    """Raised when its proposals change; campaigns record it."""

    def __init__(
        self,
        *,
        seed: Index,
        map_size: Positive | None = None,
        random_budget: Share = 0.2,
        random_roads: Count = 30,
        likely: bool = False,
        step: Positive | None = None,
        max_length: Size = MAX_LENGTH,
        is_valid: RoadCheck | None = None,
        road_class: RoadClass | None = None,
        domain: Domain | None = None,
        foresight: Foresight | None = None,
    ) -> None:
        map_size, step = size_and_step(map_size, step, road_class)
        self.options = options_of(locals(), Frenetic.__init__)
        self.road_class, self.domain = road_class, domain
        self._rng = np.random.default_rng(seed)
        self._foresight = foresight
        self._failing = FailureModel(self._rng, len(OPERATORS)) if likely else None
        self._random_budget = random_budget
        self._first_roads = random_roads
        self._usual_length = max(min(int(_ROAD_PER_MAP * map_size / step), max_length), MIN_VALUES)
        if road_class is not None:
            self._usual_length = usual_length(road_class)
        self._is_valid = MapCheck(map_size, is_valid, road_class)
        self._roads = RandomRoads(
            map_size=(self._usual_length + 0.5) * step,
            step=step,
            max_length=self._usual_length,
            is_valid=self._is_valid,
            max_redraws=_REDRAWS,
            road_class=road_class,
        )
        # 90 m on the competition's roads, for which nobody says how fast they are driven:
        self._run_up = 90.0 if road_class is None else road_class.design_speed / 3.6 * _RUN_UP
        self._room = np.empty(self._usual_length + LENGTH_JITTER + _MORE_VALUES)
        self._ledger = Ledger()
        self._rests = Rests(road_class)
        self._archive = Archive()
        self._model = SpeedModel(self._rng)
        self._faults: set[Fault] = set()  # of the driver
        self._proposed: set[bytes] = set()  # fingerprints
        self._budget_spent = 0.0
        self._severities: list[float] = []  # of the drives
        self._lowest = math.inf  # of them
        self._is_moobd = True  # what is minimised
        self._pool = np.empty(0, dtype=np.int64)  # rows of the archive
        self._pool_end = 0  # number of drives after which it is too old
        self._origin, self._spread = 0.0, 1.0  # of the severities
        # By whether the parent had failed, and operator:
        self._used = np.zeros((2, len(OPERATORS)))
        self._brought = np.zeros((2, len(OPERATORS)))
        self._children: dict[int, tuple[_Child, bool]] = {}  # outstanding, and whether foreseen
        # Without foresight and with it, of each child: how new its failure was.
        self._brought_by: tuple[list[float], list[float]] = [], []
        self._earlier = Archive()  # of earlier campaigns, none of it believed
        self._earlier_left = 0  # roads of it that were not proposed
        self._driven_again, self._brought_again = 0, 0.0
        self._given: deque[Candidate] = deque()  # stretches of real roads

    def keep_margin(self, margin: float) -> None:
        """Take only roads for valid that keep so many m from the map's edge.

        An `is_valid` of your own stays as it is.
        """
        self._is_valid.keep_margin(margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which no road is valid, see `RandomRoads.require_valid_roads`."""
        self._roads.require_valid_roads()

    def start_from(self, earlier: Sequence[Evaluation]) -> None:
        """Take roads of earlier campaigns, see `Strategy.start_from`."""
        for evaluation in earlier:
            candidate, severity = evaluation.candidate, evaluation.severity
            if evaluation.outcome is Outcome.DROPPED:
                self._given.append(candidate)
            if not evaluation.outcome.is_driven or severity is None:
                continue
            worst = places_of(evaluation, candidate, severity)[0]
            self._earlier.add(candidate, worst._replace(has_failed=False))
            if evaluation.trace is not None:
                self._model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        self._earlier_left = len(self._earlier)
        roads = [*self._earlier.candidates, *self._given]
        longest = max((len(road.curvatures) for road in roads), default=0)
        self._room = np.empty(max(len(self._room), longest))

    def ask(self) -> Candidate:
        """Return the next road to try."""
        rest = self._rests.issue(self._ledger)
        if rest is not None:
            return rest
        if self._given:
            return self._given_road(self._given.popleft())
        if self._earlier_left and self._spent_when_told < self._random_budget:
            share = (self._brought_again + _TRIED) / (self._driven_again + _TRIED)
            if self._in_random_phase:
                share = max(share, _LEAST_SHARE)
            if self._rng.random() < share:
                return self._earlier_road()
        share = _BLIND_SHARE if self._is_blind else _RANDOM_SHARE
        if self._in_random_phase or self._rng.random() < share:
            return self._random_road()
        if len(self._severities) >= self._pool_end:
            self._choose_pool()
        return self._child() or self._random_road()

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: See `Ledger.settle`.

        """
        candidate = self._ledger.settle(evaluation)
        self._rests.see(candidate, evaluation)
        asked = self._children.pop(candidate.id, None)
        self._archive.settle(candidate.id)
        self._budget_spent = max(self._budget_spent, evaluation.budget_spent)
        severity = evaluation.severity
        if severity is not None and evaluation.outcome.is_driven:
            self._severities.append(severity)
            self._lowest = min(self._lowest, severity)
            self._is_moobd = evaluation.objective is None
        elif evaluation.outcome is not Outcome.FAIL:
            return
        brought, fault = 0.0, evaluation.fault
        if fault is None or fault not in self._faults:
            brought = self._keep(evaluation, candidate, severity or 0.0)
        if fault is not None:
            self._faults.add(fault)
        if evaluation.trace is not None:
            self._model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        if candidate.origin.operator == EARLIER:
            self._driven_again += 1
            self._brought_again += brought
        if self._foresight is not None:
            self._foresight.learn(candidate, evaluation)
        if asked is not None:
            child, is_foreseen = asked
            if self._failing is not None:
                has_failed = evaluation.outcome is Outcome.FAIL
                self._failing.learn(self._features(child), has_failed=has_failed)
            self._brought_by[is_foreseen].append(brought)
            if child.operator is None:
                return
            had_failed = int(self._archive.places["has_failed"][child.row])
            self._used[had_failed, child.operator] += 1.0
            self._brought[had_failed, child.operator] += brought
            self._archive.places["cost"][child.row] -= _SUCCESS * brought

    def _keep(self, evaluation: Evaluation, candidate: Candidate, severity: float) -> float:
        """Keep the places of a drive; return how new the failure is there, 0 to 1."""
        row = len(self._archive)
        worst, *others = places_of(evaluation, candidate, severity)
        difference = self._archive.add(candidate, worst)
        if self._is_moobd:
            for place in others:
                self._archive.add(candidate, place)
        if evaluation.outcome is not Outcome.FAIL:
            return 0.0
        brought = min(max((difference - _NOTHING_NEW) / (_NEW - _NOTHING_NEW), 0.0), 1.0)
        self._archive.places["cost"][row] = _KNOWN * (1.0 - brought)
        return brought

    def facts(self) -> Mapping[str, Any]:
        """Return what foresight came to; nothing without it."""
        if self._foresight is None:
            return {}
        counts = {
            f"{what} {how} foresight": number
            for how, brought in zip(("without", "with"), self._brought_by, strict=True)
            for what, number in (("children", len(brought)), ("new failures", round(sum(brought))))
        }
        return {**self._foresight.facts(), **counts}

    @property
    def notice(self) -> str | None:
        """Why the search is not what its user expects, None if it is."""
        if not self._severities or self._in_random_phase or self._archive.has_failures:
            return None
        if not self._is_moobd or self._lowest < 0.0:
            return None
        return (
            "nothing close to failing yet: the search follows the roads on which the car comes"
            " nearest to its lane's edge"
        )

    @property
    def _in_random_phase(self) -> bool:
        driven = len(self._severities)
        return driven == 0 or (
            driven + len(self._ledger) < self._first_roads
            and self._spent_when_told < self._random_budget
        )

    @property
    def _spent_when_told(self) -> float:
        """Share of the budget that will be spent when what is out is told; 0 before a drive."""
        driven = len(self._severities)
        return self._budget_spent * (driven + len(self._ledger)) / driven if driven else 0.0

    def _random_road(self) -> Candidate:
        road = self._roads.issue(self._rng, self._ledger, self.domain, is_blind=self._is_blind)
        self._proposed.add(fingerprint(road.curvatures))
        return road

    @property
    def _is_blind(self) -> bool:
        """Whether it searches conditions, and no failure says which."""
        return self.domain is not None and not self._archive.has_failures

    def _given_road(self, road: Candidate) -> Candidate:
        """A stretch of a real road, as it is."""
        self._proposed.add(fingerprint(road.curvatures))
        own = {name: getattr(road, name) for name in ("notes", *profile.NAMES)}
        is_blind = self._is_blind
        own["conditions"] = drawn(self._rng, self.domain, road.length, is_blind=is_blind)
        return self._ledger.issue(road.curvatures, road.step, Origin(GIVEN), **own)

    def _earlier_road(self) -> Candidate:
        """The best road of earlier campaigns that was not proposed: severe, and unlike others."""
        places, squares = self._earlier.places, self._earlier.squares
        worth = np.minimum(-places["severity"], _NEAR_MISS) + np.sqrt(squares) - places["cost"]
        row = int(np.argmax(worth))
        places["cost"][row] = math.inf
        self._earlier_left -= 1
        side = int(places["side"][row])
        vectors = self._earlier.vectors
        lower_squares(squares, places["side"], vectors, side, vectors[row])
        road = self._earlier.candidates[row]
        self._proposed.add(fingerprint(road.curvatures))
        own = {name: getattr(road, name) for name in ("conditions", *profile.NAMES)}
        return self._ledger.issue(road.curvatures, self._roads.step, Origin(EARLIER), **own)

    def _choose_pool(self) -> None:
        """Choose the places that may become parents until the next choice."""
        self._pool_end = len(self._severities) + _POOL_AGE
        recent = np.array(self._severities[-_RECENT:])
        usual, middle = (float(q) for q in np.quantile(recent, (_QUANTILE, 0.5)))
        if not self._is_moobd:
            self._origin, self._spread = usual, max(middle - usual, 1e-9)
        if not self._archive.has_failures:
            share = max(_CLOSING_QUANTILE, min(_LEAST_POOL / len(recent), 1.0))
            threshold = float(np.quantile(recent, share))
        else:
            threshold = max(usual, _NEAR) if self._is_moobd else usual
        places = self._archive.places
        self._pool = np.flatnonzero(places["has_failed"] | (places["severity"] <= threshold))

    def _choose_parent(self) -> int:
        """Choose the best of a few places of the pool, by its row."""
        rows = self._pool[self._rng.integers(0, len(self._pool), _TOURNAMENT)]
        places = self._archive.places[rows]
        worth = np.minimum((self._origin - places["severity"]) / self._spread, _NEAR_MISS)
        if self._archive.has_failures:
            worth += np.sqrt(self._archive.squares[rows])
        # In a domain most that did not fail is far from it: its conditions are as usual.
        comes_first = self.domain is not None or self._failing is not None
        worth[places["has_failed"]] = _FAILURE + FAR if comes_first else _FAILURE
        return int(rows[np.argmax(worth - places["cost"])])

    def _child(self) -> Candidate | None:
        """A child of a place of the archive, None if all draws were refused."""
        children = (
            child
            for _ in range(_PARENTS if len(self._pool) else 0)
            for child in self._children_of(self._choose_parent())
        )
        if self._looks_ahead():
            return self._foreseen(children)
        tried = 1 if self._failing is None or not self._failing.is_ready else _LIKELY_OF
        child = max(islice(children, tried), key=self._chance, default=None)
        return None if child is None else self._issue(child)

    def _foreseen(self, children: Iterator[_Child]) -> Candidate | None:
        """The first child that will fail as no known failure does, or the most promising one."""
        best, most = None, -math.inf
        for child in islice(children, _LOOKS):
            worth, seen = self._promise_of(child)
            if best is None or worth > most:
                best, most = seen, worth
            if worth >= _NEW:
                break
        return None if best is None else self._issue(best, is_foreseen=True)

    def _chance(self, child: _Child) -> float:
        """The chance that a child fails; 0 if nobody asks for it."""
        return 0.0 if self._failing is None else self._failing.chance(self._features(child))

    def _features(self, child: _Child) -> FloatArray:
        """What the chance follows from, see `FailureModel`."""
        assert self._failing is not None
        vector = self._archive.vectors[child.row] if child.vector is None else child.vector
        severity = float(self._archive.places["severity"][child.row])
        return self._failing.features(vector, child.side, child.operator, severity)

    def _looks_ahead(self) -> bool:
        """Whether foresight chooses the next child: the more surely, the more it has brought."""
        if self._foresight is None or not self._foresight.is_ready:
            return False
        last = (brought[-_TRIED_LAST:] for brought in self._brought_by)
        without, with_it = (((sum(one) + 1.0) / (len(one) + 2.0)) ** _TRUST for one in last)
        share = with_it / (without + with_it)
        share = min(max(share, _LEAST_CONTROLS), 1.0 - _LEAST_CONTROLS)
        return bool(self._rng.random() < share)

    def _promise_of(self, child: _Child) -> tuple[float, _Child]:
        """How new a failure a child promises by foresight, in m, and the child as foreseen.

        Below 0 it will not fail: then it is by how much.
        """
        assert self._foresight is not None
        candidate = Candidate(0, child.curvatures, self._roads.step, Origin(""), **child.own)
        seen = self._foresight.foresee(candidate)
        if seen is None or seen.severity is None:
            return -math.inf, child
        place = places_of(seen, candidate, seen.severity)[0]
        child = child._replace(side=place.side, vector=place.vector)
        if not place.has_failed:
            return min(-place.severity, -0.0), child
        known = self._archive.failures(place.side)
        return math.sqrt(nearest_square(known, place.vector, FAR * FAR)), child

    def _children_of(self, row: int) -> Iterator[_Child]:
        """Children of a place of the archive, which are expected to fail as no known failure."""
        archive, rng, draws, step = self._archive, self._rng, 1 + _REDRAWS, self._roads.step
        place, parent = archive.places[row], archive.candidates[row]
        had_failed, side = int(place["has_failed"]), int(place["side"])
        if self.domain is not None and not had_failed and rng.random() < _IN_OTHERS:
            yield self._in_other_conditions(row)
            return
        operators = np.searchsorted(self._shares(had_failed), rng.random(draws), side="right")
        u = rng.random((draws, PARAMETERS + 2 * len(self._room)))
        kept = np.where(rng.random(draws) < had_failed * _FRESH, self._run_up, 0.0)
        lengths = self._usual_length + rng.integers(-LENGTH_JITTER, LENGTH_JITTER + 1, draws)
        others = np.zeros((draws, len(self._room)))
        sizes, sites = np.zeros(draws, dtype=np.int64), np.zeros(draws, dtype=np.int64)
        mates = self._pool[rng.integers(0, len(self._pool), draws)]
        for k in np.flatnonzero(operators == SPLICE).tolist():
            mate = archive.candidates[mates[k]]
            sizes[k] = len(mate.curvatures)
            others[k, : sizes[k]] = mate.curvatures
            sites[k] = int(archive.places["distance"][mates[k]] / mate.step)
        opposite = {LEFT: RIGHT, RIGHT: LEFT}.get(side, side)
        known = archive.failures(side), archive.failures(opposite)
        # A class's bends look much alike: without a failure, what is out forbids too many.
        if self.road_class is not None and not archive.has_failures:
            known = known[0][:0], known[1][:0]
        expected = np.empty(SIZE)
        first = 0
        while first < draws:
            k, n, moved = draw_child(
                operators[first:],
                u[first:],
                parent.curvatures,
                step,
                float(place["distance"]),
                archive.vectors[row],
                others[first:],
                sizes[first:],
                sites[first:],
                lengths[first:],
                self._roads.limits,
                *known,
                _SAME,
                kept[first:],
                self._model.weights if self._model.is_ready else np.empty(0),
                self._room,
                expected,
            )
            if k < 0:
                return
            curvatures, operator = self._room[:n].copy(), int(operators[first + k])
            if fingerprint(curvatures) not in self._proposed and self._is_valid(curvatures, step):
                inherited_values = self._inherited(parent, curvatures, moved * step)
                there = opposite if operator == MIRROR else side
                yield _Child(row, operator, curvatures, inherited_values, there, expected.copy())
            first += k + 1

    def _inherited(
        self, parent: Candidate, curvatures: FloatArray, moved: float
    ) -> Mapping[str, Any]:
        """Grade, limits and conditions of a child whose place lies ``moved`` m further along it."""
        grade, limits = parent.grade, parent.speed_limits
        if self.road_class is not None and self._rng.random() < _NEW_GRADE:
            grade = self._roads.grade(self._rng, curvatures)
        elif grade is not None and len(grade):
            grade = np.column_stack([grade[:, 0] + moved, grade[:, 1]])
        length = (len(curvatures) - 1) * self._roads.step
        conditions = inherited(self._rng, self.domain, parent, length, moved)
        values: dict[str, Any] = {"grade": grade, "conditions": conditions}
        if limits is not None and len(limits):
            values[profile.LIMITS] = profile.moved_steps(limits, moved)
        return values

    def _in_other_conditions(self, row: int) -> _Child:
        """The road of a place of the archive in other conditions."""
        assert self.domain is not None
        archive, parent = self._archive, self._archive.candidates[row]
        mate = archive.candidates[int(self._rng.choice(self._pool))]
        place = archive.places[row]
        own: dict[str, Any] = {name: getattr(parent, name) for name in profile.NAMES}
        there = float(place["distance"])
        own["conditions"] = changed(self._rng, self.domain, parent, mate, there)
        return _Child(row, None, parent.curvatures, own, int(place["side"]), None)

    def _issue(self, child: _Child, *, is_foreseen: bool = False) -> Candidate:
        """Propose a child."""
        row, operator = child.row, child.operator
        parent = self._archive.candidates[row]
        name = CONDITIONS if operator is None else OPERATORS[operator]
        origin = Origin(name, (parent.id,), parent.origin.generation + 1)
        issued = self._ledger.issue(child.curvatures, self._roads.step, origin, **child.own)
        self._proposed.add(fingerprint(child.curvatures))
        self._archive.places["cost"][row] += _USE
        self._children[issued.id] = child, is_foreseen
        if child.vector is not None:
            self._archive.expect(issued.id, child.side, child.vector)
        return issued

    def _shares(self, had_failed: int) -> FloatArray:
        """Running sum of the shares of the operators, (k,), the last 1."""
        count = OF_FAILURES if had_failed else len(OPERATORS)
        brought, used = self._brought[had_failed, :count], self._used[had_failed, :count]
        sums = np.cumsum(((brought + 1.0) / (used + 6.0)) ** _POWER)
        shares: FloatArray = sums / sums[-1]
        return shares


def fingerprint(curvatures: FloatArray) -> bytes:
    """16 bytes that no two different roads share."""
    values = np.ascontiguousarray(curvatures, dtype="<f8") + 0.0  # no negative zeros
    return hashlib.blake2b(values.tobytes(), digest_size=16).digest()
