"""The strategy `frenetic`: its archive, operators, refusals and foresight."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Frenetic, Trace
from frenetic.search import speed_model as speeds
from frenetic.search.approach import (
    BEHIND,
    POINTS_BEHIND,
    SIZE,
    SPACING,
    as_vector,
    points_along,
    road_around,
    set_points,
    set_road,
    states_before,
    table_around,
)
from frenetic.search.archive import APART, LEFT, RIGHT, Archive, Place, critical_places
from frenetic.search.child_draws import ChildDraws, Parent, RefusingFailures, draw_child
from frenetic.search.known_failures import NOTHING, Known, KnownFailures
from frenetic.search.operators import CURVATURE_BOUND, random_curvatures
from frenetic.search.road_families import FAMILIES
from frenetic.search.variation import OPERATORS, PARAMETERS, RoadSite, vary


def drive(candidate: Candidate, moobd: float, place: float, spent: float = 0.5) -> Evaluation:
    """Return a drive that is furthest to the left at a place; below -1.5 m it failed."""
    length = (len(candidate.curvatures) - 1) * candidate.step
    along = np.linspace(0.0, length, 200)
    offset = (2.0 - moobd) * np.exp(-(((along - place) / 8.0) ** 2))
    trace = Trace(along, offset, 10.0 + 200.0 * (0.07 - np.abs(_curvature(candidate, along))))
    has_failed = moobd < -1.5
    return Evaluation(
        candidate,
        Outcome.FAIL if has_failed else Outcome.PASS,
        moobd,
        spent,
        finding=Finding.departure("left", place) if has_failed else None,
        worst_place=place,
        read_trace=lambda: trace,
    )


def _curvature(candidate: Candidate, along: FloatArray) -> FloatArray:
    places = np.arange(len(candidate.curvatures)) * candidate.step
    curvatures: FloatArray = np.interp(along, places, candidate.curvatures)
    return curvatures


def run_search(search: Frenetic, tests: int, fails: bool = True) -> list[Candidate]:
    """Run a search in which drives are worst at the sharpest place; return the candidates."""
    candidates = []
    for _ in range(tests):
        candidate = search.ask()
        candidates.append(candidate)
        sharpest = int(np.argmax(np.abs(candidate.curvatures)))
        moobd = 1.5 - 60.0 * abs(candidate.curvatures[sharpest])
        search.tell(drive(candidate, moobd if fails else moobd + 3.5, sharpest * candidate.step))
    return candidates


def test_thirty_random_roads_come_first_and_fewer_in_a_short_budget() -> None:
    candidates = run_search(Frenetic(seed=1, random_budget=1.0), 60)
    operators = [candidate.origin.operator for candidate in candidates]
    assert set(operators[:30]) == set(FAMILIES)
    assert set(operators[30:]) & set(OPERATORS)

    brief = Frenetic(seed=1, random_budget=0.2)
    for count in range(1, 21):
        candidate = brief.ask()
        assert (candidate.origin.operator in FAMILIES) or count > 4
        brief.tell(drive(candidate, -2.0, 50.0, spent=count / 20))


def test_outstanding_roads_count_among_the_first_random_roads() -> None:
    for budget, least, most in ((1.0, 30, 32), (0.2, 20, 22)):
        search = Frenetic(seed=1, random_budget=budget)
        out: list[Candidate] = []
        first = 0
        for count in range(1, 61):
            while len(out) < 16:
                out.append(search.ask())
                first += out[-1].origin.operator in FAMILIES
            search.tell(drive(out.pop(0), -2.0, 50.0, spent=count / 100))
        assert least <= first <= most + 4  # one in twenty of later roads is random, too


def test_a_child_avoids_the_failures_expected_of_outstanding_roads() -> None:
    archive = Archive()
    candidate = Frenetic(seed=1).ask()
    (place, *_) = critical_places(drive(candidate, -2.0, 120.0), candidate, -2.0)
    archive.add(candidate, place)
    for number in range(2, 100):
        archive.expect(number, place.side, place.vector + number)
        archive.expect(-number, RIGHT, place.vector - number)
    expected = [place.vector + number for number in (0, *range(2, 100))]
    np.testing.assert_array_equal(archive.failures(place.side).vectors, expected)
    assert archive.add(candidate, place._replace(vector=place.vector + 2.0)) == 4.0
    for number in range(2, 100):
        archive.settle(number)
    np.testing.assert_array_equal(
        archive.failures(LEFT).vectors, [place.vector, place.vector + 2.0]
    )
    assert len(archive.failures(RIGHT).vectors) == 98


def test_a_notice_says_that_no_road_comes_close_to_failing() -> None:
    search = Frenetic(seed=1)
    assert search.notice is None
    run_search(search, 40, fails=False)
    assert "nothing close to failing" in (search.notice or "")
    search.tell(drive(search.ask(), -2.0, 50.0))
    assert search.notice is None


def test_archive_and_analysis_compute_the_same_approach() -> None:
    curvatures = random_curvatures(np.random.default_rng(4), 25)
    candidate = Candidate(1, curvatures, 10.0, Frenetic(seed=1).ask().origin)
    (place, *_) = critical_places(evaluation := drive(candidate, -2.0, 120.0), candidate, -2.0)
    assert (place.side, place.has_failed, place.distance) == (LEFT, True, 120.0)
    road = Road(curvatures, 10.0, (30.0, 40.0, 1.0))
    around = road_around(road.table, road.sub_step, 120.0)
    assert evaluation.trace is not None
    expected = as_vector(around, *states_before(evaluation.trace, 120.0))
    np.testing.assert_allclose(place.vector, expected, atol=1e-9)
    laid = expected.copy()
    laid[: 2 * len(around)] = np.nan
    for low, high in ((120.0, 120.0), (80.0, 160.0), (-50.0, 500.0)):
        table, ds, start = table_around(curvatures, 10.0, low, high)
        set_road(laid, table, ds, 120.0 - start)
        np.testing.assert_allclose(laid, expected, atol=1e-9)
        points = points_along(table, ds, 120.0 - start - BEHIND - 4 * SPACING, 23)
        set_points(laid, points, POINTS_BEHIND + 4)
        np.testing.assert_allclose(laid, expected, atol=1e-9)


def test_a_distant_second_peak_is_a_second_place() -> None:
    candidate = Frenetic(seed=1).ask()
    along = np.linspace(0.0, 150.0, 300)
    offset = 2.5 * np.exp(-(((along - 40.0) / 5.0) ** 2)) - np.exp(-(((along - 100.0) / 5.0) ** 2))
    trace = Trace(along, offset, np.full(300, 15.0))
    evaluation = Evaluation(
        candidate, Outcome.PASS, -0.5, 0.1, worst_place=40.0, read_trace=lambda: trace
    )
    first, second = critical_places(evaluation, candidate, -0.5)
    assert (first.side, second.side) == (LEFT, RIGHT)
    assert second.distance == pytest.approx(100.0, abs=1.0)
    assert second.fitness == pytest.approx(1.0, abs=0.01)
    assert abs(second.distance - first.distance) > APART


def test_the_archive_knows_the_nearest_failure_of_each_side() -> None:
    rng = np.random.default_rng(5)
    archive = Archive()
    places: list[Place] = []
    candidate = Frenetic(seed=1).ask()
    for k in range(200):
        evaluation = drive(candidate, float(rng.uniform(-3.0, 1.0)), float(rng.uniform(0.0, 150.0)))
        (place, *_) = critical_places(evaluation, candidate, evaluation.moobd or 0.0)
        place = place._replace(vector=rng.normal(0.0, 0.3, SIZE), side=k % 2)
        before = [p for p in places if p.has_failed and p.side == place.side]
        distances = [math.dist(p.vector, place.vector) for p in before]
        assert archive.add(candidate, place) == pytest.approx(min([4.0, *distances]))
        places.append(place)
    for row, place in enumerate(places):
        distances = [
            math.dist(failure.vector, place.vector)
            for failure in places
            if failure.has_failed and failure.side == place.side and failure is not place
        ]
        assert math.sqrt(archive.squares[row]) == pytest.approx(min([4.0, *distances]))


@pytest.mark.parametrize("operator", range(len(OPERATORS)), ids=OPERATORS)
def test_an_operator_makes_another_road_within_the_bound(operator: int) -> None:
    rng = np.random.default_rng(operator)
    limits = np.array([CURVATURE_BOUND, 0.05])
    children = changed = 0
    for _ in range(100):
        parent, other = random_curvatures(rng, 25), random_curvatures(rng, 22)
        before, child = parent.copy(), np.full(40, np.nan)
        site, u = int(rng.integers(0, 25)), rng.random(PARAMETERS + 40)
        roads = RoadSite(parent, site), RoadSite(other, 10)
        n, moved = vary(operator, u, *roads, 29, limits, child)
        np.testing.assert_array_equal(parent, before)
        if n:
            children += 1
            assert np.all(np.abs(child[:n]) <= CURVATURE_BOUND)
            changed += not np.array_equal(child[:n], parent)
            assert 0 <= site + moved < n + 1
    assert changed > 0.8 * children > 40


def test_a_child_that_would_repeat_a_known_failure_is_refused() -> None:
    rng = np.random.default_rng(1)
    parent = random_curvatures(rng, 25)
    candidate = Candidate(1, parent, 10.0, Frenetic(seed=1).ask().origin)
    vector = critical_places(drive(candidate, -2.0, 120.0), candidate, -2.0)[0].vector

    def draw(known: Known, same: float) -> int:
        """Return the number of the first accepted draw, or -1."""
        count = 30
        whole = np.zeros(count, dtype=np.int64)
        draws = ChildDraws(
            operators=np.full(count, OPERATORS.index("shift")),
            u=np.random.default_rng(2).random((count, PARAMETERS + 40)),
            mates=np.zeros((count, 40)),
            mate_sizes=whole,
            mate_sites=whole,
            lengths=np.full(count, 25),
            run_ups=np.zeros(count),
        )
        return draw_child(
            Parent(parent, 10.0, 120.0, vector),
            draws,
            RefusingFailures(known, known, same),
            np.array([CURVATURE_BOUND, 0.05]),
            np.empty(0),
            np.empty(40),
            np.empty(SIZE),
        )[0]

    failures = KnownFailures()
    assert draw(failures.known(), 2.0) == 0
    failures.add(vector)
    known = failures.known()
    assert draw(known, 0.05) >= 0
    assert draw(known, 50.0) == -1


def test_a_fresh_road_keeps_the_run_up_to_the_place() -> None:
    parent = random_curvatures(np.random.default_rng(1), 30)
    u = np.random.default_rng(2).random((1, PARAMETERS + 80))
    child = np.empty(40)
    whole = np.zeros(1, dtype=np.int64)
    for run_up in (0.0, 60.0):
        draws = ChildDraws(
            operators=np.array([OPERATORS.index("shift")]),
            u=u,
            mates=np.zeros((1, 40)),
            mate_sizes=whole,
            mate_sites=whole,
            lengths=np.array([30]),
            run_ups=np.array([run_up]),
        )
        k, n, moved = draw_child(
            Parent(parent, 10.0, 180.0, np.zeros(SIZE)),
            draws,
            RefusingFailures(NOTHING, NOTHING, 1.6),
            np.array([CURVATURE_BOUND, 0.05]),
            np.empty(0),
            child,
            np.empty(SIZE),
        )
        assert (k, n, moved) == (0, 30, 0)
        if not run_up:
            changed = child[:n].copy()  # with run_up 0 the child changes around the place
            np.testing.assert_array_equal(changed[:18], parent[:18])
    # The second child keeps the values from 60 m before the place at 180 m to 20 m behind it.
    np.testing.assert_array_equal(child[12:21], changed[12:21])
    assert not np.isin(child[:12], parent).any()
    assert not np.isin(child[21:30], parent).any()
    assert np.abs(np.diff(child[:12])).max() <= 0.05


class ScriptedForesight:
    """Foresight that is always right, or always wrong, about which roads fail."""

    def __init__(self, *, is_right: bool) -> None:
        self.is_ready, self.is_right = False, is_right
        self.learnt = self.asked = 0

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        assert evaluation.candidate.id == candidate.id
        self.learnt += 1
        self.is_ready = self.learnt >= 35

    def foresee(self, candidates: Sequence[Candidate]) -> list[Evaluation | None]:
        self.asked += len(candidates)
        return [drive(c, *self.result_of(c, is_right=self.is_right)) for c in candidates]

    def facts(self) -> dict[str, str]:
        return {"twin": "scripted"}

    @staticmethod
    def result_of(candidate: Candidate, *, is_right: bool = True) -> tuple[float, float]:
        """Return MOOBD and place; half of all roads fail."""
        fails = (round(abs(float(candidate.curvatures[0])) * 1e6) % 2 == 0) == is_right
        return (-2.0 if fails else 1.0), 120.0


@pytest.mark.parametrize("is_right", [True, False])
def test_foresight_is_used_more_often_if_it_is_right(*, is_right: bool) -> None:
    foresight = ScriptedForesight(is_right=is_right)
    search = Frenetic(seed=4, foresight=foresight)
    tells = 0
    for _ in range(200):
        candidate = search.ask()
        search.tell(drive(candidate, *ScriptedForesight.result_of(candidate)))
        tells += 1
    facts = dict(search.facts())
    assert foresight.learnt == tells
    assert facts["twin"] == "scripted"
    foreseen = facts["children with foresight"]
    unforeseen = facts["children without foresight"]
    assert foreseen + unforeseen < 200
    if is_right:
        assert foreseen > 1.5 * unforeseen
        assert facts["new failures with foresight"] > 0.5 * foreseen
    else:
        assert foreseen < unforeseen
    assert foresight.asked >= foreseen


def test_likely_children_fail_more_often() -> None:
    failed = {}
    for likely in (False, True):
        search = Frenetic(seed=5, likely=likely)
        failed[likely] = 0
        for _ in range(300):
            candidate = search.ask()
            # Roads that bend to the left before the place fail.
            fails = float(candidate.curvatures[8:13].mean()) > 0.012
            search.tell(drive(candidate, -2.0 if fails else 0.5, 120.0))
            failed[likely] += fails
    assert failed[True] > 1.1 * failed[False]


def test_the_speed_model_learns_a_driver() -> None:
    rng = np.random.default_rng(3)
    model = speeds.SpeedModel(rng)
    for k in range(60):
        candidate = Candidate(
            k + 1, random_curvatures(rng, 25), 10.0, Frenetic(seed=1).ask().origin
        )
        trace = drive(candidate, 1.0, 50.0).trace
        assert trace is not None
        model.learn(candidate.curvatures, 10.0, trace)
        assert model.is_ready == (k >= 19)
    unseen = random_curvatures(rng, 25)
    predicted = np.empty(60)
    speeds.predict(model.weights, unseen, 10.0, 40.0, predicted)
    truth = 10.0 + 200.0 * (
        0.07 - np.abs(np.interp(40.0 + 2.5 * np.arange(60), np.arange(25) * 10.0, unseen))
    )
    assert np.sqrt(np.mean((predicted - truth) ** 2)) < 0.7 * np.std(truth)


def test_no_road_is_proposed_twice_and_all_lie_within_the_bound() -> None:
    candidates = run_search(Frenetic(seed=2), 150)
    assert len({candidate.curvatures.tobytes() for candidate in candidates}) == 150
    assert all(np.abs(candidate.curvatures).max() <= CURVATURE_BOUND for candidate in candidates)
    assert {len(candidate.curvatures) for candidate in candidates} <= set(range(5, 41))
    assert BEHIND == 30.0
