"""One search from the first road to the last: propose, fit, validate, drive, judge, store, tell."""

from __future__ import annotations

import json
import logging
import os
import platform
import shlex
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

from msgspec import structs, to_builtins

from frenetic._support.bounds import require_count
from frenetic._support.files import require_list
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.notebook import Shown
from frenetic._support.words import counted, number_word
from frenetic.campaign.configuration import SPEC, EarlierCampaign, earlier_of
from frenetic.campaign.guarded_strategy import (
    FACTS,
    ObservingStrategy,
    facts_of,
    notice_of,
    replay,
    require_fresh,
    require_valid_roads,
    start,
)
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.loop import Dispatcher
from frenetic.campaign.objective import MOOBD, Objective, objectives
from frenetic.campaign.reader import SIGNATURE, SOURCES, STARTED_IN
from frenetic.campaign.record import Test
from frenetic.campaign.second_drive import SecondDrive
from frenetic.campaign.status import has_judged, next_campaign, stored_budget
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, EventKind, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.warm_start import (
    earlier_evaluations,
    numbered,
    take_earlier,
    take_roads,
)
from frenetic.campaign.workers import (
    InProcessWorker,
    LocalWorkers,
    Workers,
    available_cores,
    cluster_workers,
    is_isolable,
)
from frenetic.conditions.domain import Domain
from frenetic.drivers.driver import Driver
from frenetic.errors import CampaignError, CampaignGoneError, FreneticError, reason_of, traceback_of
from frenetic.parts.registry import Made, options_of
from frenetic.parts.trust import is_here, named_code, unsigned_text
from frenetic.parts.versions import package_versions, version_of
from frenetic.processes.interrupt import Interrupt, catch_interrupt
from frenetic.road import MARGIN
from frenetic.search.records import Candidate
from frenetic.search.strategy import Strategy, has_own
from frenetic.simulators.capabilities import capabilities, check_class
from frenetic.simulators.conditions import check_pair_in
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator
from frenetic.spec import MAX_WORKERS, USUAL, Budget, Spec, read_workers
from frenetic.spec.part_record import changed_parts, describe, describe_terms, sources_of
from frenetic.spec.terms import Setting, Terms

logger = logging.getLogger(__name__)

CAMPAIGNS: Final = Path("campaigns")
"""Default parent of campaigns' folders."""
LOOKAHEAD: Final = 16
"""Candidates outstanding at once where several workers drive."""
QUICK_DRIVES: Final = 1000
"""Most simulations of a campaign whose compiled drives are over before other processes are up."""
_START_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed


def new_folder(parent: Path | str = CAMPAIGNS) -> Path:
    """A new folder in `parent`, named after the date and time."""
    parent = Path(parent)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    folder = parent / stamp
    for number in range(2, 1000):
        if not folder.exists():
            break
        folder = parent / f"{stamp}-{number}"
    return folder


def prepare(simulator: Simulator, *, is_here: bool = True) -> None:
    """Lets a simulator find out its `car`, where that takes starting it.

    Args:
        simulator: not yet entered.
        is_here: whether it drives on this machine, so that its modules have to be installed.

    Raises:
        CampaignError: it does not start.
    """
    try:
        its = capabilities(simulator)
        if is_here and its.missing:
            with simulator:  # which says what to install
                pass
        its.prepare()
    except Exception as error:
        raise CampaignError(f"the simulator does not start: {reason_of(error)}") from error


