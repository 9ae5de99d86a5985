"""A session: one search in this process, from the start of its workers to its end in the log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Final

from frenetic._support.words import counted
from frenetic.campaign.guarded_strategy import SEARCH_FACTS, facts_of, notice_of
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.loop import Dispatcher, SearchPlan, SearchState
from frenetic.campaign.second_drive import SecondDrive
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, EventKind, EventListener, Summary
from frenetic.campaign.workers import Workers
from frenetic.errors import CampaignError, CampaignGoneError, FreneticError, reason_of, traceback_of
from frenetic.processes.interrupt import Interrupt, catch_interrupt

_START_POLL_INTERVAL: Final = 0.2
"""Time between two looks whether Ctrl-C was pressed while the workers start, in s (our choice)."""


@dataclass
class SearchSession:
    """A search in this process, which ends with the budget, an interrupt or an error."""

    plan: SearchPlan
    """Parts and limits of the search."""
    state: SearchState
    """Progress of the search, which the session takes over and changes."""
    store: CampaignStore
    log: CampaignLog
    make_workers: Callable[[], Workers]
    """Function that returns the workers, which are not started yet."""
    make_second_drive: Callable[[], SecondDrive | None]
    """Function that returns the second drive of the first failure; None for no second drive."""
    compile_kernels: Callable[[], None]
    """Function that compiles the kernels, if enough drives are ahead."""
    on_event: EventListener | None
    """The caller's function for events; None to send none."""
    is_consistent: bool = False
    """Whether the strategy knows exactly the results of the state, so that a run can continue."""
    interrupt: Interrupt | None = None
    """The user's request to stop; None before the start and after the end."""

    def run(self) -> Summary:
        """Search until the budget is spent or the session is interrupted; store the end.

        Raises:
            CampaignError: the strategy or all workers broke, no road or drive could be judged, or
                the workers do not start.
        """
        self._start = time.perf_counter() - self.state.summary.seconds
        try:
            is_interrupted = self._search()
        except CampaignGoneError:  # the log is gone with the folder
            raise
        except (KeyboardInterrupt, Exception) as error:
            is_interrupted = self._is_interruption(error)
            if not is_interrupted:
                self._log_error(error)
                raise
        finally:
            self.interrupt = None
            self.state.summary.seconds = self._seconds
        return self._finish(is_interrupted)

    @property
    def _seconds(self) -> float:
        """Time of the search so far, in s."""
        return time.perf_counter() - self._start

    def _send(self, kind: EventKind, summary: Summary, test_id: int | None = None) -> None:
        """Send an event to the caller; `test_id` is the id of a result."""
        if self.on_event is not None:
            read_test = None if test_id is None else partial(self.store.test, test_id)
            self.on_event(Event(kind, summary, read_test))

    def _send_interrupted(self) -> None:
        self._send("interrupted", self.state.summary.snapshot(self._seconds))

    def _search(self) -> bool:
        """Start the workers and search; return whether a stop or a limit ended the search early."""
        summary = self.state.summary
        with catch_interrupt(self._send_interrupted) as interrupt:
            self.interrupt = interrupt
            with self.make_workers() as workers:
                self.compile_kernels()  # the strategy needs them here; meanwhile the workers start
                while not workers.free and not interrupt.requested:
                    workers.wait(_START_POLL_INTERVAL)
                self._send("started", summary.snapshot(summary.seconds))
                self._start = time.perf_counter() - summary.seconds
                dispatcher = Dispatcher(
                    self.plan,
                    self.state,
                    workers=workers,
                    store=self.store,
                    log=self.log,
                    interrupt=interrupt,
                    second_drive=self.make_second_drive(),
                )
                for test_id, snapshot in dispatcher.tests():
                    try:
                        self._send("result", snapshot, test_id)
                    except Exception:  # of the caller's function: the search itself is sound
                        self.is_consistent = True
                        raise
            limit = self.plan.limit
            is_stopped = interrupt.requested or (limit is not None and summary.simulations >= limit)
            has_ended = summary.ended and not self.state.outstanding
            is_complete = summary.budget_spent >= 1.0 or has_ended
            self.is_consistent = True
        return is_stopped and not is_complete

    def _is_interruption(self, error: BaseException) -> bool:
        """Return whether Ctrl-C caused an error."""
        if isinstance(error, SystemError):  # compiled code raises it when Ctrl-C came meanwhile
            error = error.__cause__ or error
        if isinstance(error, KeyboardInterrupt):
            return True
        # A compiler that the second Ctrl-C interrupts may raise an error of its own.
        insisted = self.interrupt is not None and self.interrupt.insisted
        return insisted and not isinstance(error, FreneticError)

    def _log_error(self, error: BaseException) -> None:
        """Log the progress, and the error with which the campaign gives up."""
        self.log.progress(self.state.summary.snapshot(self._seconds))
        trace = traceback_of(error)
        cause: dict[str, Any] = {"traceback": trace} if trace else {}
        self.log.write(LogEvent.GAVE_UP, reason_of(error), level="error", **cause)

    def _finish(self, is_interrupted: bool) -> Summary:
        """Store and log the end of the session; return its summary."""
        strategy, summary = self.plan.strategy, self.state.summary
        summary.notice = notice_of(strategy)
        summary.facts = facts_of(strategy, summary)
        # The stored results count, even if an interrupt came between storing and counting.
        ended = "" if is_interrupted else summary.ended
        counts = self.store.counts().numbers()
        end = replace(summary, interrupted=is_interrupted, ended=ended, **counts)
        self.store.finish(
            seconds=round(end.seconds, 3),
            interrupted=is_interrupted,
            ended=end.ended,
            notice=end.notice,
            strategy_seconds=round(end.strategy_seconds, 4),
            budget=asdict(self.plan.budget),
            **{SEARCH_FACTS: end.facts},
        )
        self.log.progress(end)
        end_event = LogEvent.INTERRUPTED if is_interrupted else LogEvent.FINISHED
        fields: dict[str, Any] = end.as_json()
        self.log.write(end_event, end.as_text(), **fields)
        return end


@contextmanager
def progress_in_errors(store: CampaignStore, summary: Summary) -> Iterator[None]:
    """Add the number of stored results and the spent budget to the message of an error."""
    try:
        yield
    except CampaignGoneError:  # its message says what is stored
        raise
    except CampaignError as error:
        with suppress(CampaignError):  # for example because the disk is full
            store.write()
        stored = counted(store.stored(), "result")
        spent = f"{summary.budget_spent:.0%} of the budget spent"
        # The class stays: after a `StrategyError` a bench continues with its other strategies.
        raise type(error)(f"{error}; {stored} stored, {spent}") from error
