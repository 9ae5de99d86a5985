"""Workers for a driver in compiled code: threads of the campaign's process."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.workers import NAME, InProcessWorker
from frenetic.search.records import Candidate

ROADS_PER_THREAD: Final = 8
"""Largest number of candidates that a thread has at once: as many cars as the widest vector
instructions move. A candidate that waits longer is more likely to be dropped unseen (our choice).
"""

logger = logging.getLogger(__name__)


class ThreadWorkers(InProcessWorker):
    """Threads in the campaign's own process, which drive many roads side by side.

    The drives are the same as one after the other. They run compiled code of Frenetic alone, which
    breaks no process, so they need no process of their own.

    Args:
        tester: tester of the candidates, whose simulator has ``drive_many``.
        count: number of threads.
    """

    def __init__(self, tester: RoadTester, count: int) -> None:
        super().__init__(tester)
        self._threads = count
        self._candidates: list[Candidate] = []

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted before the next `wait`."""
        return ROADS_PER_THREAD * self._threads - len(self._candidates)

    def submit(self, candidate: Candidate) -> None:
        """Accept a candidate, which `wait` will test."""
        self._candidates.append(candidate)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Test the submitted candidates.

        Raises:
            CampaignError: the simulator does not start again.
        """
        self._start()
        candidates, self._candidates = self._candidates, []
        start = time.perf_counter()
        try:
            attempts = self._tester.test_many(candidates, threads=self._threads)
        except Exception:
            # One after the other, to see which candidate the error belongs to.
            logger.debug("the simulator broke", exc_info=True)
            return [
                attempt for candidate in candidates for attempt in self._test(candidate, timeout)
            ]
        seconds = (time.perf_counter() - start) / max(len(attempts), 1)
        return [replace(attempt, worker=NAME, seconds=seconds) for attempt in attempts]

    def _test(self, candidate: Candidate, timeout: float) -> Sequence[Attempt]:
        """Test a candidate as `InProcessWorker` does."""
        super().submit(candidate)
        return super().wait(timeout)
