"""Draws roads until the budget is spent."""

import numpy as np
from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class RandomRoads:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def start(self):
        while not self.executor.is_over():
            road_points = winding_road(self.map_size, points=int(np.random.randint(8, 16)))
            test = RoadTestFactory.create_road_test(road_points)
            outcome, description, execution_data = self.executor.execute_test(test)
            print(f"test {test.id}: {outcome} ({description}), {len(execution_data)} records")
