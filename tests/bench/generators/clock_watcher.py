"""Takes its time, and notes what the executor says of it."""

import json
import time
from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory

time.sleep(0.05)


class ClockWatcher:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def remaining(self):
        return self.executor.get_remaining_time()["time-budget"]

    def start(self):
        seen = []
        for x in (50.0, 100.0, 150.0):
            time.sleep(0.01)
            test = RoadTestFactory.create_road_test([(x, 20.0), (x, 90.0)])
            seen.append([self.remaining(), self.executor.execute_test(test)[0], self.remaining()])
        Path("seen.json").write_text(json.dumps(seen), encoding="utf-8")
