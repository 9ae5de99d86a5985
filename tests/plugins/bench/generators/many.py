"""Generators that crash, hang, exit or otherwise misbehave, one class each."""

import copy
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory
from roads import winding_road


class Plain:
    """Executes tests until the budget is spent."""

    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size

    def execute(self):
        road = winding_road(self.map_size, turn=0.05)
        return self.executor.execute_test(RoadTestFactory.create_road_test(road))

    def remaining(self):
        return self.executor.get_remaining_time()["time-budget"]

    def start(self):
        while not self.executor.is_over():
            self.execute()


class Crashing(Plain):
    def start(self):
        for _ in range(3):
            self.execute()
        raise ValueError("no more ideas\nafter three tests")


class Exiting(Plain):
    def start(self):
        self.execute()
        sys.exit(7)


class NeverReturning(Plain):
    """Hangs after two tests."""

    def start(self):
        self.execute()
        self.execute()
        while True:
            time.sleep(0.05)


class Stubborn(Plain):
    """Returns only after three refusals because the budget is spent."""

    def start(self):
        refusals = 0
        while refusals < 3:
            try:
                self.execute()
            except SystemExit:
                refusals += 1


class Threads(Plain):
    """Executes tests from several threads and leaves a thread that never ends."""

    def start(self):
        workers = [threading.Thread(target=self.execute) for _ in range(4)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        threading.Thread(target=threading.Event().wait).start()


class Phases(Plain):
    """Spends 20 % of its budget on a first phase."""

    def start(self):
        budget = self.executor.time_budget.time_budget
        tests = 0
        while budget - self.remaining() < 0.2 * budget:
            self.execute()
            tests += 1
        Path("first_phase.txt").write_text(str(tests), encoding="utf-8")
        while True:
            self.execute()


class Old2021(Plain):
    """Written for the pipeline of 2021, which passes the time budget; times are numbers."""

    def __init__(self, time_budget=None, executor=None, map_size=None):
        super().__init__(executor, map_size)
        self.time_budget = time_budget

    def start(self):
        while self.executor.get_remaining_time() > 0.5 * self.time_budget:
            self.execute()


class Copying(Plain):
    """Deep-copies its state, as optimisers do, and notes the folder of each drive."""

    def start(self):
        state = {"problem": self, "folders": []}
        budget = copy.deepcopy(self.executor.time_budget)
        while not budget.is_over():
            state = pickle.loads(pickle.dumps(copy.deepcopy(state)))
            if state["problem"].execute()[2]:
                folders = Path("simulations/beamng_executor").iterdir()
                state["folders"].append(max(folders, key=os.path.getmtime).name)
            Path("folders.txt").write_text("\n".join(state["folders"]), encoding="utf-8")


class Slow(Plain):
    def execute(self):
        time.sleep(1.0)
        super().execute()


class Sleeping(Plain):
    """Runs for 600 s with a helper process."""

    def start(self):
        helper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        Path("helper").write_text(str(helper.pid), encoding="utf-8")
        time.sleep(600)
