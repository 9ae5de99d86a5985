"""Frenetic 2021 proposes the same candidates as a plain implementation of Listing 1."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Frenetic2021
from frenetic.search.operators import MutationOptions

PASS, FAIL, INVALID, ERROR, DROPPED = Outcome
PAPER = MutationOptions(0.07, 0.05, 1, 5, 1.1, 1.2)
"""Values of Section I-B of the paper."""


# The operators of Listing 1, implemented value by value.


def append_values(
    rng: np.random.Generator, values: list[float], n: int, options: MutationOptions
) -> FloatArray:
    """Append n values, uniform within the bound and the largest change from the value before."""
    for u in rng.random(n).tolist():
        values = [*values, next_value(values[-1] if values else 0.0, u, options)]
    return np.array(values)


def next_value(previous: float, u: float, options: MutationOptions) -> float:
    """Return a value within the bound and the largest change, at u of 0..1 of the range."""
    low = max(previous - options.max_change, -options.bound)
    high = min(previous + options.max_change, options.bound)
    if low > high:  # P6 scaled the value beyond the bound: take the bound's nearest end
        return math.copysign(options.bound, previous)
    return low + u * (high - low)


def mutant(
    rng: np.random.Generator, name: str, road: FloatArray, options: MutationOptions
) -> FloatArray | None:
    """Return a mutant, P1 .. P6, of a road that passed; None if it is too short to lose values."""
    if name == "P6":
        return road * rng.uniform(options.min_scale, options.max_scale)
    n, count = len(road), int(rng.integers(options.min_changed, options.max_changed + 1))
    if name == "P1":
        return append_values(rng, road.tolist(), count, options)
    if name == "P5":
        values = road.tolist()
        for i in sorted(rng.choice(n, size=min(count, n), replace=False).tolist()):
            values[i] = next_value(values[i - 1] if i else 0.0, rng.random(), options)
        return np.array(values)
    count = min(count, n - 2)
    if count == 0:
        return None
    if name == "P2":
        return np.delete(road, rng.choice(n, size=count, replace=False))
    return road[count:] if name == "P3" else road[: n - count]


def mutants_of_failure(road: FloatArray) -> dict[str, FloatArray]:
    """Return F1 .. F4 of a road that failed."""
    half = len(road) // 2
    return {
        "F1": -road[::-1],
        "F2": road[::-1],
        "F3": np.array([*road[half:], *road[:half]]),
        "F4": -road,
    }


@dataclass
class Row:
    """A row of the paper's table."""

    id: int
    curvatures: FloatArray
    operator: str
    parents: tuple[int, ...]
    generation: int
    siblings: list[Row] = field(default_factory=list)
    visited: bool = False
    outcome: Outcome | None = None
    fitness: float | None = None


