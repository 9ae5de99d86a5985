"""Frenetic 2021 is Listing 1: on scripted outcomes, and against a plain twin of the listing."""

from __future__ import annotations

import itertools
import math
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Evaluation, Frenetic2021
from frenetic.search.operators import FAIL_OPERATORS

PASS, FAIL, INVALID, ERROR, DROPPED = Outcome
GOOD = 1.0  # m, a MOOBD above the threshold
P = ["P1", "P2", "P3", "P4", "P5", "P6"]
F = ["F1", "F2", "F3", "F4"]
C = ["C1", "C2"]


class Script:
    """Asks and tells, with outcomes as the test has them."""

    def __init__(self, **options: Any) -> None:
        # Without a check of its own, a script takes every road, as the paper does.
        redraws = {"max_redraws": 10 if "is_valid" in options else 0}
        self.search = Frenetic2021(**{"seed": 1, "random_budget": 0.0, **redraws, **options})
        self.asked: dict[int, Candidate] = {}
        self.spent = 0.5

    def ask(self) -> Candidate:
        candidate = self.search.ask()
        self.asked[candidate.id] = candidate
        return candidate

    def tell(self, candidate: Candidate, outcome: Outcome, moobd: float | None = None) -> None:
        if moobd is None and outcome.is_driven:
            moobd = GOOD
        self.search.tell(Evaluation(candidate, outcome, moobd, self.spent))

    def run(self, outcome: Outcome, moobd: float | None = None) -> Candidate:
        """Ask one and tell it at once."""
        candidate = self.ask()
        self.tell(candidate, outcome, moobd)
        return candidate

    def seeded(self, *results: tuple[Outcome, float | None]) -> list[Candidate]:
        """Return random roads with these results, all asked before the first is told."""
        roads = [self.ask() for _ in results]
        for road, (outcome, moobd) in zip(roads, results, strict=True):
            self.tell(road, outcome, moobd)
        return roads


def made_by(candidate: Candidate) -> tuple[str, tuple[int, ...]]:
    return candidate.origin.operator, candidate.origin.parents


# The random phase


@given(st.integers(1, 300), st.sampled_from([0.05, 0.2, 0.5, 1 / 3]))
@settings(max_examples=60)
def test_the_random_phase_takes_its_share_of_the_budget(tests: int, share: float) -> None:
    script = Script(random_budget=share)

    operators = []
    for count in range(1, tests + 1):
        script.spent = count / tests
        operators.append(script.run(PASS, -1.0).origin.operator)

    split = next(k for k in range(tests + 1) if k / tests >= share)
    assert operators[:split] == ["random"] * split
    if split < tests:
        assert operators[split] == "P1"


def test_of_1000_simulations_200_are_random() -> None:
    search = Frenetic2021(seed=1)

    operators = []
    for count in range(1, 1001):
        candidate = search.ask()
        operators.append(candidate.origin.operator)
        search.tell(Evaluation(candidate, PASS, -1.0, count / 1000))

    assert operators[:200] == ["random"] * 200
    assert "random" not in operators[200:]  # there is always a parent here


def test_the_phase_is_decided_by_what_has_been_told() -> None:
    script = Script(random_budget=0.2)
    script.spent = 0.1
    first, second, third, fourth = (script.ask() for _ in range(4))

    script.tell(first, FAIL, -1.0)
    assert script.ask().origin.operator == "random"
    script.spent = 0.3
    script.tell(second, PASS)
    script.spent = 0.15  # told late: the largest share counts
    script.tell(third, PASS)
    assert made_by(script.ask()) == ("F1", (first.id,))
    script.tell(fourth, PASS)  # and the phase does not come back
    assert made_by(script.ask()) == ("F2", (first.id,))


@pytest.mark.parametrize("outcome", [INVALID, ERROR])
def test_time_spent_on_undriven_roads_counts_towards_the_phase(outcome: Outcome) -> None:
    script = Script(random_budget=0.2)
    script.spent = 0.1
    road = script.run(PASS, -1.0)
    script.spent = 0.2
    script.run(outcome)

    assert made_by(script.ask()) == ("P1", (road.id,))


def test_a_random_budget_of_one_is_random_search() -> None:
    script = Script(random_budget=1.0)
    script.spent = 0.999

    assert {script.run(FAIL, -2.0).origin.operator for _ in range(200)} == {"random"}


