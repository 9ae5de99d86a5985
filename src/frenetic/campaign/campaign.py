"""One search from the first road to the last: propose, fit, validate, drive, judge, store, tell."""

from __future__ import annotations

import json
import math
import platform
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

import numpy as np

from frenetic.campaign.budget import Budget
from frenetic.campaign.interrupt import catch_interrupt
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.campaign.tester import RoadTester
from frenetic.drivers.driver import Driver
from frenetic.errors import CampaignError, describe_error
from frenetic.outcome import Outcome
from frenetic.registry import USER_MODULE
from frenetic.road import MAP_SIZE, MARGIN
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.strategy import Strategy
from frenetic.simulators.simulator import Simulator

CAMPAIGNS: Final = Path("campaigns")
"""Where campaigns go that are given no folder."""
MAX_ERRORS_IN_A_ROW: Final = 10
"""Drives that may break one after the other before a campaign gives up."""
MAX_INVALID_IN_A_ROW: Final = 5_000
"""Refused roads one after the other after which a campaign gives up."""

PACKAGES: Final = ("frenetic-roads", "numpy", "numba", "scipy")
"""Distributions whose versions a campaign records: its results depend on them."""


@dataclass(frozen=True)
class Progress:
    """How far a campaign has come."""

    invalid: int = 0
    passed: int = 0
    failed: int = 0
    errors: int = 0
    min_moobd: float | None = None
    """m, of all drives so far."""
    seconds: float = 0.0
    """Of wall time since the start."""
    budget_spent: float = 0.0
    """0..1."""

    @property
    def simulations(self) -> int:
        """Drives, broken ones included."""
        return self.passed + self.failed + self.errors

    @property
    def tests(self) -> int:
        """Road tests, refused ones included."""
        return self.simulations + self.invalid

    @property
    def tests_per_second(self) -> float:
        """Road tests per second of wall time."""
        return self.tests / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Estimated from the share of the budget that is spent; None while nothing is."""
        if self.budget_spent <= 0.0:
            return None
        return self.seconds * (1.0 - self.budget_spent) / self.budget_spent


@dataclass(frozen=True)
class Summary(Progress):
    """What a campaign ended with."""

    seed: int | None = None
    folder: Path = field(default_factory=Path)
    interrupted: bool = False
    """Whether it was stopped before its budget was spent."""

    def as_json(self) -> dict[str, JSONValue]:
        """The summary as one JSON object."""
        return {
            "simulations": self.simulations,
            "invalid": self.invalid,
            "passed": self.passed,
            "failed": self.failed,
            "errors": self.errors,
            "min_moobd": self.min_moobd,
            "seconds": round(self.seconds, 3),
            "tests_per_second": round(self.tests_per_second, 1),
            "seed": self.seed,
            "interrupted": self.interrupted,
            "folder": str(self.folder),
        }


def new_folder(parent: Path = CAMPAIGNS) -> Path:
    """A folder in `parent` that does not exist yet, named after the date and time."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    folder = parent / stamp
    for number in range(2, 1000):
        if not folder.exists():
            break
        folder = parent / f"{stamp}-{number}"
    return folder


