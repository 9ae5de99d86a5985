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
from frenetic.processes.forks import one_process
from frenetic.processes.interrupt import Interrupt
from frenetic.search.map_check import most_frequent
from frenetic.search.records import Candidate
from frenetic.search.strategy import SearchEnded, Strategy, has_own
from frenetic.spec import Budget

MAX_ATTEMPTS: Final = 2
"""Largest number of attempts at a candidate whose worker or simulator breaks (our choice)."""
MAX_ERRORS_IN_A_ROW: Final = 10
"""Number of consecutive drives without a verdict after which a campaign gives up (our choice)."""
MAX_INVALID_IN_A_ROW: Final = 5_000
"""Number of consecutive refused roads after which a campaign gives up (our choice)."""
MAX_INVALID_AT_FIRST: Final = 500
"""Number of refused roads after which a campaign without a drive gives up (our choice): a strategy
with 2 % valid roads would reach this limit in 4 of 100,000 campaigns."""
PROGRESS_INTERVAL: Final = 5.0
"""Time between two lines of progress in the log, in s (our choice)."""
_LONGEST_WAIT: Final = 1.0
"""Longest wait for an attempt until budget and interrupt are checked again, in s (our choice)."""


@dataclass(frozen=True)
class SearchPlan:
    """The parts and the limits of a search."""

    strategy: Strategy
    objective: Objective
    budget: Budget
    limit: int | None
    """Number of simulations at which this run stops before the budget is spent; None for no such
    limit."""
    max_in_flight: int | None
    """Largest number of outstanding candidates; None for as many as the workers hold."""


@dataclass(frozen=True)
class SearchState:
    """The progress of a search, which a search that continues takes over and changes."""

    summary: Summary
    """Counts, times and spent budget."""
    outstanding: dict[int, Candidate]
    """Candidates without a result, by id in the order of asking."""
    unreported: deque[tuple[int, Summary]]
    """Ids of stored tests that were not reported to the caller, each with the summary after it."""


