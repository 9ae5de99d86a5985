from __future__ import annotations

import logging
import math
import re
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from stand_in import (
    Executor,
    Executor2021,
    Executor2022,
    ExecutorOfTwoBudgets,
    Record,
    RoadTest,
    driven,
    enter,
    install,
    passed,
    run_2021,
    run_2022,
)

from frenetic import search
from frenetic.competition import Frenetic2021, Generator, RandomSearch
from frenetic.errors import FreneticError
from frenetic.road import check_validity
from frenetic.search.strategy import Strategy


@pytest.fixture(autouse=True)
def _in_the_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    enter(monkeypatch)


class Seeded(Frenetic2021):
    seed = 5


Edition = tuple[type[Executor], Callable[..., None]]

both_editions = pytest.mark.parametrize(
    "edition", [(Executor2021, run_2021), (Executor2022, run_2022)], ids=["2021", "2022"]
)


def operators(log: pytest.LogCaptureFixture) -> list[str]:
    """Where the tests of a run came from, in order, as its log says."""
    lines = (record.getMessage() for record in log.records)
    return [found[1] for line in lines if (found := re.match(r"test \d+, road \d+ \((\w+)", line))]


def points(executor: Executor) -> list[list[tuple[float, float]]]:
    return [test.road_points for test in executor.tests]


def complaints(log: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in log.records if record.levelno >= logging.WARNING]


# --- the search --------------------------------------------------------------------------------


