"""A stand-in for the competition's pipeline: its interface, a clock, scripted answers.

It needs only the standard library of Python 3.9.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any


@dataclass
class Record:
    """A moment of a drive; a record of the pipeline has more fields."""

    timer: float
    pos: tuple[float, float, float]
    oob_distance: Any
    is_oob: bool = False
    vel: tuple[float, float, float] = (9.0, 0.0, 0.0)
    steering: float = 0.0
    throttle: float = 0.5
    brake: float = 0.0


@dataclass
class RoadTest:
    road_points: list[tuple[float, float]]
    id: int = 0

    def __post_init__(self) -> None:
        assert type(self.road_points) is list
        assert all(type(point) is tuple and len(point) == 2 for point in self.road_points)
        assert all(type(value) is float for point in self.road_points for value in point)


class RoadTestFactory:
    create_road_test = staticmethod(RoadTest)


def install(modules: dict[str, ModuleType] = sys.modules) -> None:
    """Make `code_pipeline` importable."""
    package, module = ModuleType("code_pipeline"), ModuleType("code_pipeline.tests_generation")
    module.RoadTestFactory = RoadTestFactory  # type: ignore[attr-defined]
    modules.update({"code_pipeline": package, "code_pipeline.tests_generation": module})


def answer_to(test: RoadTest, outcome: str, *oob_distances: float) -> tuple[str, str, list[Record]]:
    """Return the pipeline's answer to a test with these oob distances, in m.

    The car drives 2 m to the right of the road's points, 4 m where it is out of its lane.
    """
    description = "Car drove out of the lane 1" if outcome == "FAIL" else "Successful test"
    records = []
    for i, distance in enumerate(oob_distances):
        (x, y), (to_x, to_y) = test.road_points[i : i + 2]
        right = (4.0 if distance < 0.0 else 2.0) / ((to_x - x) ** 2 + (to_y - y) ** 2) ** 0.5
        place = x + right * (to_y - y), y - right * (to_x - x), -28.0
        records.append(Record(0.25 * i, place, distance, is_oob=distance < 0.0))
    return outcome, description, records


def passed(test: RoadTest) -> Any:
    return answer_to(test, "PASS", 2.0, 0.5, 1.0)


class Executor:
    """Answers tests by a script; each takes 30 s on a clock that nothing else moves."""

    SECONDS_PER_TEST = 30.0

    def __init__(self, *, tests: int, answer: Callable[[RoadTest], Any] = passed) -> None:
        self.budget = tests * self.SECONDS_PER_TEST
        self.answer = answer
        self.now = 0.0
        self.tests: list[RoadTest] = []
        self.start_generation_time: float | None = 0.0

    def execute_test(self, the_test: RoadTest) -> Any:
        assert self.start_generation_time is not None, "the generation's clock does not run"
        self.start_generation_time = None
        if self.now >= self.budget:
            sys.exit(123)
        the_test.id = len(self.tests) + 1
        self.tests.append(the_test)
        self.now += self.SECONDS_PER_TEST
        answer = self.answer(the_test)
        self.start_generation_time = self.now
        return answer


class Executor2021(Executor):
    """The executor of 2021: the remaining time is a number."""

    def get_remaining_time(self) -> Any:
        return self.budget - self.now


class Executor2022(Executor):
    """The executor of 2022: the remaining time is a dictionary, and `is_over` exists."""

    def get_remaining_time(self) -> Any:
        return {"time-budget": self.budget - self.now}

    def is_over(self) -> bool:
        return self.now >= self.budget


class ExecutorOfTwoBudgets(Executor2022):
    """An executor with budgets of generation and execution; only execution takes time here."""

    def get_remaining_time(self) -> Any:
        return {"generation-budget": 1000.0, "execution-budget": self.budget - self.now}


def run_2021(kind: type[Any], executor: Executor, map_size: int = 200) -> None:
    kind(time_budget=executor.budget, executor=executor, map_size=map_size).start()


def run_2022(kind: type[Any], executor: Executor, map_size: int = 200) -> None:
    kind(executor=executor, map_size=map_size).start()
