"""Validates before it executes, and keeps an eye on the executor's counts."""

import json
from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory
from code_pipeline.validation import TestValidator
from roads import winding_road


class StatsReader:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.map_size = map_size
        self.validator = TestValidator(map_size)

    def start(self):
        kept_back = 0
        while self.executor.time_budget.can_run_a_test():
            test = RoadTestFactory.create_road_test(winding_road(self.map_size))
            is_valid, message = self.executor.validate_test(test)
            assert (is_valid, message) == self.validator.validate_test(test)
            if not is_valid:
                kept_back += 1
                continue
            self.executor.execute_test(test)
            assert test.is_valid
        assert self.executor.stats is self.executor.get_stats()
        seen = dict(vars(self.executor.get_stats()), kept_back=kept_back)
        Path("seen.json").write_text(json.dumps(seen), encoding="utf-8")
