"""Hands over malformed roads and objects that are no road tests."""

import json
from pathlib import Path

import numpy as np
from code_pipeline.tests_generation import RoadTestFactory

ROADS = [
    [],
    [(10.0, 10.0)],
    [(50.0, 50.0), (50.0, 60.0)],
    [(50.0, 50.0), (50.0, 50.0), (50.0, 90.0)],
    [(50.0, 20.0), (50.0, float("nan")), (50.0, 90.0)],
    [("a", 20.0), (50.0, None), 7],
    np.array([[50, 20], [50, 50], [50, 90]]),
]


class OddTests:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        answers = []
        for road_points in ROADS:
            test = RoadTestFactory.create_road_test(road_points)
            validity = self.executor.validate_test(test)
            outcome, description, data = self.executor.execute_test(test)
            assert validity == (test.is_valid, test.validation_message)
            assert outcome == "PASS" or description == test.validation_message
            assert hasattr(test, "execution_data") == (outcome == "PASS")
            answers.append([outcome, description, len(data), test.id, test.is_valid])
        answers += [self.executor.execute_test(other) for other in (ROADS[-1].tolist(), None)]
        Path("answers.json").write_text(json.dumps(answers), encoding="utf-8")
