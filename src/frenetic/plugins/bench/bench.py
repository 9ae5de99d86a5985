"""A bench: generators and strategies that are compared, with repeats, on the same terms."""

from __future__ import annotations

import json
import logging
import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
from filelock import FileLock

from frenetic._support.bounds import Count, Index, check
from frenetic._support.files import FolderInUse, open_file, write_file
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted
from frenetic.analysis.campaign_measures import measure_campaign
from frenetic.analysis.comparison import (
    Comparison,
    compare,
    compare_measured,
    repeats_needed,
)
from frenetic.campaign import defaults
from frenetic.campaign.lock import lock_file
from frenetic.campaign.summary import Summary
from frenetic.errors import FreneticError
from frenetic.parts.named_code import named_code
from frenetic.parts.records import differences
from frenetic.parts.signatures import unsigned_text
from frenetic.parts.versions import package_versions
from frenetic.plugins.bench.entrants import Entrant, entrant_parts, folder_names
from frenetic.plugins.bench.presets import Preset
from frenetic.plugins.bench.processes import run_all
from frenetic.plugins.bench.runs import (
    RUN_LIMITS,
    EntrantRun,
    RunState,
    RunTerms,
    compile_measures,
    ending_of,
    try_out,
)
from frenetic.plugins.bench.strategy import End
from frenetic.simulators.embedded import compile_kernels
from frenetic.spec import SIGNED, Spec, write_entries

logger = logging.getLogger(__name__)

BENCHES: Final = Path("benches")
"""Default parent of benches' folders."""
RECORD: Final = "bench.json"
"""Name of the file, in a bench's folder, that records the bench as it was begun."""
LOCK: Final = "bench.lock"
"""Name of the file, in a bench's folder, that the process which runs the bench locks."""
FILE: Final = "bench.toml"
"""Name of the file, in a bench's folder, with which `frenetic bench` repeats the bench."""

