class Edges:
    def __init__(self, points):
        self.left = [(x - 4.0, y) for x, y in points]
        self.right = [(x + 4.0, y) for x, y in points]


class RoadPolygon:
    def __init__(self, points):
        self.road_points = Edges(points)

    def is_valid(self):
        raise AssertionError("this takes seconds")