class Campaign(Shown):
    """One search with its budget.

    Args:
        strategy: proposes roads; a new one for each campaign.
        simulator: drives them.
        driver: the system under test.
        budget: the first of its limits that is spent ends the campaign; without one, `run` is told
            how many simulations to make.
        terms: map, lanes, roads and conditions of the drives; by default those of the strategy.
        folder: for results, made if need be; a new one under ``campaigns/`` by default.
        workers: number of roads driven at once, or the address of a Dask scheduler whose workers
            drive (the plug-in `dask`). 1 drives them in this process, which does
            not survive a driver that kills or hangs it, closes its files or leaves its folder,
            unless `isolate` says otherwise. More are processes on this machine, each with a
            simulator and a driver of its own.
        isolate: whether a single worker, too, drives in a process of its own, unless only compiled
            code of ours drives.
        lookahead: candidates outstanding at once, which are told in the order of asking. So the
            campaign depends on it and the seed, but not on the number and speed of the workers. By
            default 1 with one worker, `LOOKAHEAD` or more with several.
        drive_limit: s of wall time after which a worker that tests one road counts as hanging; by
            default half as long again as the simulator's own ``wall_limit``, and 10 s.
        objective: name of what the strategy minimises, see `frenetic.campaign.objective`.
        start_from: folders of earlier campaigns, such as those of the driver's last version. The
            strategy, which has `start_from`, drives again what failed there. What
            is taken from them is kept in the new campaign, and a resumed one goes on with that.
        from_roads: folder of real roads, which are driven first and then changed; kept likewise.
            The class that they show is `frenetic.road.real_roads.shown_class`.
        description: other facts for the campaign's configuration.
        spec: names driver and simulator, which each process that drives makes anew then, from the
            current folder; if it names the strategy, too, commands can go on with the campaign.

    Raises:
        ValueError: an option is out of range.
        FreneticError: the objective cannot be loaded, `start_from` is a single folder, or the
            simulator does not lay the roads of the class.
    """

    def __init__(
        self,
        *,
        strategy: Strategy,
        simulator: Simulator,
        driver: Driver,
        terms: Terms | None = None,
        budget: Budget | None = None,
        folder: Path | str | None = None,
        workers: int | str = 1,
        isolate: bool = False,
        lookahead: int | None = None,
        drive_limit: float | None = None,
        objective: str = MOOBD,
        start_from: Iterable[Path | str] = (),
        from_roads: Path | str | None = None,
        description: Mapping[str, JSONValue] | None = None,
        spec: Spec | None = None,
    ) -> None:
        workers = _checked_workers(workers)
        if drive_limit is None:
            drive_limit = capabilities(simulator).drive_limit
        if not drive_limit > 0.0:
            raise ValueError(
                f"drive_limit is {drive_limit}: a positive number of seconds is needed"
            )
        known = options_of(strategy) or {}
        if not isinstance(strategy, Strategy):
            raise ValueError(
                f"{type(strategy).__name__} is no strategy: make it a frenetic.Strategy"
            )
        if isinstance(strategy, ObservingStrategy) and workers != 1:
            raise ValueError("the strategy observes drives: it needs one worker, in this process")
        start_from = require_list("start_from", start_from)
        has_start = bool(start_from) or from_roads is not None
        if has_start and not has_own(strategy, "start_from"):
            raise ValueError(
                f"the strategy {type(strategy).__name__} starts from no earlier campaign or real"
                " road: give none, or choose a strategy with start_from, such as frenetic"
            )
        self.strategy = strategy
        self.start_from = tuple(EarlierCampaign(str(folder)) for folder in start_from)
        """Earlier campaigns that it starts from, read when it runs."""
        self.from_roads = None if from_roads is None else str(from_roads)
        """Folder of real roads that it starts from, read when it runs."""
        terms = _checked_terms(terms, strategy)
        made_in = None if spec is None else Path.cwd()
        self.tester = RoadTester(simulator, driver, terms, spec, made_in)
        if terms.road_class is not None:
            check_class(simulator, driver, terms.road_class)
        if terms.domain is not None:
            self._check_conditions(terms.domain)
        self.objective = Objective.load(objective)
        self.budget = budget
        self.workers = workers
        """Number of roads driven at once, or the address of a Dask scheduler."""
        self.isolate = isolate
        self._is_usual_lookahead = lookahead is None
        if lookahead is None:
            seats = workers if isinstance(workers, int) else LOOKAHEAD
            lookahead = 1 if workers == 1 else max(LOOKAHEAD, seats)
        self.lookahead: int | None = require_count("lookahead", lookahead)
        """None for as many as the workers have room for."""
        self.drive_limit = drive_limit
        self.folder = new_folder() if folder is None else Path(folder)
        self.seed: int | None = known.get("seed")
        self.started = False
        """Whether its folder and database exist."""
        self.description = dict(description or {})
        self.notes: tuple[str, ...] = ()
        """Sentences on what it starts from, and on what of that cannot be read."""
        self._search_so_far: tuple[Summary, dict[int, Candidate]] | None = None
        """Results told and candidates outstanding, while the strategy knows exactly these."""
        self._unreported: deque[tuple[int, Summary]] = deque()
        """Stored tests of which the caller does not know as yet, since its `on_event` raised."""
        self._interrupt: Interrupt | None = None  # while it runs

    def _check_conditions(self, domain: Domain) -> None:
        conditions = self.tester.terms.conditions_of(domain.all_at_once())
        check_pair_in(conditions, self.tester.simulator, self.tester.driver)

    @classmethod
    def of(
        cls,
        spec: Spec,
        *,
        folder: Path | str | None = None,
        workers: int | str | None = None,
        isolate: bool = False,
    ) -> Campaign:
        """The campaign of a spec.

        Args:
            spec: names strategy, driver and simulator, and has a budget.
            folder: for results, as for the class.
            workers: as for the class; by default those of the spec, or the simulator's usual
                number, or one per core, or one if at most `QUICK_DRIVES` are compiled.
            isolate: as for the class. A script that isolates needs ``if __name__ ==
                "__main__":``.

        Raises:
            FreneticError: a part cannot be made.
            ValueError: an option is out of range.
        """
        spec = Spec.of(USUAL, spec)
        if spec.from_roads is not None:  # which may show another class later
            spec = structs.replace(spec, roads=spec.driving().roads)
        tester = RoadTester.of(spec)
        return cls(
            strategy=spec.make_strategy(),
            simulator=tester.simulator,
            driver=tester.driver,
            terms=tester.terms,
            budget=spec.budget,
            folder=folder,
            workers=workers or spec.workers or _usual_workers(spec, tester),
            isolate=isolate,
            lookahead=spec.lookahead,
            objective=spec.named_objective,
            start_from=spec.start_from,
            from_roads=spec.from_roads,
            spec=spec,
        )

    @property
    def spec(self) -> Spec | None:
        """The spec of the campaign as it runs; None unless all its parts have names."""
        spec = self.tester.spec
        if spec is None or spec.strategy is None:
            return None
        limits = {} if self.budget is None else asdict(self.budget)
        more: dict[str, Any] = {**limits, "workers": self.workers, "lookahead": self.lookahead}
        return structs.replace(spec, **more, signed=None)

    def configuration(self) -> dict[str, JSONValue]:
        """The campaign's record in its database."""
        tester, spec = self.tester, self.spec
        with tester.in_folder():
            strategy = describe(self.strategy, self._made_strategy())
        record: dict[str, Any] = {
            "seed": self.seed,
            "strategy": strategy,
            **tester.described,
            **{name: getattr(tester.setting, name) for name in _SETTING},
            "rules": tester.simulator.rules.as_json(),
            "budget": self.budget,
            "workers": self.workers,
            "lookahead": self.lookahead,
            "objective": self.objective.name,
            "start_from": self.start_from,
            "from_roads": self.from_roads,
            "versions": package_versions(),
            "behaviours": describe_terms() | self._objective_version(),
        }
        if spec is not None:
            record[SPEC] = spec.entries()
        if self.objective.higher_is_worse:
            record["higher_is_worse"] = True
        plain_record: dict[str, JSONValue] = to_builtins(record, enc_hook=plain)
        return plain_record | self.description

    def run(
        self,
        simulations: int | None = None,
        *,
        on_event: Callable[[Event], object] | None = None,
    ) -> Summary:
        """Searches until the budget is spent or Ctrl-C is pressed, and stores every test.

        Called again, it goes on where it stopped: ``run(20)`` and ``run(30)`` give the same tests
        as ``run(50)`` where the campaign has a budget of 50 simulations or more.

        After the first Ctrl-C nothing more is asked and running tests are finished; the second ends
        the campaign at once.

        Args:
            simulations: most drives of this call. A budget with fewer simulations grows to allow
                them, a limit of time or failures stays. None: all that is left of the budget.
            on_event: called with each `Event`: the start, every result, the first Ctrl-C. It may
                `stop` the campaign. What it raises ends the run and is raised; all results are
                stored, and the next `run` begins with the tests that were stored together with
                that one.

        Raises:
            ValueError: there is neither a budget nor a number of simulations, or the number is not
                a whole one of at least 1.
            CampaignError: the folder cannot be used or written, it holds another campaign already,
                the strategy was asked before, an earlier campaign cannot be read or has no road
                that fits, the strategy knows no valid road, no worker can be started, or no road or
                drive can be judged. Stored results stay.
        """
        limit = self._allow(simulations)
        if not self.started:
            require_fresh(self.strategy)
            self._keep_margin()
            if not self.start_from and self.from_roads is None:
                require_valid_roads(self.strategy)
        prepare(self.tester.simulator, is_here=isinstance(self.workers, int))
        if isinstance(self.workers, str):
            cluster_workers().require_scheduler(self.workers)
        if self._search_so_far is not None:
            return self._go_on(*self._search_so_far, limit, on_event)
        folders = [earlier.folder for earlier in self.start_from]
        step = (options_of(self.strategy) or {}).get("step")
        self.start_from, taken, settings = take_earlier(folders, self.tester, self.objective, step)
        starts = [str(earlier) for earlier in self.start_from]
        unread: list[str] = []
        if self.from_roads is not None:
            words, unread, roads = take_roads(self.from_roads, self.tester, step)
            starts, taken = [words, *starts], [*roads, *taken]
        self.notes = (*(f"starts from {source}" for source in starts), *unread)
        facts: dict[str, JSONValue] = {SOURCES: self._sources(), STARTED_IN: str(self._code_folder)}
        facts |= self._signature(facts[SOURCES])
        made = CampaignStore.create(
            self.folder, self.configuration(), facts | settings, numbered(taken)
        )
        with made as store:
            lane_width = self.tester.terms.lane_width
            summary = Summary(seed=self.seed, folder=self.folder, lane_width=lane_width)
            start(self.strategy, earlier_evaluations(store, self.objective), summary)
            return self._search(LogEvent.STARTED, store, summary, {}, limit, on_event)

    def _allow(self, simulations: int | None) -> int | None:
        """The number of simulations at which to stop, which the budget allows; None for no other.

        Raises:
            ValueError: as for `run`.
        """
        if simulations is None:
            if self.budget is None:
                raise ValueError(
                    "the campaign has no budget: run(20) makes 20 simulations, and"
                    " Campaign(budget=Budget(simulations=200)) limits all of them"
                )
            return None
        before = self._search_so_far[0].simulations if self._search_so_far else 0
        limit = before + require_count("simulations", simulations)
        if self.budget is None:
            self.budget = Budget(simulations=limit)
        elif self.budget.simulations is not None and self.budget.simulations < limit:
            self.budget = replace(self.budget, simulations=limit)
        return limit

    def _go_on(
        self,
        summary: Summary,
        outstanding: dict[int, Candidate],
        limit: int | None,
        on_event: Callable[[Event], object] | None,
    ) -> Summary:
        """Searches on after an earlier `run` or `resume` of this object."""
        with CampaignStore.open(self.folder, readonly=False) as store:
            if sum(store.by_outcome().values()) != summary.told:
                raise CampaignError(
                    f"{self.folder} was written by another process since: resume() a campaign with"
                    " a fresh strategy"
                )
            summary.spend(self._required_budget, summary.seconds)
            return self._search(LogEvent.RESUMED, store, summary, outstanding, limit, on_event)

    def stop(self) -> None:
        """Stops the campaign after the running tests, like the first Ctrl-C.

        Called from `on_event`, or from another thread. `run` goes on again. Nothing
        happens unless it runs.
        """
        if self._interrupt is not None:
            self._interrupt.requested = True

    @property
    def _required_budget(self) -> Budget:
        assert self.budget is not None, "`_allow` or `resume` has seen to it"
        return self.budget

    def resume(self, *, on_event: Callable[[Event], object] | None = None) -> Summary:
        """Resumes the campaign in the folder, whatever ended it.

        The strategy must be fresh; the log is replayed to it. If it proposes other roads than the
        log holds, the campaign is not resumed. A candidate that was asked but never told is tested
        next. With a budget in simulations, an interrupted campaign ends with the same tests as an
        uninterrupted one. Time spent before counts. Without a budget, that of the folder holds.

        Args:
            on_event: as for `run`, with results that are new.

        Raises:
            CampaignError: there is no such campaign, another process writes it, it was made with
                other parts, the strategy replays differently, or as for `run`.
        """
        with CampaignStore.open(self.folder, readonly=False) as store:
            if self.budget is None:
                self.budget = stored_budget(store)
            prepare(self.tester.simulator, is_here=isinstance(self.workers, int))
            self._keep_margin()
            self.start_from = earlier_of(store.config)
            earlier = earlier_evaluations(store, self.objective)
            if self._is_usual_lookahead and isinstance(theirs := store.config["lookahead"], int):
                self.lookahead = theirs
            self._check_same(store, self.configuration())
            store.require_sound()
            summary, outstanding = replay(
                store, self.strategy, self.budget, self.objective, earlier=earlier
            )
            summary.seed, summary.folder = self.seed, self.folder
            return self._search(LogEvent.RESUMED, store, summary, outstanding, None, on_event)

    def _is_interruption(self, error: BaseException) -> bool:
        """Whether an error of a search comes of Ctrl-C."""
        if isinstance(error, SystemError):  # of compiled code, which returned at that moment
            error = error.__cause__ or error
        if isinstance(error, KeyboardInterrupt):
            return True
        # A compiler that the second one interrupts may fail in its own way.
        insisted = self._interrupt is not None and self._interrupt.insisted
        return insisted and not isinstance(error, FreneticError)

    def _keep_margin(self) -> None:
        """Has the strategy check roads with this campaign's margin."""
        margin = self.tester.terms.margin
        if margin != MARGIN:
            self.strategy.keep_margin(margin)

    def _objective_version(self) -> dict[str, str]:
        """The version of an objective of your own."""
        if self.objective.measure.__module__.partition(".")[0] == "frenetic":
            return {}
        return {"objective": version_of(self.objective.measure).text}

    def _check_same(self, store: CampaignStore, configuration: Mapping[str, JSONValue]) -> None:
        """Checks that a stored campaign was made on these terms with these parts.

        Raises:
            CampaignError: it was not.
        """
        ours = json.loads(json.dumps(configuration, default=plain))
        for name in _TERMS:
            theirs = store.config.get(name, MOOBD if name == "objective" else None)
            if ours[name] != theirs:
                raise CampaignError(
                    f"{self.folder} was made with another {name.replace('_', ' ')}:"
                    f" {json.dumps(theirs)[:300]}, not {json.dumps(ours[name])[:300]}"
                )
        if found := changed_parts(store.config, ours):
            texts = [text for one in found.values() for text in one]
            before, now = store.fact(SOURCES) or {}, self._sources()
            edited = [
                f"{name} was edited"
                for name in sorted(now)
                if isinstance(before, Mapping) and before.get(name) != now[name]
            ]
            raise CampaignError(
                f"{self.folder} was made with another {' and '.join(found)}:"
                f" {'; '.join([*edited, *texts])[:1000]}; restore it, or {self.next_campaign()}"
            )

    def next_campaign(self) -> str:
        """Return the advice to start another campaign with the present parts."""
        if (spec := self.spec) is None:
            command = shlex.join(["frenetic", "run", "--from", str(self.folder)])
            return f"start a new campaign from this one: {command}"
        with CampaignStore.open(self.folder) as store:
            has_drives = has_judged(store)
        names_parts = is_here(self._code_folder)
        return next_campaign(spec, self.folder, has_drives=has_drives, names_parts=names_parts)

    def _made_strategy(self) -> Made | None:
        """How the strategy was made by its name; None if it has none, as a bench's generator."""
        spec = self.spec
        return None if spec is None or "strategy" in self.description else spec.made("strategy")

    @property
    def _code_folder(self) -> Path:
        """The folder from which its parts are loaded."""
        return self.tester.folder or Path.cwd()

    def _signature(self, sources: JSONValue) -> dict[str, JSONValue]:
        """The fact with the user's signature; none without named code, or if none can be made."""
        if (spec := self.spec) is None:
            return {}
        if (signed := spec.signed_in(self._code_folder, sources).signed) is not None:
            return {SIGNATURE: signed.signature}
        if named_code(spec.parts):
            self.notes = (*self.notes, unsigned_text())
        return {}

    def _sources(self) -> dict[str, JSONValue]:
        """The user's own source of its parts: name of a file -> its text."""
        with self.tester.in_folder():
            sources = self.tester.sources | sources_of(self.strategy, self._made_strategy())
        return {**sources, **sources_of(self.objective.measure)}

    def _search(
        self,
        event: LogEvent,
        store: CampaignStore,
        summary: Summary,
        outstanding: dict[int, Candidate],
        limit: int | None,
        on_event: Callable[[Event], object] | None,
    ) -> Summary:
        """Tests until the budget is spent; the common part of `run` and `resume`."""
        self.started = True
        if event is LogEvent.RESUMED:
            # However this process ends, the campaign is resumed to this budget.
            store.reopen(budget=asdict(self._required_budget))
        with CampaignLog(self.folder) as log, _saying_what_is_stored(store, summary):
            configuration = self.configuration()
            fields: dict[str, Any] = {name: configuration[name] for name in _LOGGED}
            after = f" after {counted(summary.told, 'result')}" if summary.told else ""
            log.write(event, event + after, process_id=os.getpid(), host=platform.node(), **fields)
            for note in self.notes if event is LogEvent.STARTED else ():
                log.write(LogEvent.LOG, note, logger=__name__)
            return self._searched(log, store, summary, outstanding, limit, on_event)

    def _searched(
        self,
        log: CampaignLog,
        store: CampaignStore,
        summary: Summary,
        outstanding: dict[int, Candidate],
        limit: int | None,
        on_event: Callable[[Event], object] | None,
    ) -> Summary:
        if (spec := self.spec) is not None:
            spec.signed_in(self._code_folder).write(self.folder)
        interrupted = False
        self._search_so_far = None
        start = time.perf_counter() - summary.seconds

        def say(kind: EventKind, now: Summary, test_id: int | None = None) -> None:
            if on_event is not None:
                read = None if test_id is None else partial(store.test, test_id)
                on_event(Event(kind, now, read))

        def told() -> None:
            say("interrupted", summary.now(time.perf_counter() - start))

        try:
            with catch_interrupt(told) as interrupt:
                self._interrupt = interrupt
                with self._workers(log) as workers:
                    compile_kernels()  # which the strategy needs here, while they start
                    while not workers.free and not interrupt.requested:
                        workers.wait(_START_POLL)
                    say("started", summary.now(summary.seconds))
                    start = time.perf_counter() - summary.seconds
                    dispatcher = Dispatcher(
                        strategy=self.strategy,
                        workers=workers,
                        store=store,
                        log=log,
                        budget=self._required_budget,
                        limit=limit,
                        objective=self.objective,
                        lookahead=self.lookahead,
                        interrupt=interrupt,
                        summary=summary,
                        outstanding=outstanding,
                        unreported=self._unreported,
                        second=self._second_drive(store),
                    )
                    for test_id, now in dispatcher.tests():
                        try:
                            say("result", now, test_id)
                        except Exception:
                            self._search_so_far = summary, outstanding
                            raise
                is_stopped = interrupt.requested or (
                    limit is not None and summary.simulations >= limit
                )
                is_whole = summary.budget_spent >= 1.0 or (summary.ended and not outstanding)
                interrupted = is_stopped and not is_whole
                self._search_so_far = summary, outstanding
        except CampaignGoneError:  # the log is gone, too
            raise
        except (KeyboardInterrupt, Exception) as error:
            interrupted = self._is_interruption(error)
            if not interrupted:
                log.progress(summary.now(time.perf_counter() - start))
                trace = traceback_of(error)
                cause: dict[str, Any] = {"traceback": trace} if trace else {}
                log.write(LogEvent.GAVE_UP, reason_of(error), level="error", **cause)
                raise
        finally:
            self._interrupt = None
            summary.seconds = time.perf_counter() - start
        summary.notice = notice_of(self.strategy)
        summary.facts = facts_of(self.strategy, summary)
        # What is stored counts, also when an interrupt came between storing and counting.
        ended = "" if interrupted else summary.ended
        counts = asdict(store.counts())
        end = replace(summary, interrupted=interrupted, ended=ended, **counts)
        store.finish(
            seconds=round(end.seconds, 3),
            interrupted=interrupted,
            ended=end.ended,
            notice=end.notice,
            strategy_seconds=round(end.strategy_seconds, 4),
            budget=asdict(self._required_budget),
            **{FACTS: end.facts},
        )
        log.progress(end)
        last = LogEvent.INTERRUPTED if interrupted else LogEvent.FINISHED
        fields: dict[str, Any] = end.as_json()
        log.write(last, end.in_words(), **fields)
        return end

    def _second_drive(self, store: CampaignStore) -> SecondDrive | None:
        """The second drive of the first failure, unless that was driven before."""
        if self.strategy.expects_failures:
            return None
        return SecondDrive(store, self.tester.simulator)

    def _workers(self, log: CampaignLog) -> Workers:
        if isinstance(self.workers, str):
            workers: Workers = cluster_workers()(
                self.tester, self.workers, drive_limit=self.drive_limit, log=log
            )
            return workers
        if self.workers == 1 and not (self.isolate and is_isolable(self.tester)):
            return InProcessWorker(self.tester)
        return LocalWorkers(
            self.tester,
            self.workers,
            drive_limit=self.drive_limit,
            log=log,
            ahead=self.lookahead != 1,
            keep=isinstance(self.strategy, ObservingStrategy),
        )

    @property
    def best_test(self) -> Test | None:
        """The stored test that is worst for the driver, by the objective; None before a drive.

        Raises:
            CampaignError: there is no campaign, or it is damaged.
        """
        with CampaignStore.open(self.folder) as store:
            if values := objectives(store):
                turn = -1.0 if self.objective.higher_is_worse else 1.0
                return store.test(min(values, key=lambda test: turn * values[test]))
            lowest = next(store.tests(order_by="moobd", limit=1, with_trajectory=True), None)
            return None if lowest is None or lowest.moobd is None else lowest

    def __repr__(self) -> str:
        """The campaign at a glance."""
        try:
            with CampaignStore.open(self.folder) as store:
                return f"<Campaign {store.at_a_glance()}>"
        except CampaignError:
            return f"<Campaign {self.folder}: nothing stored yet>"


