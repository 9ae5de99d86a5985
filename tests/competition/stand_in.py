"""A stand-in of the competition's pipeline: its interface, a clock of its own, scripted answers."""

from __future__ import annotations

import itertools
import sys
from collections import namedtuple
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from frenetic._support.arrays import FloatArray

if TYPE_CHECKING:
    import pytest  # not there when this runs with numpy and scipy only

# Positions and controls, which no generator of ours reads, are left out.
Record = namedtuple("Record", ["timer", "is_oob", "oob_distance"])  # as theirs


class RoadTest:
    def __init__(self, road_points: list[tuple[float, float]], number: int) -> None:
        assert type(road_points) is list
        assert all(type(point) is tuple and len(point) == 2 for point in road_points)
        assert all(type(value) is float for point in road_points for value in point)
        self.road_points = road_points
        self.id = number

    @property
    def turns(self) -> FloatArray:
        """rad from each step between two points to the next: the road, wherever it lies."""
        steps = np.diff(np.array(self.road_points), axis=0)
        return np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))


class RoadTestFactory:
    numbers = itertools.count(1)

    @staticmethod
    def create_road_test(road_points: list[tuple[float, float]]) -> RoadTest:
        return RoadTest(road_points, next(RoadTestFactory.numbers))


def install() -> None:
    """Makes `code_pipeline` importable; every run of the pipeline counts its tests from 1."""
    package, module = ModuleType("code_pipeline"), ModuleType("code_pipeline.tests_generation")
    RoadTestFactory.numbers = itertools.count(1)
    module.RoadTestFactory = RoadTestFactory  # type: ignore[attr-defined]
    sys.modules["code_pipeline"] = package
    sys.modules["code_pipeline.tests_generation"] = module


def enter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs a test as if inside the pipeline, with nothing set in the environment."""
    for name in ("FRENETIC_SEED", "FRENETIC_STRATEGY_OPTIONS"):
        monkeypatch.delenv(name, raising=False)
    for name in ("code_pipeline", "code_pipeline.tests_generation"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    install()


def driven(outcome: str, *oob_distances: float) -> tuple[str, str, list[Record]]:
    """What comes back from a test of which these oob distances, m, were recorded."""
    description = "Car drove out of the lane 1" if outcome == "FAIL" else "Successful test"
    records = [Record(0.04 * i, d < 0.0, d) for i, d in enumerate(oob_distances)]
    return outcome, description, records


def passed(_: RoadTest) -> Any:
    return driven("PASS", 2.0, 0.5, 1.0)


class Executor:
    """Answers tests as told; each takes 30 s on a clock that nothing else moves."""

    SECONDS_PER_TEST = 30.0

    def __init__(self, *, tests: int, answer: Callable[[RoadTest], Any] = passed) -> None:
        self.budget = tests * self.SECONDS_PER_TEST
        self.answer = answer
        self.now = 0.0
        self.tests: list[RoadTest] = []
        self.start_generation_time: float | None = 0.0
        self.has_ended_the_process = False

    def execute_test(self, the_test: RoadTest) -> Any:
        assert self.start_generation_time is not None, "the generation's clock does not run"
        self.start_generation_time = None
        if self.now >= self.budget:
            self.has_ended_the_process = True
            sys.exit(123)
        self.tests.append(the_test)
        self.now += self.SECONDS_PER_TEST
        answer = self.answer(the_test)
        self.start_generation_time = self.now
        return answer


class Executor2021(Executor):
    """The remaining time is a number, and all that tells whether the budget is spent."""

    def get_remaining_time(self) -> float:
        return self.budget - self.now


class LaterExecutor(Executor):
    """Tells whether the budget is spent."""

    def is_over(self) -> bool:
        return self.now >= self.budget


class Executor2022(LaterExecutor):
    """The remaining time is a dictionary, of one budget; so it was from 2022 to 2024."""

    def get_remaining_time(self) -> dict[str, float]:
        return {"time-budget": self.budget - self.now}


class ExecutorOfTwoBudgets(LaterExecutor):
    """Generating and executing have a budget each; only executing takes time here."""

    def get_remaining_time(self) -> dict[str, float]:
        return {"generation-budget": 1000.0, "execution-budget": self.budget - self.now}


def run_2021(kind: type[Any], executor: Executor, map_size: int = 200) -> None:
    kind(time_budget=executor.budget, executor=executor, map_size=map_size).start()


def run_2022(kind: type[Any], executor: Executor, map_size: int = 200) -> None:
    kind(executor=executor, map_size=map_size).start()
