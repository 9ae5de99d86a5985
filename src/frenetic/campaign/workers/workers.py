"""The protocol between a campaign and its workers."""

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
    """Workers, which test candidates, each one at a time.

    It is a context manager: entering it starts them without waiting, leaving it ends them in every
    case. It is used from one thread. Each submitted candidate comes back in an `Attempt`, whatever
    happens to its worker; a lost worker is replaced.
    """

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now; 0 while workers start."""

    @property
    def needed(self) -> int:
        """Number of these that keeps all workers busy: others only wait in them."""

    def states(self) -> Mapping[str, WorkerState]:
        """Activity of each worker, by its name."""

    def submit(self, candidate: Candidate, placement: Placement | None = None) -> None:
        """Hands a candidate to a free worker, to be tested as by `RoadTester.test`."""

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: there are no workers left and none can be started; the message says why.
        """

    def __enter__(self) -> Self:
        """Starts the workers without waiting."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends all workers: at once during an error, else when they are done."""


def available_cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "process_cpu_count"):  # Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
