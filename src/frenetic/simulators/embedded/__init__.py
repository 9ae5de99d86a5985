"""The embedded simulator: a dynamic single-track car in compiled code, headless and fast."""

from frenetic.simulators.embedded.simulator import (
    EmbeddedSimulator,
    compile_kernels,
    interprets_drives,
    rehearse,
)
from frenetic.simulators.embedded.vehicle import Vehicle

__all__ = ["EmbeddedSimulator", "Vehicle", "compile_kernels", "interprets_drives", "rehearse"]
