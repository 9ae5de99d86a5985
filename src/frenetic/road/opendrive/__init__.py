"""Roads as OpenDRIVE files: writing roads, and reading roads from any such file."""

from frenetic.road.opendrive.reading import RoadMap, Stretch
from frenetic.road.opendrive.writing import ORIGIN, to_opendrive

__all__ = ["ORIGIN", "RoadMap", "Stretch", "to_opendrive"]