class Dispatcher:
    """The loop of a campaign, from its stored results to the end of its budget.

    The search depends on the results alone, not on the number and speed of the workers: as many
    candidates are outstanding as `max_in_flight` says, and the strategy is told the result of the
    oldest first. If the strategy no longer wants the oldest, its result is DROPPED, even if it was
    driven already.

    Args:
        plan: parts and limits of the search.
        state: progress of the search, which changes with each result.
        workers: workers that test the candidates.
        store: the campaign, to which the results are added.
        log: log of the campaign.
        interrupt: the user's request to stop.
        second_drive: second drive of the first failure; None for no second drive.
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
        second_drive: SecondDrive | None,
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
        self._waiting_ids = set(self._outstanding)  # of candidates that wait for a worker
        self._running_ids: set[int] = set()  # of candidates that a worker has
        self._attempt_counts: Counter[int] = Counter()  # number of attempts by a candidate's id
        # Attempts that count, by candidate, which the strategy has not been told.
        self._final_attempts: dict[int, Attempt] = {}
        # Tests that the strategy was told, each with its error and the summary after it.
        self._unwritten: list[tuple[Test, Trouble | None, Summary]] = []
        self._unreported = state.unreported
        self._second_drive = second_drive
        self._summary.not_repeatable = "" if second_drive is None else second_drive.note
        self._strategy_needs_result = False  # before it proposes another road
        self._unjudged_count = 0  # drives in a row that could not be judged
        self._refusals: Counter[str] = Counter()  # reasons of refused roads in a row
        self._start = 0.0  # [s] on the clock of `perf_counter`
        self._next_progress = 0.0  # [s] on the monotonic clock, of the next line in the log

    def tests(self) -> Iterator[tuple[int, Summary]]:
        """Search until the budget is spent or a stop is requested.

        It yields the id and the summary of each result after the result was stored.

        Raises:
            CampaignError: the strategy or all workers broke, or no road or drive could be judged.
        """
        self._start = time.perf_counter() - self._summary.seconds
        self._log_progress()
        try:
            yield from self._rounds()
        except CampaignError:
            yield from self._store_and_report()  # results from before the error
            raise

    def _rounds(self) -> Iterator[tuple[int, Summary]]:
        """Ask, drive and tell, round after round, until the search is over."""
        while True:
            self._ask()
            self._hand_out()
            yield from self._store_and_report()
            if self._is_over():
                return
            if self._may_ask():
                continue  # candidates that are no longer wanted left room for others
            for attempt in self._workers.wait(_LONGEST_WAIT):
                self._take(attempt)
            self._tell_in_order()
            yield from self._store_and_report()
            self._log_progress()

    def _store_and_report(self) -> Iterator[tuple[int, Summary]]:
        """Store all new results in one transaction, and only then yield them."""
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
        """Whether the budget is spent, or this run's limit is reached."""
        if self._plan.limit is not None and self._summary.simulations >= self._plan.limit:
            return True
        return self._summary.budget_spent >= 1.0

    def _is_over(self) -> bool:
        """Return whether the search ends here."""
        second = self._second_candidate
        if second and (second.id in self._running_ids or not self._interrupt.requested):
            return False
        if self._is_spent:
            return True  # tests that still run are left, so the end does not depend on their speed
        if self._summary.ended and not self._outstanding:
            return True
        return self._interrupt.requested and not self._running_ids

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
                self._strategy_needs_result = True
                return
            self._store.add_candidate(candidate)
            self._outstanding[candidate.id] = candidate
            self._waiting_ids.add(candidate.id)

    def _may_ask(self) -> bool:
        """Return whether the strategy may be asked for another candidate now."""
        if self._is_spent or self._summary.ended or self._strategy_needs_result:
            return False
        simulations = self._summary.simulations + len(self._outstanding)
        most = self._plan.budget.simulations
        if self._summary.reported_share is None and most is not None and simulations >= most:
            return False
        if self._plan.max_in_flight is None:
            return len(self._waiting_ids) < self._workers.free
        # An interrupt or this run's limit changes nothing here: what the strategy is asked must not
        # depend on the moment at which a run stops.
        return len(self._outstanding) < self._plan.max_in_flight

    @property
    def _second_candidate(self) -> Candidate | None:
        """Failing road to drive a second time, even when the budget is spent; None without one."""
        return None if self._second_drive is None else self._second_drive.candidate

    def _submit(self, candidate: Candidate) -> None:
        """Hand a candidate to a free worker."""
        self._running_ids.add(candidate.id)
        self._attempt_counts[candidate.id] += 1
        self._workers.submit(candidate)

    def _hand_out(self) -> None:
        """Hand waiting candidates that the strategy still wants to free workers."""
        if self._interrupt.requested:
            return
        second = self._second_candidate
        if second and second.id not in self._running_ids and self._workers.free:
            self._submit(second)
        if self._is_spent:
            return
        while self._waiting_ids and self._workers.free:
            candidate = self._next_to_submit()
            self._waiting_ids.remove(candidate.id)
            if self._is_wanted(candidate):  # otherwise it is dropped when it is the oldest
                self._submit(candidate)

    def _next_to_submit(self) -> Candidate:
        """Return the waiting candidate to submit next.

        It is the oldest candidate that the strategy will surely want: a selective strategy is
        likely to lose interest in a candidate when an older candidate of the same parents fails.
        So a candidate with an older sibling that has not passed comes last. The order does not
        change the search, only the number of drives whose results are dropped.
        """
        oldest = self._outstanding[min(self._waiting_ids)]
        if not self._is_selective:
            return oldest
        doubtful_parents: set[tuple[int, ...]] = set()  # with a child that has not passed
        for candidate in self._outstanding.values():
            parents = candidate.origin.parents
            if candidate.id in self._waiting_ids and parents not in doubtful_parents:
                return candidate
            attempt = self._final_attempts.get(candidate.id)
            if parents and (attempt is None or attempt.result.outcome is Outcome.FAIL):
                doubtful_parents.add(parents)
        return oldest

    def _take(self, attempt: Attempt) -> None:
        """Keep a worker's attempt for the strategy, or let its candidate be tried again."""
        candidate_id = attempt.candidate_id
        self._running_ids.discard(candidate_id)
        second = self._second_candidate
        is_second = second is not None and second.id == candidate_id
        if candidate_id not in self._outstanding and not is_second:
            return  # dropped while it was driven
        attempt_count = self._attempt_counts[candidate_id]
        if attempt.failure is not None and attempt_count < MAX_ATTEMPTS:
            if not is_second:  # `_hand_out` submits a second drive until it was taken
                self._waiting_ids.add(candidate_id)
            self._log.retried(attempt, attempt_count)
        elif is_second:
            self._take_second_drive(attempt)
        else:
            self._final_attempts[candidate_id] = attempt

    def _take_second_drive(self, attempt: Attempt) -> None:
        """Note whether the second drive of the first failure is like the first drive."""
        assert self._second_drive is not None
        self._attempt_counts.pop(attempt.candidate_id)
        self._second_drive.compare(attempt)
        note = self._summary.not_repeatable = self._second_drive.note
        if note:
            self._log.write(LogEvent.NOTICE, note, level="warning")

    def _tell_in_order(self) -> None:
        """Tell results, oldest candidate first, until one is missing; ask after each."""
        while self._outstanding and not self._is_spent:
            oldest = next(iter(self._outstanding.values()))
            if not self._is_wanted(oldest):
                self._drop(oldest)
            elif oldest.id in self._final_attempts:
                self._tell(oldest, self._final_attempts.pop(oldest.id))
            else:
                return
            self._ask()

    def _drop(self, candidate: Candidate) -> None:
        """Store and tell that a candidate is dropped."""
        self._final_attempts.pop(candidate.id, None)
        self._waiting_ids.discard(candidate.id)
        # Attempts are not stored here: whether there were any depends on the speed of the workers.
        self._attempt_counts.pop(candidate.id, None)
        reason = "not wanted any more when its turn came"
        self._tell(candidate, Attempt.undriven(candidate.id, Outcome.DROPPED, reason))

    def _tell(self, candidate: Candidate, attempt: Attempt) -> None:
        """Count the result of a candidate, add it to the store, and tell it to the strategy."""
        attempt = attempt.pack(keep_exact=True)
        summary, result = self._summary, attempt.result
        summary.add(candidate, result)
        summary.drive_seconds += attempt.seconds
        summary.driver_seconds += attempt.driver_seconds
        elapsed = time.perf_counter() - self._start
        summary.update_budget_spent(self._plan.budget, elapsed, attempt.reported_share)
        test = Test.of(
            candidate,
            attempt,
            result_number=summary.result_count,
            budget_spent=summary.budget_spent,
            attempts=self._attempt_counts.pop(candidate.id, 0),
            elapsed=elapsed,
            finished_at=present_moment(),
            setting=self._store.setting,
        )
        if self._observing is not None:
            self._observing.observe(attempt)
        evaluation = evaluation_of(test, lambda: test.trajectory, self._plan.objective)
        if evaluation.objective is not None:
            test = replace(test, objective=self._plan.objective.value_of(evaluation))
        self._store.add_result(test, attempt.packed)
        if self._second_drive is not None:
            self._second_drive.note_test(test)
        del self._outstanding[candidate.id]
        summary.note_objective(self._plan.objective, evaluation)
        tell(self._strategy, evaluation, summary)
        self._strategy_needs_result = False
        self._log_notice()
        snapshot = summary.snapshot(time.perf_counter() - self._start)
        self._unwritten.append((test, attempt.trouble, snapshot))
        self._give_up_if_hopeless(test)

    def _is_wanted(self, candidate: Candidate) -> bool:
        """Return whether the strategy still wants the result of a candidate."""
        if not self._is_selective:
            return True
        try:
            with one_process():
                return self._strategy.is_wanted(candidate)
        except (Exception, SystemExit) as error:
            raise strategy_error(error) from error

    def _give_up_if_hopeless(self, test: Test) -> None:
        """Raise a `CampaignError` if too many roads in a row were not judged.

        A road of an earlier campaign does not count: it is driven to learn whether it still fails.
        """
        if test.candidate.source is not None:
            return
        if test.outcome in (Outcome.INVALID, Outcome.DROPPED):
            self._refusals[test.reason] += 1
        elif test.outcome is Outcome.ERROR or self._has_only_crashed(test):
            self._unjudged_count += 1
            self._refusals.clear()
        elif test.outcome.is_driven:
            self._unjudged_count = 0
            self._refusals.clear()
        if self._unjudged_count >= MAX_ERRORS_IN_A_ROW and self._summary.reported_share is None:
            count, end = self._unjudged_count, f"so the campaign gives up: {test.reason}"
            if is_drivers(test.result.fault):
                raise BrokenDriverError(
                    f"the driver broke on each of the first {count} roads, {end}"
                )
            raise CampaignError(f"none of the last {count} drives could be judged, {end}")
        refused = self._refusals.total()
        is_first = not self._summary.simulations
        if refused >= (MAX_INVALID_AT_FIRST if is_first else MAX_INVALID_IN_A_ROW):
            raise StrategyError(
                f"the {'first' if is_first else 'last'} {refused} roads were refused, so the"
                f" campaign gives up: {most_frequent(self._refusals)}"
            )

    def _has_only_crashed(self, test: Test) -> bool:
        """Return whether the driver broke in this drive and in each drive before it."""
        has_crashed = is_drivers(test.result.fault) and not self._strategy.expects_failures
        return has_crashed and self._summary.simulations == self._unjudged_count + 1

    def _log_notice(self) -> None:
        """Log the strategy's notice about its search, once."""
        had_notice = bool(self._summary.notice)
        self._summary.notice = notice_of(self._strategy)
        if self._summary.notice and not had_notice:
            self._log.write(LogEvent.NOTICE, self._summary.notice, level="warning")

    def _log_progress(self) -> None:
        """Log the progress and store the strategy's facts, every `PROGRESS_INTERVAL` s."""
        now = time.monotonic()
        if now >= self._next_progress:
            self._next_progress = now + PROGRESS_INTERVAL
            self._store.require_there()
            facts = facts_of(self._strategy, self._summary)
            if facts != self._summary.facts:
                self._summary.facts = facts
                self._store.keep(**{SEARCH_FACTS: facts})
            summary = self._summary.snapshot(time.perf_counter() - self._start)
            self._log.progress(summary)