# Parents


def test_the_parent_has_the_lowest_moobd_below_the_threshold() -> None:
    script = Script()
    _, b, c, _, e = script.seeded(
        (PASS, GOOD), (PASS, -0.6), (FAIL, -1.5), (INVALID, None), (PASS, -1.0)
    )

    parents = []
    for _ in range(len(F) + 2 * len(P)):
        candidate = script.run(PASS)
        parents.append(candidate.origin.parents[0])

    assert parents == [c.id] * 4 + [e.id] * 6 + [b.id] * 6
    assert script.run(PASS).origin.operator == "random"  # all visited


@pytest.mark.parametrize("moobd", [-0.5, 0.0, 2.0])
def test_the_threshold_is_strict(moobd: float) -> None:
    script = Script()
    script.seeded((FAIL, moobd))

    assert script.ask().origin.operator == "random"


def test_the_threshold_is_an_option() -> None:
    script = Script(threshold=0.5)
    (road,) = script.seeded((PASS, 0.4))

    assert made_by(script.ask()) == ("P1", (road.id,))


def test_of_equal_candidates_the_first_asked_becomes_parent() -> None:
    script = Script()
    first, second = script.ask(), script.ask()
    script.tell(second, FAIL, -1.0)
    script.tell(first, FAIL, -1.0)

    assert script.ask().origin.parents == (first.id,)


@pytest.mark.parametrize("outcome", [INVALID, ERROR])
def test_roads_that_were_not_driven_are_no_parents(outcome: Outcome) -> None:
    script = Script()
    for _ in range(30):
        assert script.run(outcome).origin.operator == "random"


def test_without_a_parent_one_random_road_is_tried_at_a_time() -> None:
    script = Script()
    assert script.run(PASS).origin.operator == "random"
    assert script.run(PASS).origin.operator == "random"
    third = script.run(PASS, -0.7)
    assert third.origin.operator == "random"
    assert made_by(script.ask()) == ("P1", (third.id,))


# Mutants


def test_mutants_of_a_passed_parent_are_tried_in_order() -> None:
    script = Script()
    (parent,) = script.seeded((PASS, -1.0))

    mutants = [script.run(PASS) for _ in P]

    assert [made_by(mutant) for mutant in mutants] == [(name, (parent.id,)) for name in P]
    assert {mutant.origin.generation for mutant in mutants} == {1}
    added, thinned, back, front, replaced, scaled = (mutant.curvatures for mutant in mutants)
    road = parent.curvatures
    n = len(road)
    assert n < len(added) <= n + 5
    np.testing.assert_array_equal(added[:n], road)
    assert n - 5 <= len(thinned) < n
    np.testing.assert_array_equal(back, road[-len(back) :])
    np.testing.assert_array_equal(front, road[: len(front)])
    assert 1 <= np.count_nonzero(replaced != road) <= 5
    assert 1.1 <= scaled[0] / road[0] <= 1.2


def test_mutants_of_a_failed_parent_are_tried_in_order() -> None:
    script = Script()
    (parent,) = script.seeded((FAIL, -1.0))

    mutants = [script.run(PASS) for _ in F]

    assert [made_by(mutant) for mutant in mutants] == [(name, (parent.id,)) for name in F]
    for name, mutant in zip(F, mutants, strict=True):
        np.testing.assert_array_equal(mutant.curvatures, FAIL_OPERATORS[name](parent.curvatures))


@pytest.mark.parametrize(("outcome", "names"), [(PASS, P), (FAIL, F)])
def test_the_first_mutant_that_fails_is_the_last(outcome: Outcome, names: list[str]) -> None:
    for failing in range(len(names)):
        script = Script()
        script.seeded((outcome, -1.0))

        tried = [script.run(FAIL if i == failing else PASS) for i in range(failing + 1)]

        assert [mutant.origin.operator for mutant in tried] == names[: failing + 1]
        assert script.ask().origin.operator == "random"


@pytest.mark.parametrize("outcome", [PASS, INVALID, ERROR])
def test_mutants_that_do_not_fail_do_not_stop_their_siblings(outcome: Outcome) -> None:
    script = Script()
    script.seeded((PASS, -1.0))

    assert [script.run(outcome).origin.operator for _ in P] == P


