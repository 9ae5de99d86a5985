"""Computes for a second before each test."""

import time

from code_pipeline.tests_generation import RoadTestFactory


class Slow:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        while not self.executor.is_over():
            time.sleep(1.0)
            points = [(20.0, 20.0 + 20.0 * i) for i in range(8)]
            self.executor.execute_test(RoadTestFactory.create_road_test(points))
