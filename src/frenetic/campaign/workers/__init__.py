"""Workers, which test roads: this process, several local ones, or a cluster."""

from frenetic.campaign.record import Attempt
from frenetic.campaign.workers.alone import DriveProcess, driving
from frenetic.campaign.workers.local import LocalWorkers, is_isolable, workers_for
from frenetic.campaign.workers.workers import (
    InProcessWorker,
    Workers,
    available_cores,
    cluster_workers,
)

__all__ = [
    "Attempt",
    "DriveProcess",
    "InProcessWorker",
    "LocalWorkers",
    "Workers",
    "available_cores",
    "cluster_workers",
    "driving",
    "is_isolable",
    "workers_for",
]
