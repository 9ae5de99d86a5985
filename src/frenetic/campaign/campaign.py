"""A campaign: one search with its budget, from the first road to the last, and its resumption."""

from __future__ import annotations

import os
import platform
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from msgspec import structs, to_builtins

from frenetic._support.bounds import require_count
from frenetic._support.files import require_list
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.notebook import NotebookRepr
from frenetic._support.words import counted
from frenetic.campaign.advice import stored_campaign_advice
from frenetic.campaign.code_record import SETTING, CodeRecord
from frenetic.campaign.configuration import SPEC, EarlierCampaign, earlier_of
from frenetic.campaign.defaults import (
    checked_drive_limit,
    checked_terms,
    checked_workers,
    compile_for,
    default_max_in_flight,
    new_folder,
    prepare,
    require_strategy,
    require_warm_start,
    usual_workers,
)
from frenetic.campaign.guarded_strategy import (
    ObservingStrategy,
    require_fresh,
    require_valid_roads,
    start,
)
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.loop import SearchPlan, SearchState
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.objective_values import worst_test
from frenetic.campaign.reader import SOURCES, STARTED_IN
from frenetic.campaign.record import Test
from frenetic.campaign.replay import replay
from frenetic.campaign.second_drive import SecondDrive
from frenetic.campaign.session import SearchSession, progress_in_errors
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.stored_spec import stored_budget
from frenetic.campaign.summary import EventListener, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.warm_start import earlier_evaluations, numbered, take_starts
from frenetic.campaign.workers import Workers, cluster_workers, workers_for
from frenetic.conditions.domain import Domain
from frenetic.drivers.driver import Driver
from frenetic.errors import CampaignError
from frenetic.parts.construction import options_of
from frenetic.parts.signatures import unsigned_text
from frenetic.parts.versions import package_versions
from frenetic.road import MAP_MARGIN
from frenetic.search.strategy import Strategy
from frenetic.simulators.capabilities import check_class
from frenetic.simulators.conditions import check_pair_in
from frenetic.simulators.simulator import Simulator
from frenetic.spec import USUAL, Budget, Spec
from frenetic.spec.parts import PARTS
from frenetic.spec.terms import Terms

_LOGGED_ENTRIES: Final = ("seed", *PARTS, "budget", "workers", "max_in_flight", "versions")
"""Entries of the configuration that the log's first line repeats."""


