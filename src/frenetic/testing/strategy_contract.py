"""The conformance suite that every strategy passes."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Side
from frenetic.search.records import Candidate, Evaluation, Trace
from frenetic.search.strategy import SearchEnded, Strategy, has_own

_TESTS = 150
"""Tests of a made-up campaign: enough for phases of a strategy that depend on the budget."""


class StrategyContract:
    """The contract of `Strategy` as a pytest class: subclass it, override `make`, run pytest.

    ::

        class TestMine(StrategyContract):
            def make(self, seed: int) -> Strategy:
                return Mine(seed=seed)

    No simulator is involved: outcomes are made up and depend only on a candidate's id. A strategy
    that ends, or waits for results, is tested with the candidates that it proposes by then. A
    strategy that wants every candidate passes the tests of `is_wanted` trivially.
    """

    def make(self, seed: int) -> Strategy:
        """Return a new strategy; to be overridden.

        Args:
            seed: seed of the strategy; different seeds must give different searches.
        """
        raise NotImplementedError("override make(seed) to return your strategy")

    def test_it_has_ask_and_tell(self) -> None:
        """The strategy has the methods of the protocol `Strategy`."""
        assert isinstance(self.make(1), Strategy)

    def test_ids_count_from_one_in_the_order_of_asking(self) -> None:
        """Ids are 1, 2, 3 and so on, whatever is told in between."""
        asked = [step.asked for step in _campaign(self.make(1)) if step.asked is not None]

        assert [candidate.id for candidate in asked] == list(range(1, len(asked) + 1))

    def test_candidates_are_roads(self) -> None:
        """Each candidate has two or more finite curvatures, a positive step and an origin."""
        for step in _campaign(self.make(1)):
            if step.asked is not None:
                _assert_is_road(step.asked)

    def test_parents_were_asked_before(self) -> None:
        """Parents are earlier candidates, and a generation is one more than the latest parent's."""
        generations: dict[int, int] = {}
        for step in _campaign(self.make(1)):
            if step.asked is None:
                continue
            origin = step.asked.origin
            assert all(1 <= parent < step.asked.id for parent in origin.parents)
            expected = max((generations[parent] + 1 for parent in origin.parents), default=0)
            assert origin.generation == expected
            generations[step.asked.id] = origin.generation

    def test_fifty_are_asked_before_any_is_told(self) -> None:
        """Fifty candidates can be asked at once, unless the strategy waits for results or ends."""
        strategy = self.make(1)

        asked = _ask_many(strategy, 50)

        assert asked
        assert [candidate.id for candidate in asked] == list(range(1, len(asked) + 1))
        for candidate in asked:
            _assert_is_road(candidate)
        if len(asked) < 50:
            assert _ask(strategy) is None  # asking in vain changes nothing

    def test_another_seed_gives_other_candidates(self) -> None:
        """Among the first ten candidates of two seeds, a road differs."""
        first, second = self.make(1), self.make(2)

        pairs = zip(_ask_many(first, 10), _ask_many(second, 10), strict=False)
        assert any(not np.array_equal(a.curvatures, b.curvatures) for a, b in pairs)

    def test_two_strategies_do_not_disturb_each_other(self) -> None:
        """A strategy proposes the same beside another strategy of its class as alone."""
        alone = list(_campaign(self.make(5)))

        together = []
        for step, _ in zip(_campaign(self.make(5)), _campaign(self.make(6)), strict=True):
            together.append(step)

        _assert_same(alone, together)

    def test_global_random_states_are_neither_read_nor_changed(self) -> None:
        """The strategy neither changes nor uses the state of ``random`` and ``numpy.random``."""
        reference = list(_campaign(self.make(5)))
        np.random.seed(99)  # noqa: NPY002 - it is the legacy state that is watched
        random.seed(99)
        before = repr(np.random.get_state()), random.getstate()  # noqa: NPY002

        again = list(_campaign(self.make(5)))

        assert (repr(np.random.get_state()), random.getstate()) == before  # noqa: NPY002
        _assert_same(reference, again)

    @pytest.mark.parametrize(("outstanding", "dropping"), [(1, False), (20, True)])
    def test_a_replayed_log_gives_the_same_continuation(
        self, outstanding: int, dropping: bool
    ) -> None:
        """A new strategy that is asked and told the same continues in the same way, bit for bit.

        Both strategies want the same candidates. The log holds DROPPED candidates, too.
        """
        strategy, resumed = self.make(5), self.make(5)
        waiting: dict[int, Candidate] = {}
        for step in _campaign(strategy, outstanding=outstanding, dropping=dropping):
            if step.asked is not None:
                _assert_same_road(step.asked, _ask(resumed))
                waiting[step.asked.id] = step.asked
            if step.evaluation is not None:
                # A log gives equal values in other objects.
                candidate = _copy(waiting.pop(step.evaluation.candidate.id))
                resumed.tell(replace(step.evaluation, candidate=candidate))
            for candidate in waiting.values():
                assert strategy.is_wanted(candidate) == resumed.is_wanted(_copy(candidate))

        for _ in range(30):
            proposed, counterpart = _ask(strategy), _ask(resumed)
            if proposed is None or counterpart is None:
                assert proposed is counterpart
                break
            _assert_is_road(proposed)
            _assert_same_road(proposed, counterpart)
            strategy.tell(_made_up(proposed, 1.0))
            resumed.tell(_made_up(counterpart, 1.0))

    def test_candidates_are_told_in_any_order(self) -> None:
        """The candidate asked last may be told first."""
        strategy = self.make(1)
        asked = _ask_many(strategy, 40)

        for count, candidate in enumerate(reversed(asked), start=1):
            strategy.tell(_made_up(candidate, count / 100))

        following = _ask_many(strategy, 40)
        first = len(asked) + 1
        assert [candidate.id for candidate in following] == [*range(first, first + len(following))]
        for candidate in following:
            _assert_is_road(candidate)

    @pytest.mark.parametrize("outcome", list(Outcome))
    def test_it_continues_when_all_outcomes_are_alike(self, outcome: Outcome) -> None:
        """The strategy proposes roads even if all tests have the same outcome.

        A drive without a measured MOOBD is tried, too.
        """
        for moobd in (-1.0, None) if outcome.is_driven else (None,):
            strategy = self.make(1)
            for count in range(1, _TESTS + 1):
                candidate = _ask(strategy)
                if candidate is None:
                    break
                _assert_is_road(candidate)
                strategy.tell(Evaluation(candidate, outcome, moobd, count / _TESTS))

    @pytest.mark.parametrize("outcome", list(Outcome))
    def test_telling_twice_is_refused_and_changes_nothing(self, outcome: Outcome) -> None:
        """A second evaluation of a candidate raises ValueError and has no other effect."""
        strategy, reference = self.make(5), self.make(5)
        moobd = -1.0 if outcome.is_driven else None
        for count in range(1, 51):
            candidate, counterpart = _ask(strategy), _ask(reference)
            if candidate is None or counterpart is None:
                assert candidate is counterpart
                break
            _assert_same_road(candidate, counterpart)
            strategy.tell(_made_up(candidate, count / 100))
            reference.tell(_made_up(counterpart, count / 100))

            with pytest.raises(ValueError):
                strategy.tell(Evaluation(candidate, outcome, moobd, 0.5))

    @pytest.mark.parametrize("unknown_id", [-1, 0, 900, 1000])
    def test_an_unknown_candidate_is_refused_and_changes_nothing(self, unknown_id: int) -> None:
        """An evaluation of a candidate that was never asked raises ValueError."""
        strategy, reference = self.make(5), self.make(5)
        candidate = _ask_many(strategy, 3)[-1]
        _ask_many(reference, 3)

        with pytest.raises(ValueError):
            strategy.tell(Evaluation(replace(candidate, id=unknown_id), Outcome.FAIL, -2.0, 0.9))

        candidates, counterparts = _ask_many(strategy, 20), _ask_many(reference, 20)
        for candidate, counterpart in zip(candidates, counterparts, strict=True):
            _assert_same_road(candidate, counterpart)

    def test_interest_is_lost_once_and_asking_for_it_changes_nothing(self) -> None:
        """A strategy wants a new candidate, and never wants again what it no longer wants."""
        steps: list[_AskOrTell] = []
        waiting: dict[int, Candidate] = {}
        unwanted: set[int] = set()
        strategy = self.make(5)
        for step in _campaign(strategy, outstanding=20):
            steps.append(step)
            if step.asked is not None:
                assert strategy.is_wanted(step.asked)
                waiting[step.asked.id] = step.asked
            if step.evaluation is not None:
                del waiting[step.evaluation.candidate.id]
            for _ in range(2):  # the second time, asking must not have changed the answer
                now_unwanted = {i for i in waiting if not strategy.is_wanted(waiting[i])}
                assert unwanted & waiting.keys() <= now_unwanted
                unwanted |= now_unwanted

        _assert_same(steps, list(_campaign(self.make(5), outstanding=20)))

    def test_a_warm_start_follows_from_what_it_is_told(self) -> None:
        """The same earlier results give the same candidates, whose ids count from one."""
        evaluations = [step.evaluation for step in _campaign(self.make(3))]
        earlier = [
            evaluation
            for evaluation in evaluations
            if evaluation is not None and evaluation.outcome.is_driven
        ]
        strategies = [self.make(5), self.make(5)]
        for strategy in strategies:
            if has_own(strategy, "start_from"):
                strategy.start_from(earlier)

        first, second = (list(_campaign(strategy)) for strategy in strategies)

        _assert_same(first, second)
        asked = [step.asked.id for step in first if step.asked is not None]
        assert asked == list(range(1, len(asked) + 1))

    def test_curvatures_belong_to_one_candidate_and_stay_as_they_are(self) -> None:
        """Curvatures are read-only, share no memory with another candidate's, and never change."""
        arrays_and_copies = [
            (step.asked.curvatures, step.asked.curvatures.copy())
            for step in _campaign(self.make(1))
            if step.asked is not None
        ]

        for curvatures, first_values in arrays_and_copies:
            assert not curvatures.flags.writeable
            np.testing.assert_array_equal(curvatures, first_values)
        for (curvatures, _), (others, _) in itertools.combinations(arrays_and_copies, 2):
            assert not np.may_share_memory(curvatures, others)


