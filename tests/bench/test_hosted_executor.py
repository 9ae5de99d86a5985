"""The clock and the executor that a generator is given, here with the stand-ins behind it."""

from __future__ import annotations

import copy
import os
import pickle
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from frenetic.bench.hosting.executor import VirtualClock, make_executor
from frenetic.bench.hosting.host import takes_time_budget
from frenetic.bench.hosting.messages import Assignment
from frenetic.bench.hosting.pipeline import PACKAGES, STAND_INS


@pytest.fixture(autouse=True)
def _places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A working directory of its own, and the stand-ins on the module path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(STAND_INS)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        del sys.modules[name]


@pytest.mark.parametrize(("budget", "cost"), [(0.9, 0.3), (7200.0, 36.0), (1.1, 0.1), (7.0, 0.7)])
def test_whole_tests_use_up_a_budget(budget: float, cost: float) -> None:
    clock = VirtualClock(budget)
    for k in range(1, round(budget / cost) + 1):
        assert clock.remaining() > 0.0
        clock.spent = k * cost
    assert clock.remaining() == 0.0
    clock.is_held = True  # a test that spends all counts
    assert clock.remaining() > 0.0


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


def answer(outcome: str, spent: float, description: str = "") -> dict[str, Any]:
    rows = [[8.0, *ROW[1:]]] if outcome in ("PASS", "FAIL") else []
    return {"outcome": outcome, "description": description, "records": rows, "spent": spent}


def make(*given: dict[str, Any], as_number: bool = False) -> Any:
    assignment = Assignment(
        module="m",
        class_name="C",
        path=None,
        pipeline=None,
        seed=0,
        map_size=200,
        time_budget=100.0,
        seconds_per_test=30.0,
        oob_tolerance=0.95,
        speed_limit=70.0,
        result_folder="results",
    )
    ours = VirtualClock(100.0)
    parent = Answers(list(given))
    executor = make_executor(assignment, parent, ours, remaining_as_number=as_number)  # type: ignore[arg-type]
    ours.start()
    return executor


def straight(points: Any = ((50.0, 20.0), (50.0, 90.0))) -> Any:
    factory = import_module("code_pipeline.tests_generation").RoadTestFactory
    return factory.create_road_test(points)


def test_copies_of_an_executor_are_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    executor = make(answer("PASS", 100.0))
    copied = copy.deepcopy({"executor": executor, "budget": executor.time_budget})
    assert copied["executor"] is copy.copy(executor) is executor
    assert pickle.loads(pickle.dumps({"executor": executor}))["executor"] is executor
    executor.execute_test(straight())
    assert copied["budget"].is_over()
    monkeypatch.setattr(os, "getpid", lambda: -1)  # as in a process that it has forked
    with pytest.raises(RuntimeError, match="only works in the process"):
        executor.execute_test(straight())


def test_the_bench_judges_a_test_that_is_executed_and_nobody_else_does() -> None:
    executor = make(answer("INVALID", 0.0, "The road is too sharp"), answer("PASS", 30.0))
    test, short = straight(), straight([(50.0, 20.0), (50.0, 21.0)])
    assert executor.validate_test(test) == (True, "")
    assert executor.execute_test(test) == ("INVALID", "The road is too sharp", [])
    assert (test.is_valid, test.validation_message) == (False, "The road is too sharp")
    assert not hasattr(test, "execution_data")
    assert executor.execute_test(short)[0] == "PASS"
    assert executor.validate_test(short) == (False, "The road is not long enough.")


def test_the_bench_is_told_how_long_the_generator_took() -> None:
    executor = make(answer("PASS", 40.0), {"over": True})
    time.sleep(0.05)
    executor.execute_test(straight())
    (told,) = executor.stats.test_generation_real_times
    assert told >= 0.05
    assert executor.get_remaining_time() == {"time-budget": 60.0}
    for _ in range(2):
        with pytest.raises(SystemExit):
            executor.execute_test(straight())
        executor._parent.unasked.append({"over": True})
    assert executor._parent.asked[0]["seconds"] == told
    assert len(executor._parent.asked) == 2


