"""Comparison of generators and strategies, with repeats, on the same terms."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Self

import msgspec
from filelock import FileLock

from frenetic import trust
from frenetic._support.files import write_file
from frenetic._support.words import counted, format_duration
from frenetic.analysis.comparison import Comparison, compare, compare_measured
from frenetic.analysis.metrics import measure_campaign
from frenetic.bench.entrants import Entrant, folder_names, read_path, require_trusted
from frenetic.bench.processes import run_all
from frenetic.bench.runs import Run, RunState, Terms, compile_measures, ending_of, try_out
from frenetic.bench.strategy import End
from frenetic.campaign import campaign
from frenetic.campaign.lock import lock_file
from frenetic.campaign.summary import Summary
from frenetic.errors import FreneticError
from frenetic.registry import STRATEGIES
from frenetic.run_file import drive_entries, write_entries
from frenetic.simulators.embedded import compile_kernels
from frenetic.spec import Spec, decode_command, describe, require_count
from frenetic.versions import differences, package_versions

BENCHES: Final = Path("benches")
"""Default parent of benches' folders."""
BENCH: Final = "bench.json"
"""Name of the file in a bench's folder that describes it."""
LOCK: Final = "bench.lock"
FILE: Final = "bench.toml"
"""Name of the file in it that repeats it, see `frenetic.bench.file`."""
VERSION: Final = 2
"""Version of the file's form."""
TERMS: Final = (
    "budget",
    "seconds_per_test",
    "counts_computing",
    "patience",
    "objective",
)
"""Names of the terms in it that stand there as they are."""


