"""The search algorithm of Castellano et al., "Frenetic at the SBST 2021 Tool Competition"."""

from __future__ import annotations

import bisect
import heapq
from collections.abc import Iterator
from functools import partial
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Count, Finite, Index, Positive, Share
from frenetic.oracle.outcome import Outcome
from frenetic.road.classes import RoadClass
from frenetic.search.continuations import RoadContinuations
from frenetic.search.map_check import RoadCheck
from frenetic.search.operators import (
    CURVATURE_BOUND,
    FAIL_OPERATORS,
    MAX_CHANGE,
    PAPER_OPTIONS,
    PASS_OPERATORS,
    MutationOptions,
    PassOperator,
    mix,
    splice,
)
from frenetic.search.random_roads import (
    LENGTH_JITTER,
    MAX_LENGTH,
    Jitter,
    RandomRoads,
    Size,
    size_and_step,
)
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, Strategy, checked_options

_MIX, _SPLICE = "C1", "C2"  # names of the operators of crossover
_UNCOUNTED = frozenset({"F1", _MIX, _SPLICE})
"""Operators whose tests do not count towards the next crossover, as in the published code."""
_MIN_PARENTS = 5
"""Least number of parents of a crossover, as in the published code."""


class _Scored(NamedTuple):
    """A driven candidate below the threshold; sorts by fitness, then in the order of asking."""

    fitness: float
    id: int
    outcome: Outcome
    candidate: Candidate


class _Offspring(NamedTuple):
    """The children of one crossing of two parents."""

    operator: str
    """Name of the operator."""
    parents: tuple[_Scored, _Scored]
    """The parents."""
    children: list[FloatArray]
    """Curvatures of the children, (n,) in 1/m each."""