def test_a_failing_mutant_of_a_passed_parent_becomes_a_parent() -> None:
    script = Script()
    script.seeded((PASS, -0.8))
    mutant = script.run(FAIL, -1.2)

    grandchild = script.run(PASS)

    assert made_by(grandchild) == ("F1", (mutant.id,))
    assert grandchild.origin.generation == 2


def test_a_passed_mutant_of_a_passed_parent_becomes_a_parent() -> None:
    script = Script()
    script.seeded((PASS, -0.8))
    first = script.run(PASS, -0.7)
    for _ in P[1:]:
        script.run(PASS)

    assert made_by(script.ask()) == ("P1", (first.id,))


@pytest.mark.parametrize(("outcome", "names"), [(PASS, F), (FAIL, F[:1])])
def test_mutants_of_a_failed_parent_never_become_parents(
    outcome: Outcome, names: list[str]
) -> None:
    script = Script()
    script.seeded((FAIL, -0.8))

    assert [script.run(outcome, -5.0).origin.operator for _ in names] == names

    assert [script.run(PASS).origin.operator for _ in range(5)] == ["random"] * 5


def test_a_parent_of_two_values_skips_the_removals() -> None:
    script = Script(map_size=20.0, length_jitter=0)
    (parent,) = script.seeded((PASS, -1.0))
    assert len(parent.curvatures) == 2

    assert [script.run(PASS).origin.operator for _ in range(4)] == ["P1", "P5", "P6", "random"]


def test_mutation_options_reach_the_operators() -> None:
    script = Script(min_changed=7, max_changed=7, min_scale=1.5, max_scale=1.5)
    (parent,) = script.seeded((PASS, -1.0))

    lengths = {}
    for name in P:
        mutant = script.run(PASS)
        lengths[name] = len(mutant.curvatures) - len(parent.curvatures)

    assert lengths == {"P1": 7, "P2": -7, "P3": -7, "P4": -7, "P5": 0, "P6": 0}
    np.testing.assert_allclose(mutant.curvatures, 1.5 * parent.curvatures)


@pytest.mark.parametrize(("bound", "max_change"), [(0.002, 0.05), (0.07, 0.001)])
def test_new_values_of_mutants_keep_to_the_bound_and_the_change(
    bound: float, max_change: float
) -> None:
    script = Script(curvature_bound=bound, max_change=max_change)
    for _ in range(5):
        script.seeded((PASS, -1.0))
        mutants = {name: script.run(PASS).curvatures for name in P}

        for name in ("P1", "P5"):
            assert np.all(np.abs(mutants[name]) <= bound)
        assert np.all(np.abs(np.diff(mutants["P1"], prepend=0.0)) <= max_change + 1e-15)


# Several outstanding


def wanted(script: Script, *candidates: Candidate) -> list[bool]:
    return [script.search.is_wanted(candidate) for candidate in candidates]


@pytest.mark.parametrize(("outcome", "names"), [(PASS, P), (FAIL, F)])
def test_siblings_of_a_failed_mutant_are_not_wanted_any_more(
    outcome: Outcome, names: list[str]
) -> None:
    for failing in range(len(names)):
        script = Script()
        parent, other = script.seeded((outcome, -1.0), (FAIL, -0.9))
        mutants = [script.ask() for _ in names]
        nephews = [script.ask() for _ in F]
        road = script.ask()
        assert {mutant.origin.parents for mutant in mutants} == {(parent.id,)}
        assert {nephew.origin.parents for nephew in nephews} == {(other.id,)}
        assert wanted(script, *mutants, *nephews, road) == [True] * (len(names) + 5)

        failed = mutants.pop(failing)
        script.tell(failed, FAIL)

        assert wanted(script, *mutants) == [False] * len(mutants)
        assert wanted(script, *nephews, road) == [True] * 5
        script.tell(mutants.pop(), PASS, -3.0)  # what was being driven changes nothing
        script.tell(nephews.pop(), PASS)
        assert wanted(script, *mutants) == [False] * len(mutants)
        assert wanted(script, *nephews, road) == [True] * 4


@pytest.mark.parametrize("outcome", [PASS, INVALID, ERROR, DROPPED])
def test_siblings_of_a_mutant_that_did_not_fail_stay_wanted(outcome: Outcome) -> None:
    script = Script()
    script.seeded((PASS, -1.0))
    mutants = [script.ask() for _ in P]
    script.tell(mutants.pop(0), outcome)

    assert wanted(script, *mutants) == [True] * 5


