"""Roads from curvature: their geometry, fitting the map, validity and lanes."""

from frenetic.road.placing import MAP_MARGIN, fit_to_map
from frenetic.road.road import BEHAVIOUR, Road
from frenetic.road.road_values import Pose
from frenetic.road.validity import LANE_WIDTH, MAP_SIZE, Verdict, check_validity

__all__ = [
    "BEHAVIOUR",
    "LANE_WIDTH",
    "MAP_MARGIN",
    "MAP_SIZE",
    "Pose",
    "Road",
    "Verdict",
    "check_validity",
    "fit_to_map",
]
