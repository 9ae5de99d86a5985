"""Draws roads in the surrounding pipeline, and checks what the pipeline returns."""

import copy
import json
import pickle
import random
from pathlib import Path

import code_pipeline
from code_pipeline.tests_generation import RoadTestFactory
from self_driving.road_polygon import RoadPolygon


class Winding:
    def __init__(self, executor=None, map_size=None):
        self.executor = pickle.loads(pickle.dumps(copy.deepcopy(executor)))
        assert self.executor is executor
        assert Path(code_pipeline.__file__).parents[1] == Path(__file__).parents[1]

    def start(self):
        while not self.executor.is_over():
            points = [(100.0 + random.uniform(-6.0, 6.0), 15.0 * i) for i in range(1, 10)]
            test = RoadTestFactory.create_road_test(points)
            assert test.polygon.is_valid()
            assert not RoadPolygon(
                [(60.0, 20.0), (90.0, 50.0), (60.0, 50.0), (90.0, 20.0)]
            ).is_valid()
            valid = self.executor.validate_test(test)
            outcome, _, _ = self.executor.execute_test(test)
            assert valid == test.verdict == (outcome != "INVALID", valid[1])
        stats = {**vars(self.executor.stats), "generation": self.executor.get_remaining_time()}
        Path("statistics.json").write_text(json.dumps(stats), encoding="utf-8")
