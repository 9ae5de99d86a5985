"""A bench as a TOML file: the options of `frenetic bench`, and entries that only a file has.

Every bench whose driver and simulator have names keeps such a file beside its record, see
`Bench.file`. The record decides what the bench is: an edited file is the file of another bench.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, convert, structs

from frenetic._support.bounds import Count, Index, Positive
from frenetic._support.option_text import COMMAND, part_word, read_part
from frenetic._support.words import parse_duration
from frenetic.campaign.tester import RoadTester
from frenetic.errors import FreneticError
from frenetic.parts.construction import required_options
from frenetic.parts.named_code import Parts
from frenetic.parts.registry import STRATEGIES, hint
from frenetic.parts.trust import require_trusted
from frenetic.plugins.bench.bench import FILE, Bench, read_record
from frenetic.plugins.bench.entrants import PATH_OPTIONS, Entrant, entrant_parts
from frenetic.plugins.bench.presets import find_preset
from frenetic.plugins.bench.recipes import find_recipe
from frenetic.plugins.bench.runs import RunTerms
from frenetic.spec import DRIVING_ENTRIES, SIGNED, USUAL, Signed, Spec
from frenetic.spec.files import read_table
from frenetic.spec.terms import Terms


class BenchFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The entries of a bench's file beside those that say how roads are driven."""

    generator: tuple[str, ...] = ()
    """Generators as on the command line, such as ``"wiggly.py:Wiggly,name=Wiggly"``."""
    strategy: tuple[str, ...] = ()
    """Strategies as on the command line; all built-in ones if the file names no entrant."""
    simulations: Count | None = None
    """Budget of each run, in drives."""
    kilometres: Positive | None = None
    """Budget of each run, in km of driven road."""
    simulated_time: Positive | str | None = None
    """Budget of each run, in s of simulated time or as "30m"."""
    seconds_per_test: Positive = 36.0
    """Virtual time that a drive costs, in s."""
    patience: Positive | str = "10m"
    """Wall time after which a generator that asks for no test is ended, in s or as "10m"."""
    stability: Index = 0
    """Number of failures of each run that are driven again, with hardly other grip."""
    repeats: Count = 10
    """Number of runs of each entrant."""
    seed: Index = 1
    """Seed of the first run of each entrant."""
    workers: Count | None = None
    """Number of runs at once."""
    preset: str | None = None
    """Edition of the competition, see `frenetic.plugins.bench.presets`; entries of the file win."""

    @property
    def parts(self) -> Parts:
        """Entrants as `frenetic.parts.named_code` takes them, see `entrant_parts`.

        Raises:
            ValueError: a text has no form NAME,OPTION=VALUE.
        """
        return entrant_parts(self.generator, self.strategy)

    def entrants(self) -> tuple[Entrant, ...]:
        """Return the entrants of the file, or all built-in strategies if it names none.

        Raises:
            ValueError: a text has no form NAME,OPTION=VALUE, or an unknown option.
            FreneticError: there is no such published generator, or its files are missing.
        """
        entrants = (*map(self._generator, self.generator), *map(_strategy, self.strategy))
        return entrants or tuple(_built_in())

    def bench(
        self, spec: Spec, folder: Path | str, entrants: tuple[Entrant, ...] | None = None
    ) -> Bench:
        """Return the bench of this file.

        Args:
            spec: driver, simulator and terms of the drives.
            folder: folder of the bench.
            entrants: the entrants; by default those that the file names.

        Raises:
            ValueError: an entry has a value that is not allowed.
            FreneticError: a part cannot be made, or a value is out of range.
        """
        # Generators know only the competition's roads: two lanes of 4 m, and no road class.
        terms = replace(spec.terms, lane_width=Terms().lane_width, road_class=None)
        return Bench(
            entrants=self.entrants() if entrants is None else entrants,
            terms=RunTerms(
                RoadTester.of(spec, terms),
                simulations=self.simulations,
                kilometres=self.kilometres,
                simulated_time=None
                if self.simulated_time is None
                else parse_duration(self.simulated_time),
                seconds_per_test=self.seconds_per_test,
                patience=parse_duration(self.patience),
                stability=self.stability,
                objective=spec.named_objective,
            ),
            repeats=self.repeats,
            seed=self.seed,
            folder=Path(folder),
            preset=None if self.preset is None else find_preset(self.preset),
        )

    def _generator(self, text: str) -> Entrant:
        """Return the generator of a text: one by its class, or a published one by its name."""
        spec, options, name = _read_entrant(text)
        if unknown := [option for option in options if option not in PATH_OPTIONS]:
            raise ValueError(
                f"{spec} has no option {unknown[0]!r}: a generator takes"
                f" {', '.join(PATH_OPTIONS)} and name"
            )
        paths: dict[str, Any] = {
            option: Path(str(value)).expanduser() for option, value in options.items()
        }
        is_class = bool(set(spec) & set(":./\\"))
        if is_class:
            return Entrant(name=name or spec.rpartition(":")[2], spec=spec, **paths)
        recipe = find_recipe(spec)
        if "path" not in paths or {"copy", "pipeline"} & set(paths):
            raise FreneticError(
                f"{recipe.title} is a published generator: say where its files are, no more, as in"
                f" {spec},path=FOLDER; the files come from {recipe.source}"
            )
        recipe.require_enough_seconds(self.seconds_per_test)
        return recipe.entrant(paths["path"], python=paths.get("python"), name=name)