@dataclass(frozen=True)
class _AskOrTell:
    """A step of a campaign: either a candidate is asked or its evaluation is told."""

    asked: Candidate | None = None
    evaluation: Evaluation | None = None


def _ask(strategy: Strategy) -> Candidate | None:
    """Return the next candidate; None if the strategy waits for results, or has ended."""
    try:
        return strategy.ask()
    except SearchEnded:
        return None


def _ask_many(strategy: Strategy, most: int) -> list[Candidate]:
    """Return up to ``most`` next candidates, without telling a result."""
    return list(itertools.islice(iter(lambda: _ask(strategy), None), most))


def _campaign(
    strategy: Strategy, *, outstanding: int = 7, dropping: bool = False
) -> Iterator[_AskOrTell]:
    """Ask `_TESTS` candidates, tell made-up results in a fixed random order, and yield each step.

    Args:
        strategy: the strategy.
        outstanding: most candidates that are asked and not told.
        dropping: whether to drop every eleventh candidate, and candidates that the strategy no
            longer wants when their turn comes.
    """
    rng = np.random.default_rng(20210501)
    waiting: list[Candidate] = []
    ask_count = tell_count = 0
    while tell_count < _TESTS:
        may_ask = ask_count < _TESTS and len(waiting) < outstanding
        proposed = _ask(strategy) if may_ask else None
        if proposed is not None:
            waiting.append(proposed)
            ask_count += 1
            yield _AskOrTell(asked=proposed)
        elif not waiting:
            return  # the strategy has ended
        else:
            tell_count += 1
            candidate = waiting.pop(int(rng.integers(len(waiting))))
            evaluation = _made_up(candidate, tell_count / _TESTS)
            if dropping and (candidate.id % 11 == 0 or not strategy.is_wanted(candidate)):
                evaluation = Evaluation(candidate, Outcome.DROPPED, None, tell_count / _TESTS)
            strategy.tell(evaluation)
            yield _AskOrTell(evaluation=evaluation)