def test_random_roads_and_children_of_crossover_stay_wanted() -> None:
    script = Script(cross_freq=0, cross_num=4)
    roads = [script.ask() for _ in range(3)]
    script.tell(roads.pop(), FAIL, -1.0)
    assert wanted(script, *roads) == [True, True]
    script.tell(roads.pop(), FAIL, -0.9)
    children = [script.ask() for _ in range(4)]
    assert {child.origin.operator for child in children} <= set(C)
    script.tell(children.pop(), FAIL, -2.0)

    assert wanted(script, *children, *roads) == [True] * 4


def test_what_is_wanted_goes_by_the_id() -> None:
    script = Script()
    script.seeded((FAIL, -1.0))
    first, second = script.ask(), script.ask()
    rebuilt = Candidate(second.id, second.curvatures.copy(), second.step, second.origin)
    assert wanted(script, rebuilt) == [True]
    script.tell(first, FAIL)

    assert wanted(script, rebuilt) == [False]


def test_dropped_siblings_leave_nothing_behind() -> None:
    script = Script(cross_freq=3, cross_num=4)
    script.seeded((FAIL, -1.0))
    mutants = [script.ask() for _ in F]
    assert [mutant.origin.operator for mutant in mutants] == F
    script.tell(mutants[0], FAIL, -2.0)
    for mutant in mutants[1:]:
        script.tell(mutant, DROPPED)
    assert len(script.search._siblings_of) == 0

    # They are no tests that ran: two did so far, and more than three have to.
    assert [script.run(PASS).origin.operator in C for _ in range(3)] == [False, False, True]


def test_siblings_are_asked_before_they_are_told_until_one_fails() -> None:
    script = Script()
    parent, other = script.seeded((PASS, -1.0), (FAIL, -0.9))
    p1, p2, p3 = (script.ask() for _ in range(3))
    assert [made_by(mutant) for mutant in (p1, p2, p3)] == [(name, (parent.id,)) for name in P[:3]]

    script.tell(p2, FAIL, GOOD)

    assert made_by(script.ask()) == ("F1", (other.id,))
    script.tell(p3, PASS, -2.0)  # outstanding siblings count like any other
    script.tell(p1, PASS, -1.5)
    rest = [script.ask() for _ in range(3 + 6 + 6)]
    assert [candidate.origin.parents[0] for candidate in rest] == (
        [other.id] * 3 + [p3.id] * 6 + [p1.id] * 6
    )


def test_a_late_failure_does_not_stop_another_family() -> None:
    script = Script()
    first, second = script.seeded((PASS, -1.0), (PASS, -0.9))
    family = [script.ask() for _ in P]
    p1 = script.ask()
    assert made_by(p1) == ("P1", (second.id,))

    for mutant in family:
        assert mutant.origin.parents == (first.id,)
        script.tell(mutant, FAIL, GOOD)

    assert [script.ask().origin.operator for _ in P[1:]] == P[1:]


def test_with_all_outstanding_and_no_parent_more_random_roads_follow() -> None:
    script = Script()
    script.seeded((FAIL, -1.0))

    operators = [script.ask().origin.operator for _ in range(10)]

    assert operators == F + ["random"] * 6


# Crossover


def run_campaign(script: Script, tests: int, moobds: Iterator[float]) -> list[Candidate]:
    return [script.run(PASS, next(moobds)) for _ in range(tests)]


def groups(candidates: Iterable[Candidate]) -> list[tuple[bool, int]]:
    """Return the lengths of the runs of crossover's children (True) and of others (False)."""
    runs = itertools.groupby(candidates, key=lambda c: c.origin.operator in C)
    return [(is_cross, len(list(run))) for is_cross, run in runs]


def test_crossover_comes_after_more_than_40_tests_and_has_20_children() -> None:
    script = Script(random_budget=0.2)
    rng = np.random.default_rng(5)
    script.spent = 0.1
    for _ in range(99):
        script.run(PASS, float(rng.uniform(-2, 2)))
    script.spent = 0.2
    script.run(PASS, float(rng.uniform(-2, 2)))

    candidates = run_campaign(script, 1000, iter(lambda: float(rng.uniform(-2, 2)), None))

    # Tests of the random phase do not count; families of six end before crossover is checked.
    runs = groups(candidates)
    assert len(runs) > 20
    assert runs[:-1] == [(i % 2 == 1, 20 if i % 2 else 42) for i in range(len(runs) - 1)]


