"""A bench as a TOML file: what the options of `frenetic bench` say, and what only a file says.

Every bench whose driver and simulator have names keeps one beside its document, see `Bench.file`.
It is a copy for people: an edited copy is another bench.
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
from frenetic._support.words import parse_duration, read_part
from frenetic.campaign.tester import RoadTester
from frenetic.errors import FreneticError
from frenetic.parts.registry import STRATEGIES, hint
from frenetic.parts.trust import Parts
from frenetic.plugins.bench.bench import FILE, Bench, read_record
from frenetic.plugins.bench.entrants import PLACES, Entrant, entrant_parts
from frenetic.plugins.bench.presets import find_preset
from frenetic.plugins.bench.recipes import find_recipe
from frenetic.plugins.bench.runs import RunTerms
from frenetic.spec import DRIVING, SIGNED, USUAL, Signed, Spec
from frenetic.spec.files import read_table
from frenetic.spec.terms import Terms


class BenchFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The entries of a bench's file beside those that say how roads are driven."""

    generator: tuple[str, ...] = ()
    """Generators as on the command line: ``"wiggly.py:Wiggly,name=Wiggly"``."""
    strategy: tuple[str, ...] = ()
    """Strategies as on the command line; all built-in ones if the bench has no entrant."""
    simulations: Count = 200
    """Budget of each run, in drives."""
    seconds_per_test: Positive = 36.0
    """Virtual time that a drive costs, in s."""
    patience: Positive | str = "10m"
    """Time after which a generator that asks for no test is ended."""
    repeats: Count = 10
    seed: Index = 1
    """Seed of the first run of each entrant."""
    workers: Count | None = None
    """Number of runs at once."""
    preset: str | None = None
    """Edition of the competition, see `frenetic.plugins.bench.presets`; entries of the file win."""

    @property
    def parts(self) -> Parts:
        """Entrants, as `frenetic.parts.trust` takes them.

        Raises:
            ValueError: a text names no entrant.
        """
        return entrant_parts(self.generator, self.strategy)

    def entrants(self) -> tuple[Entrant, ...]:
        """Return the entrants.

        Raises:
            ValueError: a text names no entrant, or has an unknown option.
            FreneticError: there is no such published generator, or its files are missing.
        """
        entrants = (*map(self._generator, self.generator), *map(_strategy, self.strategy))
        return entrants or tuple(_built_in())

    def bench(
        self, spec: Spec, folder: Path | str, entrants: tuple[Entrant, ...] | None = None
    ) -> Bench:
        """Return the bench of a spec, in a folder; by default with the entrants of the file.

        Raises:
            ValueError: an entry has a value that is not allowed.
            FreneticError: a part cannot be made, or a value is out of range.
        """
        # Generators know two lanes of 4 m and the competition's rules of roads alone.
        terms = replace(spec.terms, lane_width=Terms().lane_width, road_class=None)
        return Bench(
            entrants=self.entrants() if entrants is None else entrants,
            terms=RunTerms(
                RoadTester.of(spec, terms),
                simulations=self.simulations,
                seconds_per_test=self.seconds_per_test,
                patience=parse_duration(self.patience),
                objective=spec.named_objective,
            ),
            repeats=self.repeats,
            seed=self.seed,
            folder=Path(folder),
            preset=None if self.preset is None else find_preset(self.preset),
        )

    def _generator(self, text: str) -> Entrant:
        """Return a generator by its class, or a published one by its name."""
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
                f" {spec},path=FOLDER; the files come from {recipe.source}"
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
    """Return spec, options and name of an entrant."""
    spec, options = read_part(text)
    if spec is None:
        raise ValueError(f"{text}: a name is needed before the options")
    name = options.pop("name", None)
    return spec, options, None if name is None else str(name)


_OWN: Final = frozenset(BenchFile.__struct_fields__)
_OF_SPEC: Final = frozenset(
    entry.encode_name
    for entry in structs.fields(Spec)
    if entry.name in {*DRIVING, "roads", "map_size", "objective", SIGNED}
)
"""Entries of a bench's file that belong to its spec."""
_USUAL: Final = {name: USUAL[name] for name in ("driver", "simulator")}


def read_bench(path: Path | None, preset: str | None = None) -> tuple[Spec, BenchFile]:
    """Return the spec of a bench's file, and its other entries.

    Args:
        path: path of the file; None for the defaults alone.
        preset: preset that holds below the file, in place of the one that the file names.

    Raises:
        FreneticError: there is no such file or preset, or the file is wrong.
    """
    entries = {} if path is None else read_table(path, "a bench")
    preset = preset or entries.get("preset")
    usual: Mapping[str, Any] = {}
    if preset is not None:
        usual = {**find_preset(str(preset)).bench, "preset": preset}
    try:
        return _split({**usual, **entries})
    except (ValueError, FreneticError) as error:
        if path is None:
            raise
        raise FreneticError(f"{path} does not say a bench: {error}") from None


def _split(entries: Mapping[str, Any]) -> tuple[Spec, BenchFile]:
    """Return the spec in the entries of a bench's file, and the other entries.

    Raises:
        ValueError: an entry is unknown, of another kind or out of range.
        FreneticError: there are no such roads, criteria or signals.
    """
    bench_entries = {name: value for name, value in entries.items() if name in _OWN}
    said = {name: value for name, value in entries.items() if name not in _OWN}
    if unknown := [name for name in said if name not in _OF_SPEC]:
        known = sorted(_OWN | _OF_SPEC)
        raise ValueError(f"there is no entry {unknown[0]!r}{hint(unknown[0], known)}")
    spec = Spec.of(_USUAL, said)
    signed = convert(said.get(SIGNED), Signed | None)
    return structs.replace(spec, signed=signed), convert(bench_entries, BenchFile)


def open_bench(folder: Path | str, *, is_trusted: bool = False) -> Bench:
    """Return the bench in a folder, by its file.

    Args:
        folder: folder of the bench.
        is_trusted: whether its user trusts the code that it names, from now on.

    Raises:
        FreneticError: the folder holds no bench, or a damaged one; the bench was begun from Python;
            or it names code that is not loaded unasked (`frenetic.parts.trust`).
    """
    path = Path(folder) / FILE
    if "driver" not in read_record(folder).entries:
        raise FreneticError(
            f"{folder} was begun from Python, so its driver and simulator have no names: go on"
            " from Python"
        )
    spec, entries = read_bench(path)
    try:
        trusted_folder = spec.require_trusted(
            path, others=entries.parts, is_trusted=is_trusted, is_toml=True, optional=()
        )
        with chdir(trusted_folder):
            return entries.bench(spec, folder)
    except ValueError as error:
        raise FreneticError(f"{path}: {error}") from None
