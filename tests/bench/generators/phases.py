"""Spends 20 % of its budget on a first phase."""

from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Phases:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def remaining(self):
        return self.executor.get_remaining_time()["time-budget"]

    def start(self):
        budget = self.executor.time_budget.time_budget
        tests = 0
        while budget - self.remaining() < 0.2 * budget:
            self.execute()
            tests += 1
        Path("first_phase.txt").write_text(str(tests), encoding="utf-8")
        while True:
            self.execute()

    def execute(self):
        self.executor.execute_test(
            RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
        )
