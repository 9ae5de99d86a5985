"""Runs of a bench side by side, each in its own process."""

from __future__ import annotations

import os
import pickle
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final

from threadpoolctl import threadpool_limits

from frenetic._support.child_processes import process_context, stand_alone
from frenetic._support.interrupt import catch_interrupt
from frenetic.bench.runs import Run, RunState, Terms, run_entrant
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError, FreneticError, describe_error
from frenetic.registry import load_user_file, user_files

_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed
RUNS_PRELOADED: Final = ("frenetic.bench.preloading",)
"""Modules that the server of runs imports."""
_REPORT: Final = 0.2  # s between two messages about the progress of a run


def run_all(
    runs: Iterable[Run],
    terms: Terms,
    *,
    workers: int,
    on_interrupt: Callable[[], None] | None = None,
) -> Generator[tuple[Run, Summary | RunState]]:
    """Runs all, several at once; gives the messages of each, at last its state.

    After the first Ctrl-C no run begins and running ones are finished; the second ends them at
    once, as closing the generator does.

    Raises:
        FreneticError: driver or simulator cannot be copied into another process.
    """
    try:
        packed = pickle.dumps(terms)
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be copied to another process"
            f" ({describe_error(error)}): define it in a module of its own"
        ) from error
    context = process_context(RUNS_PRELOADED)
    waiting = deque(runs)
    at_work: dict[Any, tuple[Run, BaseProcess]] = {}  # by the connection with each
    with catch_interrupt(on_interrupt) as interrupt:
        try:
            while at_work or (waiting and not interrupt.requested):
                while waiting and len(at_work) < workers and not interrupt.requested:
                    run = waiting.popleft()
                    ours, theirs = context.Pipe(duplex=False)
                    process: BaseProcess = context.Process(
                        target=_serve,
                        args=(theirs, user_files(), packed, run),
                        name=str(run.folder),
                    )
                    process.start()
                    theirs.close()
                    at_work[ours] = (run, process)
                for heard in wait(list(at_work), _POLL):
                    run, process = at_work[heard]
                    message = _message(heard, run, process)  # type: ignore[arg-type]
                    if isinstance(message, RunState):
                        process.join()
                        heard.close()  # type: ignore[union-attr]
                        del at_work[heard]
                    yield run, message
        finally:
            for connection, (_, left) in at_work.items():
                left.kill()
                left.join()
                connection.close()


def _message(connection: Connection, run: Run, process: BaseProcess) -> Summary | RunState:
    """The next message of a run."""
    try:
        message: Summary | RunState = connection.recv()
    except Exception:  # its end without a word
        process.join()
        return RunState(run, None, f"its process ended with exit code {process.exitcode}")
    return message


def _serve(connection: Connection, files: Sequence[str], packed_terms: bytes, run: Run) -> None:
    """The work of a run's process."""
    stand_alone()
    said = 0.0

    def say(progress: Summary) -> None:
        nonlocal said
        now = time.monotonic()
        if now - said >= _REPORT:
            said = now
            with suppress(OSError):  # nobody listens, but the results still count
                connection.send(progress)

    try:
        for file in files:
            load_user_file(file)
        # Made by our own parent for us alone, so it may be unpickled.
        terms: Terms = pickle.loads(packed_terms)  # noqa: S301
        with threadpool_limits(1):  # the cores are busy with other runs
            ending = run_entrant(
                run.entrant, terms, seed=run.seed, folder=run.folder, on_progress=say
            )
        end = RunState(run, ending)
    except FreneticError as error:
        end = RunState(run, None, str(error))
    except Exception as error:
        traceback.print_exc()  # a mistake of ours, or of a simulator
        end = RunState(run, None, describe_error(error))
    with suppress(OSError):
        connection.send(end)
    connection.close()
    os._exit(0)  # without waiting for a driver's threads