@both_editions
def test_a_fifth_of_the_time_budget_goes_to_random_roads(
    edition: Edition, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    make, run = edition
    executor = make(tests=50, answer=lambda _: driven("PASS", 2.0, -1.0))
    run(Seeded, executor)
    assert len(executor.tests) == 50
    origins = operators(caplog)
    assert origins[:10] == ["random"] * 10
    assert not complaints(caplog)
    assert "exceptions" not in caplog.text
    # Every road is a parent now, so nothing else is random.
    assert "random" not in origins[10:]
    assert origins[10:12] == ["P1", "P2"]


@both_editions
def test_the_mutants_of_a_failing_road_follow_the_random_phase(edition: Edition) -> None:
    make, run = edition

    def third_fails(test: RoadTest) -> Any:
        # The last record is harmless: the least distance counts.
        return driven("FAIL", 2.0, -1.9, 0.3) if test.id == 3 else passed(test)

    executor = make(tests=20, answer=third_fails)
    run(Seeded, executor)
    failing = executor.tests[2].turns
    mutants = [test.turns for test in executor.tests[4:8]]
    # F1, the road from its other end, F2, its mirror image, and F4, that of the road itself; F3 is
    # handed over if it is valid.
    for turns in (-failing[::-1], failing[::-1], -failing):
        assert any(
            len(mutant) == len(turns) and np.allclose(mutant, turns, atol=1e-6)
            for mutant in mutants
        )


def test_the_road_of_lowest_moobd_has_mutants_first(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    moobd = {2: -0.7, 3: -1.2}
    executor = Executor2022(
        tests=20, answer=lambda test: driven("PASS", 2.0, moobd.get(test.id, 0.5))
    )
    run_2022(Seeded, executor)
    first = next(r.getMessage() for r in caplog.records if "P1" in r.getMessage())
    third = next(r.getMessage() for r in caplog.records if r.getMessage().startswith("test 3,"))
    parent = re.search(r"P1 of (\d+)", first)
    assert parent is not None
    assert f"road {parent[1]} (random)" in third


def test_the_larger_share_of_two_budgets_counts(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    executor = ExecutorOfTwoBudgets(tests=20, answer=lambda _: driven("PASS", 2.0, -1.0))
    run_2022(Seeded, executor)
    assert [i for i, origin in enumerate(operators(caplog)) if origin == "random"] == [0, 1, 2, 3]


def test_random_search_only_draws(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    executor = Executor2022(tests=15, answer=lambda _: driven("FAIL", -1.9))
    run_2022(RandomSearch, executor)
    assert operators(caplog) == ["random"] * 15


@pytest.mark.parametrize("map_size", [100, 200, 1000])
def test_only_valid_roads_are_handed_over(map_size: int) -> None:
    class AsPublished(Seeded):
        options = {"max_redraws": 0}  # noqa: RUF012  # many of its roads are invalid

    executor = Executor2022(
        tests=60, answer=lambda test: driven("FAIL" if test.id % 3 else "PASS", 2.0, -1.0)
    )
    run_2022(AsPublished, executor, map_size)
    assert len(executor.tests) == 60
    for test in executor.tests:
        assert check_validity(test.road_points, map_size).valid
        spacings = np.hypot(*np.diff(np.array(test.road_points), axis=0).T)
        assert spacings.max() <= 2.0 + 1e-9
        assert len(test.road_points) <= 500


def test_invalid_roads_cost_no_test_and_are_reported_when_there_is_nothing_else(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class TooSharp(Seeded):
        options = {"curvature_bound": 5.0, "max_change": 5.0, "max_redraws": 0}  # noqa: RUF012

    executor = Executor2022(tests=10)
    looks = iter(range(150))
    executor.is_over = lambda: next(looks, None) is None  # type: ignore[method-assign]
    run_2022(TooSharp, executor)
    assert executor.tests == []
    assert len(complaints(caplog)) == 1
    assert "100 invalid roads in a row" in complaints(caplog)[0]


# --- what an executor may do -------------------------------------------------------------------


def raising(_: RoadTest) -> Any:
    raise RuntimeError("the simulator is gone")


ODD = {
    "error": lambda _: ("ERROR", "Exhausted attempts", []),
    "error without data": lambda _: ("ERROR", "Exhausted attempts", None),
    "invalid": lambda _: ("INVALID", "The road is too sharp", []),
    "pass without data": lambda _: ("PASS", "Successful test", None),
    "fail without data": lambda _: ("FAIL", "Car is not moving fast enough", []),
    "no records": lambda _: ("PASS", "Successful test", 5),
    "records of something else": lambda _: ("PASS", "Successful test", [None, "x", 3]),
    "no distance": lambda _: ("FAIL", "", [Record(0.0, False, None)]),
    "no finite distance": lambda _: driven("FAIL", math.nan, -math.inf),
    "an outcome of its own": lambda _: driven("TIMEOUT", 1.0),
    "no outcome": lambda _: (None, None, None),
    "nothing": lambda _: None,
    "half an answer": lambda _: ("PASS", "Successful test"),
    "exception": raising,
}


@both_editions
@pytest.mark.parametrize("name", ODD)
def test_the_search_goes_on_whatever_comes_back(name: str, edition: Edition) -> None:
    make, run = edition
    # Every other answer is a proper one.
    executor = make(tests=30, answer=lambda test: ODD[name](test) if test.id % 2 else passed(test))
    run(Seeded, executor)
    assert len(executor.tests) == 30


@pytest.mark.parametrize("name", [name for name in ODD if name != "no finite distance"])
def test_what_cannot_be_learnt_from_is_logged(name: str, caplog: pytest.LogCaptureFixture) -> None:
    run_2022(Seeded, Executor2022(tests=1, answer=ODD[name]))
    assert any(
        line.startswith(("road 1 (random)", "test 1, road 1")) for line in complaints(caplog)
    )


def test_records_without_a_distance_among_others_are_passed_over(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)

    def answer(_: RoadTest) -> Any:
        outcome, description, records = driven("FAIL", 2.0, math.nan, -1.25)
        return outcome, description, [*records, Record(1.0, False, None), object()]

    run_2022(Seeded, Executor2022(tests=1, answer=answer))
    assert any("FAIL, MOOBD -1.25 m" in record.getMessage() for record in caplog.records)


def test_an_executor_that_only_raises_is_given_up(caplog: pytest.LogCaptureFixture) -> None:
    executor = Executor2022(tests=10**6, answer=raising)
    run_2022(Seeded, executor)
    assert len(executor.tests) == 100
    assert complaints(caplog)[-1].startswith("the executor raised 100 times in a row")


@pytest.mark.parametrize("reading", [None, "soon", {}, {"time-budget": None}, math.nan])
def test_a_remaining_time_that_says_nothing_is_reported_once(
    reading: Any, caplog: pytest.LogCaptureFixture
) -> None:
    executor = Executor2022(tests=10)
    executor.get_remaining_time = lambda: reading  # type: ignore[method-assign]
    run_2022(Seeded, executor)
    assert len(executor.tests) == 10
    assert len(complaints(caplog)) == 1
    assert "does not say what time remains" in complaints(caplog)[0]


def test_a_budget_that_cannot_be_read_for_a_while(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    executor = Executor2022(tests=20, answer=lambda _: driven("PASS", -1.0))
    tell = executor.get_remaining_time

    def sometimes() -> dict[str, float]:
        if executor.now < 300.0:
            raise OSError("no clock")
        return tell()

    executor.get_remaining_time = sometimes  # type: ignore[method-assign]
    executor.time_budget = type("Budget", (), {"time_budget": executor.budget})()  # type: ignore[attr-defined]
    run_2022(Seeded, executor)
    # When it is told at last, half of the budget is spent.
    assert operators(caplog)[:10] == ["random"] * 10
    assert "random" not in operators(caplog)[10:]


def test_is_over_may_raise() -> None:
    executor = Executor2022(tests=10)
    tell, looks = executor.is_over, iter(range(10**6))

    def sometimes() -> bool:
        if next(looks) % 4 == 1:
            raise ConnectionError("no simulator")
        return tell()

    executor.is_over = sometimes  # type: ignore[method-assign]
    run_2022(Seeded, executor)
    assert len(executor.tests) == 10


@both_editions
def test_the_end_of_the_process_passes_through(
    edition: Edition, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    make, run = edition
    executor = make(tests=7)
    vars(executor)["is_over"] = lambda: False  # which it tells in one edition only
    with pytest.raises(SystemExit) as ended:
        run(Seeded, executor)
    assert ended.value.code == 123
    assert caplog.records[-1].getMessage() == "Seeded ends after 7 PASS"


# --- seed and options --------------------------------------------------------------------------


def some_fail(test: RoadTest) -> Any:
    return driven("FAIL" if test.id % 5 == 0 else "PASS", 2.0, -0.1 * (test.id % 15))


def roads(kind: type[Generator], edition: Edition = (Executor2022, run_2022)) -> Any:
    install()
    make, run = edition
    executor = make(tests=25, answer=some_fail)
    run(kind, executor)
    return points(executor)


def test_the_seed_makes_the_roads(monkeypatch: pytest.MonkeyPatch) -> None:
    class Another(Frenetic2021):
        seed = 6

    assert roads(Seeded) == roads(Seeded) == roads(Seeded, (Executor2021, run_2021))
    assert roads(Seeded) != roads(Another)
    assert roads(Frenetic2021) != roads(Frenetic2021)
    monkeypatch.setenv("FRENETIC_SEED", "5")
    assert roads(Frenetic2021) == roads(Another) == roads(Seeded)


def test_a_seed_that_was_drawn_is_logged(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.INFO)
    drawn = roads(Frenetic2021)
    seed = re.search(r"seed (\d+)", caplog.records[0].getMessage())
    assert seed is not None
    monkeypatch.setenv("FRENETIC_SEED", seed[1])
    assert roads(Frenetic2021) == drawn


def test_options_of_class_and_environment(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)

    class Short(Seeded):
        options = {"max_length": 12, "random_budget": 1.0}  # noqa: RUF012

    # 120 m and up to 50 m more.
    assert max(len(road) for road in roads(Short)) <= 86
    assert "random" in operators(caplog)[-1]
    monkeypatch.setenv("FRENETIC_STRATEGY_OPTIONS", "max_length=6 length_jitter=0")
    assert {len(road) for road in roads(Short)} == {26}


@pytest.mark.parametrize(
    ("variable", "value", "says"),
    [
        ("FRENETIC_SEED", "many", "a whole number of at least 0"),
        ("FRENETIC_SEED", "-1", "a whole number of at least 0"),
        ("FRENETIC_STRATEGY_OPTIONS", "treshold=-0.3", "did you mean 'threshold'?"),
        ("FRENETIC_STRATEGY_OPTIONS", "threshold", "NAME=VALUE is needed"),
        ("FRENETIC_STRATEGY_OPTIONS", "cross_num=1", "cross_num must be"),
        ("FRENETIC_STRATEGY_OPTIONS", "cross_num=much", "cross_num"),
        ("FRENETIC_STRATEGY_OPTIONS", "seed=3", "FRENETIC_SEED"),
        ("FRENETIC_STRATEGY_OPTIONS", "map_size=300", "--map-size"),
        ("FRENETIC_STRATEGY_OPTIONS", "threshold='-0.3", "No closing quotation"),
    ],
)
def test_mistakes_are_told_in_one_line(
    variable: str, value: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(FreneticError) as raised:
        Frenetic2021(executor=Executor2022(tests=1), map_size=200)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_map_needs_a_size() -> None:
    with pytest.raises(FreneticError, match="map_size is 0"):
        Frenetic2021(executor=Executor2022(tests=1), map_size=0)


def test_outside_the_pipeline_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "code_pipeline.tests_generation", None)
    with pytest.raises(FreneticError, match=r"run by the pipeline's competition\.py"):
        run_2022(Seeded, Executor2022(tests=1))


def test_a_strategy_of_ones_own() -> None:
    class Gentle(Strategy):
        """Takes neither a seed nor a map size."""

        def __init__(self, curvature: float = 0.01) -> None:
            self.ledger = search.strategy.Ledger()
            self.curvature = curvature

        def ask(self) -> search.Candidate:
            return self.ledger.issue(np.full(8, self.curvature), 10.0, search.Origin("gentle"))

        def tell(self, evaluation: search.Evaluation) -> None:
            self.ledger.settle(evaluation)

    class Mine(Generator):
        strategy = Gentle
        options = {"curvature": 0.02}  # noqa: RUF012

    executor = Executor2022(tests=3)
    run_2022(Mine, executor)
    for test in executor.tests:
        assert np.allclose(test.turns, 2.0 * 0.02, atol=1e-6)
