"""Executes tests from several threads and leaves two running that nobody will end."""

import threading

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Threads:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def execute(self):
        self.executor.execute_test(
            RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
        )

    def start(self):
        workers = [threading.Thread(target=self.execute) for _ in range(4)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        for _ in range(2):
            threading.Thread(target=threading.Event().wait).start()