OnProgress = Callable[[float, str], None]
"""Function of the spent share of all runs' budgets, from 0 to 1, and of the counts in words."""
_MAX_CHANGES_LENGTH: Final = 1000  # letters of a part's changes in an error
_MAX_VALUE_LENGTH: Final = 200  # letters of an entry's value in an error
_MAX_REASONS: Final = 3  # in the note about an entrant's endings


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A bench: its entrants, terms, repeats and folder.

    Run k of each entrant has the seed ``seed + k - 1``.
    """

    entrants: tuple[Entrant, ...]
    terms: RunTerms
    """Terms of every run."""
    repeats: Count = 10
    """Number of runs of each entrant."""
    seed: Index = 1
    """Seed of the first run of each entrant."""
    folder: Path = field(default_factory=lambda: defaults.new_folder(BENCHES))
    """Folder of the bench, a `Path` or a text."""
    preset: Preset | None = None
    """Edition of the competition whose figures stand beside its results."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))
        check({"repeats": self.repeats, "seed": self.seed}, Bench)
        if not self.entrants:
            raise FreneticError("nobody takes part: name a generator or a strategy")
        object.__setattr__(self, "entrants", tuple(self.entrants))
        folder_names(self.entrants)  # raises if two entrants have the same name
        for entrant in self.entrants:
            if entrant.is_strategy:  # made once, so that wrong options are noticed at once
                self.terms.make_strategy(entrant, self.seed)

    @property
    def runs(self) -> list[EntrantRun]:
        """All runs: the first runs of all entrants, then the second ones, and so on."""
        names = folder_names(self.entrants)
        return [
            EntrantRun(
                entrant,
                repeat,
                seed=self.seed + repeat - 1,
                folder=self.folder / names[entrant.name] / f"{repeat:02d}",
            )
            for repeat in range(1, self.repeats + 1)
            for entrant in self.entrants
        ]

    @property
    def runs_text(self) -> str:
        """Text about each entrant's runs, such as "10 runs of 200 simulations"."""
        return f"{counted(self.repeats, 'run')} of {self.terms.budget}"

    @property
    def repeats_needed(self) -> int:
        """Fewest repeats with which a difference between two entrants can be shown.

        All measures are taken to differ between runs: where some are equal, fewer may do.
        """
        return repeats_needed(len(self.entrants)) if len(self.entrants) > 1 else 1

    def states(self) -> list[RunState]:
        """Return all runs with their endings.

        Raises:
            CampaignError: the campaign of a run is damaged.
        """
        return [RunState(run, ending_of(run.folder)) for run in self.runs]

    def run(
        self,
        *,
        resume: bool = False,
        workers: Count = 1,
        on_start: Callable[[], None] | None = None,
        on_progress: OnProgress = lambda *_: None,
        on_end: Callable[[RunState], None] = lambda _: None,
        on_interrupt: Callable[[], None] | None = None,
    ) -> list[RunState]:
        """Run all runs that are not complete; return the states of these runs.

        Each generator is built once before the first run, so an error in it is noticed at once.

        Args:
            resume: whether to complete the bench that the folder holds; else the folder must be
                new or empty.
            workers: number of runs at once.
            on_start: called before the first run.
            on_progress: called after each message of a run.
            on_end: called after each run.
            on_interrupt: called at the first Ctrl-C, after which no run begins.

        Raises:
            ValueError: ``workers`` is no whole number of at least 1.
            FreneticError: the folder is not empty, or holds another bench or none to resume;
                another process uses it; a generator cannot be built; the simulator does not start;
                or the folder is moved or deleted while the bench runs.
        """
        check({"workers": workers}, Bench.run)
        defaults.prepare(self.terms.tester.simulator)
        compile_kernels()
        compile_measures()
        if resume:
            self._require_same()
        else:
            self._require_new_folder()
        to_do = [state.run for state in self.states() if state.ending is None]
        for entrant in self.entrants:
            if not entrant.is_strategy and any(run.entrant == entrant for run in to_do):
                try_out(entrant, self.terms, self.seed)
        with _locked(self.folder):
            if not resume:
                self._write()
            if on_start is not None:
                on_start()
            return self._run(workers, on_progress, on_end, on_interrupt)

    def _run(
        self,
        workers: int,
        on_progress: OnProgress,
        on_end: Callable[[RunState], None],
        on_interrupt: Callable[[], None] | None,
    ) -> list[RunState]:
        """Run all runs that are not complete; return their states. See `run` for the arguments."""
        states = self.states()
        to_do = [state.run for state in states if state.ending is None]
        complete_before = len(states) - len(to_do)
        summaries: dict[Path, Summary] = {}  # latest of each run's folder
        ends: dict[Path, RunState] = {}
        messages = run_all(to_do, self.terms, workers=workers, on_interrupt=on_interrupt)
        with closing(messages), closing(FolderInUse(self.folder)) as folder:
            for run, message in messages:
                self._require_in_place(folder)
                if isinstance(message, Summary):
                    summaries[run.folder] = message
                else:
                    ends[run.folder] = message
                    on_end(message)
                complete = complete_before + len(ends)
                running = sum(s.budget_spent for f, s in summaries.items() if f not in ends)
                simulations = sum(summary.simulations for summary in summaries.values())
                failures = sum(summary.failures for summary in summaries.values())
                on_progress(
                    (complete + running) / len(states),
                    f"runs {complete} of {len(states)}, simulations {simulations},"
                    f" failures {failures}",
                )
                # Once more, as the next run would make a folder that was moved or deleted anew.
                self._require_in_place(folder)
        return list(ends.values())

    def _require_in_place(self, folder: FolderInUse) -> None:
        """Check that nobody has moved or deleted the folder.

        Raises:
            FreneticError: the folder was moved or deleted.
        """
        if fate := folder.fate():
            advice = "its complete runs are there; continue with --resume there"
            if "deleted" in fate:
                advice = "its runs are gone; begin a new bench"
            raise FreneticError(f"{self.folder} {fate} while the bench ran: {advice}")

    def comparison(self) -> Comparison:
        """Return the comparison of the entrants by their complete runs.

        Raises:
            FreneticError: no entrant has a complete run.
        """
        states = self.states()
        folders_of: dict[str, list[Path]] = {entrant.name: [] for entrant in self.entrants}
        for state in states:
            if state.ending is not None:
                folders_of[state.run.entrant.name].append(state.run.folder)
        folders_of = {name: folders for name, folders in folders_of.items() if folders}
        if len(folders_of) == 1:  # `compare` takes two groups or more
            metrics = {
                name: tuple(map(measure_campaign, folders)) for name, folders in folders_of.items()
            }
            comparison = compare_measured(metrics)
        else:
            comparison = compare(folders_of)
        return replace(comparison, notes=(*unusual_endings(states), *comparison.notes))

    @property
    def file(self) -> Path | None:
        """File that repeats the bench; None if driver or simulator came from Python as objects."""
        return None if self.terms.tester.spec is None else self.folder / FILE

    def entries(self) -> dict[str, Any]:
        """Return the entries of the bench's file; a driver or simulator without a name has none."""
        terms, spec = self.terms, self.terms.tester.spec
        return {
            "generator": [entrant.word for entrant in self.entrants if not entrant.is_strategy],
            "strategy": [entrant.word for entrant in self.entrants if entrant.is_strategy],
            **({} if spec is None else spec.driving_spec().entries()),
            "with": dict(terms.tester.terms.conditions),
            "map_size": terms.tester.terms.map_size,
            "objective": terms.objective,
            **{name: getattr(terms, name) for name in RUN_LIMITS},
            "seconds_per_test": terms.seconds_per_test,
            "patience": terms.patience,
            "stability": terms.stability or None,
            "repeats": self.repeats,
            "seed": self.seed,
            "preset": None if self.preset is None else self.preset.name,
        }

    def _record(self) -> dict[str, Any]:
        """Return the record of what the bench was begun with, see `BenchRecord`."""
        tester = self.terms.tester
        return {
            "version": 3,
            "entries": self.entries(),
            "sources": {entrant.name: entrant.source() for entrant in self.entrants},
            **tester.described,
            "rules": tester.simulator.rules.as_json(),
        }

    def _require_new_folder(self) -> None:
        """Check that the folder does not exist, or holds nothing.

        Raises:
            FreneticError: something is in the folder's place.
        """
        if os.path.lexists(self.folder) and (
            not self.folder.is_dir() or any(child.name != LOCK for child in self.folder.iterdir())
        ):
            raise FreneticError(
                f"{self.folder} is not empty: choose another place, or continue the bench in it"
            )

    def _require_same(self) -> None:
        """Check that the folder holds this bench.

        Raises:
            FreneticError: the folder holds another bench or none.
        """
        earlier, now = read_record(self.folder), json.loads(json.dumps(self._record()))
        for name, source in earlier.sources.items():
            if now["sources"].get(name) != source:
                raise FreneticError(
                    f"the source of {name} is not what the bench in {self.folder} was begun with:"
                    " restore it, or begin a new bench"
                )
        for name in ("simulator", "driver"):
            if changes := differences(name, getattr(earlier, name), now[name]):
                raise FreneticError(
                    f"{self.folder} holds a bench with another {name}:"
                    f" {'; '.join(changes)[:_MAX_CHANGES_LENGTH]}; restore it, or begin a new bench"
                )
        for name, value in [*now["entries"].items(), ("rules", now["rules"])]:
            earlier_value = earlier.rules if name == "rules" else earlier.entries.get(name)
            if earlier_value != value:
                raise FreneticError(
                    f"{self.folder} holds a bench with another {name}:"
                    f" {json.dumps(earlier_value)[:_MAX_VALUE_LENGTH]},"
                    f" not {json.dumps(value)[:_MAX_VALUE_LENGTH]}"
                )

    def _write(self) -> None:
        """Write the record of the bench, and the file that repeats it."""
        document = self._record() | {
            "created_at": datetime.now().astimezone().isoformat(timespec="seconds"),
            "versions": package_versions(),
        }
        text = json.dumps(document, indent=1) + "\n"
        write_file(self.folder / RECORD, text, remedy="choose another place", durable=True)
        if self.file is not None:
            comment = "What ran in this folder; 'frenetic bench' with this file does it again."
            write_entries({**self.entries(), **self._signed()}, self.file, comment)

    def _signed(self) -> dict[str, Any]:
        """Return the file's entry with the user's signature of the code that the file names.

        Empty if no code is named, or it cannot be signed; then a warning is logged.
        """
        entries, tester = self.entries(), self.terms.tester
        assert tester.spec is not None
        others = entrant_parts(entries["generator"], entries["strategy"])
        driving = {**tester.spec.driving_spec().entries(), "objective": self.terms.objective}
        spec = Spec.of(driving).signed_in(tester.folder, others=others)
        if spec.signed is not None:
            return {SIGNED: msgspec.to_builtins(spec.signed)}
        if named_code({**spec.parts, **others}):
            logger.warning("%s", unsigned_text())
        return {}


