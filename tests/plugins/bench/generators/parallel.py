"""Makes its roads in a spawned process."""

import multiprocessing

from code_pipeline.tests_generation import RoadTest, RoadTestFactory


def straight(x):
    assert RoadTest.__module__ == "code_pipeline.tests_generation"
    return [(x, 20.0), (x, 90.0)]


class Parallel:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            for road_points in pool.map(straight, [50.0, 100.0]):
                self.executor.execute_test(RoadTestFactory.create_road_test(road_points))