def package_versions() -> dict[str, str]:
    """Versions of Python and of what a campaign's results depend on."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


def describe(part: object) -> dict[str, JSONValue]:
    """A part of a campaign for its record: its class, its options, what it is laid over.

    The options are the part's ``options`` if it has any, or the fields of a dataclass.
    """
    kind = type(part)
    module = kind.__module__
    if module.startswith(USER_MODULE):
        module = Path(sys.modules[module].__file__ or module).name
    described: dict[str, JSONValue] = {"class": f"{module}:{kind.__qualname__}"}
    options = getattr(part, "options", None)
    if isinstance(options, Mapping):
        described["options"] = {str(name): _plain(value) for name, value in options.items()}
    elif is_dataclass(part):
        described["options"] = {
            item.name: _plain(getattr(part, item.name, None)) for item in fields(part)
        }
    inner = getattr(part, "driver", None)
    if isinstance(inner, Driver):
        described["driver"] = describe(inner)
    return described


def _plain(value: object) -> JSONValue:
    """A value as JSON, or else what it looks like."""
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)) and len(value) <= 100:
        return [_plain(item) for item in value]
    return repr(value)[:200]


class _Progressing:
    """How far a campaign has come, as it goes."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(Outcome, 0)
        self.told = 0
        self.min_moobd: float | None = None
        self.seconds = 0.0  # spent before this process went on
        self.budget_spent = 0.0
        self.outstanding: deque[Candidate] = deque()  # asked, not told

    @property
    def simulations(self) -> int:
        return self.told - self.counts[Outcome.INVALID]

    def count(self, outcome: Outcome, moobd: float | None) -> None:
        self.counts[outcome] += 1
        self.told += 1
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)

    def progress(self, seconds: float) -> Progress:
        return Progress(
            invalid=self.counts[Outcome.INVALID],
            passed=self.counts[Outcome.PASS],
            failed=self.counts[Outcome.FAIL],
            errors=self.counts[Outcome.ERROR],
            min_moobd=self.min_moobd,
            seconds=seconds,
            budget_spent=self.budget_spent,
        )