class Campaign(NotebookRepr):
    """One search with its budget.

    Args:
        strategy: strategy that proposes the roads; each campaign needs a new one.
        simulator: simulator in which the roads are driven.
        driver: the system under test.
        budget: limits, the first of which ends the campaign when it is spent; without a budget,
            `run` takes a number of simulations.
        terms: map, lanes, roads and conditions of the drives; by default the strategy's.
        folder: folder for results, created if need be; by default a new one under ``campaigns/``.
        workers: number of roads driven at once, or the address of a Dask scheduler whose workers
            drive. One worker drives in this process, unless `isolate` is set: a driver that kills
            or hangs the process, closes its files or leaves its folder ends the campaign. More
            workers are processes on this machine, each with a simulator and a driver.
        isolate: whether a single worker drives in another process, unless all code is compiled.
        max_in_flight: candidates outstanding at once; the strategy learns their results in the
            order of asking. So the campaign depends on max_in_flight and seed, not on number and
            speed of the workers. By default 1 with one worker, `MAX_IN_FLIGHT` or more.
        drive_limit: wall time in s after which a worker that tests one road counts as hanging; by
            default 1.5 times the simulator's ``wall_limit``, plus 10 s.
        objective: name of the value that the strategy minimises, see `frenetic.campaign.objective`.
        start_from: folders of earlier campaigns, such as one with the driver's last version. The
            strategy, which needs `start_from`, drives their failing roads again. The campaign
            stores the roads that it takes.
        from_roads: folder of real roads, which are stored, driven first and then changed. Their
            class is `frenetic.road.real_roads.shown_class`.
        description: other entries for the campaign's configuration.
        spec: spec that names driver and simulator, so that each process that drives makes them
            from the current folder. If it names the strategy, too, commands can resume the
            campaign.

    Raises:
        ValueError: an option is out of range.
        FreneticError: the objective cannot be loaded, `start_from` is a single folder, or the
            simulator cannot build the roads of the class.
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
        max_in_flight: int | None = None,
        drive_limit: float | None = None,
        objective: str = MOOBD,
        start_from: Iterable[Path | str] = (),
        from_roads: Path | str | None = None,
        description: Mapping[str, JSONValue] | None = None,
        spec: Spec | None = None,
    ) -> None:
        workers = checked_workers(workers)
        require_strategy(strategy, workers)
        start_from = require_list("start_from", start_from)
        if start_from or from_roads is not None:
            require_warm_start(strategy)
        self.strategy = strategy
        self.start_from = tuple(EarlierCampaign(str(folder)) for folder in start_from)
        """Earlier campaigns from which the search starts, read when it runs."""
        self.from_roads = None if from_roads is None else str(from_roads)
        """Folder of real roads from which the search starts, read when it runs."""
        terms = checked_terms(terms, strategy)
        self.tester = RoadTester(simulator, driver, terms, spec)
        if terms.road_class is not None:
            check_class(simulator, driver, terms.road_class)
        if terms.domain is not None:
            self._check_conditions(terms.domain)
        self.objective = Objective.load(objective)
        self.budget = budget
        self.workers = workers
        """Number of roads driven at once, or address of a Dask scheduler."""
        self.isolate = isolate
        self._is_default_in_flight = max_in_flight is None
        most = default_max_in_flight(workers) if max_in_flight is None else max_in_flight
        self.max_in_flight: int | None = require_count("max_in_flight", most)
        """Largest number of outstanding candidates; None for as many as the workers hold."""
        self.drive_limit = checked_drive_limit(drive_limit, simulator)
        self.folder = new_folder() if folder is None else Path(folder)
        self.seed: int | None = (options_of(strategy) or {}).get("seed")
        self.started = False
        """Whether the campaign's folder and database exist."""
        self.description = dict(description or {})
        self.notes: tuple[str, ...] = ()
        """Sentences about the warm start, and about files and roads that cannot be read."""
        self._unreported: deque[tuple[int, Summary]] = deque()
        """Stored tests that were not reported, since the caller's `on_event` raised, see `run`."""
        self._state: SearchState | None = None
        """Progress between runs; None unless the strategy knows exactly its results."""
        self._session: SearchSession | None = None  # while it runs

    def _check_conditions(self, domain: Domain) -> None:
        """Check that simulator and driver can be put into all conditions of a domain."""
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
        """Return the campaign of a spec.

        Args:
            spec: spec that names strategy, driver and simulator, and has a budget.
            folder: folder for results, as for the class.
            workers: number or address, as for the class; by default the number in the spec, or else
                the simulator's usual number, one per core, or 1 for few compiled drives
                (`frenetic.campaign.defaults.QUICK_DRIVES`).
            isolate: whether a single worker drives in another process, as for the class; then a
                script needs ``if __name__ == "__main__":``.

        Raises:
            FreneticError: a part cannot be made.
            ValueError: an option is out of range.
        """
        spec = Spec.of(USUAL, spec)
        if spec.from_roads is not None:  # which may show another class later
            spec = structs.replace(spec, roads=spec.driving_spec().roads)
        tester = RoadTester.of(spec)
        return cls(
            strategy=spec.make_strategy(driver=tester.driver, simulator=tester.simulator),
            simulator=tester.simulator,
            driver=tester.driver,
            terms=tester.terms,
            budget=spec.budget,
            folder=folder,
            workers=workers
            or spec.workers
            or usual_workers(spec.budget, spec.max_in_flight, tester),
            isolate=isolate,
            max_in_flight=spec.max_in_flight,
            objective=spec.named_objective,
            start_from=spec.start_from,
            from_roads=spec.from_roads,
            spec=spec,
        )

    @property
    def spec(self) -> Spec | None:
        """The spec of the campaign as it runs; None if a part has no name."""
        spec = self.tester.spec
        if spec is None or spec.strategy is None:
            return None
        limits = {} if self.budget is None else asdict(self.budget)
        extent = {"workers": self.workers, "max_in_flight": self.max_in_flight}
        return structs.replace(spec, **limits, **extent, signed=None)

    @property
    def _code(self) -> CodeRecord:
        """Code of the campaign's parts."""
        is_named = "strategy" not in self.description
        return CodeRecord(self.tester, self.strategy, self.objective, self.spec, is_named)

    def configuration(self) -> dict[str, JSONValue]:
        """Return the campaign's configuration, which its database stores."""
        tester, spec = self.tester, self.spec
        code = self._code
        record: dict[str, Any] = {
            "seed": self.seed,
            "strategy": code.strategy_record,
            **tester.described,
            **{name: getattr(tester.setting, name) for name in SETTING},
            "rules": tester.simulator.rules.as_json(),
            "budget": self.budget,
            "workers": self.workers,
            "max_in_flight": self.max_in_flight,
            "objective": self.objective.name,
            "start_from": self.start_from,
            "from_roads": self.from_roads,
            "versions": package_versions(),
            "behaviours": code.behaviours,
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
        on_event: EventListener | None = None,
    ) -> Summary:
        """Search until the budget is spent or Ctrl-C is pressed, and store every test.

        A further call continues where the last one stopped: ``run(20)`` and ``run(30)`` give the
        same tests as ``run(50)`` if the campaign has a budget of 50 simulations or more.

        After the first Ctrl-C only running tests are finished; the second ends the campaign at
        once.

        Args:
            simulations: most drives of this call. A budget with fewer simulations grows to allow
                them; a limit of time or failures stays. None for all that is left of the budget.
            on_event: called with each `Event`: the start, every result, the first Ctrl-C. It may
                `stop` the campaign. An exception that it raises ends the run and is raised; all
                results are stored, and the next `run` begins with the tests that were stored but
                not reported.

        Raises:
            ValueError: there is neither a budget nor a number of simulations, or the number is no
                whole number of at least 1.
            CampaignError: the folder cannot be used or written, it holds another campaign already,
                the strategy was asked before, an earlier campaign cannot be read or has no road
                that fits, the strategy knows no valid road, no worker can be started, or no road or
                drive can be judged. Stored results stay.
        """
        limit = self._allow(simulations)
        if not self.started:
            require_fresh(self.strategy)
            self._keep_map_margin()
            if not self.start_from and self.from_roads is None:
                require_valid_roads(self.strategy)
        prepare(self.tester.simulator, drives_here=isinstance(self.workers, int))
        if isinstance(self.workers, str):
            cluster_workers().require_scheduler(self.workers)
        if self._state is not None:
            return self._continue(self._state, limit, on_event)
        step = (options_of(self.strategy) or {}).get("step")
        folders = [earlier.folder for earlier in self.start_from]
        starts = take_starts(folders, self.from_roads, self.tester, self.objective, step)
        self.start_from, self.notes = starts.campaigns, starts.notes
        code = self._code
        facts: dict[str, JSONValue] = {SOURCES: code.sources, STARTED_IN: str(code.folder)}
        signature, is_unsigned = code.signature(facts[SOURCES])
        if is_unsigned:
            self.notes = (*self.notes, unsigned_text())
        facts |= signature | starts.facts
        with CampaignStore.create(
            self.folder, self.configuration(), facts, numbered(starts.tests)
        ) as store:
            lane_width = self.tester.terms.lane_width
            summary = Summary(seed=self.seed, folder=self.folder, lane_width=lane_width)
            start(self.strategy, earlier_evaluations(store, self.objective), summary)
            state = SearchState(summary, {}, self._unreported)
            return self._search(LogEvent.STARTED, store, state, limit, on_event)

    def _allow(self, simulations: int | None) -> int | None:
        """Return the number of simulations at which to stop, if any, and let the budget allow it.

        Raises:
            ValueError: there is neither a budget nor a number of simulations, or the number is no
                whole number of at least 1.
        """
        if simulations is None:
            if self.budget is None:
                raise ValueError(
                    "the campaign has no budget: run(20) makes 20 simulations, and"
                    " Campaign(budget=Budget(simulations=200)) limits all of them"
                )
            return None
        before = 0 if self._state is None else self._state.summary.simulations
        limit = before + require_count("simulations", simulations)
        if self.budget is None:
            self.budget = Budget(simulations=limit)
        elif self.budget.simulations is not None and self.budget.simulations < limit:
            self.budget = replace(self.budget, simulations=limit)
        return limit

    def _continue(
        self, state: SearchState, limit: int | None, on_event: EventListener | None
    ) -> Summary:
        """Continue the search after an earlier `run` or `resume` of this object."""
        summary = state.summary
        with CampaignStore.open(self.folder, readonly=False) as store:
            if sum(store.by_outcome().values()) != summary.result_count:
                raise CampaignError(
                    f"{self.folder} was written by another process since: resume() a campaign with"
                    " a fresh strategy"
                )
            summary.update_budget_spent(self._required_budget, summary.seconds)
            return self._search(LogEvent.RESUMED, store, state, limit, on_event)

    def stop(self) -> None:
        """Stop a running campaign after the running tests, like the first Ctrl-C.

        Call it from `on_event` or another thread. A later `run` continues the campaign.
        """
        if self._session is not None and self._session.interrupt is not None:
            self._session.interrupt.requested = True

    @property
    def _required_budget(self) -> Budget:
        assert self.budget is not None, "`_allow` or `resume` has set it"
        return self.budget

    def resume(self, *, on_event: EventListener | None = None) -> Summary:
        """Resume the campaign in the folder, whatever ended it.

        The strategy must be fresh: it is asked again, and told the stored results. If it proposes
        other roads than the stored ones, the campaign is not resumed. Candidates without a result
        are tested next. With a budget in simulations, an interrupted campaign ends with the same
        tests as an uninterrupted one. Time that was spent before counts. Without a budget, the
        stored budget applies.

        Args:
            on_event: as for `run`, but called with new results only.

        Raises:
            CampaignError: there is no such campaign, another process writes it, it was made with
                other parts, the strategy proposes other roads, or for a cause that `run` names.
        """
        with CampaignStore.open(self.folder, readonly=False) as store:
            if self.budget is None:
                self.budget = stored_budget(store)
            prepare(self.tester.simulator, drives_here=isinstance(self.workers, int))
            self._keep_map_margin()
            self.start_from = earlier_of(store.config)
            earlier = earlier_evaluations(store, self.objective)
            max_in_flight = store.config["max_in_flight"]
            if self._is_default_in_flight and isinstance(max_in_flight, int):
                self.max_in_flight = max_in_flight
            self._code.require_same(store, self.configuration(), self.next_campaign)
            store.require_sound()
            summary, outstanding = replay(
                store, self.strategy, self.budget, self.objective, earlier=earlier
            )
            summary.seed, summary.folder = self.seed, self.folder
            state = SearchState(summary, outstanding, self._unreported)
            return self._search(LogEvent.RESUMED, store, state, None, on_event)

    def _keep_map_margin(self) -> None:
        """Let the strategy check roads with this campaign's margin to the map's edge."""
        if (map_margin := self.tester.terms.map_margin) != MAP_MARGIN:
            self.strategy.keep_map_margin(map_margin)

    def next_campaign(self) -> str:
        """Return the advice to start another campaign with the present parts."""
        return stored_campaign_advice(self.spec, self.folder, self._code.folder)

    def _search(
        self,
        event: LogEvent,
        store: CampaignStore,
        state: SearchState,
        limit: int | None,
        on_event: EventListener | None,
    ) -> Summary:
        """Log the start, then search in a session until the budget is spent or it is stopped."""
        self.started = True
        summary = state.summary
        if event is LogEvent.RESUMED:
            # Stored now: however this process ends, a later resume takes this budget.
            store.reopen(budget=asdict(self._required_budget))
        with CampaignLog(self.folder) as log, progress_in_errors(store, summary):
            configuration = self.configuration()
            fields: dict[str, Any] = {name: configuration[name] for name in _LOGGED_ENTRIES}
            message = str(event)
            if count := summary.result_count:
                message += f" after {counted(count, 'result')}"
            log.write(event, message, process_id=os.getpid(), host=platform.node(), **fields)
            if event is LogEvent.STARTED:
                for note in self.notes:
                    log.write(LogEvent.LOG, note, logger=__name__)
            if (spec := self.spec) is not None:
                spec.signed_in(self._code.folder).write(self.folder)
            self._state = None
            self._session = session = SearchSession(
                SearchPlan(
                    self.strategy, self.objective, self._required_budget, limit, self.max_in_flight
                ),
                state,
                store,
                log,
                make_workers=partial(self._workers, log),
                make_second_drive=partial(self._second_drive, store),
                compile_kernels=partial(compile_for, self._required_budget, self.tester),
                on_event=on_event,
            )
            try:
                return session.run()
            finally:
                self._session = None
                self._state = state if session.is_consistent else None

    def _second_drive(self, store: CampaignStore) -> SecondDrive | None:
        """Return the second drive of the first failure; None if failures are expected."""
        if self.strategy.expects_failures:
            return None
        return SecondDrive(store, self.tester.simulator)

    def _workers(self, log: CampaignLog) -> Workers:
        """Return the workers, which are not started yet."""
        return workers_for(
            self.tester,
            self.workers,
            isolate=self.isolate,
            drive_limit=self.drive_limit,
            log=log,
            may_queue=self.max_in_flight != 1,
            keep_exact=isinstance(self.strategy, ObservingStrategy),
        )

    @property
    def best_test(self) -> Test | None:
        """The stored test that is worst for the driver, by the objective; None before a drive.

        Raises:
            CampaignError: the folder holds no campaign, or a damaged one.
        """
        with CampaignStore.open(self.folder) as store:
            return worst_test(store, self.objective)

    def __repr__(self) -> str:
        """The campaign at a glance."""
        try:
            with CampaignStore.open(self.folder) as store:
                return f"<Campaign {store.at_a_glance()}>"
        except CampaignError:
            return f"<Campaign {self.folder}: nothing stored yet>"
