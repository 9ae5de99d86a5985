"""Generators that do not end by themselves."""

import time

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class NeverReturning:
    """Has nothing more to say after two tests, and does not stop."""

    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def execute(self):
        return self.executor.execute_test(
            RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
        )

    def start(self):
        self.execute()
        self.execute()
        print("two tests are enough")
        while True:
            time.sleep(0.05)


class Unstoppable(NeverReturning):
    """Goes on when the budget is spent."""

    def start(self):
        while True:
            try:
                self.execute()
            except BaseException as error:
                print(f"went on after {error!r}")


class Stubborn(NeverReturning):
    """Returns only when it has been told three times that the budget is spent."""

    def start(self):
        refusals = 0
        while refusals < 3:
            try:
                self.execute()
            except SystemExit:
                refusals += 1