class Frenetic2021(Strategy):
    """A `Strategy` that mutates and crosses the roads on which the driver did worst: Listing 1.

    1. *Random phase*, while the largest share of the budget told so far is below `random_budget`.
    2. *Mutation*, from then on: the unvisited candidate of lowest MOOBD below `threshold` becomes
       the parent and is visited. Its mutants (P1 to P6 if it passed, F1 to F4 if it failed) are
       proposed in order until one fails. Mutants of a failed parent count as visited from the
       start: they never become parents. Without a parent, one more random road is proposed.
    3. *Crossover*, checked after each parent's mutants and after each such random road: when more
       than `cross_freq` tests ran since the last crossover, the `cross_num` candidates of lowest
       MOOBD below `threshold`, visited or not, have `cross_num` children.

    Section I-B of the paper gives the threshold of -0.5 m, steps of 10 m, at most 30 ± 5 values,
    the bound of 0.07, the change of 0.05, 1 to 5 changed values and the scale of 1.1 to 1.2. It
    gives no value of `random_budget`, `cross_freq` and `cross_num`. The published code
    (github.com/ERATOMMSD/frenetic-sbst21, class ``Frenetic``) has 40 and 20 for the last two. Its
    random phase takes an hour, which a comment there calls 20 % of the time; 20 % of any budget is
    our choice.

    Where the paper leaves room, we follow the published code:

    - A crossover needs five candidates below the threshold, or `cross_num` if that is less: with
      two or three it would propose the same children again and again. With fewer candidates there
      is no crossover, and the count of tests begins anew.
    - Tests that ran are those told after the random phase, valid or not, except roads of F1 and
      children of crossover. So the first crossover comes after more than `cross_freq` tests of the
      main loop, and the next after as many tests since the last child of the crossover before.
    - The last C2 of a crossover has both its children: so a crossover has `cross_num` children, or
      one more.
    - Two different candidates are the parents of a child.
    - P6 has one factor for all values.
    - The first value of a random road is drawn relative to 0.
    - A road that was tested before may be proposed again; `frenetic.campaign.counts` counts it.

    Where paper and code leave room, this is our choice:

    - The threshold is strict ("lower than a threshold", Section I-B, where Listing 1 calls it
      ``candidates_with_min_oob_gt``). Equal MOOBDs go to the candidate asked first.
    - INVALID and ERROR count neither as failures nor as parents.
    - Removing leaves at least two values; a parent of two values skips P2, P3 and P4.
    - Where the value before a new one lies further than `max_change` outside the bound, because it
      was scaled, P1 and P5 put the new one on the bound.
    - F3, which the paper lists among the mutations that undo themselves, does so for an even number
      of values only. Its mutants are visited from the start for any number.

    With several candidates outstanding, each decision follows from the results told by then: a
    parent's next mutants may be asked before earlier mutants are told. Once a failing mutant is
    told, its parent has no more mutants, and the outstanding ones are unwanted. Asked and told one
    by one, the strategy follows Listing 1.

    We deviate from the paper in two ways. `max_redraws`, which is 0 by default, draws roads again
    that `is_valid` refuses. A road that does not fit the map when it is moved is turned, which the
    paper leaves to future work.

    The strategy remembers only the roads below the threshold that can still become parents, and
    the `cross_num` best roads.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        random_budget: Share of the budget spent on random roads, 0..1; 0.2 is our choice.
        threshold: m, only roads with a MOOBD below this have offspring.
        cross_freq: Number of tests after which a further test leads to a crossover; 40 is the
            published code's.
        cross_num: Number of parents and of children of a crossover; 20 is the published code's.
        curvature_bound: 1/m, largest absolute value of new curvatures.
        max_change: 1/m, largest difference of a new curvature to the one before it.
        step: m between two curvature values.
        length_jitter: Largest deviation of a random road from the usual number of values.
        max_length: Largest usual number of values of a random road, before the jitter.
        usual_length: Usual number of values of a random road; by default the map's side divided by
            the step, at most `max_length`.
        min_changed: Least number of values that P1 to P5 add, remove or replace.
        max_changed: Largest number of values that P1 to P5 add, remove or replace.
        min_scale: Least factor of P6.
        max_scale: Largest factor of P6.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
            With `max_redraws`, random roads, mutants of P1 to P6 and children of crossover that it
            refuses are drawn again (for a child, parents and operator, too); when all draws were
            refused, the last is proposed. F1 to F4 are not random: their mutants are always
            proposed.
        max_redraws: How often a refused road is drawn again; by default 0, since the paper checks
            no road (Section II).
        road_class: Class of the roads, see `Strategy.road_class`; it replaces bound, change, step
            and lengths, and the results of operators are changed to keep its rules.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 2
    """Version of the proposals, which campaigns record; increase it when they change."""
    default_max_in_flight: ClassVar[int] = 1
    """Candidates that `frenetic run` keeps outstanding: Listing 1 needs each result at once."""

    def __init__(
        self,
        *,
        seed: Index,
        map_size: Positive | None = None,
        random_budget: Share = 0.2,
        threshold: Finite = -0.5,
        cross_freq: Index = 40,
        cross_num: Annotated[int, Meta(ge=2)] = 20,
        curvature_bound: Positive = CURVATURE_BOUND,
        max_change: Positive = MAX_CHANGE,
        step: Positive | None = None,
        length_jitter: Jitter = LENGTH_JITTER,
        max_length: Size = MAX_LENGTH,
        usual_length: Size | None = None,
        min_changed: Count = PAPER_OPTIONS.min_changed,
        max_changed: Count = PAPER_OPTIONS.max_changed,
        min_scale: Positive = PAPER_OPTIONS.min_scale,
        max_scale: Positive = PAPER_OPTIONS.max_scale,
        is_valid: RoadCheck | None = None,
        max_redraws: Index = 0,
        road_class: RoadClass | None = None,
    ) -> None:
        map_size, step = size_and_step(map_size, step, road_class)
        self.options = checked_options(locals(), Frenetic2021.__init__)
        ranges = ("changed", min_changed, max_changed), ("scale", min_scale, max_scale)
        for name, low, high in ranges:
            if low > high:
                raise ValueError(f"min_{name} is {low!r}: at most max_{name}, {high!r}, is allowed")
        self.road_class = road_class
        self._rng = np.random.default_rng(seed)
        self._random_budget = random_budget
        self._threshold = threshold
        self._cross_freq = cross_freq
        self._cross_num = cross_num
        self._roads = RandomRoads(
            map_size=map_size,
            step=step,
            length_jitter=length_jitter,
            max_length=max_length,
            usual_length=usual_length,
            curvature_bound=curvature_bound,
            max_change=max_change,
            is_valid=is_valid,
            max_redraws=max_redraws,
            road_class=road_class,
        )
        self._max_redraws = max_redraws
        bound, change = self._roads.limits[:2].tolist()
        self._options = MutationOptions(
            bound=bound,
            max_change=change,
            min_changed=min_changed,
            max_changed=max_changed,
            min_scale=min_scale,
            max_scale=max_scale,
        )
        self._ledger = Ledger()
        self._continuations = RoadContinuations(road_class)
        self._budget_spent = 0.0
        self._has_driven = False
        self._tests_since_crossover = 0
        self._unvisited: list[_Scored] = []  # a heap of possible parents
        self._best: list[_Scored] = []  # sorted, at most cross_num
        # Id of an outstanding mutant -> ids of the siblings that failed; siblings share one list.
        self._failed_siblings: dict[int, list[int]] = {}
        self._proposals = self._listing_1()

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer than `map_margin` m to the map's edge.

        A user's `is_valid` stays as it is.
        """
        self._roads.keep_map_margin(map_margin)

    def require_valid_roads(self) -> None:
        """Refuse options with which hardly any road is valid, see `RandomRoads`."""
        self._roads.require_valid_roads()

    def ask(self) -> Candidate:
        """Return the next road to try."""
        return self._continuations.issue(self._ledger) or next(self._proposals)

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: The candidate was never asked, or was told already; see `Ledger.settle`.

        """
        candidate = self._ledger.settle(evaluation)
        self._continuations.note_result(candidate, evaluation)
        siblings = self._failed_siblings.pop(candidate.id, None)
        if self._counts(evaluation):
            self._tests_since_crossover += 1
        self._budget_spent = max(self._budget_spent, evaluation.budget_spent)
        if not evaluation.outcome.is_driven:
            return
        self._has_driven = True
        fitness = evaluation.fitness
        if siblings is not None and evaluation.outcome is Outcome.FAIL:
            siblings.append(candidate.id)
        if fitness is not None and fitness < self._threshold:
            self._remember(_Scored(fitness, candidate.id, evaluation.outcome, candidate))

    def is_wanted(self, candidate: Candidate) -> bool:
        """Return whether no sibling of a mutant has failed: mutants are tried until one fails."""
        return not self._failed_siblings.get(candidate.id)

    @property
    def notice(self) -> str | None:
        """Warning that all roads are random, since none is below the threshold; or None."""
        if self._in_random_phase or self._best or not self._has_driven:
            return None
        return (
            f"no road has a MOOBD below the threshold of {self._threshold:g} m, so all roads are"
            " random"
        )

    @property
    def _in_random_phase(self) -> bool:
        """Whether the search still proposes random roads only."""
        return self._budget_spent < self._random_budget

    def _counts(self, evaluation: Evaluation) -> bool:
        """Return whether a test counts towards the next crossover."""
        is_counted = evaluation.candidate.origin.operator not in _UNCOUNTED
        return is_counted and evaluation.outcome.is_test and not self._in_random_phase

    def _remember(self, scored: _Scored) -> None:
        """Remember a candidate as a possible parent of mutants, and of crossover if it is good."""
        if scored.candidate.origin.operator not in FAIL_OPERATORS:
            heapq.heappush(self._unvisited, scored)
        bisect.insort(self._best, scored)
        del self._best[self._cross_num :]

    def _listing_1(self) -> Iterator[Candidate]:
        """Yield the candidates of Listing 1, one for each `ask`.

        After a yield, the results that were told before the next `ask` are known.
        """
        while self._in_random_phase:
            yield self._roads.issue(self._rng, self._ledger)
        while True:
            if self._unvisited:
                yield from self._mutants(heapq.heappop(self._unvisited))
            else:
                yield self._roads.issue(self._rng, self._ledger)
            if self._tests_since_crossover > self._cross_freq:
                self._tests_since_crossover = 0
                if len(self._best) >= min(_MIN_PARENTS, self._cross_num):
                    yield from self._crossover()

    def _mutants(self, parent: _Scored) -> Iterator[Candidate]:
        """Issue the mutants of a parent until one is told to have failed."""
        failed_siblings: list[int] = []
        for name, curvatures in self._mutations(parent):
            mutant = self._issue(curvatures, name, parent)
            self._failed_siblings[mutant.id] = failed_siblings  # `tell` appends to it
            yield mutant
            if failed_siblings:
                return

    def _mutations(self, parent: _Scored) -> Iterator[tuple[str, FloatArray]]:
        """Yield names of operators and the curvatures that they make of a parent's road."""
        road = parent.candidate.curvatures
        if parent.outcome is Outcome.FAIL:
            for name, vary in FAIL_OPERATORS.items():
                yield name, self._roads.conformed(vary(road))
            return
        for name, mutate in PASS_OPERATORS.items():
            mutant = self._roads.redraw_until_valid(partial(self._mutant, mutate, road))
            if mutant is not None:
                yield name, mutant

    def _mutant(self, mutate: PassOperator, road: FloatArray) -> FloatArray | None:
        """Return a mutant of a road; None if the operator cannot change the road."""
        mutant = mutate(self._rng, road, self._options)
        return None if mutant is None else self._roads.conformed(mutant)

    def _crossover(self) -> Iterator[Candidate]:
        """Issue the children of a crossover."""
        pool = self._best.copy()
        missing = self._cross_num
        while missing > 0:
            offspring = self._offspring(pool)
            for curvatures in offspring.children:
                yield self._issue(curvatures, offspring.operator, *offspring.parents)
            missing -= len(offspring.children)

    def _offspring(self, pool: list[_Scored]) -> _Offspring:
        """Return the one or two children of two different parents.

        Refused children are left out, and drawn again if all are refused. The last draw is returned
        unchecked.
        """
        offspring = self._draw_offspring(pool)
        for _ in range(self._max_redraws):
            accepted = [child for child in offspring.children if self._roads.accepts(child)]
            if accepted:
                return offspring._replace(children=accepted)
            offspring = self._draw_offspring(pool)
        return offspring

    def _draw_offspring(self, pool: list[_Scored]) -> _Offspring:
        """Return the children of random parents by a random operator."""
        i, j = self._rng.choice(len(pool), size=2, replace=False).tolist()
        parents = pool[i], pool[j]
        first, second = (parent.candidate.curvatures for parent in parents)
        if self._rng.random() < 0.5:
            operator, children = _MIX, [mix(self._rng, first, second)]
        else:
            operator, children = _SPLICE, list(splice(first, second))
        return _Offspring(operator, parents, [self._roads.conformed(child) for child in children])

    def _issue(self, curvatures: FloatArray, name: str, *parents: _Scored) -> Candidate:
        """Issue a candidate that an operator made of parents; the first gives its grade."""
        origin = Origin(
            operator=name,
            parents=tuple(parent.id for parent in parents),
            generation=1 + max(parent.candidate.origin.generation for parent in parents),
        )
        grade = parents[0].candidate.grade
        return self._ledger.issue(curvatures, self._roads.step, origin, grade=grade)
