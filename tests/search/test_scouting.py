"""What a search tries until a road fails: families of roads, and how fast they may bend."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding
from frenetic.search import Candidate, Evaluation, Frenetic, RandomSearch, Strategy, Trace
from frenetic.search.change_limit import ChangeLimit, largest_change
from frenetic.search.operator_names import INDEPENDENT
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE
from frenetic.search.road_families import FAMILIES, FamilyChoice
from frenetic.search.variation import limit_changes


def result(candidate: Candidate, moobd: float) -> Evaluation:
    """Return the result of a drive that fails below -1.5 m, in the middle of the road."""
    place = 0.5 * candidate.length
    finding = Finding.departure("left", place) if moobd < -1.5 else None
    outcome = Outcome.PASS if finding is None else Outcome.FAIL
    return Evaluation(candidate, outcome, moobd, 0.1, finding=finding, worst_place=place)


def turned(candidate: Candidate, yaw_rate: FloatArray) -> Evaluation:
    """Return a drive that passed with these yaw rates, (3,) in rad/s."""
    columns = {name: np.zeros(3) for name in Trajectory.names()}
    columns |= {"time": np.array([0.0, 0.05, 0.1]), "yaw_rate": yaw_rate}
    distance = np.linspace(0.0, candidate.length, 3)
    trace = Trace(distance, np.full(3, 0.5), np.full(3, 9.0), Trajectory(**columns))
    return Evaluation(candidate, Outcome.PASS, 1.0, 0.1, worst_place=60.0, read_trace=lambda: trace)


def fears_a_slalom(candidate: Candidate) -> float:
    """Return the MOOBD of a driver that fears sharp bends to both sides in turn."""
    values = candidate.curvatures
    return 1.5 - 500.0 * float((-values[1:] * values[:-1]).clip(min=0.0).sum())


def fears_sharp_changes(candidate: Candidate) -> float:
    """Return the MOOBD of a driver that fails where the curvature changes by 0.07 1/m or more."""
    return -2.0 if largest_change(candidate.curvatures) > 0.07 else 1.0


def first_failure(search: Strategy, driver: Callable[[Candidate], float], most: int) -> int:
    """Return the number of drives up to the first failure, or ``most``."""
    for drives in range(1, most):
        candidate = search.ask()
        assert candidate is not None
        evaluation = result(candidate, driver(candidate))
        search.tell(evaluation)
        if evaluation.outcome is Outcome.FAIL:
            return drives
    return most


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_keeps_bound_and_change(family: str) -> None:
    rng = np.random.default_rng(1)
    for max_change in (0.01, MAX_CHANGE, 0.14):
        for _ in range(50):
            values = FAMILIES[family](rng, 25, CURVATURE_BOUND, max_change)
            assert values.shape == (25,)
            assert np.abs(values).max() <= CURVATURE_BOUND
            assert largest_change(values) <= max_change + 1e-12


def test_each_family_comes_once_and_then_the_successful_more_often() -> None:
    rng, choice = np.random.default_rng(2), FamilyChoice()
    others = [family for family in FAMILIES if family != INDEPENDENT]
    assert [choice.choose(rng, has_failures=True) for _ in others] == others
    for family in FAMILIES:
        for _ in range(10):
            choice.learn(family, 1.0 if family == "slalom" else 0.0)
    chosen = Counter(choice.choose(rng, has_failures=True) for _ in range(200))
    assert chosen["slalom"] > 150


def test_every_other_road_has_independent_values_until_a_road_fails() -> None:
    rng, choice = np.random.default_rng(2), FamilyChoice()
    families = [choice.choose(rng, has_failures=False) for _ in range(2 * len(FAMILIES))]
    assert families[::2] == [INDEPENDENT] * len(FAMILIES)
    others = [family for family in FAMILIES if family != INDEPENDENT]
    assert families[1 : 2 * len(others) : 2] == others


def test_limited_values_stay_at_the_site_and_change_no_more_than_allowed() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        values, site = rng.uniform(-0.07, 0.07, 20), int(rng.integers(3, 20))
        limited = values.copy()
        limit_changes(limited, site, MAX_CHANGE)
        assert limited[site] == values[site]
        assert largest_change(limited) <= MAX_CHANGE + 1e-12
        again = limited.copy()
        limit_changes(again, site, MAX_CHANGE)
        np.testing.assert_array_equal(again, limited)


def test_all_roads_change_by_at_most_the_usual_amount() -> None:
    for max_change in (MAX_CHANGE, 0.03):
        search = Frenetic(seed=4, max_change=max_change, sharper_after=10_000)
        for _ in range(200):
            candidate = search.ask()
            assert largest_change(candidate.curvatures) <= max_change + 1e-9
            search.tell(result(candidate, fears_a_slalom(candidate)))


def test_sharper_roads_come_only_where_no_other_road_fails() -> None:
    search = Frenetic(seed=5, sharper_after=20)
    changes = []
    for _ in range(60):
        candidate = search.ask()
        changes.append(largest_change(candidate.curvatures))
        search.tell(result(candidate, 1.0))
    assert max(changes[:20]) <= MAX_CHANGE + 1e-9 < max(changes[20:])
    assert "0.05 1/m" in (search.notice or "")
    assert first_failure(Frenetic(seed=5), fears_sharp_changes, 300) > 100
    assert first_failure(Frenetic(seed=5, sharper_after=10_000), fears_sharp_changes, 300) == 300


def test_a_failure_within_the_usual_change_ends_sharper_roads() -> None:
    rng, limits = np.random.default_rng(6), np.array([CURVATURE_BOUND, MAX_CHANGE])
    limit = ChangeLimit(limits, sharper_after=10)
    limit.choose(rng, 9, has_failures=False)
    assert limits[1] == MAX_CHANGE
    shares = []
    for _ in range(200):
        limit.choose(rng, 10, has_failures=False)
        shares.append(limit.is_lifted)
    assert 70 < sum(shares) < 130
    limit.learn_failure(np.array([0.0, 0.07, -0.07]), 10)
    limit.choose(rng, 10, has_failures=True)
    assert limits[1] == 2.0 * CURVATURE_BOUND
    limit.learn_failure(np.array([0.0, 0.05, 0.0]), 11)
    limit.choose(rng, 20, has_failures=True)
    assert limits[1] == MAX_CHANGE
    assert not limit.has_lifted(20)
    assert limit.has_lifted(21)


def test_nothing_is_sharper_than_roads_of_any_change() -> None:
    limits = np.array([CURVATURE_BOUND, 3.0 * CURVATURE_BOUND])
    limit = ChangeLimit(limits, sharper_after=0)
    limit.choose(np.random.default_rng(1), 1000, has_failures=False)
    assert not limit.has_lifted(1000)
    assert limits[1] == 3.0 * CURVATURE_BOUND


def test_the_search_begins_sooner_than_random_roads() -> None:
    scouting = [first_failure(Frenetic(seed=s), fears_a_slalom, 100) for s in range(9)]
    random = [first_failure(RandomSearch(seed=s), fears_a_slalom, 100) for s in range(9)]
    assert np.median(scouting) * 3 <= np.median(random)


def test_a_car_that_is_turned_abruptly_becomes_a_parent() -> None:
    """All drives come equally near failing; one of them turns the car abruptly."""
    search = Frenetic(seed=7, sharper_after=10_000)
    abrupt, parents = 3, Counter[int]()
    for _ in range(300):
        candidate = search.ask()
        parents.update(candidate.origin.parents)
        yaw_rate = np.zeros(3)
        yaw_rate[1] = 5.0 if candidate.id == abrupt else 0.1
        search.tell(turned(candidate, yaw_rate))
    assert parents[abrupt] > 2 * parents.total() / len(parents)