@dataclass(frozen=True)
class BenchProgress:
    """Progress of a bench."""

    runs: int
    """Number of complete runs."""
    runs_in_all: int
    simulations: int
    """Number of simulations in this session's runs."""
    failures: int
    share: float
    """Spent share 0..1 of all runs' budgets."""

    def in_words(self, seconds: float) -> str:
        """Progress in one line, after so many s."""
        left = "?"
        if self.share > 0.0:
            left = format_duration(seconds * (1.0 - self.share) / self.share)
        return (
            f"runs {self.runs} of {self.runs_in_all}, simulations {self.simulations}, failures"
            f" {self.failures}, {self.simulations / max(seconds, 1e-3):.0f} simulations/s,"
            f" {left} left"
        )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A bench: its entrants, terms, repeats and folder.

    Run k of an entrant has the seed ``seed + k - 1``; so the runs with one number share it.
    """

    entrants: tuple[Entrant, ...]
    terms: Terms
    repeats: int = 10
    seed: int = 1
    folder: Path = field(default_factory=lambda: new_folder())
    """Its folder; a text is taken, too."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))
        for name, least in (("repeats", 1), ("seed", 0)):
            try:
                number = require_count(name, getattr(self, name), least)
            except ValueError as error:
                raise FreneticError(str(error)) from None
            object.__setattr__(self, name, number)
        if not self.entrants:
            raise FreneticError("nobody takes part: name a generator or a strategy")
        object.__setattr__(self, "entrants", tuple(one.absolute() for one in self.entrants))
        folder_names(self.entrants)
        for entrant in self.entrants:
            if entrant.is_strategy:
                available = {"seed": self.seed, "map_size": self.terms.map_size}
                STRATEGIES.make_from(entrant.spec, entrant.options, available)

    @classmethod
    def open(cls, folder: Path | str) -> Self:
        """The bench in a folder.

        Raises:
            FreneticError: there is none, it is damaged, or it was begun from Python.
        """
        folder = Path(folder)
        document, path = read_bench(folder), folder / BENCH
        if document.get("command") == {}:
            raise FreneticError(
                f"{folder} was begun from Python, so its driver and simulator have no names: go on"
                " from Python"
            )
        recorded = _decoded(document, path)
        try:
            command = decode_command(recorded.command, "driver", "simulator")
        except ValueError as error:
            raise _damaged(path, f"its command: {error}") from None
        spec = Spec.from_options({**command, "map_size": recorded.map_size})
        spec.require_trusted(folder)
        require_trusted(recorded.entrants, folder)
        return cls(
            entrants=recorded.entrants,
            terms=Terms.of(spec, **{name: getattr(recorded, name) for name in TERMS}),
            repeats=recorded.repeats,
            seed=recorded.seed,
            folder=folder,
        )

    @property
    def runs(self) -> list[Run]:
        """All runs; the first of every entrant come first, for early results of all."""
        names = folder_names(self.entrants)
        return [
            Run(
                entrant,
                repeat,
                self.seed + repeat - 1,
                self.folder / names[entrant.name] / f"{repeat:02d}",
            )
            for repeat in range(1, self.repeats + 1)
            for entrant in self.entrants
        ]

    @property
    def runs_in_words(self) -> str:
        """Numbers of runs and of simulations of an entrant."""
        most = "at most " if self.terms.counts_computing else ""
        return f"{counted(self.repeats, 'run')} of {most}{self.terms.simulations} simulations"

    def states(self) -> list[RunState]:
        """All runs with their results.

        Raises:
            CampaignError: one is damaged.
        """
        return [RunState(run, ending_of(run.folder)) for run in self.runs]

    def run(
        self,
        *,
        resume: bool = False,
        workers: int = 1,
        on_start: Callable[[], None] | None = None,
        on_progress: Callable[[BenchProgress], None] | None = None,
        on_end: Callable[[RunState], None] | None = None,
        on_interrupt: Callable[[], None] | None = None,
    ) -> list[RunState]:
        """Completes all runs; returns their states.

        Each generator is built once beforehand, so an unbuildable one is noticed at once.

        Args:
            resume: whether the folder holds this bench already, to be completed.
            workers: runs at once.
            on_start: called before the first run.
            on_progress: called now and then.
            on_end: called after each run.
            on_interrupt: called at the first Ctrl-C, after which no run begins.

        Raises:
            ValueError: ``workers`` is no whole number of at least 1.
            FreneticError: the folder holds something else, another process uses it, a generator
                cannot be built, or the simulator does not start.
        """
        require_count("workers", workers)
        with ExitStack() as stack:
            campaign.prepare(self.terms.simulator)
            compile_kernels()
            compile_measures()
            if resume:
                self._require_same()
            else:
                self._require_new_folder()
            to_do = [state.run.entrant for state in self.states() if state.ending is None]
            for entrant in self.entrants:
                if entrant in to_do and not entrant.is_strategy:
                    try_out(entrant, self.terms, self.seed)
                trust.remember(entrant.kind, *entrant.code)
            stack.enter_context(_locked(self.folder))
            if not resume:
                self._write()
            if on_start is not None:
                on_start()
            return self._run(workers, on_progress, on_end, on_interrupt)

    def _run(
        self,
        workers: int,
        on_progress: Callable[[BenchProgress], None] | None,
        on_end: Callable[[RunState], None] | None,
        on_interrupt: Callable[[], None] | None,
    ) -> list[RunState]:
        states = self.states()
        to_do = [state.run for state in states if state.ending is None]
        done = len(states) - len(to_do)
        progress: dict[Path, Summary] = {}
        ends: dict[Path, RunState] = {}
        events = run_all(to_do, self.terms, workers=workers, on_interrupt=on_interrupt)
        with closing(events):
            for run, event in events:
                if isinstance(event, Summary):
                    progress[run.folder] = event
                else:
                    ends[run.folder] = event
                    if on_end is not None:
                        on_end(event)
                if on_progress is None:
                    continue
                shares = (p.budget_spent for f, p in progress.items() if f not in ends)
                on_progress(
                    BenchProgress(
                        runs=done + len(ends),
                        runs_in_all=len(states),
                        simulations=sum(one.simulations for one in progress.values()),
                        failures=sum(one.failed for one in progress.values()),
                        share=(done + len(ends) + sum(shares)) / len(states),
                    )
                )
        return list(ends.values())

    def comparison(self) -> Comparison:
        """The comparison of the entrants by their complete runs.

        Raises:
            FreneticError: no entrant has a complete run.
        """
        groups: dict[str, list[Path]] = {}
        for state in self.states():
            if state.ending is not None:
                groups.setdefault(state.run.entrant.name, []).append(state.run.folder)
        ordered = {e.name: groups[e.name] for e in self.entrants if e.name in groups}
        if len(ordered) == 1:
            measured = {n: tuple(map(measure_campaign, f)) for n, f in ordered.items()}
            comparison = compare_measured(measured)
        else:
            comparison = compare(ordered)
        short = endings_in_short(self.states())
        return replace(comparison, notes=(*([short] if short else []), *comparison.notes))

    @property
    def file(self) -> Path | None:
        """Its file; None for parts without names, which came from Python."""
        return None if self.terms.spec is None else self.folder / FILE

    def as_json(self) -> dict[str, Any]:
        """The description for the bench's folder."""
        terms = self.terms
        return {
            "version": VERSION,
            "entrants": [entrant.as_json() for entrant in self.entrants],
            "repeats": self.repeats,
            "seed": self.seed,
            **{name: getattr(terms, name) for name in TERMS},
            "map_size": terms.map_size,
            "simulator": describe(terms.simulator),
            "driver": describe(terms.driver),
            "rules": asdict(terms.simulator.rules),
            "command": terms.spec.command() if terms.spec is not None else {},
        }

    def _require_new_folder(self) -> None:
        if os.path.lexists(self.folder) and (
            not self.folder.is_dir() or any(child.name != LOCK for child in self.folder.iterdir())
        ):
            raise FreneticError(
                f"{self.folder} is not empty: choose another place, or go on with the bench in it"
            )

    def _require_same(self) -> None:
        theirs, ours = read_bench(self.folder), json.loads(json.dumps(self.as_json()))
        recorded = _decoded(theirs, self.folder / BENCH)
        for entrant, begun in zip(recorded.entrants, theirs["entrants"], strict=True):
            if entrant.source() != begun.get("source"):
                raise FreneticError(
                    f"the source of {entrant.name} is not what the bench in {self.folder} was"
                    " begun with: restore it, or begin a new bench"
                )
        for name in ("simulator", "driver"):
            if changed := differences(name, theirs.get(name), ours.pop(name)):
                raise FreneticError(
                    f"{self.folder} holds a bench with another {name}: {'; '.join(changed)[:1000]};"
                    " restore it, or begin a new bench"
                )
        for name, value in ours.items():
            if theirs.get(name) != value:
                raise FreneticError(
                    f"{self.folder} holds a bench with another {name.replace('_', ' ')}:"
                    f" {json.dumps(theirs.get(name))[:200]}, not {json.dumps(value)[:200]}"
                )

    def _write(self) -> None:
        document = self.as_json() | {
            "created_at": datetime.now().astimezone().isoformat(timespec="seconds"),
            "versions": package_versions(),
        }
        path = self.folder / BENCH
        write_file(
            path,
            json.dumps(document, indent=1) + "\n",
            remedy="choose another place",
            durable=True,
        )
        if self.file is not None:
            assert self.terms.spec is not None
            write_entries(
                self._entries(self.terms.spec),
                self.file,
                f"What ran in this folder; 'frenetic bench {FILE}' does it again in another.",
            )

    def _entries(self, spec: Spec) -> dict[str, Any]:
        """The entries of its file."""
        terms = self.terms
        return {
            "generator": [one.word for one in self.entrants if not one.is_strategy],
            "strategy": [one.word for one in self.entrants if one.is_strategy],
            **drive_entries(spec),
            "objective": terms.objective,
            "time": terms.budget,
            "seconds_per_test": terms.seconds_per_test,
            "count_computing": terms.counts_computing,
            "patience": terms.patience,
            "repeats": self.repeats,
            "seed": self.seed,
        }


