"""Comes with a copy of the pipeline that has an additional module."""

import json
from pathlib import Path

import code_pipeline
from code_pipeline import my_helper, tests_generation
from code_pipeline.tests_generation import RoadTestFactory


class Helped:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        test = RoadTestFactory.create_road_test(my_helper.straight_road(50.0))
        outcome, _, _ = self.executor.execute_test(test)
        report = [outcome, tests_generation.__name__, code_pipeline.my_helper is my_helper]
        Path("report.json").write_text(json.dumps(report), encoding="utf-8")
