"""Files for other tools."""

from frenetic.export.competition import (
    SimulationRecord,
    competition_document,
    simulation_records,
    stored_test_document,
)
from frenetic.export.roads import (
    FORMATS,
    ExportedRoad,
    RoadFormat,
    road_format,
    write_road,
)

__all__ = [
    "FORMATS",
    "ExportedRoad",
    "RoadFormat",
    "SimulationRecord",
    "competition_document",
    "road_format",
    "simulation_records",
    "stored_test_document",
    "write_road",
]
