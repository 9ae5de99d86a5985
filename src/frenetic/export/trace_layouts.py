"""Layouts with which Foxglove and PlotJuggler show a trace at once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

from frenetic._support.files import write_file
from frenetic.export.trace_columns import TRACE_COLUMNS, field_name
from frenetic.export.trace_files import TraceForm

FOXGLOVE: Final = "foxglove-layout.json"
"""Name of the layout for Foxglove, which shows MCAP files."""
PLOTJUGGLER: Final = "plotjuggler-layout.xml"
"""Name of the layout for PlotJuggler."""
_PLOTS: Final = (
    ("Place in the lane", ("lateral_offset", "edge_distance")),
    ("Heading error", ("heading_error", "slip_angle")),
    ("Steering", ("steering_input", "steering")),
    ("Speed", ("speed",)),
    ("Acceleration", ("lateral_acceleration", "acceleration")),
    ("Pedals", ("throttle", "brake")),
)
"""Title of a plot -> columns in it."""
_FIELDS: Final = {column.name: field_name(column) for column in TRACE_COLUMNS}
_TOPIC: Final = "/drive"
_MOST_ITEMS: Final = 500
"""Largest list that PlotJuggler plots; its own default."""


def write_layouts(folder: Path | str, form: TraceForm) -> tuple[Path, ...]:
    """Write the layouts for traces of a form into a folder; existing layouts are replaced.

    Args:
        folder: an existing folder.
        form: form of the traces. Foxglove shows MCAP files only.

    Returns:
        The files.

    Raises:
        FreneticError: a file cannot be written.
    """
    texts = layout_texts(form)
    for name, text in texts.items():
        write_file(Path(folder) / name, text, remedy="choose another place")
    return tuple(Path(folder) / name for name in texts)


def layout_texts(form: TraceForm) -> dict[str, str]:
    """Return the name and the text of each layout for traces of a form."""
    texts = {PLOTJUGGLER: plotjuggler_layout(form)}
    return texts | ({FOXGLOVE: foxglove_layout()} if form == "mcap" else {})


def foxglove_layout() -> str:
    """Return the layout for Foxglove, as JSON: the scene and the log beside the plots."""
    plots = {f"Plot!{number}": _plot_panel(*plot) for number, plot in enumerate(_PLOTS)}
    scene = {
        "followMode": "follow-pose",
        "followTf": "car",
        "topics": {"/scene": {"visible": True}},
        "cameraState": {"distance": 60, "phi": 50, "thetaOffset": 90, "perspective": True},
    }
    log = {"topicToRender": "/events", "minLogLevel": 1, "searchTerms": []}
    layout = {
        "configById": {"3D!scene": scene, "RosOut!events": log, **plots},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _split("column", "3D!scene", "RosOut!events", 75),
            "second": _stacked(list(plots)),
            "splitPercentage": 45,
        },
    }
    return json.dumps(layout, indent=1) + "\n"


def _plot_panel(title: str, columns: Sequence[str]) -> dict[str, Any]:
    """Return the settings of a plot over time."""
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {
                "value": f"{_TOPIC}.{_FIELDS[column]}",
                "label": _FIELDS[column],
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for column in columns
        ],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
    }


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    """Return two panels side by side (row) or one above the other (column)."""
    return {
        "direction": direction,
        "first": first,
        "second": second,
        "splitPercentage": percentage,
    }


def _stacked(panels: Sequence[str]) -> Any:
    """Return panels of equal height, one above the other."""
    if len(panels) == 1:
        return panels[0]
    return _split("column", panels[0], _stacked(panels[1:]), 100.0 / len(panels))


def plotjuggler_layout(form: TraceForm) -> str:
    """Return the layout for PlotJuggler, as XML.

    Args:
        form: form of the traces: the curves of MCAP files have the topic before their names.
    """
    root = ET.Element("root")
    widget = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = ET.SubElement(widget, "Tab", tab_name="drive", containers="1")
    share = f"{1.0 / len(_PLOTS):.6f}"
    splitter = ET.SubElement(
        ET.SubElement(tab, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(len(_PLOTS)),
        sizes=";".join([share] * len(_PLOTS)),
    )
    for title, columns in _PLOTS:
        area = ET.SubElement(splitter, "DockArea", name=title)
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines")
        for column in columns:
            prefix = f"{_TOPIC}/" if form == "mcap" else ""
            ET.SubElement(plot, "curve", name=f"{prefix}{_FIELDS[column]}")
    ET.SubElement(widget, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="0")
    plugins = ET.SubElement(root, "Plugins")
    csv_plugin = ET.SubElement(plugins, "plugin", ID="DataLoad CSV")
    ET.SubElement(csv_plugin, "default", time_axis=_FIELDS["time"], delimiter="0")
    mcap_plugin = ET.SubElement(plugins, "plugin", ID="DataLoad MCAP")
    ET.SubElement(
        mcap_plugin,
        "parameters",
        use_timestamp="0",
        use_mcap_log_time="1",
        clamp_large_arrays="1",
        max_array_size=str(_MOST_ITEMS),
        selected_topics=_TOPIC,
    )
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
