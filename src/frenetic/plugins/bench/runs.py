"""A run of a bench: one entrant with one seed, as a campaign."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Final

import msgspec
import numpy as np
from msgspec import structs

from frenetic._support.bounds import Count, Index, Positive, check
from frenetic._support.json_value import JSONValue
from frenetic._support.option_text import part_word
from frenetic._support.words import format_duration
from frenetic.analysis.sparseness import largest_distances, unlike_lines
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.configuration import Owner
from frenetic.campaign.database import DATABASE
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.errors import FreneticError, StrategyError
from frenetic.plugins.bench.entrants import Entrant
from frenetic.plugins.bench.generator import GeneratorProcess
from frenetic.plugins.bench.strategy import (
    End,
    GeneratorStrategy,
    RunEnding,
)
from frenetic.rerun.stability_study import FRICTION, study_stability_with
from frenetic.road import Road, check_validity
from frenetic.road.validity import interpolate, min_radius, overlaps_itself
from frenetic.search import Strategy
from frenetic.simulators.conditions import check_can_vary
from frenetic.spec import USUAL, Budget, Spec

WORK: Final = "work"
"""Folder, in a run's folder, that is its generator's working directory."""
RESULTS: Final = "results"
"""Folder, in `WORK`, that a generator sees as the pipeline's results folder."""
GENERATOR_LOG: Final = "generator.log"
"""Name of the file, in a run's folder, with the output of its generator."""
ENDING_FACT: Final = "bench"
"""Name of the campaign's fact with the end of its run in a bench."""

_NEVER_COPIED: Final = (".git", "__pycache__")  # names of files and folders
_MAX_ERROR_LENGTH: Final = 300  # letters: an error of copying lists every file
_MAX_LINE_LENGTH: Final = 200  # letters of a generator's output in an error
_SEED_RANGE: Final = 2**32  # numpy's `random.seed` takes smaller numbers

DEFAULT_SIMULATIONS: Final = 200
"""Budget of each run of a bench without any limit, in drives (our choice)."""
RUN_LIMITS: Final = ("simulations", "kilometres", "simulated_time")
"""Limits of a `Budget` that the runs of a bench may have: none depends on a computer's speed."""
TYPICAL_LENGTH: Final = 0.2
"""Length of a road with which kilometres become virtual time, in km (our choice)."""

OnProgress = Callable[[Summary], None]


@dataclass(frozen=True)
class RunTerms:
    """Terms of all runs of a bench."""

    tester: RoadTester
    """Tester of the roads of every run."""
    _: KW_ONLY
    simulations: Count | None = None
    """Budget of each run, in drives; `DEFAULT_SIMULATIONS` without any limit."""
    kilometres: Positive | None = None
    """Budget of each run, in km of driven road; None without this limit."""
    simulated_time: Positive | None = None
    """Budget of each run, in s of simulated time; None without this limit."""
    seconds_per_test: Positive = 36.0
    """Virtual time that each executed test costs, as a generator sees it, in s."""
    patience: Positive = 600.0
    """Wall time that a generator may take between two tests, in s."""
    stability: Index = 0
    """Number of failures of each run, evenly spaced, whose stability is studied, see
    `frenetic.rerun.stability_study`."""
    objective: str = MOOBD
    """Name of the objective that the strategies minimise; a generator has its own."""

    def __post_init__(self) -> None:
        Objective.load(self.objective)
        if not any(getattr(self, name) is not None for name in RUN_LIMITS):
            object.__setattr__(self, "simulations", DEFAULT_SIMULATIONS)
        checked = (*RUN_LIMITS, "seconds_per_test", "patience", "stability")
        check({name: getattr(self, name) for name in checked}, RunTerms)
        if self.stability:
            check_can_vary(self.tester.simulator, [FRICTION])

    @property
    def budget(self) -> Budget:
        """Limits of each run, of which the first that is reached ends it."""
        return Budget(**{name: getattr(self, name) for name in RUN_LIMITS})

    @property
    def time(self) -> float:
        """Budget of each run as virtual time, in s.

        It passes as the budget is spent. Without a number of simulations it is the simulated time,
        or what so many kilometres cost on roads of `TYPICAL_LENGTH`.
        """
        if self.simulations is not None:
            return self.simulations * self.seconds_per_test
        if self.simulated_time is not None:
            return self.simulated_time
        assert self.kilometres is not None, "there is a limit"
        return self.kilometres / TYPICAL_LENGTH * self.seconds_per_test

    @property
    def clock_text(self) -> str:
        """Text about the virtual clock and what makes it go on."""
        time = format_duration(self.time)
        if self.kilometres is None and self.simulated_time is None:
            cost = f"of which each simulation costs {self.seconds_per_test:g} s"
        else:
            cost = f"which passes as the budget is spent, {self.budget}"
        return f"{time}, {cost}; the time that a generator computes is free"

    def make_strategy(self, entrant: Entrant, seed: int) -> Strategy:
        """Make the strategy of an entrant, as `Campaign.of` makes the strategy of a spec.

        Raises:
            FreneticError: the strategy cannot be made.
        """
        tester = self.tester
        spec = structs.replace(
            Spec() if tester.spec is None else Spec.of(USUAL, tester.spec),
            strategy=part_word(entrant.spec, entrant.options),
            seed=seed,
            objective=self.objective,
            # All entrants search the competition's roads.
            roads=None,
            odd=None,
            map_size=tester.terms.map_size,
            lane_width=tester.terms.lane_width,
        )
        return spec.make_strategy(driver=tester.driver, simulator=tester.simulator)