def _checked_workers(workers: int | str) -> int | str:
    """A number of workers, or the address of a scheduler.

    Raises:
        ValueError: it is neither, or too many.
    """
    if isinstance(workers, str):
        return read_workers(workers)
    number = require_count("workers", workers)
    if number > MAX_WORKERS:
        raise ValueError(f"workers is {number}: at most {MAX_WORKERS} are allowed")
    return number


def _checked_terms(terms: Terms | None, strategy: Strategy) -> Terms:
    """Terms that agree with a strategy; by default those that it was made for.

    Raises:
        ValueError: they do not agree.
    """
    made_for: dict[str, Any] = {"road_class": strategy.road_class, "domain": strategy.domain}
    made_for["map_size"] = (options_of(strategy) or {}).get("map_size")
    made_for = {name: value for name, value in made_for.items() if value is not None}
    if terms is None:
        return Terms.of_class(made_for.pop("road_class", None), **made_for)
    for name, value in made_for.items():
        if getattr(terms, name) != value:
            given, own = (
                number_word(one) if name == "map_size" else getattr(one, "name", one)
                for one in (getattr(terms, name), value)
            )
            raise ValueError(
                f"{name} is {given}, but the strategy was made for {own}: they have to agree"
            )
    return terms


def _usual_workers(spec: Spec, tester: RoadTester) -> int:
    """Number of workers that are of use, by default one per core."""
    budget = spec.budget
    usual = capabilities(tester.simulator).usual_workers or available_cores()
    drives = None if budget is None else budget.simulations
    if drives is not None and drives <= QUICK_DRIVES and tester.drives_compiled:
        return 1
    return usual if spec.lookahead is None else min(usual, spec.lookahead)


_SETTING: Final = tuple(item.name for item in fields(Setting))
"""Entries of the configuration that are those of its `Setting`."""
_TERMS: Final = (*(name for name in _SETTING if name != "car"), "lookahead", "objective")
"""Entries of the configuration on which a resumed campaign is the same."""
_LOGGED: Final = (
    "seed",
    "strategy",
    "driver",
    "simulator",
    "budget",
    "workers",
    "lookahead",
    "versions",
)
"""The configuration in the log's first line."""


@contextmanager
def _saying_what_is_stored(store: CampaignStore, summary: Summary) -> Iterator[None]:
    """Adds to an error how far the campaign came."""
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