class Campaign:
    """One search with its budget.

    Args:
        strategy: proposes roads.
        simulator: drives them.
        driver: the system under test.
        budget: the first of its limits that is spent ends the campaign.
        folder: where results go, made if need be; a new one under ``campaigns/`` by default.
        map_size: m, side of the square map into which roads are fitted; by default the strategy's.
        margin: m that a road's centre line keeps from the map's edge.
        lane_width: m, of each of the two lanes.
        description: what else to record as the campaign's configuration.
    """

    def __init__(
        self,
        *,
        strategy: Strategy,
        simulator: Simulator,
        driver: Driver,
        budget: Budget,
        folder: Path | str | None = None,
        map_size: float | None = None,
        margin: float = MARGIN,
        lane_width: float = 4.0,
        description: Mapping[str, JSONValue] | None = None,
    ) -> None:
        options = getattr(strategy, "options", None)
        known = options if isinstance(options, Mapping) else {}
        theirs = known.get("map_size")
        if map_size is None:
            map_size = MAP_SIZE if theirs is None else theirs
        elif theirs is not None and theirs != map_size:
            raise ValueError(
                f"map_size is {map_size:g}, but the strategy was made for {theirs:g}: they have to"
                " agree"
            )
        self.strategy = strategy
        self.tester = RoadTester(simulator, driver, map_size, margin, lane_width)
        self.budget = budget
        self.folder = new_folder() if folder is None else Path(folder)
        self.seed: int | None = known.get("seed")
        self.started = False
        """Whether its folder and database are made."""
        self.description = dict(description or {})

    def configuration(self) -> dict[str, JSONValue]:
        """What the campaign's database records about it."""
        return {
            "seed": self.seed,
            "strategy": describe(self.strategy),
            "simulator": describe(self.tester.simulator),
            "driver": describe(self.tester.driver),
            "rules": asdict(self.tester.simulator.rules),
            "car": asdict(self.tester.simulator.car),
            "budget": asdict(self.budget),
            "map_size": self.tester.map_size,
            "margin": self.tester.margin,
            "lane_width": self.tester.lane_width,
            "versions": package_versions(),
            **self.description,
        }

    def run(
        self,
        on_progress: Callable[[Progress], None] | None = None,
        *,
        on_start: Callable[[], None] | None = None,
        on_interrupt: Callable[[], None] | None = None,
    ) -> Summary:
        """Searches until the budget is spent or Ctrl-C is pressed, and stores every test.

        The first Ctrl-C ends the campaign after the test at hand, the second at once.

        Args:
            on_progress: called after every test.
            on_start: called when the folder is made and the simulator has started; the budget's
                time begins here.
            on_interrupt: called at the first Ctrl-C.

        Raises:
            CampaignError: the folder cannot be used or written, it holds a campaign already, or
                nothing but broken drives or refused roads comes any more. What was stored stays.
        """
        with CampaignStore.create(self.folder, self.configuration()) as store:
            self.started = True
            return self._search(store, _Progressing(), on_progress, on_start, on_interrupt)

    def resume(
        self,
        on_progress: Callable[[Progress], None] | None = None,
        *,
        on_start: Callable[[], None] | None = None,
        on_interrupt: Callable[[], None] | None = None,
    ) -> Summary:
        """Goes on with the campaign in the folder, whatever ended it.

        The strategy, which has to be fresh, is asked and told what the log says; where it proposes
        other roads than it did, nothing is continued. A candidate that was asked but never told is
        tested next. With a budget in simulations, a campaign that was interrupted at any moment
        ends with the tests of one that was not. Time spent before counts.

        Args:
            on_progress: called after every test.
            on_start: called when the log is replayed and the simulator has started.
            on_interrupt: called at the first Ctrl-C.

        Raises:
            CampaignError: there is no such campaign, another process writes it, it was made with
                other parts, the strategy replays differently, or as for `run`.
        """
        with CampaignStore.open(self.folder, readonly=False) as store:
            self._require_same_parts(store.config)
            state = self._replay(store)
            self.started = True
            return self._search(store, state, on_progress, on_start, on_interrupt)

    def _require_same_parts(self, config: Mapping[str, JSONValue]) -> None:
        """Raises a `CampaignError` if a log was not made by parts like these."""
        ours = json.loads(json.dumps(self.configuration()))
        for name in (
            "strategy",
            "driver",
            "simulator",
            "rules",
            "map_size",
            "margin",
            "lane_width",
        ):
            if ours[name] != config.get(name):
                raise CampaignError(
                    f"{self.folder} was made with another {name.replace('_', ' ')}:"
                    f" {json.dumps(config.get(name))[:300]}, not {json.dumps(ours[name])[:300]}"
                )

    def _replay(self, store: CampaignStore) -> _Progressing:
        """Asks and tells the strategy what the log says; returns how far that brought it."""
        state = _Progressing()
        asked = store.candidates_with_place()
        following = next(asked, None)
        outstanding: dict[int, Candidate] = {}

        def ask_until(told: int) -> None:
            nonlocal following
            while following is not None and following[1] <= told:
                logged = following[0]
                self._require_same_road(store, logged, self._ask())
                outstanding[logged.id] = logged
                following = next(asked, None)

        for record in store.tests():
            ask_until(state.told)
            candidate = outstanding.pop(record.candidate.id, None)
            if candidate is None:
                raise CampaignError(
                    f"{self.folder} is damaged: candidate {record.candidate.id} was told before it"
                    " was asked"
                )
            evaluation = Evaluation(candidate, record.outcome, record.moobd, record.budget_spent)
            self._tell(evaluation)
            state.count(record.outcome, record.moobd)
            state.seconds += record.seconds
        ask_until(state.told)
        state.outstanding.extend(outstanding.values())
        state.budget_spent = self.budget.spent(
            state.simulations, state.seconds, state.counts[Outcome.FAIL]
        )
        return state

    def _require_same_road(
        self, store: CampaignStore, logged: Candidate, proposed: Candidate
    ) -> None:
        same = (
            proposed.id == logged.id
            and proposed.step == logged.step
            and proposed.origin == logged.origin
            and np.array_equal(proposed.curvatures, logged.curvatures)
        )
        if same:
            return
        theirs = store.config.get("versions")
        ours = package_versions()
        differing = (
            [f"{k} {v}, now {ours.get(k)}" for k, v in theirs.items() if ours.get(k) != v]
            if isinstance(theirs, Mapping)
            else []
        )
        raise CampaignError(
            f"{self.folder} cannot be resumed: the strategy now proposes another road as candidate"
            f" {logged.id} than it did; "
            + (f"versions differ: {', '.join(differing)}" if differing else "was it changed?")
        )

    def _search(
        self,
        store: CampaignStore,
        state: _Progressing,
        on_progress: Callable[[Progress], None] | None,
        on_start: Callable[[], None] | None,
        on_interrupt: Callable[[], None] | None,
    ) -> Summary:
        """Tests until the budget is spent; the rest of `run` and `resume`."""
        interrupted = False
        start = time.perf_counter() - state.seconds
        try:
            with catch_interrupt(on_interrupt) as interrupt, self.tester.simulator:
                if on_start is not None:
                    on_start()
                start = time.perf_counter() - state.seconds
                for progress in self._tests(store, state, start):
                    if on_progress is not None:
                        on_progress(progress)
                    if interrupt.requested and state.budget_spent < 1.0:
                        interrupted = True
                        break
        except (KeyboardInterrupt, SystemError) as error:
            # Raised while compiled code returns, an interrupt arrives as its SystemError.
            if not isinstance(error.__cause__ or error, KeyboardInterrupt):
                raise
            interrupted = True
        # What is stored counts, also when an interrupt came between storing and counting.
        stored = store.counts()
        summary = Summary(
            invalid=stored.by_outcome[Outcome.INVALID],
            passed=stored.by_outcome[Outcome.PASS],
            failed=stored.by_outcome[Outcome.FAIL],
            errors=stored.by_outcome[Outcome.ERROR],
            min_moobd=stored.lowest_moobd,
            seconds=time.perf_counter() - start,
            budget_spent=state.budget_spent,
            seed=self.seed,
            folder=self.folder,
            interrupted=interrupted,
        )
        store.finish(
            seconds=round(summary.seconds, 3),
            interrupted=interrupted,
            budget=asdict(self.budget),
        )
        return summary

    def _ask(self) -> Candidate:
        try:
            candidate = self.strategy.ask()
        except Exception as error:
            raise CampaignError(f"the strategy raised {describe_error(error)}") from error
        if not isinstance(candidate, Candidate):
            raise CampaignError(
                f"the strategy proposed {type(candidate).__name__} instead of frenetic.Candidate"
            )
        if not (np.isfinite(candidate.curvatures).all() and np.isfinite(candidate.step)):
            raise CampaignError(
                f"the strategy proposed candidate {candidate.id} with values that are not finite"
            )
        return candidate

    def _tell(self, evaluation: Evaluation) -> None:
        try:
            self.strategy.tell(evaluation)
        except Exception as error:
            raise CampaignError(f"the strategy raised {describe_error(error)}") from error

    def _tests(self, store: CampaignStore, state: _Progressing, start: float) -> Iterator[Progress]:
        """Runs test after test; yields how far the campaign has come after each."""
        broken = refused = 0
        while state.budget_spent < 1.0:
            before = time.perf_counter()
            if state.outstanding:
                candidate = state.outstanding.popleft()
            else:
                candidate = self._ask()
                store.asked(candidate)
            tested = self.tester.test(candidate)
            result = tested.result
            state.count(result.outcome, result.moobd)
            now = time.perf_counter()
            state.budget_spent = self.budget.spent(
                state.simulations, now - start, state.counts[Outcome.FAIL]
            )
            store.told(tested.record(candidate, state.told, state.budget_spent, now - before))
            self._tell(Evaluation(candidate, result.outcome, result.moobd, state.budget_spent))
            yield state.progress(time.perf_counter() - start)
            if result.outcome is Outcome.INVALID:
                refused += 1
            elif result.outcome is Outcome.ERROR:
                broken, refused = broken + 1, 0
            else:
                broken = refused = 0
            if broken >= MAX_ERRORS_IN_A_ROW:
                raise CampaignError(
                    f"the last {broken} drives broke, so the campaign gives up: {result.reason}"
                )
            if refused >= MAX_INVALID_IN_A_ROW:
                raise CampaignError(
                    f"the last {refused} roads were refused, so the campaign gives up:"
                    f" {result.reason}; is a map of {self.tester.map_size:g} m too small?"
                )
