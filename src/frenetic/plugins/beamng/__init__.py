"""BeamNG.tech as a simulator, through BeamNGpy (extra ``beamng``)."""

from frenetic.plugins.beamng.link import BeamngError
from frenetic.plugins.beamng.simulator import BeamngSimulator

__all__ = ["BeamngError", "BeamngSimulator"]
