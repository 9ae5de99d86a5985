"""The protocol between a campaign and its workers, and the worker in the campaign's own process."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence
from typing import Any, Final, Protocol, Self

from frenetic._support.entry_points import imported, installed
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError, Trouble, reason_of, traceback_of
from frenetic.search.records import Candidate

CLUSTERS: Final = "frenetic.clusters"
"""Group of entry points; each is a class of workers on a cluster, which is called with
``(tester, address, *, drive_limit, log)``."""


class Workers(Protocol):
    """Workers, each of which tests one candidate at a time.

    Workers are a context manager: entering it starts them without waiting, and leaving it ends
    them in any case. Use them from one thread. Each submitted candidate comes back in an `Attempt`,
    whatever happens to its worker; a lost worker is replaced.
    """

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now; 0 while workers start."""

    def submit(self, candidate: Candidate) -> None:
        """Hand a candidate to a free worker, which tests it as `RoadTester.test` does."""

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Wait for attempts for at most `timeout` s; return those that have ended.

        Raises:
            CampaignError: no worker is left and no other can be started; the message says why.
        """

    def __enter__(self) -> Self:
        """Start the workers without waiting."""

    def __exit__(self, *raised: Any) -> None:
        """End all workers: at once during an error, otherwise when they have finished."""


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


NAME: Final = "this process"
"""Name of the worker in the campaign's own process."""

logger = logging.getLogger(__name__)


class InProcessWorker(Workers):
    """The worker in the campaign's own process: it tests a candidate within `wait`.

    A simulator that broke is started again for the next candidate.

    Nothing is copied, so driver and simulator may be any objects. A simulator or driver that kills
    the process kills the campaign, which can then be resumed; with `LocalWorkers` it kills only its
    worker's process.

    Args:
        tester: tester of the candidates.
    """

    def __init__(self, tester: RoadTester) -> None:
        self._tester = tester
        self._is_started = False
        self._candidate: Candidate | None = None  # the candidate that `wait` will test

    @property
    def free(self) -> int:
        """1 unless a submitted candidate waits for `wait`."""
        return 0 if self._candidate else 1

    def submit(self, candidate: Candidate) -> None:
        """Accept the candidate that `wait` will test."""
        assert self._candidate is None
        self._candidate = candidate

    def wait(self, timeout: float) -> Sequence[Attempt]:  # noqa: ARG002 - a test is not cut short
        """Test the submitted candidate.

        Raises:
            CampaignError: the simulator does not start again.
        """
        if self._candidate is None:
            return ()
        self._start()
        candidate = self._candidate
        start = time.perf_counter()
        try:
            attempt = self._tester.attempt(candidate, NAME, keep_exact=True)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            logger.debug("the simulator broke", exc_info=True)
            seconds = time.perf_counter() - start
            trouble = Trouble(reason_of(error), traceback_of(error))
            attempt = Attempt.lost(candidate.id, NAME, seconds, trouble)
        if attempt.simulator_broke or attempt.worker_lost:
            self.__exit__(None, None, None)
        self._candidate = None
        return (attempt,)

    def __enter__(self) -> Self:
        """Start the simulator.

        Raises:
            CampaignError: the simulator does not start.
        """
        self._start()
        return self

    def __exit__(self, *raised: Any) -> None:
        """End the simulator."""
        if self._is_started:
            self._is_started = False
            try:
                self._tester.simulator.__exit__(*raised)
            except Exception as error:  # its drives remain valid
                logger.warning("the simulator did not end well: %s", reason_of(error))

    def _start(self) -> None:
        if not self._is_started:
            try:
                self._tester.simulator.__enter__()
            except Exception as error:
                raise CampaignError(f"the simulator does not start: {reason_of(error)}") from error
            self._is_started = True


def cluster_workers() -> Any:
    """Return the class of workers on a cluster, which a plug-in provides.

    Raises:
        CampaignError: no installed package has an entry point in the group `frenetic.clusters`.
    """
    for entry in installed(CLUSTERS):
        return imported(entry.target)
    raise CampaignError(f"workers on a cluster need a package with an entry point in {CLUSTERS}")
