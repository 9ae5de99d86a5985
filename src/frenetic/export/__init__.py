"""Files for other tools."""

from frenetic.export.campaigns import export_campaign
from frenetic.export.official_format import SimulationRecord
from frenetic.export.openscenario import to_openscenario
from frenetic.export.quality_tables import quality_frame
from frenetic.export.roads import FORMATS, ExportedRoad, format_of, road_format, write_road
from frenetic.export.table_columns import TABLES
from frenetic.export.tables import data_frame
from frenetic.export.trace_columns import TRACE_COLUMNS
from frenetic.export.trace_files import write_trace
from frenetic.export.trace_folder import export_traces
from frenetic.export.trace_layouts import write_layouts
from frenetic.export.traces import DriveTrace, LaneEdges, TraceEvent, trace_of, trace_of_test
from frenetic.export.version_tables import versions_frame

__all__ = [
    "FORMATS",
    "TABLES",
    "TRACE_COLUMNS",
    "DriveTrace",
    "ExportedRoad",
    "LaneEdges",
    "SimulationRecord",
    "TraceEvent",
    "data_frame",
    "export_campaign",
    "export_traces",
    "format_of",
    "quality_frame",
    "road_format",
    "to_openscenario",
    "trace_of",
    "trace_of_test",
    "versions_frame",
    "write_layouts",
    "write_road",
    "write_trace",
]
