"""Roads as OpenDRIVE files: writing our own, reading those of others."""

from frenetic.road.opendrive.reading import RoadMap, Stretch
from frenetic.road.opendrive.writing import ORIGIN, to_opendrive

__all__ = ["ORIGIN", "RoadMap", "Stretch", "to_opendrive"]
