"""The default search: it looks for failures that differ from the known ones (quality diversity)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from frenetic._support.bounds import Count, Index, Positive, Share
from frenetic.conditions.domain import Domain
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.search.approach import SIZE
from frenetic.search.archive import LEFT, RIGHT, Archive, critical_places
from frenetic.search.child_draws import ChildDraws, Parent, RefusingFailures, draw_child
from frenetic.search.children import (
    NEW_DIFFERENCE,
    Child,
    choose_foreseen,
    choose_likeliest,
    features_of_child,
    inherited_fields,
)
from frenetic.search.conditions import change_conditions, draw_conditions
from frenetic.search.continuations import RoadContinuations
from frenetic.search.earlier_roads import EarlierRoads
from frenetic.search.failing import FailureModel
from frenetic.search.known_failures import NOTHING
from frenetic.search.map_check import MapCheck, RoadCheck
from frenetic.search.operator_choice import OperatorChoice
from frenetic.search.operator_names import CONDITIONS, EARLIER, GIVEN
from frenetic.search.operators import MAX_CHANGE, MIN_VALUES
from frenetic.search.parents import ParentPool
from frenetic.search.prediction import Foresight, ForesightTrial
from frenetic.search.proposed import ProposedRoads
from frenetic.search.random_roads import (
    LENGTH_JITTER,
    MAX_LENGTH,
    RandomRoads,
    Size,
    length_in_class,
    size_and_step,
)
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.scouting import Scouting
from frenetic.search.speed_model import SpeedModel
from frenetic.search.strategy import Ledger, Strategy, checked_options
from frenetic.search.variation import MIRROR, OPERATORS, PARAMETERS, SPLICE

# The values are our choice; research/search.md measures `_FRESH_SHARE` and `_RUN_UP_TIME`.
#
# Roads
_LENGTH_PER_MAP_SIDE = 1.45  # usual length of a road per side of the map
_EXTRA_VALUES = 6  # values that a child may have beyond the longest random road
_RANDOM_SHARE = 0.05  # share of random roads after the random phase
_BLIND_SHARE = 0.5  # share of random roads while no failure tells which conditions matter
_MAX_REDRAWS = 36  # times that a refused road or child is drawn again
#
# Parents
_MAX_PARENTS = 8  # parents that are tried before a random road is proposed
_USE_COST = 0.3  # cost of a place for each of its children: it becomes a parent less often
_SUCCESS_REFUND = 0.15  # part of this cost that a child with a new failure takes back
_KNOWN_FAILURE_COST = 0.6  # cost at first of a place with a failure that was known already
#
# Children
_IMPROVEMENT = 0.5  # success of a child nearer to failing than its parent, while none has failed
_FRESH_SHARE = 0.45  # share of a failure's children whose road is new except for the run-up
_RUN_UP = 90.0  # [m] of road before the place that such a child keeps
_RUN_UP_TIME = 4.6  # [s] of driving at the design speed that it keeps in a road class
_OTHER_CONDITIONS_SHARE = 0.5  # share of a near miss's children that only change its conditions
_LEAST_DIFFERENCE = 1.6  # [m] least expected difference of a child from the known failures
_KNOWN_DIFFERENCE = 1.0  # [m] difference from the known failures up to which nothing is new


class Frenetic(Strategy):
    """A `Strategy` that looks for failures unlike the known ones, for any driver.

    1. *Scouting*, until a road fails: the first eight roads are random, and ever fewer of the next
       thirty, down to three in ten. Every other random road has independent values, and the rest
       are of several families, see `road_families`; the nearer a family's roads bring the car to
       failing, the more often it is drawn. The roads that are not random are children of the worst
       roads so far, or of those on which the car was turned most abruptly.
       *Random phase*, once a road has failed: roads are random, until there are `random_roads`
       roads in all, or fewer if they take `random_budget` of the budget. Later one road in twenty
       is random. Now the families are drawn that bring new failures.
    2. *Archive*: from each drive it keeps the place where the car left its lane or came nearest to
       its edge, and a second such place if the car came near the edge there, too. With each place
       it keeps the `approach`: the road around the place, and offsets and speeds before it.
    3. *Parent*: a place of a failure or of a near miss. A near miss is one of the worst fifth of
       the recent drives, or a drive with a MOOBD below -0.3 m; before the first failure, it is one
       of the worst 3 %, and of the worst five at least. Of 24 such places the best one is taken:
       near failing, far from the known failures, and seldom used.
    4. *Child*: an operator of `variation` changes the road around that place. The chance of an
       operator is a power of the share of new failures among its children, counted apart for
       parents that failed and for others.
    5. *Refusal*: a child that is expected to fail as a known failure did is drawn again, up to 36
       times; then another parent is taken. The car is expected to fail between 5 m before the
       parent's place and 15 m after it, with the parent's offsets, and with the parent's speeds
       plus the change that a `SpeedModel` predicts. Until the result of a child is known, the child
       counts as a failure there.
    6. *Foresight*, if it is given, looks at up to 40 children, eight at a time, until it expects a
       child to fail with a difference of 2 m or more from all known failures. The more of its
       recent children brought new failures, compared with children chosen without it, the more
       often it chooses.

    Nearly half of a failure's children keep their parent's road only from 90 m before the place to
    30 m after it (in a road class 4.6 s of driving before it, and a third of that after it).
    Elsewhere their road is random.

    The curvature changes by at most `max_change` from value to value. If no such road has failed in
    the last `sharper_after` drives, half of the roads may change by more, see `ChangeLimit`.

    A failure is new if it differs from all known failures by 2 m or more, and partly new above 1 m.

    With several candidates outstanding, each decision follows from the results told by then and
    from how the outstanding candidates are expected to fail.

    *Warm start* (`start_from`): for `random_budget` of the budget, roads of earlier campaigns are
    driven again. Severe roads that are unlike each other come first. The chance that the next road
    is such a road is the share of new failures on such roads so far, and at least one half in the
    random phase. Only their new drives count as results, but the speed model learns from the
    earlier drives, too.

    *Real roads* (also by `start_from`): stretches of real roads are driven first, as they are.

    *Road classes*: roads are as long as the class says. The rest of a road, after the place where
    the car left its lane, is the next test, see `frenetic.search.continuations.RoadContinuations`.

    `Frenetic2021` is the search of the paper.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        random_budget: Share of the budget that the random phase may take, 0..1; the roads of
            earlier campaigns may take as much.
        random_roads: Number of random roads in the random phase.
        likely: For users who count all failures, whether they are alike or not. Failures become
            parents before near misses, and of six children the likeliest to fail is driven.
        step: m between two curvature values.
        max_length: Largest usual number of values of a road; it has up to five more or fewer.
        max_change: 1/m, largest change of the curvature from value to value; the paper's by
            default. A road class has its own.
        sharper_after: Drives without a failure of such roads after which roads are tried, too, that
            change by more, up to what the competition calls valid.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        road_class: Class of the roads, see `Strategy.road_class`; it replaces step and lengths.
        domain: Domain of roads and conditions, see `Strategy.domain`: then a child has its parent's
            conditions, and half of a near miss's children are its road in other conditions. Until
            the first failure, half of the random roads have a condition that few drives have.
        foresight: Model of the driver that foresees the drive on a child's road.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 7
    """Version of the proposals, which campaigns record; increase it when they change."""

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
        max_change: Positive = MAX_CHANGE,
        sharper_after: Index = 100,
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
        self._failure_model = FailureModel(self._rng, len(OPERATORS)) if likely else None
        self._random_budget = random_budget
        self._random_phase_roads = random_roads
        usual = min(int(_LENGTH_PER_MAP_SIDE * map_size / step), max_length)
        self._usual_length = max(usual, MIN_VALUES)
        if road_class is not None:
            self._usual_length = length_in_class(road_class)
        self._map_check = MapCheck(map_size, is_valid, road_class)
        self._roads = RandomRoads(
            map_size=map_size,
            step=step,
            usual_length=self._usual_length,
            max_change=max_change,
            is_valid=self._map_check,
            max_redraws=_MAX_REDRAWS,
            road_class=road_class,
        )
        self._run_up = _RUN_UP  # the competition's roads have no design speed
        if road_class is not None:
            self._run_up = road_class.design_speed / 3.6 * _RUN_UP_TIME
        # Room for the values of a child.
        self._room = np.empty(self._usual_length + LENGTH_JITTER + _EXTRA_VALUES)
        self._ledger, self._continuations = Ledger(), RoadContinuations(road_class)
        self._archive = Archive()
        self._speed_model = SpeedModel(self._rng)
        self._faults: set[Fault] = set()  # faults of the driver so far
        self._proposed = ProposedRoads()
        self._budget_spent = 0.0
        # In a domain most near misses have usual conditions, so they are far from failing.
        failures_first = domain is not None or likely
        self._parents = ParentPool(self._archive, self._rng, failures_first=failures_first)
        self._operators = OperatorChoice()
        self._scouting = Scouting(
            self._rng, self._roads, self._parents, self._archive, sharper_after
        )
        # Id of an outstanding candidate -> its child, and whether foresight chose it.
        self._children: dict[int, tuple[Child, bool]] = {}
        self._foresight_trial = ForesightTrial()
        self._earlier_roads = EarlierRoads()
        self._real_roads: deque[Candidate] = deque()  # stretches that wait to be proposed

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer than `map_margin` m to the map's edge.

        A user's `is_valid` stays as it is.
        """
        self._map_check.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which hardly any road is valid, see `RandomRoads`."""
        self._roads.require_valid_roads()

    def start_from(self, earlier: Sequence[Evaluation]) -> None:
        """Learn from earlier campaigns and take their roads, see `Strategy.start_from`."""
        for evaluation in earlier:
            candidate, fitness = evaluation.candidate, evaluation.fitness
            if evaluation.outcome is Outcome.DROPPED:  # a stretch of a real road
                self._real_roads.append(candidate)
            if not evaluation.outcome.is_driven or fitness is None:
                continue
            self._earlier_roads.add(evaluation, fitness)
            if evaluation.trace is not None:
                self._speed_model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        longest_real = max((len(road.curvatures) for road in self._real_roads), default=0)
        self._room = np.empty(max(len(self._room), self._earlier_roads.longest, longest_real))

    def ask(self) -> Candidate:
        """Return the next road: a rest, a real road, an earlier one, a random one or a child."""
        rest = self._continuations.issue(self._ledger)
        if rest is not None:
            return rest
        if self._real_roads:
            return self._real_road(self._real_roads.popleft())
        if self._earlier_roads and self._spent_with_outstanding < self._random_budget:
            earlier_share = self._earlier_roads.share(is_random_phase=self._in_random_phase)
            if self._rng.random() < earlier_share:
                return self._earlier_road()
        self._scouting.choose_change()
        if self._rng.random() < self._random_share:
            return self._random_road()
        self._parents.refresh()
        return self._child() or self._random_road()

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: The candidate was never asked, or was told already; see `Ledger.settle`.

        """
        candidate = self._ledger.settle(evaluation)
        self._continuations.note_result(candidate, evaluation)
        proposed = self._children.pop(candidate.id, None)
        self._archive.settle(candidate.id)
        self._budget_spent = max(self._budget_spent, evaluation.budget_spent)
        fitness = evaluation.fitness
        if fitness is not None and evaluation.outcome.is_driven:
            self._parents.learn(fitness, is_moobd=evaluation.objective is None)
        elif evaluation.outcome is not Outcome.FAIL:
            return  # not driven, or without a verdict: nothing to learn
        novelty, fault = 0.0, evaluation.fault
        if fault is None or fault not in self._faults:  # only the first fault of a line is new
            novelty = self._add_to_archive(evaluation, candidate, fitness or 0.0)
        if fault is not None:
            self._faults.add(fault)
        if evaluation.trace is not None:
            self._speed_model.learn(candidate.curvatures, candidate.step, evaluation.trace)
        if candidate.origin.operator == EARLIER:
            self._earlier_roads.learn(novelty)
        self._scouting.learn(candidate, evaluation, novelty)
        if self._foresight is not None:
            self._foresight.learn(candidate, evaluation)
        if proposed is not None:
            child, is_foreseen = proposed
            self._foresight_trial.learn(novelty, is_foreseen=is_foreseen)
            self._learn_from_child(child, novelty, evaluation)

    def _learn_from_child(self, child: Child, novelty: float, evaluation: Evaluation) -> None:
        """Tell the failure model and the choice of operators how a driven child did."""
        if self._failure_model is not None:
            features = features_of_child(child, self._failure_model, self._archive)
            self._failure_model.learn(features, has_failed=evaluation.outcome is Outcome.FAIL)
        if child.operator is not None:
            parent_failed = int(self._archive.places["has_failed"][child.row])
            success, fitness = novelty, evaluation.fitness
            parent_fitness = self._archive.places["fitness"][child.row]
            if not self._archive.has_failures and fitness is not None and fitness < parent_fitness:
                success = _IMPROVEMENT
            self._operators.learn(child.operator, success, parent_failed=parent_failed)
            self._archive.places["cost"][child.row] -= _SUCCESS_REFUND * novelty

    def _add_to_archive(
        self, evaluation: Evaluation, candidate: Candidate, fitness: float
    ) -> float:
        """Add the critical places of a drive; return the novelty of its failure, 0 to 1."""
        row = len(self._archive)
        worst, *others = critical_places(evaluation, candidate, fitness)
        difference = self._archive.add(candidate, worst)
        if self._parents.is_moobd:
            for place in others:
                self._archive.add(candidate, place)
        if evaluation.outcome is not Outcome.FAIL:
            return 0.0
        novelty = (difference - _KNOWN_DIFFERENCE) / (NEW_DIFFERENCE - _KNOWN_DIFFERENCE)
        novelty = min(max(novelty, 0.0), 1.0)
        self._archive.places["cost"][row] = _KNOWN_FAILURE_COST * (1.0 - novelty)
        return novelty

    def facts(self) -> Mapping[str, Any]:
        """Return what foresight has achieved; empty without foresight."""
        if self._foresight is None:
            return {}
        return {**self._foresight.facts(), **self._foresight_trial.facts()}

    @property
    def notice(self) -> str | None:
        """Warning that no road has failed, or only sharp ones; None if there is no such warning."""
        return None if self._in_random_phase else self._scouting.notice

    @property
    def _random_share(self) -> float:
        """Chance that the next road is random rather than a child."""
        if self._is_blind:
            return 1.0 if self._in_random_phase else _BLIND_SHARE
        if not self._archive.has_failures:
            return self._scouting.random_share
        return 1.0 if self._in_random_phase else _RANDOM_SHARE

    @property
    def _in_random_phase(self) -> bool:
        """Whether random roads come first; also while nothing was driven."""
        driven = self._parents.drives
        return driven == 0 or (
            driven + len(self._ledger) < self._random_phase_roads
            and self._spent_with_outstanding < self._random_budget
        )

    @property
    def _spent_with_outstanding(self) -> float:
        """Share of the budget that is spent once all outstanding roads are driven.

        It assumes that a drive costs as much as the drives so far; it is 0 before the first drive.
        """
        driven = self._parents.drives
        return self._budget_spent * (driven + len(self._ledger)) / driven if driven else 0.0

    def _random_road(self) -> Candidate:
        """Propose a random road."""
        road = self._roads.issue(
            self._rng,
            self._ledger,
            self.domain,
            is_blind=self._is_blind,
            family=self._scouting.choose_family(),
        )
        self._proposed.add(road.curvatures)
        return road

    @property
    def _is_blind(self) -> bool:
        """Whether the search varies conditions, but no failure tells yet which of them matter."""
        return self.domain is not None and not self._archive.has_failures

    def _real_road(self, road: Candidate) -> Candidate:
        """Propose a stretch of a real road, as it is."""
        self._proposed.add(road.curvatures)
        fields = {name: getattr(road, name) for name in ("notes", *profile.NAMES)}
        is_blind = self._is_blind
        fields["conditions"] = draw_conditions(
            self._rng, self.domain, road.length, is_blind=is_blind
        )
        return self._ledger.issue(road.curvatures, road.step, Origin(GIVEN), **fields)

    def _earlier_road(self) -> Candidate:
        """Propose the best road of earlier campaigns that was not yet proposed."""
        road = self._earlier_roads.pop()
        self._proposed.add(road.curvatures)
        fields = {name: getattr(road, name) for name in ("conditions", *profile.NAMES)}
        return self._ledger.issue(road.curvatures, self._roads.step, Origin(EARLIER), **fields)

    def _child(self) -> Candidate | None:
        """Propose a child of a place of the archive; return None if all children were refused."""
        # Children are drawn lazily: no more than are looked at.
        children = (
            child
            for _ in range(_MAX_PARENTS if len(self._parents.rows) else 0)
            for child in self._children_of(self._parents.choose())
        )
        foresight, trial = self._foresight, self._foresight_trial
        if foresight is not None and foresight.is_ready and trial.chooses(self._rng):
            child = choose_foreseen(children, foresight, self._archive, self._roads.step)
            return None if child is None else self._issue(child, is_foreseen=True)
        model = self._failure_model
        if model is not None and model.is_ready:
            child = choose_likeliest(children, model, self._archive)
        else:
            child = next(children, None)
        return None if child is None else self._issue(child)

    def _children_of(self, row: int) -> Iterator[Child]:
        """Yield children of a place of the archive that may fail unlike every known failure."""
        archive, rng, count, step = self._archive, self._rng, 1 + _MAX_REDRAWS, self._roads.step
        place, candidate = archive.places[row], archive.candidates[row]
        parent_failed, side = int(place["has_failed"]), int(place["side"])
        if self.domain is not None and not parent_failed and rng.random() < _OTHER_CONDITIONS_SHARE:
            yield self._in_other_conditions(row)
            return
        operators = self._operators.draw(rng, count, parent_failed=parent_failed)
        u = rng.random((count, PARAMETERS + 2 * len(self._room)))
        run_ups = np.where(rng.random(count) < parent_failed * _FRESH_SHARE, self._run_up, 0.0)
        lengths = self._usual_length + rng.integers(-LENGTH_JITTER, LENGTH_JITTER + 1, count)
        mates = self._parents.draw_mates(operators == SPLICE, len(self._room))
        draws = ChildDraws(operators, u, *mates, lengths, run_ups)
        opposite = {LEFT: RIGHT, RIGHT: LEFT}.get(side, side)
        known = archive.failures(side), archive.failures(opposite)
        # In a class all bends look alike: without a failure, outstanding children would refuse
        # nearly all others.
        if self.road_class is not None and not archive.has_failures:
            known = NOTHING, NOTHING
        refusing = RefusingFailures(*known, _LEAST_DIFFERENCE)
        parent = Parent(candidate.curvatures, step, float(place["distance"]), archive.vectors[row])
        expected = np.empty(SIZE)
        while len(draws.operators):
            k, n, moved = draw_child(
                parent,
                draws,
                refusing,
                self._roads.limits,
                self._speed_model.weights if self._speed_model.is_ready else np.empty(0),
                self._room,
                expected,
            )
            if k < 0:
                return
            curvatures, operator = self._room[:n].copy(), int(draws.operators[k])
            if curvatures not in self._proposed and self._map_check(curvatures, step):
                fields = inherited_fields(
                    rng, self._roads, self.domain, candidate, curvatures, moved * step
                )
                child_side = opposite if operator == MIRROR else side
                yield Child(row, operator, curvatures, fields, child_side, expected.copy())
            draws = draws.after(k)

    def _in_other_conditions(self, row: int) -> Child:
        """Return a child with the road of a place of the archive in other conditions."""
        assert self.domain is not None
        archive, parent = self._archive, self._archive.candidates[row]
        mate = archive.candidates[int(self._rng.choice(self._parents.rows))]
        place = archive.places[row]
        fields: dict[str, Any] = {name: getattr(parent, name) for name in profile.NAMES}
        distance = float(place["distance"])
        fields["conditions"] = change_conditions(self._rng, self.domain, parent, mate, distance)
        return Child(row, None, parent.curvatures, fields, int(place["side"]), None)

    def _issue(self, child: Child, *, is_foreseen: bool = False) -> Candidate:
        """Propose a child, and count its parent as used."""
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