@pytest.mark.parametrize("cross_freq", [0, 1, 5, 8])
def test_crossover_wants_more_than_cross_freq_tests(cross_freq: int) -> None:
    script = Script(random_budget=0.2, cross_freq=cross_freq, cross_num=3)
    script.spent = 0.1
    script.run(FAIL, -1.0)
    script.spent = 0.2
    script.run(FAIL, -0.9)

    # Both parents' families are F1 passing, F2 failing; then random roads, one at a time.
    candidates = [script.run(FAIL if count % 2 else PASS, GOOD) for count in range(30)]
    ran = groups(candidates)[0][1]

    # It is checked after 2, 4, 5, 6, .. tests.
    assert ran == {0: 2, 1: 2, 5: 6, 8: 9}[cross_freq]


@pytest.mark.parametrize("outcome", [INVALID, ERROR])
def test_only_tests_that_ran_count_towards_crossover(outcome: Outcome) -> None:
    script = Script(cross_freq=3, cross_num=2)
    script.seeded((FAIL, -1.0), (FAIL, -0.9))  # two tests

    # Two families and random roads that are not driven: no crossover however many.
    assert not {script.run(outcome).origin.operator for _ in range(50)} & set(C)
    script.run(PASS)
    assert script.run(PASS).origin.operator == "random"
    assert script.run(PASS).origin.operator in C  # four tests ran


def test_parents_of_crossover_are_the_best_below_the_threshold_visited_or_not() -> None:
    script = Script(cross_freq=30, cross_num=6)
    moobds = [-0.4, -3.0, -0.6, -2.0, -0.5, -1.0, -2.5, -0.7, -0.8, -0.9, 2.0]
    roads = script.seeded(*((FAIL, moobd) for moobd in moobds))
    best = {roads[i].id for i in (1, 3, 5, 6, 9)}
    f1 = script.run(PASS, -2.2)  # a mutant of a failed parent, visited from the start
    assert f1.origin.operator == "F1"

    following = [script.run(PASS) for _ in range(40)]
    children = [candidate for candidate in following if candidate.origin.operator in C]

    assert len(children) == 6
    parents = [child.origin.parents for child in children]
    assert all(len(set(pair)) == 2 for pair in parents)
    assert set(itertools.chain(*parents)) <= best | {f1.id}


def test_every_parent_of_the_pool_has_children_by_either_operator() -> None:
    script = Script(cross_freq=0, cross_num=400)
    roads = script.seeded(*((FAIL, -1.0 - i / 100) for i in range(15)))
    children = [script.run(PASS) for _ in range(400)]

    operators = Counter(child.origin.operator for child in children)
    assert set(operators) == set(C)
    assert operators["C1"] / 400 == pytest.approx(1 / 3, abs=0.08)  # C2 has two children a time
    used = Counter(itertools.chain(*(child.origin.parents for child in children)))
    assert set(used) == {road.id for road in roads}
    assert max(used.values()) < 3 * min(used.values())


