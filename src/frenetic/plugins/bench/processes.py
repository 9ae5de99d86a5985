"""Runs of a bench side by side, each in its own process."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from dataclasses import replace
from typing import Final

from threadpoolctl import threadpool_limits

from frenetic.campaign.summary import Progress, Summary
from frenetic.plugins.bench.runs import EntrantRun, RunState, RunTerms, run_entrant
from frenetic.plugins.bench.strategy import RunEnding
from frenetic.processes.interrupt import catch_interrupt
from frenetic.processes.object_host import report
from frenetic.processes.object_process import (
    MOST_WORKERS,
    LostProcessError,
    ObjectProcess,
    pack,
    ready,
)

_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed
RUNS_PRELOADED: Final = ("frenetic.plugins.bench.preloading",)
"""Modules that the server of runs imports."""
_REPORT: Final = 0.2  # s between two messages about the progress of a run

logger = logging.getLogger(__name__)


def run_all(
    runs: Iterable[EntrantRun],
    terms: RunTerms,
    *,
    workers: int,
    on_interrupt: Callable[[], None] | None = None,
) -> Generator[tuple[EntrantRun, Summary | RunState]]:
    """Run all, several at once; gives the messages of each, at last its state.

    After the first Ctrl-C no run begins and running ones are finished; the second ends them at
    once, as closing the generator does.

    Raises:
        FreneticError: driver or simulator cannot be copied into another process.
    """
    packed, workers = pack(_Runner(terms)), min(workers, MOST_WORKERS)
    waiting = deque(runs)
    at_work: dict[ObjectProcess, EntrantRun] = {}
    with catch_interrupt(on_interrupt) as interrupt:
        try:
            while at_work or (waiting and not interrupt.requested):
                while waiting and len(at_work) < workers and not interrupt.requested:
                    run = waiting.popleft()
                    worker = ObjectProcess(run.name, packed, RUNS_PRELOADED)
                    at_work[worker] = run
                    worker.start()
                    # Its process is in the folder of the parts.
                    absolute = replace(run, folder=run.folder.absolute())
                    worker.send("run", absolute, limit=math.inf, answer=RunEnding, report=Progress)
                for worker in ready(at_work, _POLL):
                    run = at_work[worker]
                    try:
                        messages = worker.receive()
                    except LostProcessError as error:
                        logger.debug("%s: %s\n%s", run.name, error, error.trouble.traceback)
                        messages = [RunState(run, None, str(error))]
                    for message in filter(None, messages):
                        if isinstance(message, Progress):
                            yield run, message.summary()
                            continue
                        worker.kill()
                        del at_work[worker]
                        is_end = isinstance(message, RunEnding)
                        yield run, RunState(run, message) if is_end else message
        finally:
            for worker in at_work:
                worker.kill()


class _Runner:
    """What a run's process holds."""

    def __init__(self, terms: RunTerms) -> None:
        self._terms = terms

    def start(self) -> None:
        """Leave the other cores to the other runs."""
        threadpool_limits(1)

    def run(self, run: EntrantRun) -> RunEnding:
        """Run an entrant and report its progress."""
        reported_at = 0.0  # [s], on the monotonic clock

        def say(progress: Summary) -> None:
            nonlocal reported_at
            if time.monotonic() - reported_at >= _REPORT:
                reported_at = time.monotonic()
                report(Progress.of_summary(progress))

        return run_entrant(run, self._terms, say)
