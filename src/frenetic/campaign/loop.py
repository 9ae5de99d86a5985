"""The loop of a campaign: ask the strategy, test its candidate, store and tell the result."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from frenetic._support.words import present_moment
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.guarded_strategy import (
    SEARCH_FACTS,
    ObservingStrategy,
    ask,
    facts_of,
    notice_of,
    strategy_error,
    tell,
)
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.objective import Objective
from frenetic.campaign.record import Attempt, Test
from frenetic.campaign.second_drive import SecondDrive
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Summary
from frenetic.campaign.workers.workers import Workers
from frenetic.errors import BrokenDriverError, CampaignError, StrategyError, Trouble
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import is_drivers
from frenetic.processes.children import one_process
from frenetic.processes.interrupt import Interrupt
from frenetic.search.random_search import most_frequent
from frenetic.search.records import Candidate
from frenetic.search.strategy import SearchEnded, Strategy, has_own
from frenetic.spec import Budget

MAX_ATTEMPTS: Final = 2
"""Most attempts at a candidate whose worker or simulator breaks (ours)."""
MAX_ERRORS_IN_A_ROW: Final = 10
"""Consecutive drives without a verdict after which a campaign gives up (ours)."""
MAX_INVALID_IN_A_ROW: Final = 5_000
"""Consecutive refused roads after which a campaign gives up (ours)."""
MAX_INVALID_AT_FIRST: Final = 500
"""Refused roads after which a campaign without a drive gives up (ours): a strategy with 2 % valid
roads would come to this limit in 4 of 100,000 campaigns."""
PROGRESS_INTERVAL: Final = 5.0
"""Time between two lines of progress in the log, in s (ours)."""

_HEARTBEAT: Final = 1.0  # [s] between two looks at the clock while nothing comes back, ours


@dataclass(frozen=True)
class SearchPlan:
    """What a search is to do."""

    strategy: Strategy
    objective: Objective
    budget: Budget
    limit: int | None
    """Number of simulations at which this run stops within the budget; None for no such limit."""
    max_in_flight: int | None
    """Candidates outstanding at once; None for as many as the workers have room for."""


@dataclass(frozen=True)
class SearchState:
    """How far a search has come; a search that goes on takes it over."""

    summary: Summary
    outstanding: dict[int, Candidate]
    """Candidates without a result, by id in the order of asking."""
    unreported: deque[tuple[int, Summary]]
    """Ids of stored tests that the caller has not seen yet, each with the summary after it."""


class Dispatcher:
    """The loop of a campaign, from its stored results to the end of its budget.

    Asking and telling follow from the results alone, not from the number and speed of workers: as
    many candidates are outstanding as `max_in_flight` says, and the strategy learns the oldest
    first, as DROPPED if it no longer wants it, even if it was driven already.

    Args:
        plan: what to search.
        state: how far the search has come, which changes with each result.
        workers: test the candidates.
        store: of the campaign.
        log: of the campaign.
        interrupt: request to stop.
        second: drive of the first failure; None for no second drive.
    """

    def __init__(
        self,
        plan: SearchPlan,
        state: SearchState,
        *,
        workers: Workers,
        store: CampaignStore,
        log: CampaignLog,
        interrupt: Interrupt,
        second: SecondDrive | None,
    ) -> None:
        strategy = plan.strategy
        self._plan = plan
        self._strategy = strategy
        self._is_selective = has_own(strategy, "is_wanted")
        self._observing = strategy if isinstance(strategy, ObservingStrategy) else None
        self._workers = workers
        self._store = store
        self._log = log
        self._interrupt = interrupt
        self._summary = state.summary
        self._outstanding = state.outstanding
        self._waiting = set(self._outstanding)  # ids of candidates that wait for a worker
        self._running: set[int] = set()  # ids
        self._tries: Counter[int] = Counter()
        self._ended: dict[int, Attempt] = {}  # tested or lost for good, unknown to the strategy
        self._unwritten: list[tuple[Test, Trouble | None, Summary]] = []  # known to the strategy
        self._unreported = state.unreported
        self._second = second
        self._summary.not_repeatable = "" if second is None else second.note
        self._waits_for_result = False  # the strategy, before it proposes another road
        self._broken = 0  # drives in a row that could not be judged
        self._refusals: Counter[str] = Counter()  # reasons of refused roads in a row
        self._start = 0.0
        self._next_line = 0.0  # of progress

    def tests(self) -> Iterator[tuple[int, Summary]]:
        """Test until the budget is spent or a stop requested.

        Yields the candidate's id and the summary after every result, which is stored by then.

        Raises:
            CampaignError: the strategy or all workers broke, or no road or drive could be judged.
        """
        self._start = time.perf_counter() - self._summary.seconds
        self._log_progress()
        try:
            yield from self._rounds()
        except CampaignError:
            yield from self._report()  # earlier results
            raise

    def _rounds(self) -> Iterator[tuple[int, Summary]]:
        while True:
            self._ask()
            self._hand_out()
            yield from self._report()  # dropped candidates
            if self._is_over():
                return
            if self._may_ask():
                continue  # waiting candidates were dropped
            for attempt in self._workers.wait(_HEARTBEAT):
                self._take(attempt)
            self._tell_in_order()
            yield from self._report()
            self._log_progress()

    def _report(self) -> Iterator[tuple[int, Summary]]:
        """Write all new results in one transaction, and only then report them."""
        if self._unwritten:
            self._store.write()
            written, self._unwritten = self._unwritten, []
            for test, trouble, summary in written:
                self._log.result(test, trouble)
                self._unreported.append((test.id, summary))
        while self._unreported:
            yield self._unreported.popleft()

    @property
    def _is_spent(self) -> bool:
        """Whether the budget is spent, or the limit within it reached."""
        if self._plan.limit is not None and self._summary.simulations >= self._plan.limit:
            return True
        return self._summary.budget_spent >= 1.0

    def _is_over(self) -> bool:
        if self._again and (self._again.id in self._running or not self._interrupt.requested):
            return False
        if self._is_spent:
            return True  # running tests come too late, however fast the workers are
        if self._summary.ended and not self._outstanding:
            return True
        return self._interrupt.requested and not self._running

    def _ask(self) -> None:
        """Ask for candidates up to the allowed number."""
        while self._may_ask():
            try:
                candidate = ask(self._strategy, self._summary)
            except SearchEnded as end:
                self._summary.ended = str(end) or "the strategy has nothing left to propose"
                return
            if candidate is None:
                if not self._outstanding:
                    raise StrategyError(
                        "the strategy wants to be told a result before it proposes a road, and none"
                        " is outstanding"
                    )
                self._waits_for_result = True
                return
            self._store.add_candidate(candidate)
            self._outstanding[candidate.id] = candidate
            self._waiting.add(candidate.id)

    def _may_ask(self) -> bool:
        if self._is_spent or self._summary.ended or self._waits_for_result:
            return False
        simulations = self._summary.simulations + len(self._outstanding)
        most = self._plan.budget.simulations
        if self._summary.reported_share is None and most is not None and simulations >= most:
            return False
        if self._plan.max_in_flight is None:
            return len(self._waiting) < self._workers.free
        # Also after an interrupt or within a limit: asking must not depend on its moment.
        return len(self._outstanding) < self._plan.max_in_flight

    @property
    def _again(self) -> Candidate | None:
        """Failing road that is to be driven a second time, also when the budget is spent."""
        return None if self._second is None else self._second.candidate

    def _submit(self, candidate: Candidate) -> None:
        self._running.add(candidate.id)
        self._tries[candidate.id] += 1
        self._workers.submit(candidate)

    def _hand_out(self) -> None:
        """Submit waiting candidates to free workers, and drop unwanted candidates."""
        if self._interrupt.requested:
            return
        if self._again and self._again.id not in self._running and self._workers.free:
            self._submit(self._again)
        if self._is_spent:
            return
        while self._waiting and self._workers.free:
            candidate = self._next()
            self._waiting.remove(candidate.id)
            if self._is_wanted(candidate):  # else it is dropped when its turn comes
                self._submit(candidate)

    def _next(self) -> Candidate:
        """Return the waiting candidate to submit next.

        This is the oldest candidate that the strategy will surely want: a selective strategy is
        likely to lose interest in a candidate when an older candidate of the same parents fails.
        The order does not change the search, only the number of drives in vain, so siblings come
        last.
        """
        oldest = self._outstanding[min(self._waiting)]
        if not self._is_selective:
            return oldest
        doubtful: set[tuple[int, ...]] = set()  # parents of a child that has not passed
        for candidate in self._outstanding.values():
            parents = candidate.origin.parents
            if candidate.id in self._waiting and parents not in doubtful:
                return candidate
            attempt = self._ended.get(candidate.id)
            if parents and (attempt is None or attempt.result.outcome is Outcome.FAIL):
                doubtful.add(parents)
        return oldest

    def _take(self, attempt: Attempt) -> None:
        """Record an attempt; repeat a lost attempt unless it was the last."""
        candidate_id = attempt.candidate_id
        self._running.discard(candidate_id)
        is_second = self._again is not None and self._again.id == candidate_id
        if candidate_id not in self._outstanding and not is_second:
            return  # dropped meanwhile
        tries = self._tries[candidate_id]
        if attempt.failure is not None and tries < MAX_ATTEMPTS:
            if not is_second:
                self._waiting.add(candidate_id)
            self._log.retried(attempt, tries)
        elif is_second:
            self._take_second(attempt)
        else:
            self._ended[candidate_id] = attempt

    def _take_second(self, attempt: Attempt) -> None:
        """Note whether the second drive of the first failure is like the first drive."""
        assert self._second is not None
        self._tries.pop(attempt.candidate_id)
        self._second.take(attempt)
        self._summary.not_repeatable = self._second.note
        if self._second.note:
            self._log.write(LogEvent.NOTICE, self._second.note, level="warning")

    def _tell_in_order(self) -> None:
        """Tell results as long as the oldest candidate's is known, and ask in between."""
        while self._outstanding and not self._is_spent:
            oldest = next(iter(self._outstanding.values()))
            if not self._is_wanted(oldest):
                self._drop(oldest)
            elif oldest.id in self._ended:
                self._tell(oldest, self._ended.pop(oldest.id))
            else:
                return
            self._ask()

    def _drop(self, candidate: Candidate) -> None:
        """Store and tell that a candidate is dropped."""
        self._ended.pop(candidate.id, None)
        self._waiting.discard(candidate.id)
        # Whether it was tried meanwhile depends on the workers.
        self._tries.pop(candidate.id, None)
        reason = "not wanted any more when its turn came"
        self._tell(candidate, Attempt.undriven(candidate.id, Outcome.DROPPED, reason))

    def _tell(self, candidate: Candidate, attempt: Attempt) -> None:
        attempt = attempt.pack(keep_exact=True)
        summary, result = self._summary, attempt.result
        summary.add(candidate, result.outcome, result.moobd)
        summary.drive_seconds += attempt.seconds
        summary.driver_seconds += attempt.driver_seconds
        elapsed = time.perf_counter() - self._start
        summary.update_budget_spent(self._plan.budget, elapsed, attempt.reported_share)
        test = Test.of(
            candidate,
            attempt,
            result_number=summary.result_count,
            budget_spent=summary.budget_spent,
            attempts=self._tries.pop(candidate.id, 0),
            elapsed=elapsed,
            finished_at=present_moment(),
            setting=self._store.setting,
        )
        if self._observing is not None:
            self._observing.observe(attempt)
        evaluation = evaluation_of(test, attempt.stored_trajectory, self._plan.objective)
        if evaluation.objective is not None:
            test = replace(test, objective=self._plan.objective.value_of(evaluation))
        self._store.add_result(test, attempt.packed)
        if self._second is not None:
            self._second.see(test)
        del self._outstanding[candidate.id]
        summary.note_objective(self._plan.objective, evaluation)
        tell(self._strategy, evaluation, summary)
        self._waits_for_result = False
        self._log_notice()
        now = summary.snapshot(time.perf_counter() - self._start)
        self._unwritten.append((test, attempt.trouble, now))
        self._give_up_if_hopeless(test)

    def _is_wanted(self, candidate: Candidate) -> bool:
        if not self._is_selective:
            return True
        try:
            with one_process():
                return self._strategy.is_wanted(candidate)
        except (Exception, SystemExit) as error:
            raise strategy_error(error) from error

    def _give_up_if_hopeless(self, test: Test) -> None:
        """Raise a `CampaignError` if too many roads in a row were not judged.

        A road of an earlier campaign does not count: that it breaks or is refused is an answer.
        """
        if test.candidate.source is not None:
            return
        if test.outcome in (Outcome.INVALID, Outcome.DROPPED):
            self._refusals[test.reason] += 1
        elif test.outcome is Outcome.ERROR or self._has_only_crashed(test):
            self._broken += 1
            self._refusals.clear()
        elif test.outcome.is_driven:
            self._broken = 0
            self._refusals.clear()
        if self._broken >= MAX_ERRORS_IN_A_ROW and self._summary.reported_share is None:
            so = f"so the campaign gives up: {test.reason}"
            if is_drivers(test.result.fault):
                first = f"the driver broke on each of the first {self._broken} roads"
                raise BrokenDriverError(f"{first}, {so}")
            raise CampaignError(f"none of the last {self._broken} drives could be judged, {so}")
        refused = self._refusals.total()
        is_first = not self._summary.simulations
        if refused >= (MAX_INVALID_AT_FIRST if is_first else MAX_INVALID_IN_A_ROW):
            raise StrategyError(
                f"the {'first' if is_first else 'last'} {refused} roads were refused, so the"
                f" campaign gives up: {most_frequent(self._refusals)}"
            )

    def _has_only_crashed(self, test: Test) -> bool:
        """Return whether each drive so far ended by a fault of its driver."""
        has_crashed = is_drivers(test.result.fault) and not self._strategy.expects_failures
        return has_crashed and self._summary.simulations == self._broken + 1

    def _log_notice(self) -> None:
        """Log the strategy's notice about its search, once."""
        before, self._summary.notice = self._summary.notice, notice_of(self._strategy)
        if self._summary.notice and not before:
            self._log.write(LogEvent.NOTICE, self._summary.notice, level="warning")

    def _log_progress(self) -> None:
        now = time.monotonic()
        if now >= self._next_line:
            self._next_line = now + PROGRESS_INTERVAL
            self._store.require_there()
            facts = facts_of(self._strategy, self._summary)
            if facts != self._summary.facts:
                self._summary.facts = facts
                self._store.keep(**{SEARCH_FACTS: facts})
            summary = self._summary.snapshot(time.perf_counter() - self._start)
            self._log.progress(summary)
