"""Files for other tools."""

from frenetic.export.campaigns import export_campaign
from frenetic.export.official_format import SimulationRecord
from frenetic.export.openscenario import to_openscenario
from frenetic.export.quality_tables import quality_frame
from frenetic.export.roads import FORMATS, ExportedRoad, format_of, road_format, write_road
from frenetic.export.table_columns import TABLES
from frenetic.export.tables import data_frame

__all__ = [
    "FORMATS",
    "TABLES",
    "ExportedRoad",
    "SimulationRecord",
    "data_frame",
    "export_campaign",
    "format_of",
    "quality_frame",
    "road_format",
    "to_openscenario",
    "write_road",
]