@dataclass
class Twin:
    """Listing 1 of the paper; each step looks through the table of all roads."""

    seed: int
    random_budget: float = 0.2  # ours
    threshold: float = -0.5  # the paper's, Section I-B
    cross_freq: int = 40  # the published code's
    cross_num: int = 20  # the published code's
    mutation: MutationOptions = PAPER
    usual_length: int = 20
    is_valid: Callable[[FloatArray, float], bool] = lambda curvatures, step: True
    max_redraws: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.table: list[Row] = []
        self.spent, self.ran = 0.0, 0
        self.proposals = self.listing()

    def listing(self) -> Iterator[Row]:
        while self.spent < self.random_budget:
            yield self.random_road()
        while True:
            parent = next((row for row in self.below() if not row.visited), None)
            if parent is None:
                yield self.random_road()
            else:
                parent.visited = True
                yield from self.mutants(parent)
            if self.ran > self.cross_freq:
                self.ran = 0
                pool = self.below()[: self.cross_num]
                if len(pool) > 4 or len(pool) == self.cross_num:
                    yield from self.crossover(pool)

    def random_road(self) -> Row:
        def draw() -> FloatArray:
            n = self.usual_length + int(self.rng.integers(-5, 6))
            return append_values(self.rng, [], max(n, 2), self.mutation)

        return self.add("random", self.draw_accepted(draw))

    def mutants(self, parent: Row) -> Iterator[Row]:
        road = parent.curvatures
        siblings: list[Row] = []
        names = (
            mutants_of_failure(road)
            if parent.outcome is FAIL
            else [f"P{number}" for number in range(1, 7)]
        )
        for name in names:
            if parent.outcome is FAIL:
                mutant_values = mutants_of_failure(road)[name]
            else:
                mutant_values = self.draw_accepted(
                    partial(mutant, self.rng, name, road, self.mutation)
                )
            if mutant_values is not None:
                row = self.add(name, mutant_values, parent)
                row.visited = parent.outcome is FAIL
                row.siblings = siblings
                siblings.append(row)
                yield row
                if any(sibling.outcome is FAIL for sibling in siblings):
                    return

    def crossover(self, pool: list[Row]) -> Iterator[Row]:
        missing = self.cross_num
        while missing > 0:
            name, parents, children = self.children(pool)
            for _ in range(self.max_redraws):
                accepted = [child for child in children if self.accepts(child)]
                if accepted:
                    children = accepted
                    break
                name, parents, children = self.children(pool)
            for child in children:
                yield self.add(name, child, *parents)
                missing -= 1

    def children(self, pool: list[Row]) -> tuple[str, list[Row], list[FloatArray]]:
        parents = [pool[i] for i in self.rng.choice(len(pool), size=2, replace=False)]
        first, second = (parent.curvatures for parent in parents)
        if self.rng.random() < 0.5:
            n = min(len(first), len(second))
            takes = zip(self.rng.random(n), first, second, strict=False)
            return "C1", parents, [np.array([a if u < 0.5 else b for u, a, b in takes])]
        i, j = len(first) // 2, len(second) // 2
        joined = [*first[:i], *second[j:]], [*second[:j], *first[i:]]
        return "C2", parents, [np.array(values) for values in joined]

    def below(self) -> list[Row]:
        """Return driven roads below the threshold, the worst first."""
        ranked = [
            (row.fitness, row.id, row)
            for row in self.table
            if row.fitness is not None and row.fitness < self.threshold
        ]
        return [row for _, _, row in sorted(ranked, key=lambda entry: entry[:2])]

    def add(self, operator: str, curvatures: FloatArray, *parents: Row) -> Row:
        generation = max((parent.generation + 1 for parent in parents), default=0)
        ids = tuple(parent.id for parent in parents)
        self.table.append(Row(len(self.table) + 1, curvatures, operator, ids, generation))
        return self.table[-1]

    def draw_accepted(self, draw: Callable[[], Any]) -> Any:
        for _ in range(self.max_redraws):
            road = draw()
            if road is None or self.accepts(road):
                return road
        return draw()

    def accepts(self, road: FloatArray) -> bool:
        return self.max_redraws == 0 or self.is_valid(road, 10.0)

    def tell(self, evaluation: Evaluation) -> None:
        row = self.table[evaluation.candidate.id - 1]
        row.outcome, row.fitness = evaluation.outcome, evaluation.fitness
        if row.outcome is not DROPPED and row.operator not in ("F1", "C1", "C2"):
            self.ran += self.spent >= self.random_budget
        self.spent = max(self.spent, evaluation.budget_spent)

    def wants(self, candidate: Candidate) -> bool:
        siblings = self.table[candidate.id - 1].siblings
        return not any(sibling.outcome is FAIL for sibling in siblings)


def follow(
    search: Frenetic2021,
    twin: Twin,
    tests: int,
    result: Callable[[], tuple[Outcome, float | None]],
    outstanding: int = 1,
    objective: bool = False,
) -> list[str]:
    """Tell both the same random results, check that both propose alike; return the operators."""
    rng = np.random.default_rng(twin.seed)
    waiting: list[Candidate] = []
    for count in range(1, tests + 1):
        while len(waiting) < outstanding:
            candidate, row = search.ask(), next(twin.proposals)
            origin = candidate.origin
            assert (candidate.id, origin.operator) == (row.id, row.operator)
            assert (origin.parents, origin.generation) == (row.parents, row.generation)
            np.testing.assert_array_equal(candidate.curvatures, row.curvatures)
            waiting.append(candidate)
        assert [search.is_wanted(candidate) for candidate in waiting] == [
            twin.wants(candidate) for candidate in waiting
        ]
        candidate = waiting.pop(int(rng.integers(outstanding)))
        outcome, fitness = result()
        if not twin.wants(candidate) and rng.random() < 0.5:
            outcome, fitness = DROPPED, None
        spent = count / tests if rng.random() < 0.9 else 0.0  # some results come late
        evaluation = Evaluation(candidate, outcome, fitness, spent)
        if objective and fitness is not None:
            evaluation = Evaluation(candidate, outcome, 1.0, spent, objective=fitness)
        search.tell(evaluation)
        twin.tell(evaluation)
    return [row.operator for row in twin.table]


def bends_alike(curvatures: FloatArray, step: float) -> bool:
    """Return whether both ends turn the same way."""
    assert step == 10.0
    return bool(curvatures[0] * curvatures[-1] > 0)


OPTIONS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "the paper's": ({}, {}),
    "two values": ({"map_size": 20.0}, {"usual_length": 2}),
    "strong mutations": (
        {"min_changed": 2, "max_changed": 7, "min_scale": 1.5, "max_scale": 2.0},
        {"mutation": MutationOptions(0.07, 0.05, 2, 7, 1.5, 2.0)},
    ),
    "narrow": (
        {"curvature_bound": 0.002, "max_change": 0.001},
        {"mutation": MutationOptions(0.002, 0.001)},
    ),
    "refusing": ({"is_valid": bends_alike, "max_redraws": 3},) * 2,
    "refusing all": ({"is_valid": lambda *_: False, "max_redraws": 2},) * 2,
}
"""Name -> options of the search, and the same options of the twin."""


