"""Files for other tools."""

from frenetic.export.campaigns import export_campaign
from frenetic.export.competition import (
    SimulationRecord,
    competition_document,
    simulation_records,
    stored_test_document,
)
from frenetic.export.openscenario import to_openscenario
from frenetic.export.roads import (
    FORMATS,
    ExportedRoad,
    RoadFormat,
    format_of,
    road_format,
    write_road,
)
from frenetic.export.tables import TABLES, data_frame

__all__ = [
    "FORMATS",
    "TABLES",
    "ExportedRoad",
    "RoadFormat",
    "SimulationRecord",
    "competition_document",
    "data_frame",
    "export_campaign",
    "format_of",
    "road_format",
    "simulation_records",
    "stored_test_document",
    "to_openscenario",
    "write_road",
]