@dataclass(frozen=True)
class EntrantRun:
    """An entrant with a seed."""

    entrant: Entrant
    repeat: int
    """Number of the entrant's run, from 1."""
    seed: int
    folder: Path
    """Folder of this run alone, which becomes a campaign's."""

    @property
    def name(self) -> str:
        """Entrant and number, for messages."""
        return f"{self.entrant.name}, run {self.repeat}"


@dataclass(frozen=True)
class RunState:
    """A run and its result."""

    run: EntrantRun
    ending: RunEnding | None
    """End of the run; None if it is not complete."""
    trouble: str = ""
    """Reason why the last try did not complete it, in one line."""

    def as_json(self) -> dict[str, JSONValue]:
        """Return the run as a JSON object."""
        return {
            "generator": self.run.entrant.name,
            "run": self.run.repeat,
            "seed": self.run.seed,
            "folder": str(self.run.folder),
            "ending": msgspec.to_builtins(self.ending),
        }


def run_entrant(
    run: EntrantRun, terms: RunTerms, on_progress: OnProgress | None = None
) -> RunEnding:
    """Run an entrant until its budget is spent, or until it ends otherwise.

    What an interrupted run has left in the folder is deleted: a run is not resumed.

    Args:
        run: the entrant with its seed and folder.
        terms: terms of the bench.
        on_progress: called after every test.

    Raises:
        FreneticError: the simulator does not start, or the folder cannot be written.
    """
    try:
        if run.folder.is_dir():
            shutil.rmtree(run.folder)
    except OSError as error:
        raise FreneticError(
            f"{run.folder} cannot be cleared for a new run: {error.strerror or error}"
        ) from None
    facts: dict[str, Any] = {"seconds_per_test": terms.seconds_per_test}
    if run.entrant.is_strategy:
        strategy = terms.make_strategy(run.entrant, run.seed)
        ending = _search(_campaign(run, terms, strategy), on_progress)
    else:
        with hosted_generator(run, terms) as generator:
            campaign = _campaign(run, terms, generator, {"strategy": _strategy_record(run)})
            ending = _search(campaign, on_progress)
            if ending is None or ending.end is not End.GAVE_UP:
                ending = generator.dismiss()
        facts["strategy_seconds"] = round(generator.computing, 4)
    if terms.stability:
        is_isolated = terms.tester.spec is not None
        study_stability_with(run.folder, terms.tester, most=terms.stability, isolate=is_isolated)
    ending = ending or RunEnding(End.OVER)
    facts[ENDING_FACT] = msgspec.to_builtins(ending)
    with CampaignStore.open(run.folder, readonly=False) as store:
        store.finish(finished_at=store.facts["finished_at"], **facts)
    return ending


