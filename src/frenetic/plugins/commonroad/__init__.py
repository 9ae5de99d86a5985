"""CommonRoad's multi-body car as a simulator.

Nothing here imports the package ``vehiclemodels`` before a drive starts, so that it need not be
installed.
"""

from frenetic.plugins.commonroad.simulator import CommonRoadSimulator

__all__ = ["CommonRoadSimulator"]