@given(
    way=st.sampled_from(list(OPTIONS)),
    seed=st.integers(0, 1000),
    outstanding=st.sampled_from([1, 1, 2, 7, 20]),
    shares=st.sampled_from([(6, 2, 1, 1), (2, 6, 1, 1), (9, 1, 0, 0), (1, 1, 4, 4)]),
    lowest=st.sampled_from([-3.0, -1.0, -0.6, 0.3]),
    listing=st.fixed_dictionaries(
        {
            "random_budget": st.sampled_from([0.0, 0.2, 1 / 3, 0.5]),
            "threshold": st.sampled_from([-0.5, 0.0]),
            "cross_freq": st.integers(0, 45),
            "cross_num": st.integers(2, 25),
        }
    ),
    objective=st.booleans(),
)
@settings(max_examples=80)
def test_it_proposes_and_wants_the_same_roads_as_listing_1(
    way: str,
    seed: int,
    outstanding: int,
    shares: tuple[int, ...],
    lowest: float,
    listing: dict[str, Any],
    objective: bool,
) -> None:
    rng = np.random.default_rng(seed)
    weights = np.array(shares) / sum(shares)

    def result() -> tuple[Outcome, float | None]:
        outcome = list(Outcome)[int(rng.choice(4, p=weights))]
        # Rounded, so that MOOBDs are often equal.
        return outcome, round(float(rng.uniform(lowest, 1.0)), 1) if outcome.is_driven else None

    options, twin_options = OPTIONS[way]
    search = Frenetic2021(seed=seed, **listing, **options)
    twin = Twin(seed, **listing, **twin_options)
    follow(search, twin, 250, result, outstanding, objective)


def test_the_defaults_are_the_twins() -> None:
    rng = np.random.default_rng(5)
    operators = follow(
        Frenetic2021(seed=1), Twin(1), 400, lambda: (PASS, float(rng.uniform(-2.0, 2.0)))
    )
    assert {"P1", "P6", "C1", "C2"} <= set(operators)


@pytest.mark.parametrize(("parents", "has_children"), [(4, False), (5, True)])
def test_a_crossover_needs_five_parents(parents: int, has_children: bool) -> None:
    search = Frenetic2021(seed=1, random_budget=0.0, cross_freq=10)
    operators = set()
    for number in range(200):
        candidate = search.ask()
        moobd = -1.0 if number < parents else 1.0
        operators.add(candidate.origin.operator)
        # Only the first roads are below the threshold; F1 .. F4 have no mutants.
        search.tell(Evaluation(candidate, FAIL, moobd, 0.5))
    assert ({"C1", "C2"} <= operators) is has_children


def test_a_crossover_without_enough_parents_restarts_the_count_of_tests() -> None:
    search = Frenetic2021(seed=1, random_budget=0.0, cross_freq=9)
    operators = []
    for number in range(22):
        candidate = search.ask()
        operators.append(candidate.origin.operator)
        # Every parent has one mutant, which fails at once. Ten results give four parents.
        is_parent = number in (0, 2, 4, 6, 10)
        outcome, moobd = (PASS, -1.0) if is_parent else (FAIL, 1.0)
        search.tell(Evaluation(candidate, outcome, moobd, 0.5))
    assert operators[:12] == ["random", "P1"] * 4 + ["random", "random", "random", "P1"]
    assert {"C1", "C2"}.isdisjoint(operators[:20])
    assert operators[20] in ("C1", "C2")


def test_roads_that_are_invalid_in_the_competition_are_redrawn_by_default() -> None:
    def is_valid(curvatures: FloatArray, step: float) -> bool:
        return Road(curvatures, step).placed(200.0)[1].valid

    twin = Twin(1, random_budget=0.5, is_valid=is_valid, max_redraws=2)
    search = Frenetic2021(seed=1, random_budget=0.5, max_redraws=2)

    follow(search, twin, 100, lambda: (PASS, -1.0))

    assert {is_valid(row.curvatures, 10.0) for row in twin.table} == {True, False}


def test_a_notice_says_that_no_road_is_below_the_threshold() -> None:
    search = Frenetic2021(seed=1, random_budget=0.1)
    for count in range(20):
        assert search.notice is None or count > 2
        search.tell(Evaluation(search.ask(), PASS, 1.0, count / 20))
    assert "threshold of -0.5 m" in (search.notice or "")
    search.tell(Evaluation(search.ask(), PASS, -0.6, 0.99))
    assert search.notice is None


@pytest.mark.parametrize(("moobd", "most"), [(-0.5, 1), (-1.0, 22)])
def test_memory_holds_only_the_best_roads_below_the_threshold(moobd: float, most: int) -> None:
    search = Frenetic2021(seed=1, random_budget=0.0, cross_num=20)
    references: list[weakref.ref[Candidate]] = []
    for _ in range(3000):
        candidate = search.ask()
        references.append(weakref.ref(candidate))
        is_random = candidate.origin.operator == "random"
        search.tell(Evaluation(candidate, FAIL, moobd if is_random else 1.0, 0.5))
    del candidate

    assert sum(ref() is not None for ref in references) <= most
    assert all(len(value) <= 22 for value in vars(search).values() if hasattr(value, "__len__"))