def ending_of(folder: Path) -> RunEnding | None:
    """Return the end of the run in a folder; None if the run is not complete.

    Raises:
        CampaignError: the run's campaign is damaged.
    """
    if not (folder / DATABASE).is_file():
        return None
    with CampaignStore.open(folder) as store:
        fact = store.facts.get(ENDING_FACT)
    try:
        return msgspec.convert(fact, RunEnding)
    except msgspec.ValidationError:
        return None


@contextmanager
def hosted_generator(run: EntrantRun, terms: RunTerms) -> Iterator[GeneratorStrategy]:
    """Start a generator's process, and yield the strategy that proposes its roads.

    The strategy has an ``ending`` if the generator could not be built.

    Args:
        run: the generator, the seed of `random` and numpy in its process, and the folder for its
            working directory and output.
        terms: terms of the bench.

    Raises:
        OSError: the generator's folder cannot be copied, its log cannot be written, or its process
            cannot be started.
    """
    work = run.folder.absolute() / WORK
    if run.entrant.copy is not None:
        _copy(run.entrant.copy, work)
    (work / RESULTS).mkdir(parents=True, exist_ok=True)
    process = GeneratorProcess(
        assignment(run, terms),
        folder=work,
        log=run.folder / GENERATOR_LOG,
        python=run.entrant.python,
    )
    with process:
        strategy = GeneratorStrategy(
            process,
            terms.tester,
            time_budget=terms.time,
            patience=terms.patience,
            seed=run.seed,
        )
        strategy.start()
        yield strategy