def test_every_outcome_is_counted() -> None:
    executor = make(
        answer("PASS", 30.0),
        answer("INVALID", 30.0, "The road is too sharp"),
        answer("ERROR", 60.0, "The simulator broke"),
        answer("FAIL", 90.0, "Car moved less than 1 m in the last 10 s"),
        answer("FAIL", 100.0, "Car drove out of the lane to the left"),
    )
    executor.stats.test_generated += 5  # a generator counts what it kept back
    seen = [executor.execute_test(straight())[0] for _ in range(5)]
    assert seen == ["PASS", "INVALID", "ERROR", "FAIL", "FAIL"]
    stats = executor.get_stats()
    assert (stats.test_generated, stats.test_valid, stats.test_invalid) == (10, 4, 1)
    assert (stats.test_passed, stats.test_failed, stats.test_in_error, stats.obes) == (1, 2, 1, 1)
    assert stats.test_execution_real_times == [30.0] * 4
    assert stats.test_execution_simulation_times == [8.0] * 3
    assert len(stats.test_generation_real_times) == 5
    assert executor.is_over()


def test_an_executed_test_holds_what_became_of_it() -> None:
    said = "Car drove out of the lane to the right"
    executor = make(answer("FAIL", 30.0, said), answer("INVALID", 30.0, "Wrong type"))
    test, odd = straight(), straight([(1, 2, 3)])
    outcome, description, records = executor.execute_test(the_test=test)
    assert (outcome, description) == ("FAIL", said)
    assert (records[0].pos, records[0].oob_percentage) == ((1.0, 2.0, -28.0), 0.5)
    assert (test.test_outcome, test.description, test.execution_data) == ("FAIL", said, records)
    assert (test.is_valid, test.validation_message) == (True, "")
    assert isinstance(executor, import_module("code_pipeline.executors").AbstractTestExecutor)
    assert executor.execute_test(odd) == ("INVALID", "Wrong type", [])
    assert executor._parent.asked[-1]["road_points"] is None


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
    assert executor.is_force_timeout()
    assert not hasattr(test, "test_outcome")
    assert executor.stats.test_generated == 1


def test_the_remaining_time_of_2021_is_a_number() -> None:
    executor = make(answer("PASS", 30.0), as_number=True)
    executor.execute_test(straight())
    remaining = executor.get_remaining_time()
    assert (remaining, remaining - 0.5, f"{remaining:.1f}") == (70.0, 69.5, "70.0")
    # A class that takes the time budget and knows later pipelines, too.
    assert remaining["time-budget"] == 70.0
    with pytest.raises(KeyError):
        remaining["generation-budget"]


def test_what_else_the_pipeline_has() -> None:
    executor = make()
    budget = executor.time_budget
    assert (budget.time_budget, budget.get_remaining_real_time()) == (100.0, 100.0)
    assert budget.generation_budget is budget.execution_budget is None
    assert budget.can_run_a_test()
    assert not budget.is_over()
    assert budget.get_remaining_time() == executor.get_remaining_time()
    assert executor.validate_test([(50.0, 20.0), (50.0, 90.0)]) == (False, "Wrong type")
    assert (executor.oob_tolerance, executor.map_size, executor.speed_limit) == (0.95, 200, 70.0)
    assert executor.road_visualizer is None
    executor.close()


def of_2021(time_budget: Any = None, executor: Any = None, map_size: Any = None) -> None: ...


def of_2022(executor: Any = None, map_size: Any = None) -> None: ...


def of_any_year(*args: Any, **kwargs: Any) -> None: ...


def by_name_only(executor: Any, map_size: Any, *, time_budget: Any) -> None: ...


@pytest.mark.parametrize(
    ("kind", "takes"),
    [(of_2021, True), (of_2022, False), (of_any_year, False), (by_name_only, True)],
)
def test_who_is_given_the_time_budget(kind: Any, takes: bool) -> None:
    assert takes_time_budget(kind) is takes
