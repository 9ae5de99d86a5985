"""Records of a drive; `frenetic.export.official_format` says what their values are."""

from collections import namedtuple

SimulationDataRecord = namedtuple(
    "SimulationDataRecord",
    "timer pos dir vel steering steering_input brake brake_input throttle throttle_input"
    " wheelspeed vel_kmh is_oob oob_counter max_oob_percentage oob_distance oob_percentage",
)