def try_out(entrant: Entrant, terms: RunTerms, seed: int) -> None:
    """Build a generator in a temporary folder, and end it.

    Raises:
        FreneticError: the generator cannot be built.
    """
    with TemporaryDirectory(prefix="frenetic-bench-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        run = EntrantRun(entrant, repeat=1, seed=seed, folder=folder)
        try:
            with hosted_generator(run, terms) as generator:
                ending = generator.ending
        except OSError as error:
            reason = str(error.strerror or error)[:_MAX_ERROR_LENGTH]
            raise FreneticError(f"{entrant.name} cannot be started: {reason}") from None
        if ending is None:
            return
        log = (folder / GENERATOR_LOG).read_text(encoding="utf-8", errors="replace")
    message = f"{entrant.name} cannot be built: {ending.detail or ending.end}"
    # A process that ended before it could say why may have printed the reason.
    lines = log.strip().splitlines() if ending.detail.startswith("its process") else []
    if lines:
        message += f" ({lines[-1][:_MAX_LINE_LENGTH]})"
        if entrant.python is not None:
            message += "; its interpreter needs Python 3.9 or newer and numpy"
    raise FreneticError(message)


@cache
def compile_measures() -> None:
    """Compile the kernels of validity and sparseness once, before several runs start.

    The kernels are called with roads of arbitrary points: only the types matter.
    """
    points = np.column_stack([np.linspace(0.0, 60.0, 31), 5.0 * np.sin(np.linspace(0.0, 6.0, 31))])
    for road_points in (points, points[::10]):
        Road.from_points(road_points)
    check_validity(points)
    min_radius(interpolate(points))
    overlaps_itself(points, points + 4.0)
    segments = [points, 1.5 * points, points[:-4].copy()]
    largest_distances(segments)
    unlike_lines(segments)


def _strategy_record(run: EntrantRun) -> dict[str, JSONValue]:
    """Return a generator as a campaign records its strategy."""
    entrant = run.entrant
    module = Path(entrant.module).name if entrant.module.endswith(".py") else entrant.module
    path: dict[str, JSONValue] = {} if entrant.path is None else {"path": str(entrant.path)}
    return {"class": f"{module}:{entrant.class_name}", "options": {**path, "seed": run.seed}}


def assignment(run: EntrantRun, terms: RunTerms) -> dict[str, Any]:
    """Return the first message to a generator's process, see `frenetic.plugins.bench.host`."""
    entrant, setting = run.entrant, terms.tester.setting
    rules, map_size = setting.rules_in({}), setting.map_size
    work = run.folder.absolute() / WORK

    def path_text(path: Path | None) -> str | None:
        return None if path is None else str(_in_copy(path, entrant, work))

    is_file = entrant.module.endswith(".py")
    return {
        "module": path_text(Path(entrant.module)) if is_file else entrant.module,
        "class_name": entrant.class_name,
        "path": path_text(entrant.path),
        "pipeline": path_text(entrant.own_pipeline),
        "seed": run.seed % _SEED_RANGE,
        "map_size": int(map_size) if map_size == int(map_size) else map_size,  # as the pipeline has
        "time_budget": terms.time,
        "seconds_per_test": terms.seconds_per_test,
        "oob_tolerance": rules.oob_tolerance,
        "speed_limit": rules.speed_limit,
        "result_folder": str(work / RESULTS),
    }


def _in_copy(path: Path, entrant: Entrant, work: Path) -> Path:
    """Return where a generator's file or folder lies in the run's copy, if there is a copy of it.

    Args:
        path: absolute path of the file or folder.
        entrant: the generator.
        work: the run's copy of the folder ``entrant.copy``.
    """
    if entrant.copy is not None and path.is_relative_to(entrant.copy):
        return work / path.relative_to(entrant.copy)
    return path


def _copy(source: Path, target: Path) -> None:
    """Copy a folder without repositories, virtual environments and folders that hold the target."""
    target_and_parents = {target.resolve(), *target.resolve().parents}

    def is_left_out(path: Path) -> bool:
        is_environment = (path / "pyvenv.cfg").is_file()
        return path.name in _NEVER_COPIED or is_environment or path.resolve() in target_and_parents

    def left_out(folder: str, names: list[str]) -> list[str]:
        return [name for name in names if is_left_out(Path(folder, name))]

    shutil.copytree(
        source, target, ignore=left_out, ignore_dangling_symlinks=True, dirs_exist_ok=True
    )


def _campaign(
    run: EntrantRun,
    terms: RunTerms,
    strategy: Strategy,
    more_entries: Mapping[str, JSONValue] = MappingProxyType({}),
) -> Campaign:
    """Return the campaign of a run.

    Args:
        run: the run.
        terms: terms of the bench.
        strategy: the entrant's strategy, or the generator's.
        more_entries: further entries of the campaign's configuration.
    """
    budget: JSONValue = {"time": terms.time, "seconds_per_test": terms.seconds_per_test}
    entrant: JSONValue = {**run.entrant.as_json(), "budget": budget}
    owner = Owner(
        summary="is a run of a bench, which keeps its budget",
        advice="what a bench lacks is run by 'frenetic bench --resume --out BENCH'",
        resume=("bench", "--resume", "--out"),
        levels_up=2,
        time_budget=terms.time,
    )
    tester, spec = terms.tester, terms.tester.spec
    if spec is not None:
        name = part_word(run.entrant.spec, run.entrant.options)
        spec = structs.replace(spec, strategy=name, seed=run.seed)
    with tester.in_folder():
        return Campaign(
            strategy=strategy,
            simulator=tester.simulator,
            driver=tester.driver,
            terms=tester.terms,
            budget=terms.budget,
            folder=run.folder,
            isolate=spec is not None,
            objective=terms.objective,
            description={"seed": run.seed, "entrant": entrant, **owner.entry(), **more_entries},
            spec=spec,
        )


def _search(campaign: Campaign, on_progress: OnProgress | None) -> RunEnding | None:
    """Run a campaign; return its end, None if its budget was spent."""

    def report_result(event: Event) -> None:
        if on_progress is not None and event.kind == "result":
            on_progress(event.summary)

    try:
        summary = campaign.run(on_event=report_result)
    except StrategyError as error:
        # A run is never resumed, so its campaign counts as finished.
        with CampaignStore.open(campaign.folder, readonly=False) as store:
            seconds = round(store.elapsed(), 3)
            store.finish(seconds=seconds, interrupted=False, ended=str(error))
        return RunEnding(End.GAVE_UP, str(error))
    return RunEnding(End.RETURNED, summary.ended) if summary.ended else None
