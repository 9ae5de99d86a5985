"""Workers, which test roads: this process, several local ones, or a Dask cluster."""

from frenetic.campaign.workers.here import ThisProcess
from frenetic.campaign.workers.processes import LocalWorkers
from frenetic.campaign.workers.workers import Workers, available_cores

__all__ = ["LocalWorkers", "ThisProcess", "Workers", "available_cores"]
