"""BeamNG.tech as a simulator, through BeamNGpy (extra ``beamng``)."""

from frenetic.plugins.beamng.package import BeamngError
from frenetic.plugins.beamng.simulator import BeamngSimulator

__all__ = ["BeamngError", "BeamngSimulator"]
