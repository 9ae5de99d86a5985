"""The clock and the executor that a generator is given."""

from __future__ import annotations

import copy
import math
import os
import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from frenetic.bench.hosting.loader import takes_time_budget
from frenetic.bench.hosting.offered.code_pipeline.executors import (
    AbstractTestExecutor,
    SharedReference,
)
from frenetic.bench.hosting.offered.code_pipeline.tests_generation import (
    RoadTest,
    RoadTestFactory,
)

from frenetic.bench.hosting.executor import HostedExecutor, VirtualClock
from frenetic.bench.hosting.messages import Assignment

# --- the clock ---------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@dataclass
class Timer:
    now: float = 1000.0

    def __call__(self) -> float:
        return self.now


def test_computing_costs_nothing_where_it_does_not_count() -> None:
    timer = Timer()
    clock = VirtualClock(100.0, counts_computing=False, timer=timer)
    clock.start()
    for k in range(1, 4):
        timer.now += 1000.0
        clock.stop()
        clock.settle(30.0 * k)
        timer.now += 1000.0
        assert clock.spent == 30.0 * k
        assert clock.remaining == 100.0 - 30.0 * k
    assert not clock.is_over


def test_computing_counts_between_the_tests() -> None:
    timer = Timer()
    clock = VirtualClock(100.0, counts_computing=True, timer=timer)
    timer.now += 500.0  # before the start
    assert clock.spent == 0.0
    clock.start()
    timer.now += 7.0
    assert clock.spent == 7.0
    clock.stop()
    timer.now += 500.0  # of the bench
    assert clock.spent == 7.0
    clock.settle(38.0)  # as the bench has it
    timer.now += 62.0
    assert clock.remaining == 0.0
    assert clock.is_over
    timer.now += 1.0
    assert clock.remaining == 0.0


@pytest.mark.parametrize(("budget", "cost"), [(0.9, 0.3), (7200.0, 36.0), (1.1, 0.1), (7.0, 0.7)])
def test_whole_tests_use_up_a_budget(budget: float, cost: float) -> None:
    clock = VirtualClock(budget, counts_computing=False)
    tests = round(budget / cost)
    for k in range(1, tests + 1):
        assert not clock.is_over
        clock.settle(k * cost)
    assert clock.is_over


def test_a_remainder_is_something() -> None:
    clock = VirtualClock(100.0, counts_computing=False)
    clock.settle(90.0)
    assert (clock.remaining, clock.is_over) == (10.0, False)
    clock.end()
    assert (clock.remaining, clock.is_over) == (0.0, True)


# --- the executor ------------------------------------------------------------------------------

ROW = [0.0, [1.0, 2.0, -28.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], *range(12), 0.5]


@dataclass
class Answers:
    """A bench that gives prepared answers."""

    given: list[dict[str, Any]]
    asked: list[Any] = field(default_factory=list)
    unasked: list[dict[str, Any]] = field(default_factory=list)

    @property
    def has_spoken(self) -> bool:
        return bool(self.unasked)

    def receive(self) -> dict[str, Any]:
        return self.unasked.pop(0)

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        self.asked.append(message)
        return self.given.pop(0)


def answer(outcome: str, spent: float, description: str = "", **rest: Any) -> dict[str, Any]:
    rows = [ROW] if outcome in ("PASS", "FAIL") else []
    assert all(len(row) == 17 for row in rows)
    defaults = {"records": rows, "simulated": 8.0, "description": description, "spent": spent}
    return {"outcome": outcome, **defaults, **rest}


def make(*given: dict[str, Any], as_number: bool = False, budget: float = 100.0) -> HostedExecutor:
    executor = built(Answers(list(given)), as_number=as_number, budget=budget)
    executor.start()
    return executor


def built(
    parent: Answers, *, as_number: bool = False, budget: float = 100.0, **options: Any
) -> HostedExecutor:
    counts = options.pop("counts_computing", False)
    assignment = Assignment(
        module="m",
        class_name="C",
        path=None,
        seed=0,
        map_size=200,
        time_budget=budget,
        seconds_per_test=30.0,
        counts_computing=counts,
        oob_tolerance=0.95,
        speed_limit=70.0,
        result_folder="results",
    )
    return HostedExecutor(assignment, parent, remaining_as_number=as_number, **options)  # type: ignore[arg-type]


