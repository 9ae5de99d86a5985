"""Raises after three tests."""

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Crashing:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def start(self):
        for _ in range(3):
            self.executor.execute_test(
                RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
            )
        raise ValueError("no more ideas\nafter three tests")
