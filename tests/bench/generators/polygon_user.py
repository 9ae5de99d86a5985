"""Looks at a road's area, its sharpest place and the map's boundary before it executes a test."""

import json
from pathlib import Path

from code_pipeline.beamng_executor import BeamngExecutor
from code_pipeline.executors import AbstractTestExecutor
from code_pipeline.tests_generation import RoadTestFactory
from code_pipeline.validation import min_radius
from code_pipeline.visualization import RoadTestVisualizer
from roads import winding_road
from self_driving.bbox import RoadBoundingBox
from self_driving.road_polygon import RoadPolygon


class PolygonUser:
    def __init__(self, executor: BeamngExecutor = None, map_size=None):
        assert isinstance(executor, AbstractTestExecutor)
        self.executor = executor
        self.map_size = map_size
        self.box = RoadBoundingBox((0, 0, map_size, map_size))
        self.visualizer = RoadTestVisualizer(map_size=map_size)

    def start(self):
        outcomes = []
        while not self.executor.is_over():
            test = RoadTestFactory.create_road_test(winding_road(self.map_size))
            road = RoadPolygon.from_nodes(test.interpolated_points)
            self.visualizer.visualize_road_test(test)
            if (
                road.is_valid()
                and self.box.contains(road)
                and not self.box.intersects_boundary(road.polygon)
                and min_radius(test.interpolated_points) > 47
            ):
                outcome, _, execution_data = self.executor.execute_test(test)
                outcomes.append(outcome)
                lane = test.get_road_polygon().right_polygon
                assert lane.area > 0.4 * road.polygon.area
                assert min(record.oob_distance for record in execution_data) <= 2.0
        Path("seen.json").write_text(json.dumps(outcomes), encoding="utf-8")
