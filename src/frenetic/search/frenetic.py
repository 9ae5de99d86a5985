"""Our search: quality diversity over the paper's roads, in the measure of distinct failures."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, ClassVar, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Count, Index, Positive, Share
from frenetic.conditions.domain import Domain
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.search.approach import SIZE
from frenetic.search.archive import LEFT, RIGHT, Archive, critical_places
from frenetic.search.conditions import changed, drawn, inherited
from frenetic.search.continuations import RoadContinuations
from frenetic.search.earlier_roads import EarlierRoads
from frenetic.search.failing import FailureModel
from frenetic.search.known_failures import NOTHING
from frenetic.search.map_check import MapCheck, RoadCheck
from frenetic.search.operator_choice import OperatorChoice
from frenetic.search.operator_names import CONDITIONS, EARLIER, GIVEN
from frenetic.search.operators import MIN_VALUES
from frenetic.search.parents import ParentPool
from frenetic.search.prediction import Foresight, ForesightTrial, promise_of
from frenetic.search.proposed import ProposedRoads
from frenetic.search.random_roads import (
    LENGTH_JITTER,
    MAX_LENGTH,
    RandomRoads,
    Size,
    size_and_step,
    usual_length,
)
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.speed_model import SpeedModel
from frenetic.search.strategy import Ledger, Strategy, checked_options
from frenetic.search.variation import MIRROR, OPERATORS, PARAMETERS, SPLICE, draw_child

# All values are ours; research/search.md measures `_FRESH_SHARE` and `_RUN_UP_TIME`.
_ROAD_PER_MAP = 1.45  # [m] of road for each m of the map's side
_MORE_VALUES = 6  # that a child may have beyond the longest random road
_USE_COST = 0.3  # of a child, for its parent
_SUCCESS_REFUND = 0.15  # of that cost, for a child with a new failure
_KNOWN_FAILURE_COST = 0.6  # of the first child of a failure that was known already
_LIKELY_OF = 6  # children of which the one is taken that most likely fails
_FORESEEN_OF = 40  # children that foresight may look at for one road
_NOTHING_NEW = 1.0  # [m] of difference from the known failures, up to which nothing is new
_NEW = 2.0  # [m] of difference from the known failures, from which a failure is new
_NEW_GRADE_SHARE = 0.25  # of children with a grade of their own, in a road class
_RANDOM_SHARE = 0.05  # of random roads after the first ones
_BLIND_SHARE = 0.5  # of random roads while no failure tells which conditions matter
_LEAST_DIFFERENCE = 1.6  # [m] from the known failures that a child is expected to have
_REDRAWS = 36  # of a road or child that is refused
_PARENTS = 8  # that are tried before a random road is proposed
_FRESH_SHARE = 0.45  # of children of failures with a new road but for the run-up to the place
_RUN_UP = 90.0  # [m] of road before the place that such a child keeps
_RUN_UP_TIME = 4.6  # [s] of driving at the design speed that it keeps in a road class
_OTHER_CONDITIONS_SHARE = 0.5  # of a near miss's children that are its road in other conditions


class _Child(NamedTuple):
    """A road that may be proposed."""

    row: int
    """Row of the parent's place in the archive."""
    operator: int | None
    """Number of the operator; None for the parent's road in other conditions."""
    curvatures: FloatArray
    """Curvatures, (n,) in 1/m."""
    fields: Mapping[str, Any]
    """Further fields of the `Candidate`, such as grade and conditions."""
    side: int
    """Side on which the car is expected to leave its lane."""
    vector: FloatArray | None
    """Approach with which the car is expected to fail; None in other conditions."""


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
       parents that failed and for others.
    5. *Refusal*: a child that is expected to fail as a known failure did is drawn again, up to 36
       times; then another parent is taken. The expectation combines the child's road, the parent's
       offsets, and the parent's speeds with the change that a `SpeedModel` predicts, from 5 m
       before the parent's place to 15 m after it. Until the result of a child is known, the child
       counts as failing there.
    6. *Foresight*, if there is any, looks at up to 40 children until it expects one to fail 2 m
       from all known failures. The more new failures it has brought in the last drives, compared
       with choice without it, the more often it chooses.

    Nearly half of a failure's children keep their parent's road only from 90 m before the place to
    30 m after it (in a road class 4.6 s of driving, and a third of that), and are new elsewhere.

    A failure is new if it differs from all known ones by 2 m, in part if it does by 1 m.

    With several candidates outstanding, each decision follows from the results told by then and
    from what the others are expected to do.

    *Warm start* (`start_from`): for `random_budget` of the budget, roads of earlier campaigns are
    driven again, severe and unlike each other first, each with a chance that is the share of new
    failures among those before it, and at least one half in place of the first random roads. Only
    their new drives count as results. The speed model learns from the earlier drives, too.

    *Real roads* (`start_from`, too): stretches of them are driven first, as they are.

    *Road classes*: roads are as long as the class says. The rest of a road, after the place where
    the car left its lane, is the next test, see `frenetic.search.continuations.RoadContinuations`.

    `Frenetic2021` is the search of the paper.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        random_budget: Share of the budget that the first random roads may take, 0..1, and those
            of earlier campaigns.
        random_roads: Number of the first random roads.
        likely: Whether failures are parents first, and the likeliest to fail of six children is
            driven: for users who count failures, alike or not.
        step: m between two curvature values.
        max_length: Largest usual number of values of a road; it has up to five more or fewer.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        road_class: Class of the roads, see `Strategy.road_class`; it takes the place of step and
            lengths.
        domain: Domain of roads and conditions, see `Strategy.domain`: then a child has its parent's
            conditions, and half of a near miss's children are its road in other conditions. Until
            the first failure, half of the random roads have a condition that few drives have.
        foresight: Expects what the driver will do on a child's road.

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
        self.options = checked_options(locals(), Frenetic.__init__)
        self.road_class, self.domain = road_class, domain
        self._rng = np.random.default_rng(seed)
        self._foresight = foresight
        self._failing = FailureModel(self._rng, len(OPERATORS)) if likely else None
        self._random_budget = random_budget
        self._first_roads = random_roads
        self._usual_length = max(min(int(_ROAD_PER_MAP * map_size / step), max_length), MIN_VALUES)
        if road_class is not None:
            self._usual_length = usual_length(road_class)
        self._map_check = MapCheck(map_size, is_valid, road_class)
        self._roads = RandomRoads(
            map_size=(self._usual_length + 0.5) * step,
            step=step,
            max_length=self._usual_length,
            is_valid=self._map_check,
            max_redraws=_REDRAWS,
            road_class=road_class,
        )
        self._run_up = _RUN_UP  # nobody says how fast the competition's roads are driven
        if road_class is not None:
            self._run_up = road_class.design_speed / 3.6 * _RUN_UP_TIME
        self._room = np.empty(self._usual_length + LENGTH_JITTER + _MORE_VALUES)
        self._ledger, self._continuations = Ledger(), RoadContinuations(road_class)
        self._archive = Archive()
        self._model = SpeedModel(self._rng)
        self._faults: set[Fault] = set()  # of the driver
        self._proposed = ProposedRoads()
        self._budget_spent = 0.0
        # In a domain most near misses are far from failing: their conditions are as usual.
        failures_first = domain is not None or likely
        self._parents = ParentPool(self._archive, self._rng, failures_first=failures_first)
        self._operators = OperatorChoice()
        self._children: dict[int, tuple[_Child, bool]] = {}  # outstanding, and whether foreseen
        self._trial = ForesightTrial()
        self._earlier = EarlierRoads()
        self._real_roads: deque[Candidate] = deque()  # stretches that were not proposed

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer to the map's edge than `map_margin`, in m.

        An `is_valid` of your own stays as it is.
        """
        self._map_check.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which no road is valid, see `RandomRoads.require_valid_roads`."""
        self._roads.require_valid_roads()

    def start_from(self, earlier: Sequence[Evaluation]) -> None:
        """Take roads of earlier campaigns, see `Strategy.start_from`."""
        for evaluation in earlier:
            candidate, severity = evaluation.candidate, evaluation.severity
            if evaluation.outcome is Outcome.DROPPED:
                self._real_roads.append(candidate)
            if not evaluation.outcome.is_driven or severity is None:
                continue
            self._earlier.add(evaluation, severity)
            if evaluation.trace is not None:
                self._model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        longest_real = max((len(road.curvatures) for road in self._real_roads), default=0)
        self._room = np.empty(max(len(self._room), self._earlier.longest, longest_real))

    def ask(self) -> Candidate:
        """Return the next road to try."""
        rest = self._continuations.issue(self._ledger)
        if rest is not None:
            return rest
        if self._real_roads:
            return self._real_road(self._real_roads.popleft())
        if self._earlier and self._spent_with_outstanding < self._random_budget:
            share = self._earlier.share(is_random_phase=self._in_random_phase)
            if self._rng.random() < share:
                return self._earlier_road()
        share = _BLIND_SHARE if self._is_blind else _RANDOM_SHARE
        if self._in_random_phase or self._rng.random() < share:
            return self._random_road()
        self._parents.refresh()
        return self._child() or self._random_road()

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: See `Ledger.settle`.

        """
        candidate = self._ledger.settle(evaluation)
        self._continuations.remember_failure(candidate, evaluation)
        asked = self._children.pop(candidate.id, None)
        self._archive.settle(candidate.id)
        self._budget_spent = max(self._budget_spent, evaluation.budget_spent)
        severity = evaluation.severity
        if severity is not None and evaluation.outcome.is_driven:
            self._parents.learn(severity, is_moobd=evaluation.objective is None)
        elif evaluation.outcome is not Outcome.FAIL:
            return
        novelty, fault = 0.0, evaluation.fault
        if fault is None or fault not in self._faults:
            novelty = self._keep(evaluation, candidate, severity or 0.0)
        if fault is not None:
            self._faults.add(fault)
        if evaluation.trace is not None:
            self._model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        if candidate.origin.operator == EARLIER:
            self._earlier.learn(novelty)
        if self._foresight is not None:
            self._foresight.learn(candidate, evaluation)
        if asked is not None:
            child, is_foreseen = asked
            if self._failing is not None:
                has_failed = evaluation.outcome is Outcome.FAIL
                self._failing.learn(self._features(child), has_failed=has_failed)
            self._trial.learn(novelty, is_foreseen=is_foreseen)
            if child.operator is None:
                return
            parent_failed = int(self._archive.places["has_failed"][child.row])
            self._operators.learn(child.operator, novelty, parent_failed=parent_failed)
            self._archive.places["cost"][child.row] -= _SUCCESS_REFUND * novelty

    def _keep(self, evaluation: Evaluation, candidate: Candidate, severity: float) -> float:
        """Add the places of a drive; return how new its failure is, 0 to 1."""
        row = len(self._archive)
        worst, *others = critical_places(evaluation, candidate, severity)
        difference = self._archive.add(candidate, worst)
        if self._parents.is_moobd:
            for place in others:
                self._archive.add(candidate, place)
        if evaluation.outcome is not Outcome.FAIL:
            return 0.0
        novelty = min(max((difference - _NOTHING_NEW) / (_NEW - _NOTHING_NEW), 0.0), 1.0)
        self._archive.places["cost"][row] = _KNOWN_FAILURE_COST * (1.0 - novelty)
        return novelty

    def facts(self) -> Mapping[str, Any]:
        """Return what foresight has achieved, as facts; none without foresight."""
        if self._foresight is None:
            return {}
        return {**self._foresight.facts(), **self._trial.facts()}

    @property
    def notice(self) -> str | None:
        """Warning that no road has come near failing, or None."""
        if not self._parents.drives or self._in_random_phase or self._archive.has_failures:
            return None
        if not self._parents.is_moobd or self._parents.lowest < 0.0:
            return None
        return (
            "nothing close to failing yet: the search follows the roads on which the car comes"
            " nearest to its lane's edge"
        )

    @property
    def _in_random_phase(self) -> bool:
        driven = self._parents.drives
        return driven == 0 or (
            driven + len(self._ledger) < self._first_roads
            and self._spent_with_outstanding < self._random_budget
        )

    @property
    def _spent_with_outstanding(self) -> float:
        """Share of the budget spent once all outstanding roads are driven; 0 before a drive."""
        driven = self._parents.drives
        return self._budget_spent * (driven + len(self._ledger)) / driven if driven else 0.0

    def _random_road(self) -> Candidate:
        road = self._roads.issue(self._rng, self._ledger, self.domain, is_blind=self._is_blind)
        self._proposed.add(road.curvatures)
        return road

    @property
    def _is_blind(self) -> bool:
        """Whether the search varies conditions and knows no failure that tells which matter."""
        return self.domain is not None and not self._archive.has_failures

    def _real_road(self, road: Candidate) -> Candidate:
        """Propose a stretch of a real road, as it is."""
        self._proposed.add(road.curvatures)
        fields = {name: getattr(road, name) for name in ("notes", *profile.NAMES)}
        is_blind = self._is_blind
        fields["conditions"] = drawn(self._rng, self.domain, road.length, is_blind=is_blind)
        return self._ledger.issue(road.curvatures, road.step, Origin(GIVEN), **fields)

    def _earlier_road(self) -> Candidate:
        """Propose the best road of earlier campaigns that was not proposed."""
        road = self._earlier.pop()
        self._proposed.add(road.curvatures)
        fields = {name: getattr(road, name) for name in ("conditions", *profile.NAMES)}
        return self._ledger.issue(road.curvatures, self._roads.step, Origin(EARLIER), **fields)

    def _child(self) -> Candidate | None:
        """Propose a child of a place of the archive; return None if all draws were refused."""
        children = (
            child
            for _ in range(_PARENTS if len(self._parents.rows) else 0)
            for child in self._children_of(self._parents.choose())
        )
        foresight = self._foresight
        if foresight is not None and foresight.is_ready and self._trial.chooses(self._rng):
            return self._foreseen(children, foresight)
        count = 1 if self._failing is None or not self._failing.is_ready else _LIKELY_OF
        child = max(islice(children, count), key=self._chance, default=None)
        return None if child is None else self._issue(child)

    def _foreseen(self, children: Iterator[_Child], foresight: Foresight) -> Candidate | None:
        """Propose the first child that fails as no known failure does, or the most promising one.

        None if there is no child.
        """
        best, most = None, -math.inf
        for child in islice(children, _FORESEEN_OF):
            candidate = Candidate(0, child.curvatures, self._roads.step, Origin(""), **child.fields)
            promise, place = promise_of(candidate, foresight, self._archive)
            if best is None or promise > most:
                best, most = child, promise
                if place is not None:
                    best = child._replace(side=place.side, vector=place.vector)
            if promise >= _NEW:
                break
        return None if best is None else self._issue(best, is_foreseen=True)

    def _chance(self, child: _Child) -> float:
        """Return the chance that a child fails; 0 without a model of failures."""
        return 0.0 if self._failing is None else self._failing.chance(self._features(child))

    def _features(self, child: _Child) -> FloatArray:
        """Return the features of a child, see `FailureModel.features`."""
        assert self._failing is not None
        vector = self._archive.vectors[child.row] if child.vector is None else child.vector
        severity = float(self._archive.places["severity"][child.row])
        return self._failing.features(vector, child.side, child.operator, severity)

    def _children_of(self, row: int) -> Iterator[_Child]:
        """Yield children of a place of the archive that may fail as no known failure does."""
        archive, rng, draws, step = self._archive, self._rng, 1 + _REDRAWS, self._roads.step
        place, parent = archive.places[row], archive.candidates[row]
        parent_failed, side = int(place["has_failed"]), int(place["side"])
        if self.domain is not None and not parent_failed and rng.random() < _OTHER_CONDITIONS_SHARE:
            yield self._in_other_conditions(row)
            return
        operators = self._operators.draw(rng, draws, parent_failed=parent_failed)
        u = rng.random((draws, PARAMETERS + 2 * len(self._room)))
        run_ups = np.where(rng.random(draws) < parent_failed * _FRESH_SHARE, self._run_up, 0.0)
        lengths = self._usual_length + rng.integers(-LENGTH_JITTER, LENGTH_JITTER + 1, draws)
        others, sizes, sites = self._parents.draw_mates(operators == SPLICE, len(self._room))
        opposite = {LEFT: RIGHT, RIGHT: LEFT}.get(side, side)
        known = archive.failures(side), archive.failures(opposite)
        # A class's bends look much alike: without a failure, what is out forbids too many.
        if self.road_class is not None and not archive.has_failures:
            known = NOTHING, NOTHING
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
                _LEAST_DIFFERENCE,
                run_ups[first:],
                self._model.weights if self._model.is_ready else np.empty(0),
                self._room,
                expected,
            )
            if k < 0:
                return
            curvatures, operator = self._room[:n].copy(), int(operators[first + k])
            if curvatures not in self._proposed and self._map_check(curvatures, step):
                fields = self._inherited(parent, curvatures, moved * step)
                child_side = opposite if operator == MIRROR else side
                yield _Child(row, operator, curvatures, fields, child_side, expected.copy())
            first += k + 1

    def _inherited(
        self, parent: Candidate, curvatures: FloatArray, moved: float
    ) -> Mapping[str, Any]:
        """Return grade, limits and conditions of a child whose place moved so many m along it."""
        grade, limits = parent.grade, parent.speed_limits
        if self.road_class is not None and self._rng.random() < _NEW_GRADE_SHARE:
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
        """Return the road of a place of the archive in other conditions."""
        assert self.domain is not None
        archive, parent = self._archive, self._archive.candidates[row]
        mate = archive.candidates[int(self._rng.choice(self._parents.rows))]
        place = archive.places[row]
        fields: dict[str, Any] = {name: getattr(parent, name) for name in profile.NAMES}
        distance = float(place["distance"])
        fields["conditions"] = changed(self._rng, self.domain, parent, mate, distance)
        return _Child(row, None, parent.curvatures, fields, int(place["side"]), None)

    def _issue(self, child: _Child, *, is_foreseen: bool = False) -> Candidate:
        """Propose a child."""
        row, operator = child.row, child.operator
        parent = self._archive.candidates[row]
        name = CONDITIONS if operator is None else OPERATORS[operator]
        origin = Origin(name, (parent.id,), parent.origin.generation + 1)
        issued = self._ledger.issue(child.curvatures, self._roads.step, origin, **child.fields)
        self._proposed.add(child.curvatures)
        self._archive.places["cost"][row] += _USE_COST
        self._children[issued.id] = child, is_foreseen
        if child.vector is not None:
            self._archive.expect(issued.id, child.side, child.vector)
        return issued
