"""A bench as a TOML file: what the options of `frenetic bench` say, and what only a file says.

Every bench whose driver and simulator have names keeps one beside its document, see `Bench.file`.
It is a copy for people: an edited copy is another bench.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msgspec import convert

from frenetic._support.bounds import Count, Index, Positive
from frenetic._support.words import parse_duration, read_part
from frenetic.bench.bench import FILE, Bench, read_record
from frenetic.bench.entrants import PLACES, Entrant, require_trusted
from frenetic.bench.presets import find_preset
from frenetic.bench.recipes import find_recipe
from frenetic.bench.runs import Terms
from frenetic.errors import FreneticError
from frenetic.registry import STRATEGIES
from frenetic.run_file import DriveFile, read_file
from frenetic.spec import Spec


class BenchFile(DriveFile, kw_only=True):
    """The entries of a bench's file."""

    generator: tuple[str, ...] = ()
    """As on the command line: ``"wiggly.py:Wiggly,name=Wiggly"``."""
    strategy: tuple[str, ...] = ()
    """Likewise; all built-in ones if there is no entrant at all."""
    simulations: Count = 200
    """Budget of each run, in drives."""
    seconds_per_test: Positive = 36.0
    """Virtual time that a drive costs, in s."""
    patience: Positive | str = "10m"
    """A generator that asks for no test so long is ended."""
    repeats: Count = 10
    seed: Index = 1
    """Of the first run of each."""
    workers: Count | None = None
    """Runs at once."""
    preset: str | None = None
    """Edition of the competition, see `frenetic.bench.presets`; entries of the file win."""

    def entrants(self) -> tuple[Entrant, ...]:
        """The entrants.

        Raises:
            ValueError: one is none.
            FreneticError: likewise, or its files are not there.
        """
        entrants = (*map(self._generator, self.generator), *map(_strategy, self.strategy))
        return entrants or tuple(_built_in())

    def bench(self, spec: Spec, folder: Path | str) -> Bench:
        """The bench of a spec, in a folder.

        Raises:
            ValueError: an entry is wrong.
            FreneticError: a part cannot be made, or a value is out of range.
        """
        return Bench(
            entrants=self.entrants(),
            terms=Terms.of(
                spec,
                simulations=self.simulations,
                seconds_per_test=self.seconds_per_test,
                patience=parse_duration(self.patience),
                objective=spec.objective,
            ),
            repeats=self.repeats,
            seed=self.seed,
            folder=Path(folder),
            preset=None if self.preset is None else find_preset(self.preset),
        )

    def _generator(self, text: str) -> Entrant:
        """A generator by its class, or a published one by its name."""
        spec, options, name = _read(text)
        if unknown := [option for option in options if option not in PLACES]:
            raise ValueError(
                f"{spec} has no option {unknown[0]!r}: a generator takes {', '.join(PLACES)} and"
                " name"
            )
        places: dict[str, Any] = {k: Path(str(v)).expanduser() for k, v in options.items()}
        if set(spec) & set(":./\\"):
            return Entrant(name=name or spec.rpartition(":")[2], spec=spec, **places)
        recipe = find_recipe(spec)
        if "path" not in places or {"copy", "pipeline"} & set(places):
            raise FreneticError(
                f"{recipe.title} is a published generator: say where its files are, no more, as in"
                f" {spec},path=FOLDER; they are those of {recipe.source}"
            )
        recipe.check(self.seconds_per_test)
        return recipe.entrant(places["path"], python=places.get("python"), name=name)


def _strategy(text: str) -> Entrant:
    spec, options, name = _read(text)
    settings = [f"{key}={json.dumps(value)}" for key, value in options.items()]
    usual = ",".join([spec.rpartition(":")[2], *settings])
    return Entrant(name=name or usual, spec=spec, is_strategy=True, options=options)


def _built_in() -> Iterator[Entrant]:
    for entry in STRATEGIES.entries():
        if set(STRATEGIES.needs(STRATEGIES.load(entry.name))) <= {"seed", "map_size"}:
            yield Entrant(name=entry.name, spec=entry.name, is_strategy=True)


def _read(text: str) -> tuple[str, dict[str, Any], str | None]:
    """Spec, options and name of an entrant."""
    spec, options = read_part(text)
    if spec is None:
        raise ValueError(f"{text}: a name is needed before the options")
    name = options.pop("name", None)
    return spec, options, None if name is None else str(name)


def read_bench(path: Path | None, preset: str | None = None) -> tuple[Spec, BenchFile]:
    """The spec of a bench's file, with the defaults of the command line, and its entries.

    Args:
        path: of the file; None for the defaults alone.
        preset: that holds below the file, in place of the one that the file names.

    Raises:
        FreneticError: there is no such file or preset, or the file is wrong.
    """
    if preset is None and path is not None:
        preset = read_file(path, BenchFile, "a bench")[1].preset
    usual = {} if preset is None else {**find_preset(preset).bench, "preset": preset}
    if path is not None:
        return read_file(path, BenchFile, "a bench", usual)
    entries = convert(usual, BenchFile)
    return entries.spec(), entries


def open_bench(folder: Path | str) -> Bench:
    """The bench in a folder, by its file.

    Raises:
        FreneticError: there is none, it is damaged, it names code that is not loaded unasked
            (`frenetic.trust`), or it was begun from Python.
    """
    path = Path(folder) / FILE
    if "driver" not in read_record(folder).entries:
        raise FreneticError(
            f"{folder} was begun from Python, so its driver and simulator have no names: go on"
            " from Python"
        )
    spec, entries = read_bench(path)
    spec.require_trusted(path)
    try:
        require_trusted(entries.entrants(), path)
        return entries.bench(spec, folder)
    except ValueError as error:
        raise FreneticError(f"{path}: {error}") from None
