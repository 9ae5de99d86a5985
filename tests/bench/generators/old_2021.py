"""Is written for the pipeline of 2021: it is given the time budget, and time is a number."""

import json
from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Old2021:
    def __init__(self, time_budget=None, executor=None, map_size=None):
        self.time_budget = time_budget
        self.executor = executor
        self.map_size = map_size

    def start(self):
        remaining = []
        while self.executor.get_remaining_time() > 0.5 * self.time_budget:
            remaining.append(self.time_budget - self.executor.get_remaining_time())
            self.executor.execute_test(
                RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
            )
        Path("seen.json").write_text(json.dumps(remaining), encoding="utf-8")