def _made_up(candidate: Candidate, budget_spent: float) -> Evaluation:
    """Return an evaluation that depends only on the candidate.

    All outcomes but DROPPED occur, with MOOBDs from -3 to 2 m. Every third drive has no trace, as
    in a simulator that gives none.
    """
    outcome, moobd, places, offset, worst, speed, duration = _draw_result(candidate.id)
    if not outcome.is_driven:
        return Evaluation(candidate, outcome, None, budget_spent)
    if candidate.id % 3 == 0:
        return Evaluation(candidate, outcome, moobd, budget_spent)
    distance = candidate.length * places
    # Every seventh failure happens in the lane.
    stays_in_lane = outcome is not Outcome.FAIL or candidate.id % 7 == 0
    side: Side = "left" if offset[worst] > 0.0 else "right"
    place = float(distance[worst])
    return Evaluation(
        candidate,
        outcome,
        moobd,
        budget_spent,
        finding=None if stays_in_lane else Finding.departure(side, place),
        worst_place=place,
        duration=duration,
        read_trace=lambda: Trace(distance, offset.copy(), speed.copy()),
    )


_DrawnResult: TypeAlias = tuple[Outcome, float, FloatArray, FloatArray, int, FloatArray, float]


@cache
def _draw_result(candidate_id: int) -> _DrawnResult:
    """Return a candidate's outcome, MOOBD, places, offsets, worst index, speeds and duration.

    Places are shares of the road's length, offsets in m, speeds in m/s, the duration in s.
    """
    rng = np.random.default_rng(candidate_id)
    outcome = list(Outcome)[int(rng.choice(4, p=[0.5, 0.3, 0.15, 0.05]))]
    moobd = float(rng.uniform(-3.0, 2.0))
    places = np.linspace(0.0, float(rng.uniform(0.2, 1.0)), 100)
    offset = rng.normal(0.0, 0.3, 100)
    worst = int(rng.integers(100))
    offset[worst] = (2.0 - moobd) * (1.0 if rng.random() < 0.5 else -1.0)
    speed = rng.uniform(5.0, 20.0, 100)
    return outcome, moobd, places, offset, worst, speed, float(rng.uniform(1.0, 60.0))


def _copy(candidate: Candidate) -> Candidate:
    """Return an equal candidate with an array of its own."""
    return replace(candidate, curvatures=candidate.curvatures.copy())


def _assert_is_road(candidate: Candidate) -> None:
    """Assert that a candidate describes a road and has an origin."""
    assert candidate.curvatures.dtype == np.float64
    assert candidate.curvatures.ndim == 1
    assert len(candidate.curvatures) >= 2
    assert np.all(np.isfinite(candidate.curvatures))
    assert 0 < candidate.step < np.inf
    assert candidate.origin.operator


def _assert_same_road(first: Candidate, second: Candidate | None) -> None:
    """Assert that two candidates have the same id, origin and road, bit for bit."""
    assert second is not None
    assert (first.id, first.step, first.origin) == (second.id, second.step, second.origin)
    assert first.curvatures.tobytes() == second.curvatures.tobytes()


def _assert_same(first: list[_AskOrTell], second: list[_AskOrTell]) -> None:
    """Assert that two campaigns asked the same candidates at the same steps."""
    for step, counterpart in zip(first, second, strict=True):
        if step.asked is None or counterpart.asked is None:
            assert step.asked is counterpart.asked
        else:
            _assert_same_road(step.asked, counterpart.asked)
