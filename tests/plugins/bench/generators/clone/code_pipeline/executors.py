"""The executor of 2022, which discards the test during which the budget ends."""

import sys
from abc import ABC, abstractmethod
from pathlib import Path

import descartes
from beamngpy.sensors import Electrics
from tensorflow.keras.models import Model

from code_pipeline.tests_generation import Statistic


class Budget:
    def __init__(self, time_budget):
        self.time_budget = time_budget

    def get_remaining_real_time(self):
        raise AssertionError("real time has no meaning here")

    def get_remaining_time(self):
        return {"time-budget": self.get_remaining_real_time()}

    def is_over(self):
        return self.get_remaining_real_time() <= 0


class AbstractTestExecutor(ABC):
    def __init__(self, result_folder, map_size, time_budget=None, road_visualizer=None):
        assert all(map(callable, (Electrics, Model)))
        descartes.patch.draw_nothing(False)  # an attribute of a stand-in's attribute exists, too
        self.folder = Path(result_folder)
        self.time_budget = Budget(time_budget)
        self.stats = Statistic()

    def execute_test(self, test):
        if self.time_budget.is_over():
            sys.exit(123)
        self.stats.test_generation_real_times.append(-1.0)
        test.set_validity(*self.validate_test(test))
        if not test.verdict[0]:
            return "INVALID", test.verdict[1], []
        self.stats.test_execution_real_times.append(-1.0)
        outcome, description, records = self._execute(test)
        if self.time_budget.is_over():
            sys.exit(123)
        self.store_test(test)
        self.stats.outcomes.append(outcome)
        return outcome, description, records

    def validate_test(self, test):
        return test.polygon.is_valid(), "The road is self-intersecting"

    def store_test(self, test):
        (self.folder / "test.json").write_text("{}")

    def get_remaining_time(self):
        return self.time_budget.get_remaining_time()

    def is_over(self):
        return self.time_budget.is_over()

    @abstractmethod
    def _execute(self, test): ...
