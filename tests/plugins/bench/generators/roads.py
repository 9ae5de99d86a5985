"""Roads for the generators of this folder, which import this module."""

import math
import random


def winding_road(map_size, points=14, turn=0.3):
    """Return a road that starts at the bottom of the map and turns a little every 10 m."""
    x, y, heading = map_size / 2, 15.0, math.pi / 2
    road = [(x, y)]
    while len(road) < points:
        heading += random.uniform(-turn, turn)
        x, y = x + 10.0 * math.cos(heading), y + 10.0 * math.sin(heading)
        road.append((x, y))
    return road
