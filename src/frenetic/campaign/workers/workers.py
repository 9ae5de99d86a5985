"""The seam between a campaign and those who test its roads."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Protocol, Self

from frenetic.campaign.log import WorkerState
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import Placement
from frenetic.search.records import Candidate


class Workers(Protocol):
    """Test candidates, as many at once as there are of them.

    A context manager: entering it begins to start them, leaving it ends them in every case. It is
    used from one thread. Whatever happens to a worker, each candidate that was submitted comes back
    in an `Attempt`; a worker that was lost is replaced.
    """

    @property
    def free(self) -> int:
        """How many candidates can be submitted now; 0 while workers are being started."""

    @property
    def needed(self) -> int:
        """How many of these it takes to keep all workers busy: others only wait in them."""

    def states(self) -> Mapping[str, WorkerState]:
        """What each worker does at the moment, by its name."""

    def submit(self, candidate: Candidate, placement: Placement | None = None) -> None:
        """Hands a candidate to a free worker, to be tested as by `RoadTester.test`."""

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns what has come back.

        Raises:
            CampaignError: there are no workers left and none can be started; the message says why.
        """

    def __enter__(self) -> Self:
        """Begins to start the workers."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends all workers: at once if an error is under way, else when they are done."""


def available_cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "process_cpu_count"):  # Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