def unusual_endings(states: Sequence[RunState]) -> dict[str, str]:
    """Name of each entrant with runs that did not end by the budget -> how, with the reasons."""
    found: dict[str, str] = {}
    for name, runs in _by_entrant(states).items():
        reasons = Counter(
            str(state.ending or "not run") for state in runs if str(state.ending) != End.OVER
        )
        told = [f"{count} of {len(runs)} runs {why}" for why, count in reasons.most_common(3)]
        if threads := sum(state.ending.threads for state in runs if state.ending is not None):
            told.append(f"{threads} threads left running")
        if told:
            found[name] = "; ".join(told)
    return found


def endings_in_short(states: Sequence[RunState]) -> str:
    """The entrants some of whose runs did not end by the budget, in a line; empty if none."""
    told = []
    for name, runs in _by_entrant(states).items():
        ends = Counter(str(state.ending.end) for state in runs if state.ending is not None)
        done = ends.total()
        ends.pop(End.OVER, None)
        if ends:
            kinds = " and ".join(f"{end} in {count}" for end, count in ends.most_common())
            told.append(f"{name} ({kinds} of {done} runs)")
    return f"Ended before the budget: {', '.join(told)}" if told else ""


def _by_entrant(states: Sequence[RunState]) -> dict[str, list[RunState]]:
    found: dict[str, list[RunState]] = {}
    for state in states:
        found.setdefault(state.run.entrant.name, []).append(state)
    return found


def new_folder() -> Path:
    """A new folder for a bench, named after the date and time."""
    return campaign.new_folder(BENCHES)


@dataclass(frozen=True, kw_only=True)
class _Recorded:
    """The part of a bench's file that resuming needs."""

    entrants: tuple[Entrant, ...]
    repeats: int
    seed: int
    budget: float
    seconds_per_test: float
    counts_computing: bool
    patience: float
    map_size: float
    command: dict[str, Any]
    objective: str


def read_bench(folder: Path | str) -> Mapping[str, Any]:
    """The description in a bench's folder.

    Raises:
        FreneticError: there is none, or it is damaged or of another version.
    """
    path = Path(folder) / BENCH
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FreneticError(f"{folder} holds no bench: give the folder of one") from None
    except OSError as error:
        raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not isinstance(document.get("version"), int):
        raise _damaged(path)
    if document["version"] != VERSION:
        raise FreneticError(
            f"{path} has format {document['version']}, this version of frenetic reads format"
            f" {VERSION}: begin a new bench, or use the version that wrote it"
        )
    return document


def _decoded(document: Mapping[str, Any], path: Path) -> _Recorded:
    try:
        return msgspec.convert(document, _Recorded, dec_hook=read_path)
    except msgspec.ValidationError as error:
        raise _damaged(path, str(error)) from None


def _damaged(path: Path, why: str = "") -> FreneticError:
    reason = f" ({why})" if why else ""
    return FreneticError(f"{path} is damaged{reason}: restore it from a copy, or begin a new bench")


def _locked(folder: Path) -> FileLock:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FreneticError(
            f"cannot make the folder {folder}: {error.strerror or error}; choose another place"
        ) from error
    return lock_file(folder / LOCK)
