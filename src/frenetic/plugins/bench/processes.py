"""Runs of a bench at the same time, each in its own process."""

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

PRELOADED_MODULES: Final = ("frenetic.plugins.bench.preloading",)
"""Modules that the server from which runs are forked imports."""
_POLL_INTERVAL: Final = 0.2  # [s] between two checks whether Ctrl-C was pressed
_REPORT_INTERVAL: Final = 0.2  # [s] between two messages about the progress of a run

logger = logging.getLogger(__name__)


def run_all(
    runs: Iterable[EntrantRun],
    terms: RunTerms,
    *,
    workers: int,
    on_interrupt: Callable[[], None] | None = None,
) -> Generator[tuple[EntrantRun, Summary | RunState]]:
    """Run all runs, several at once; yield each with summaries of its progress, then its state.

    After the first Ctrl-C no run begins, and running ones are finished. The second Ctrl-C ends
    running ones at once, and so does closing this iterator.

    Args:
        runs: the runs, in the order in which they begin.
        terms: terms of the bench.
        workers: number of runs at once.
        on_interrupt: called at the first Ctrl-C.

    Raises:
        FreneticError: driver or simulator cannot be copied into another process.
    """
    packed_runner, workers = pack(_Runner(terms)), min(workers, MOST_WORKERS)
    waiting = deque(runs)
    running: dict[ObjectProcess, EntrantRun] = {}
    with catch_interrupt(on_interrupt) as interrupt:
        try:
            while running or (waiting and not interrupt.requested):
                while waiting and len(running) < workers and not interrupt.requested:
                    run = waiting.popleft()
                    process = ObjectProcess(run.name, packed_runner, PRELOADED_MODULES)
                    running[process] = run
                    process.start()
                    # The process works in the folder of the parts, so the run's is absolute.
                    absolute = replace(run, folder=run.folder.absolute())
                    process.send("run", absolute, limit=math.inf, answer=RunEnding, report=Progress)
                for process in ready(running, _POLL_INTERVAL):
                    run = running[process]
                    for message in _received(process, run):
                        if isinstance(message, RunState):
                            process.kill()
                            del running[process]
                        yield run, message
        finally:
            for process in running:
                process.kill()


def _received(process: ObjectProcess, run: EntrantRun) -> list[Summary | RunState]:
    """Return what a run's process has sent: summaries, and the state of a run that has ended."""
    try:
        messages = process.receive()
    except LostProcessError as error:
        logger.debug("%s: %s\n%s", run.name, error, error.trouble.traceback)
        return [RunState(run, ending=None, trouble=str(error))]
    return [
        message.summary() if isinstance(message, Progress) else RunState(run, ending=message)
        for message in messages
        if message is not None  # None is the answer to `_Runner.start`
    ]


class _Runner:
    """Object in a run's process, whose methods the bench calls."""

    def __init__(self, terms: RunTerms) -> None:
        self._terms = terms

    def start(self) -> None:
        """Keep this run to one core, since other runs need the others."""
        threadpool_limits(1)

    def run(self, run: EntrantRun) -> RunEnding:
        """Run an entrant and report its progress."""
        reported_at = 0.0  # [s] on the monotonic clock

        def report_progress(summary: Summary) -> None:
            nonlocal reported_at
            if time.monotonic() - reported_at >= _REPORT_INTERVAL:
                reported_at = time.monotonic()
                report(Progress.of_summary(summary))

        return run_entrant(run, self._terms, report_progress)
