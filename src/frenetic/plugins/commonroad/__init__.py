"""CommonRoad's multi-body car as a simulator.

The package ``vehiclemodels`` is imported when the simulator is entered, so it need not be
installed for other simulators.
"""

from frenetic.plugins.commonroad.simulator import CommonRoadSimulator

__all__ = ["CommonRoadSimulator"]
