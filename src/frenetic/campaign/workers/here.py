"""One worker: the campaign's own process."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Final, Self

from frenetic.campaign.log import WorkerState, WorkerStatus
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.workers import Attempt
from frenetic.search.records import Candidate

NAME: Final = "this process"


class ThisProcess:
    """Tests one candidate after the other, within `wait`; a simulator that broke is restarted.

    Nothing has to be sent anywhere, so driver and simulator may be any objects. A simulator or
    driver that takes the process with it takes the campaign, which then has to be resumed.
    """

    def __init__(self, tester: RoadTester) -> None:
        self._tester = tester
        self._candidate: Candidate | None = None
        self._tests = 0
        self._since = time.monotonic()

    @property
    def free(self) -> int:
        """1 unless a candidate has been submitted and not been waited for."""
        return 0 if self._candidate else 1

    def states(self) -> Mapping[str, WorkerState]:
        """What it does, seen between two tests."""
        state: WorkerStatus = "driving" if self._candidate else "idle"
        return {NAME: WorkerState(NAME, state, self._tests, time.monotonic() - self._since)}

    def submit(self, candidate: Candidate) -> None:
        """Takes the candidate that `wait` will test."""
        assert self._candidate is None
        self._candidate = candidate
        self._since = time.monotonic()

    def wait(self, timeout: float) -> Sequence[Attempt]:  # noqa: ARG002 - it takes what it takes
        """Tests the candidate that was submitted."""
        if self._candidate is None:
            return ()
        candidate = self._candidate
        start = time.perf_counter()
        tested = self._tester.test(candidate)
        seconds = time.perf_counter() - start
        if tested.simulator_broke:
            self._tester.simulator.__exit__(None, None, None)
            self._tester.simulator.__enter__()
        self._candidate = None
        self._tests += 1
        return (Attempt(candidate.id, NAME, seconds, tested),)

    def __enter__(self) -> Self:
        """Starts the simulator."""
        self._tester.simulator.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends the simulator."""
        self._tester.simulator.__exit__(kind, error, trace)
