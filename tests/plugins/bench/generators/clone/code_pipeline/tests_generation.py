"""A small pipeline, written for these tests; `self_driving.road_polygon` checks its roads."""

from self_driving.road_polygon import RoadPolygon


class RoadTest:
    count = 0

    def __init__(self, road_points):
        RoadTest.count += 1
        self.id = RoadTest.count
        self.road_points = road_points
        self.polygon = RoadPolygon(road_points)

    def set_validity(self, is_valid, message):
        self.verdict = is_valid, message


class RoadTestFactory:
    create_road_test = RoadTest


class Statistic:
    def __init__(self):
        self.outcomes = []
        self.test_generation_real_times = []
        self.test_execution_real_times = []
