"""What CommonRoad's Scenario Designer makes of OpenDRIVE files, as JSON: for each file, its lanes.

    python tests/road/commonroad_lanelets.py FILE... [PROJECTION FILE...]

leaves them where a file does; those behind a PROJECTION (+proj=...) are placed on its map.
It runs where the package commonroad-scenario-designer is installed. That wants versions of its own
of many packages, so the tests give it an environment of its own.
"""

from __future__ import annotations

import json
import logging
import sys
import warnings
from pathlib import Path

from crdesigner.common.config.opendrive_config import open_drive_config
from crdesigner.map_conversion.map_conversion_interface import opendrive_to_commonroad


def lanelets(path: str, projection: str | None) -> list[list[list[float]]] | str:
    """Centre line of each lanelet, in m, or what went wrong."""
    open_drive_config.proj_string_odr = projection
    try:
        scenario = opendrive_to_commonroad(Path(path), odr_conf=open_drive_config)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return [lanelet.center_vertices.tolist() for lanelet in scenario.lanelet_network.lanelets]


if __name__ == "__main__":
    logging.disable()
    warnings.simplefilter("ignore")
    projection, found = None, {}
    for argument in sys.argv[1:]:
        if argument.startswith("+proj="):
            projection = argument
        else:
            found[argument] = lanelets(argument, projection)
    json.dump(found, sys.stdout)
