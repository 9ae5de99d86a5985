"""Deep-copies all that it holds, as optimisers do, and notes the folder of each drive."""

import copy
import os
import pickle
from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Problem:
    def __init__(self, executor, map_size):
        self.executor = executor
        self.map_size = map_size
        self.folders = []

    def evaluate(self):
        test = RoadTestFactory.create_road_test(winding_road(self.map_size, turn=0.05))
        _, _, records = self.executor.execute_test(test)
        if records:
            folders = Path("simulations/beamng_executor").iterdir()
            self.folders.append(sorted(folders, key=os.path.getmtime)[-1].name)


class Copying:
    def __init__(self, executor=None, map_size=None):
        self.problem = Problem(executor, map_size)

    def start(self):
        budget = copy.deepcopy(self.problem.executor.time_budget)
        while not budget.is_over():
            self.problem = pickle.loads(pickle.dumps(copy.deepcopy(self.problem)))
            self.problem.evaluate()
            Path("folders.txt").write_text("\n".join(self.problem.folders), encoding="utf-8")