def straight() -> RoadTest:
    return RoadTestFactory.create_road_test([(50.0, 20.0), (50.0, 90.0)])


def test_an_executed_test_holds_what_became_of_it() -> None:
    executor = make(answer("FAIL", 30.0, "Car drove out of the lane to the right"))
    test = straight()
    assert not hasattr(test, "execution_data")
    outcome, description, records = executor.execute_test(the_test=test)
    assert (outcome, description) == ("FAIL", "Car drove out of the lane to the right")
    assert records[0].pos == (1.0, 2.0, -28.0)
    assert records[0].oob_percentage == 0.5
    assert len(records[0]) == 17
    assert (test.test_outcome, test.description, test.execution_data) == (
        outcome,
        description,
        records,
    )
    assert (test.is_valid, test.validation_message) == (True, "")
    assert test.features == {"MAX_CURV": 0.0, "DIR_COV": 1 / 26}
    assert isinstance(executor, AbstractTestExecutor)


def test_copies_of_an_executor_are_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    executor = make(answer("PASS", 100.0))
    held = {"executor": executor, "budget": executor.time_budget, "stats": executor.stats}
    for copied in (copy.deepcopy(held), pickle.loads(pickle.dumps(held))):
        assert copied["executor"] is executor
        assert copied["budget"] is executor.time_budget
        assert copied["stats"] is not executor.stats
    assert copy.copy(executor) is executor
    monkeypatch.setattr(os, "getpid", lambda: -1)  # as in a process that it has forked
    with pytest.raises(RuntimeError, match="only works in the process"):
        executor.execute_test(straight())
    elsewhere = SharedReference(-1, -1)
    assert not hasattr(copy.deepcopy(elsewhere), "__len__")
    with pytest.raises(RuntimeError, match="only works in the process"):
        elsewhere.execute_test(straight())


def test_an_invalid_test_holds_only_that() -> None:
    executor = make(answer("INVALID", 0.0, "The road is too sharp"))
    test = straight()
    assert executor.execute_test(test) == ("INVALID", "The road is too sharp", [])
    assert (test.is_valid, test.validation_message) == (False, "The road is too sharp")
    for name in ("execution_data", "test_outcome", "description", "features"):
        assert not hasattr(test, name)


@pytest.mark.parametrize("points", ["abc", None, [(1, 2, 3)], [(1.0, math.inf), (2.0, 3.0)]])
def test_points_of_the_wrong_type_are_not_sent(points: Any) -> None:
    answers = Answers([answer("INVALID", 0.0, "road points must be pairs")])
    executor = built(answers)
    executor.start()
    test = RoadTestFactory.create_road_test(points)
    assert executor.execute_test(test) == ("INVALID", "Wrong type", [])
    assert answers.asked[0]["road_points"] is None
    assert executor.validate_test(test) == (test.is_valid, test.validation_message)
    assert executor.validate_test(test) == (False, "Wrong type")


def test_the_bench_is_told_how_long_the_generator_took() -> None:
    timer = Timer()
    answers = Answers([answer("PASS", 40.0), {"over": True}])
    executor = built(answers, timer=timer, counts_computing=True)
    timer.now += 500.0  # while the generator is built
    assert executor.get_remaining_time() == {"time-budget": 100.0}
    executor.start()
    timer.now += 10.0
    assert executor.get_remaining_time() == {"time-budget": 90.0}
    executor.execute_test(straight())
    assert executor.stats.test_generation_real_times == [10.0]
    # What the bench adds to what it knows, and the test: nothing else.
    assert executor.get_remaining_time() == {"time-budget": 60.0}
    timer.now += 7.0
    with pytest.raises(SystemExit):
        executor.execute_test(straight())
    timer.now += 2.0
    answers.unasked.append({"over": True})
    with pytest.raises(SystemExit):
        executor.execute_test(straight())
    timer.now += 0.5
    assert [message["seconds"] for message in answers.asked] == [10.0, 7.0]
    assert executor.stop() == 2.5


def test_the_time_of_a_generator_that_was_not_started_is_none() -> None:
    timer = Timer()
    executor = built(Answers([]), timer=timer)
    timer.now += 5.0
    assert executor.stop() == 0.0


