"""Standard manoeuvres: roads with a purpose, and what is measured on their drives."""

from frenetic.manoeuvres.bends import ConstantRadius, CurvatureStep
from frenetic.manoeuvres.driving import ManoeuvrePlan, drive_manoeuvre
from frenetic.manoeuvres.lane_offset import LaneOffset
from frenetic.manoeuvres.manoeuvre import (
    Graph,
    Line,
    Manoeuvre,
    ManoeuvreDrive,
    ManoeuvreResult,
    Measures,
    Quantity,
    QuantityName,
)
from frenetic.manoeuvres.sines import Slalom, SweptSine

__all__ = [
    "ConstantRadius",
    "CurvatureStep",
    "Graph",
    "LaneOffset",
    "Line",
    "Manoeuvre",
    "ManoeuvreDrive",
    "ManoeuvrePlan",
    "ManoeuvreResult",
    "Measures",
    "Quantity",
    "QuantityName",
    "Slalom",
    "SweptSine",
    "drive_manoeuvre",
]
