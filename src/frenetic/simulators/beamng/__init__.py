"""BeamNG.tech as a simulator, through BeamNGpy (extra ``beamng``)."""

from frenetic.simulators.beamng.link import BeamngError
from frenetic.simulators.beamng.simulator import BeamngSimulator

__all__ = ["BeamngError", "BeamngSimulator"]
