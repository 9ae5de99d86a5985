"""BeamNG.tech as a simulator, through BeamNGpy (extra ``beamng``)."""

from frenetic.beamng.link import BeamngError
from frenetic.beamng.simulator import BeamngSimulator

__all__ = ["BeamngError", "BeamngSimulator"]