def unusual_endings(states: Sequence[RunState]) -> list[str]:
    """Return a line for each entrant whose runs did not end by the budget, with the reasons."""
    runs_of: dict[str, list[RunState]] = {}
    for state in states:
        runs_of.setdefault(state.run.entrant.name, []).append(state)
    lines = []
    for name, runs in runs_of.items():
        endings = [state.ending for state in runs if state.ending is not None]
        unusual = Counter(str(ending) for ending in endings if str(ending) != End.OVER)
        texts = [
            f"{count} of {len(runs)} runs {ending}"
            for ending, count in unusual.most_common(_MAX_REASONS)
        ]
        if texts:
            lines.append(f"{name}: {'; '.join(texts)}")
    return lines


class BenchRecord(msgspec.Struct):
    """The part of a bench's record that is compared before the bench is resumed."""

    version: Literal[3]
    """Version of the record's format."""
    entries: dict[str, Any]
    """Entries of the bench's file, see `Bench.entries`."""
    sources: dict[str, str | None]
    """Name of an entrant -> digest of its source, see `Entrant.source`."""
    simulator: Any
    """Description of the simulator."""
    driver: Any
    """Description of the driver."""
    rules: Any
    """Rules of the drives."""


def read_record(folder: Path | str) -> BenchRecord:
    """Return the record of the bench in a folder.

    Raises:
        FreneticError: the folder holds no bench, or its record is damaged or of another version.
    """
    path = Path(folder) / RECORD
    try:
        with open_file(path) as file:
            return read_json(file.read(), BenchRecord)
    except FileNotFoundError:
        raise FreneticError(f"{folder} holds no bench: give the folder of a bench") from None
    except (OSError, ValueError) as error:
        raise FreneticError(
            f"{path} is damaged or of another version of frenetic ({error}): restore it from a"
            " copy, or begin a new bench"
        ) from None


def _locked(folder: Path) -> FileLock:
    """Make the folder if need be, lock it, and return its lock.

    Raises:
        FreneticError: the folder cannot be made, or another process has locked it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FreneticError(
            f"cannot make the folder {folder}: {error.strerror or error}; choose another place"
        ) from error
    return lock_file(folder / LOCK)