def test_children_are_made_of_their_parents() -> None:
    script = Script(cross_freq=0, cross_num=40)
    script.seeded(*((FAIL, -1.0 - i / 100) for i in range(10)))

    for _ in range(40):
        child = script.run(PASS)
        first, second = (script.asked[parent].curvatures for parent in child.origin.parents)
        n, m = len(first), len(second)
        values = child.curvatures.tolist()
        if child.origin.operator == "C1":
            assert len(values) == min(n, m)
            assert all(values[i] in (first[i], second[i]) for i in range(len(values)))
        else:
            assert values in (
                [*first[: n // 2], *second[m // 2 :]],
                [*second[: m // 2], *first[n // 2 :]],
            )


def test_both_children_of_c2_are_proposed_one_after_the_other() -> None:
    script = Script(cross_freq=0, cross_num=41)
    script.seeded(*((FAIL, -1.0 - i / 100) for i in range(10)))

    spliced = []
    children = [script.run(PASS) for _ in range(41)]
    for parents, litter in itertools.groupby(children, key=lambda c: c.origin.parents):
        brood = [child for child in litter if child.origin.operator == "C2"]
        if brood and children[-1] not in brood:
            spliced.append((parents, brood))

    assert spliced
    for (first, second), brood in spliced:
        n, m = len(script.asked[first].curvatures), len(script.asked[second].curvatures)
        lengths = [len(child.curvatures) for child in brood]
        expected = [n // 2 + math.ceil(m / 2), m // 2 + math.ceil(n / 2)]
        assert lengths == expected * (len(lengths) // 2)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("cross_num", [2, 3])
def test_crossover_proposes_no_child_too_many(seed: int, cross_num: int) -> None:
    script = Script(seed=seed, cross_freq=0, cross_num=cross_num)
    script.seeded((FAIL, -1.0), (FAIL, -0.9))

    operators = [script.run(PASS).origin.operator for _ in range(cross_num + 1)]

    assert set(operators[:-1]) <= set(C)
    assert operators[-1] == "F1"


def test_the_generation_is_one_more_than_the_youngest_parents() -> None:
    script = Script(cross_freq=0, cross_num=20)
    script.seeded((PASS, -1.0))
    script.run(FAIL, -2.0)  # P1: generation 1

    child = script.run(PASS)

    assert child.origin.operator in C
    assert sorted(child.origin.parents) == [1, 2]
    assert child.origin.generation == 2


def test_children_of_crossover_are_unvisited() -> None:
    script = Script(cross_freq=0, cross_num=2)
    script.seeded((FAIL, -1.0), (FAIL, -0.9))
    child, other = script.run(PASS, -4.0), script.run(FAIL, -3.0)
    assert {child.origin.operator, other.origin.operator} <= set(C)

    assert made_by(script.run(FAIL)) == ("P1", (child.id,))


def test_a_failing_child_does_not_end_the_crossover() -> None:
    script = Script(cross_freq=0, cross_num=10)
    script.seeded((FAIL, -1.0), (FAIL, -0.9))

    assert {script.run(FAIL, GOOD).origin.operator for _ in range(10)} <= set(C)


@pytest.mark.parametrize("below", [0, 1])
def test_crossover_waits_for_two_parents(below: int) -> None:
    script = Script(cross_freq=5, cross_num=4)
    script.seeded(*[(FAIL, -1.0)] * below)
    for _ in range(30):
        assert script.run(PASS).origin.operator not in C
    for _ in range(2 - below):
        assert script.run(FAIL, -0.9).origin.operator not in C

    # The count went on meanwhile, so it comes as soon as there are two.
    assert [script.run(PASS).origin.operator in C for _ in range(5)] == [True] * 4 + [False]


def test_the_pool_is_that_of_the_moment_of_crossover() -> None:
    script = Script(cross_freq=0, cross_num=30)
    pool = script.seeded((FAIL, -1.0), (FAIL, -0.9))

    children = [script.run(FAIL, -9.0) for _ in range(30)]

    assert {frozenset(child.origin.parents) for child in children} == {
        frozenset(road.id for road in pool)
    }


# Refused roads


def test_random_roads_mutants_and_children_are_drawn_until_valid() -> None:
    def is_valid(curvatures: FloatArray, step: float) -> bool:
        assert step == 10.0
        return bool(curvatures[0] * curvatures[-1] > 0)  # both ends turn the same way

    redrawing = Script(is_valid=is_valid, max_redraws=100, cross_freq=30)
    plain = Script(cross_freq=30)
    shares = {}
    for name, script in (("redrawing", redrawing), ("plain", plain)):
        rng = np.random.default_rng(3)
        results: dict[str, list[bool]] = {}
        for _ in range(1500):
            outcome = FAIL if rng.random() < 0.1 else PASS
            candidate = script.run(outcome, float(rng.uniform(-1.5, 2.0)))
            results.setdefault(candidate.origin.operator, []).append(
                is_valid(candidate.curvatures, 10.0)
            )
        shares[name] = {operator: np.mean(valid) for operator, valid in results.items()}

    for operator in ("random", "P1", "P2", "P5", "C1", "C2"):
        assert shares["redrawing"][operator] == 1.0, operator
        assert shares["plain"][operator] < 0.9, operator


def test_a_valid_child_is_proposed_even_if_its_twin_is_refused() -> None:
    checking = False
    accepted: list[list[float]] = []

    def is_valid(curvatures: FloatArray, step: float) -> bool:
        if checking and curvatures[0] < 0:
            return False
        accepted.append(curvatures.tolist())
        return True

    script = Script(is_valid=is_valid, max_redraws=100, cross_freq=0, cross_num=50)
    script.seeded(*((FAIL, -1.0 - i / 100) for i in range(10)))
    checking = True
    accepted.clear()

    children = [script.run(PASS).curvatures.tolist() for _ in range(50)]

    assert children == accepted[:50]
    assert len(accepted) <= 51  # no valid child is thrown away, but for a last one too many


def test_what_cannot_be_drawn_again_is_handed_out() -> None:
    calls = []

    def is_valid(curvatures: FloatArray, step: float) -> bool:
        calls.append(curvatures)
        return False

    script = Script(is_valid=is_valid, max_redraws=3, cross_freq=0, cross_num=4)
    script.seeded((FAIL, -1.0), (FAIL, -0.9))
    assert len(calls) == 2 * 3
    calls.clear()
    assert {script.run(INVALID).origin.operator for _ in range(4)} <= set(C)
    # Two to four children or pairs of them, each drawn until the fourth time.
    assert 2 * 3 <= len(calls) <= 4 * 3 * 2
    calls.clear()
    assert [script.run(INVALID).origin.operator for _ in F] == F
    assert calls == []


def test_a_check_that_accepts_all_changes_nothing() -> None:
    checked, plain = Script(is_valid=lambda curvatures, step: True), Script()
    rng = np.random.default_rng(3)
    for _ in range(500):
        moobd = float(rng.uniform(-1.5, 2.0))
        first, second = checked.run(PASS, moobd), plain.run(PASS, moobd)
        assert first.origin == second.origin
        np.testing.assert_array_equal(first.curvatures, second.curvatures)


# Options and memory


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("random_budget", 1.1, "random_budget must be between 0 and 1, got 1.1"),
        ("random_budget", -0.1, "random_budget must be between 0 and 1, got -0.1"),
        ("threshold", float("nan"), "threshold must be a finite number (m), got nan"),
        ("cross_freq", -1, "cross_freq must be a whole number of at least 0, got -1"),
        ("cross_num", 1, "cross_num must be a whole number of at least 2, got 1"),
        ("min_changed", 0, "min_changed must be a whole number of at least 1, got 0"),
        ("max_changed", 0, "max_changed must be a whole number of at least 1, got 0"),
        ("max_scale", 1.0, "max_scale must be a number of at least min_scale (1.1), got 1.0"),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: float, message: str) -> None:
    options: dict[str, Any] = {"seed": 1, option: value}

    with pytest.raises(ValueError) as refusal:
        Frenetic2021(**options)

    assert str(refusal.value) == message


def test_candidates_above_the_threshold_are_forgotten() -> None:
    script = Frenetic2021(seed=1)
    seen: list[weakref.ref[Candidate]] = []
    for count in range(20_000):
        candidate = script.ask()
        seen.append(weakref.ref(candidate))
        script.tell(Evaluation(candidate, PASS, -0.5, count / 20_000))
    del candidate

    assert sum(ref() is not None for ref in seen) <= 1
    held = {
        name: len(value)
        for name, value in vars(script).items()
        if hasattr(value, "__len__") and name != "options"
    }
    assert {"_unvisited", "_best", "_ledger", "_siblings_of"} <= set(held)
    assert set(held.values()) == {0}


def test_visited_candidates_are_forgotten_but_for_the_best() -> None:
    search = Frenetic2021(seed=1, random_budget=0.0, cross_num=20)
    seen: list[weakref.ref[Candidate]] = []
    for count in range(5_000):
        candidate = search.ask()
        seen.append(weakref.ref(candidate))
        is_random = candidate.origin.operator == "random"
        search.tell(Evaluation(candidate, FAIL, -1.0 if is_random else GOOD, count / 5_000))
    del candidate

    assert sum(ref() is not None for ref in seen) <= 20 + 2
    assert len(search._siblings_of) == len(search._ledger) == 0


# The listing, once more


@dataclass
class Known:
    """A row of the table that the paper keeps."""

    id: int
    outcome: Outcome
    moobd: float
    visited: bool


Tell = Callable[[Candidate], tuple[Outcome, float | None]]


def listing_1(
    script: Script, tell: Tell, tests: int, random_budget: float, cross_freq: int, cross_num: int
) -> None:
    """Follow Listing 1 as it stands in the paper, sequentially, and check each candidate."""
    table: list[Known] = []
    count = 0

    def execute(operators: list[str], parents: list[set[int]], visited: bool = False) -> Known:
        nonlocal count
        if count == tests:
            raise StopIteration
        candidate = script.ask()
        count += 1
        assert candidate.origin.operator in operators
        assert set(candidate.origin.parents) in parents
        outcome, moobd = tell(candidate)
        script.spent = count / tests
        script.tell(candidate, outcome, moobd)
        row = Known(candidate.id, outcome, math.inf if moobd is None else moobd, visited)
        table.append(row)
        return row

    def below() -> list[Known]:
        rows = [row for row in table if row.outcome in (PASS, FAIL) and row.moobd < -0.5]
        return sorted(rows, key=lambda row: (row.moobd, row.id))

    while count / tests < random_budget:
        execute(["random"], [set()])
    recent = 0
    while True:
        parent = next((row for row in below() if not row.visited), None)
        if parent is None:
            recent += execute(["random"], [set()]).outcome in (PASS, FAIL)
        else:
            parent.visited = True
            names = F if parent.outcome is FAIL else P
            if len(script.asked[parent.id].curvatures) == 2:
                names = [name for name in names if name not in ("P2", "P3", "P4")]
            for name in names:
                mutant = execute([name], [{parent.id}], visited=parent.outcome is FAIL)
                recent += mutant.outcome in (PASS, FAIL)
                if mutant.outcome is FAIL:
                    break
        pool = [row.id for row in below()[:cross_num]]
        if recent > cross_freq and len(pool) >= 2:
            pairs = [set(pair) for pair in itertools.combinations(pool, 2)]
            for _ in range(cross_num):
                execute(C, pairs)
            recent = 0


@given(
    seed=st.integers(0, 1000),
    shares=st.sampled_from([(6, 2, 1, 1), (2, 6, 1, 1), (9, 1, 0, 0), (1, 1, 4, 4)]),
    lowest=st.sampled_from([-3.0, -1.0, -0.6]),
    random_budget=st.sampled_from([0.0, 0.2, 0.35]),
    cross_freq=st.integers(0, 45),
    cross_num=st.integers(2, 25),
)
@settings(max_examples=60)
def test_asked_and_told_one_by_one_it_is_listing_1(
    seed: int,
    shares: tuple[int, ...],
    lowest: float,
    random_budget: float,
    cross_freq: int,
    cross_num: int,
) -> None:
    rng = np.random.default_rng(seed)
    weights = np.array(shares) / sum(shares)

    def tell(candidate: Candidate) -> tuple[Outcome, float | None]:
        outcome = list(Outcome)[int(rng.choice(4, p=weights))]
        # Rounded, so that MOOBDs are often equal.
        return outcome, round(float(rng.uniform(lowest, 1.0)), 1) if outcome.is_driven else None

    script = Script(
        seed=seed, random_budget=random_budget, cross_freq=cross_freq, cross_num=cross_num
    )
    script.spent = 0.0
    with pytest.raises(StopIteration):
        listing_1(script, tell, 400, random_budget, cross_freq, cross_num)
    assert len(script.asked) == 400


def test_repeats_are_skipped_on_request() -> None:
    def proposed(skip: bool, tests: int = 400) -> list[bytes]:
        script = Script(is_valid=lambda curvatures, step: True, skip_repeats=skip)
        moobds = itertools.cycle([-0.6, -1.5, -0.9, 1.0, -2.0, -1.1])
        outcomes = itertools.cycle([FAIL, PASS, FAIL, PASS, PASS])
        return [script.run(next(outcomes), next(moobds)).curvatures.tobytes() for _ in range(tests)]

    assert len(set(proposed(skip=False))) < 400
    assert len(set(proposed(skip=True))) == 400


def test_skipping_repeats_changes_nothing_before_the_first_one() -> None:
    plain, skipping = Script(), Script(skip_repeats=True)
    for _ in range(30):
        assert np.array_equal(plain.run(PASS).curvatures, skipping.run(PASS).curvatures)
