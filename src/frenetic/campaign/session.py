"""A search in one process: from the start of its workers to the last line of its log."""

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
from frenetic.simulators.embedded import compile_kernels

_START_POLL: Final = 0.2  # [s] between two looks whether Ctrl-C was pressed, ours


@dataclass
class SearchSession:
    """A search in one process, which ends with the budget, an interrupt or an error."""

    plan: SearchPlan
    state: SearchState
    """Progress, which the session takes on."""
    store: CampaignStore
    log: CampaignLog
    make_workers: Callable[[], Workers]
    make_second_drive: Callable[[], SecondDrive | None]
    """Maker of the second drive of the first failure; None for no second drive."""
    on_event: EventListener | None
    is_consistent: bool = False
    """Whether the strategy knows exactly the results of the state, so that a run can go on."""
    interrupt: Interrupt | None = None
    """Request to stop; None before the start and after the end."""

    def run(self) -> Summary:
        """Search until the budget is spent or the session is interrupted; store the end.

        Raises:
            CampaignError: as `Dispatcher.tests` does, or the workers do not start.
        """
        self._start = time.perf_counter() - self.state.summary.seconds
        try:
            is_interrupted = self._search()
        except CampaignGoneError:  # the log is gone, too
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

    def _say(self, kind: EventKind, summary: Summary, test_id: int | None = None) -> None:
        if self.on_event is not None:
            read_test = None if test_id is None else partial(self.store.test, test_id)
            self.on_event(Event(kind, summary, read_test))

    def _say_interrupted(self) -> None:
        self._say("interrupted", self.state.summary.snapshot(self._seconds))

    def _search(self) -> bool:
        """Start the workers and test; return whether a request to stop ended the search early."""
        summary = self.state.summary
        with catch_interrupt(self._say_interrupted) as interrupt:
            self.interrupt = interrupt
            with self.make_workers() as workers:
                compile_kernels()  # which the strategy needs here, while they start
                while not workers.free and not interrupt.requested:
                    workers.wait(_START_POLL)
                self._say("started", summary.snapshot(summary.seconds))
                self._start = time.perf_counter() - summary.seconds
                dispatcher = Dispatcher(
                    self.plan,
                    self.state,
                    workers=workers,
                    store=self.store,
                    log=self.log,
                    interrupt=interrupt,
                    second=self.make_second_drive(),
                )
                for test_id, now in dispatcher.tests():
                    try:
                        self._say("result", now, test_id)
                    except Exception:
                        self.is_consistent = True
                        raise
            limit = self.plan.limit
            is_stopped = interrupt.requested or (limit is not None and summary.simulations >= limit)
            is_whole = summary.budget_spent >= 1.0 or (summary.ended and not self.state.outstanding)
            self.is_consistent = True
        return is_stopped and not is_whole

    def _is_interruption(self, error: BaseException) -> bool:
        """Return whether Ctrl-C caused an error."""
        if isinstance(error, SystemError):  # of compiled code, which returned at that moment
            error = error.__cause__ or error
        if isinstance(error, KeyboardInterrupt):
            return True
        # A compiler that the second Ctrl-C interrupts may fail in its own way.
        insisted = self.interrupt is not None and self.interrupt.insisted
        return insisted and not isinstance(error, FreneticError)

    def _log_error(self, error: BaseException) -> None:
        self.log.progress(self.state.summary.snapshot(self._seconds))
        trace = traceback_of(error)
        cause: dict[str, Any] = {"traceback": trace} if trace else {}
        self.log.write(LogEvent.GAVE_UP, reason_of(error), level="error", **cause)

    def _finish(self, is_interrupted: bool) -> Summary:
        """Store and log the end of the session; return its summary."""
        strategy, summary = self.plan.strategy, self.state.summary
        summary.notice = notice_of(strategy)
        summary.facts = facts_of(strategy, summary)
        # What is stored counts, also when an interrupt came between storing and counting.
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
        last = LogEvent.INTERRUPTED if is_interrupted else LogEvent.FINISHED
        fields: dict[str, Any] = end.as_json()
        self.log.write(last, end.as_text(), **fields)
        return end


@contextmanager
def saying_what_is_stored(store: CampaignStore, summary: Summary) -> Iterator[None]:
    """Add to an error how far the campaign came."""
    try:
        yield
    except CampaignGoneError:  # it says what is stored
        raise
    except CampaignError as error:
        with suppress(CampaignError):  # the disk is full, say
            store.write()
        stored = counted(store.stored(), "result")
        spent = f"{summary.budget_spent:.0%} of the budget spent"
        # A strategy's fault stays one: a bench goes on with the others.
        raise type(error)(f"{error}; {stored} stored, {spent}") from error