def _strategy(text: str) -> Entrant:
    """Return the strategy of a text; by default its name in tables holds its options, too."""
    spec, options, name = _read_entrant(text)
    settings = [f"{option}={json.dumps(value)}" for option, value in options.items()]
    default_name = ",".join([spec.rpartition(":")[2], *settings])
    if spec == COMMAND:
        default_name = part_word(spec, options)
    return Entrant(name=name or default_name, spec=spec, is_strategy=True, options=options)


def _built_in() -> Iterator[Entrant]:
    """Yield the registered strategies that need no more than a seed and the map's size."""
    for entry in STRATEGIES.entries():
        if set(required_options(STRATEGIES.load(entry.name))) <= {"seed", "map_size"}:
            yield Entrant(name=entry.name, spec=entry.name, is_strategy=True)


def _read_entrant(text: str) -> tuple[str, dict[str, Any], str | None]:
    """Return an entrant's spec, its options, and its name in tables if the text gives one.

    Raises:
        ValueError: the text has no form NAME,OPTION=VALUE.
    """
    spec, options = read_part(text)
    if spec is None:
        raise ValueError(f"{text}: a name is needed before the options")
    name = options.pop("name", None)
    return spec, options, None if name is None else str(name)


_BENCH_ENTRIES: Final = frozenset(BenchFile.__struct_fields__)
"""Entries of a bench's file that are fields of `BenchFile`."""
_SPEC_ENTRIES: Final = frozenset(
    entry.encode_name
    for entry in structs.fields(Spec)
    if entry.name in {*DRIVING_ENTRIES, "roads", "map_size", "objective", SIGNED}
)
"""Entries of a bench's file that belong to its spec."""
_DEFAULT_PARTS: Final = {name: USUAL[name] for name in ("driver", "simulator")}
"""Driver and simulator of a file that names none."""


def read_bench(path: Path | None, preset: str | None = None) -> tuple[Spec, BenchFile]:
    """Return the spec of a bench's file, and its other entries.

    Args:
        path: path of the file; None for the defaults alone.
        preset: name of a preset that replaces the file's preset; entries of the file win over it.

    Raises:
        FreneticError: there is no such file or preset, or an entry is unknown or not allowed.
    """
    entries = {} if path is None else read_table(path, "a bench")
    preset = preset or entries.get("preset")
    preset_entries: Mapping[str, Any] = {}
    if preset is not None:
        preset_entries = {**find_preset(str(preset)).bench, "preset": preset}
    try:
        return _split({**preset_entries, **entries})
    except (ValueError, FreneticError) as error:
        if path is None:
            raise
        raise FreneticError(f"{path} does not say a bench: {error}") from None


def _split(entries: Mapping[str, Any]) -> tuple[Spec, BenchFile]:
    """Return the spec in the entries of a bench's file, and the other entries.

    Raises:
        ValueError: an entry is unknown, of a wrong type or out of range.
        FreneticError: there are no such roads, criteria or signals.
    """
    bench_entries = {name: value for name, value in entries.items() if name in _BENCH_ENTRIES}
    spec_entries = {name: value for name, value in entries.items() if name not in _BENCH_ENTRIES}
    if unknown := [name for name in spec_entries if name not in _SPEC_ENTRIES]:
        known = sorted(_BENCH_ENTRIES | _SPEC_ENTRIES)
        raise ValueError(f"there is no entry {unknown[0]!r}{hint(unknown[0], known)}")
    spec = Spec.of(_DEFAULT_PARTS, spec_entries)
    signed = convert(spec_entries.get(SIGNED), Signed | None)
    return structs.replace(spec, signed=signed), convert(bench_entries, BenchFile)


def open_bench(folder: Path | str, *, is_trusted: bool = False) -> Bench:
    """Return the bench that the file in a bench's folder describes.

    Args:
        folder: folder of the bench.
        is_trusted: whether the user trusts the code that the file names, from now on.

    Raises:
        FreneticError: the folder holds no bench, or a damaged one; the bench was begun from Python;
            or the file names code that its user has not trusted (`frenetic.parts.trust`).
    """
    path = Path(folder) / FILE
    if "driver" not in read_record(folder).entries:
        raise FreneticError(
            f"{folder} was begun from Python, so its driver and simulator have no names: resume it"
            " from Python, by Bench.run(resume=True)"
        )
    spec, entries = read_bench(path)
    try:
        claim = spec.code_claim(others=entries.parts)
        trusted_folder = require_trusted(
            path, claim, is_trusted=is_trusted, is_toml=True, optional=()
        )
        with chdir(trusted_folder):
            return entries.bench(spec, folder)
    except ValueError as error:
        raise FreneticError(f"{path}: {error}") from None
