"""Workers, which test roads: this process, several local ones, or a Dask cluster."""

from frenetic.campaign.record import Attempt
from frenetic.campaign.workers.local import LocalWorkers
from frenetic.campaign.workers.workers import InProcessWorker, Workers, available_cores

ThisProcess = InProcessWorker  # its former name

__all__ = [
    "Attempt",
    "InProcessWorker",
    "LocalWorkers",
    "ThisProcess",
    "Workers",
    "available_cores",
]
