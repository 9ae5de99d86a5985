"""Roads as OpenDRIVE files: writing our own, reading those of others that hold a single road."""

from frenetic.road.opendrive.reading import from_opendrive
from frenetic.road.opendrive.writing import ORIGIN, to_opendrive

__all__ = ["ORIGIN", "from_opendrive", "to_opendrive"]
