"""Ends its process by itself."""

import sys

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Exiting:
    code = 7

    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def start(self):
        self.executor.execute_test(
            RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
        )
        sys.exit(self.code)


class Content(Exiting):
    """Ends as if nothing had happened."""

    code = 0
