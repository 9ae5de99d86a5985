"""Stand-in for the pipeline's records; `frenetic.export.official_format` describes their values."""

from collections import namedtuple

SimulationDataRecord = namedtuple(
    "SimulationDataRecord",
    "timer pos dir vel steering steering_input brake brake_input throttle throttle_input"
    " wheelspeed vel_kmh is_oob oob_counter max_oob_percentage oob_distance oob_percentage",
)