def test_every_outcome_is_counted() -> None:
    executor = make(
        answer("PASS", 30.0),
        answer("INVALID", 30.0, "The road is too sharp", simulated=0.0),
        answer("ERROR", 60.0, "The simulator broke", simulated=0.0),
        answer("FAIL", 90.0, "Car moved less than 1 m in the last 10 s"),
        budget=90.0,
    )
    seen = [executor.execute_test(straight())[0] for _ in range(4)]
    assert seen == ["PASS", "INVALID", "ERROR", "FAIL"]
    stats = executor.get_stats()
    assert (stats.test_generated, stats.test_valid, stats.test_invalid) == (4, 3, 1)
    assert (stats.test_passed, stats.test_failed, stats.test_in_error, stats.obes) == (1, 1, 1, 0)
    assert stats.test_execution_real_times == [30.0] * 3
    assert stats.test_execution_simulation_times == [8.0, 0.0, 8.0]
    assert len(stats.test_generation_real_times) == 4
    assert executor.is_over()


def test_a_generator_may_add_to_the_counts_and_break_them() -> None:
    executor = make(*(answer("PASS", 1.0) for _ in range(3)))
    executor.stats.test_generated += 5
    executor.execute_test(straight())
    assert executor.stats.test_generated == 6
    executor.stats.test_generated = None  # type: ignore[assignment]
    executor.stats.test_execution_real_times = 4.0  # type: ignore[assignment]
    executor.execute_test(straight())
    assert executor.stats.test_valid == 2
    executor.stats = None  # type: ignore[assignment]
    assert executor.execute_test(straight())[0] == "PASS"


def test_a_spent_budget_ends_the_process() -> None:
    executor = make(answer("PASS", 90.0), {"over": True}, {"over": True})
    executor.execute_test(straight())
    assert executor.get_remaining_time() == {"time-budget": 10.0}
    assert not executor.is_over()
    test = straight()
    for _ in range(2):
        with pytest.raises(SystemExit) as ended:
            executor.execute_test(test)
        assert ended.value.code == 123
    assert executor.is_over()
    assert not hasattr(test, "test_outcome")
    assert executor.stats.test_generated == 1


def test_the_remaining_time_of_2021_is_a_number() -> None:
    executor = make(answer("PASS", 30.0), as_number=True)
    executor.execute_test(straight())
    remaining = executor.get_remaining_time()
    assert remaining == 70.0
    assert remaining - 0.5 == 69.5
    assert f"{remaining:.1f} {remaining}" == "70.0 70.0"
    # A class that takes the time budget and knows later pipelines, too.
    assert remaining["time-budget"] == 70.0
    with pytest.raises(KeyError):
        remaining["generation-budget"]


@pytest.mark.parametrize("as_number", [False, True])
def test_the_remaining_time_is_a_number_or_in_a_dictionary(as_number: bool) -> None:
    executor = make(answer("PASS", 30.0), as_number=as_number)
    executor.execute_test(straight())
    assert executor.get_remaining_time() == (70.0 if as_number else {"time-budget": 70.0})


def test_what_else_the_pipeline_has() -> None:
    executor = make(answer("PASS", 30.0))
    budget = executor.time_budget
    assert (budget.time_budget, budget.get_remaining_real_time()) == (100.0, 100.0)
    assert budget.generation_budget is budget.execution_budget is None
    assert not budget.is_over()
    assert budget.can_run_a_test()
    assert budget.get_remaining_time() == executor.get_remaining_time()
    assert executor.validate_test(straight()) == (True, "")
    assert executor.validate_test([(50.0, 20.0), (50.0, 90.0)]) == (False, "Wrong type")
    assert executor.oob_tolerance == 0.95
    assert executor.map_size == 200
    assert executor.road_visualizer is None
    assert not executor.is_force_timeout()
    executor.close()
    assert executor.execute_test(straight())[0] == "PASS"


class Of2022:
    def __init__(self, executor: Any = None, map_size: Any = None) -> None: ...


class Of2021:
    def __init__(self, time_budget: Any = None, executor: Any = None, map_size: Any = None) -> None:
        pass


class OfAnyYear:
    def __init__(self, *args: Any, **kwargs: Any) -> None: ...


class OnlyBy:
    def __init__(self, executor: Any, map_size: Any, *, time_budget: Any) -> None: ...


@pytest.mark.parametrize(
    ("kind", "takes"), [(Of2022, False), (Of2021, True), (OfAnyYear, False), (OnlyBy, True)]
)
def test_who_is_given_the_time_budget(kind: type[Any], takes: bool) -> None:
    assert takes_time_budget(kind) is takes
