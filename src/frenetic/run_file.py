"""A run as a TOML file: what the options of `frenetic run` say, by the same names and grammar.

A bench has such a file, too (`frenetic.bench.file`).

Every campaign with named parts keeps one beside its database, `NAME`. It is a copy for people: the
database is the record, and an edited copy is another run.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeVar

import tomli_w
from msgspec import Struct, convert, field

from frenetic._support.bounds import Count, Index, NotNegative, Positive
from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_toml
from frenetic._support.words import parse_duration
from frenetic.description import PARTS
from frenetic.drive_entries import DriveEntries, read_domain
from frenetic.errors import FreneticError
from frenetic.spec import Budget, EarlierCampaign, Part, Spec
from frenetic.trust import REGISTRIES

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

NAME: Final = "campaign.toml"
"""Name of the file in a campaign's folder."""


def class_entry(road_class: RoadClass | None) -> str | dict[str, Any] | None:
    """The entry of a file for a road class: its name if that says all."""
    from frenetic.road.classes import RoadClass, classes  # numba takes its time

    if road_class is None:
        return None
    name = road_class.name
    is_known = name in classes() and RoadClass.of(name) == road_class
    return name if is_known else road_class.as_json()


class DriveFile(DriveEntries, kw_only=True):
    """The entries of a file whose roads are driven alike."""

    def spec(self, usual: str | None = None) -> Spec:
        """The spec, with the defaults of the command line.

        Args:
            usual: strategy, if the file says none.

        Raises:
            ValueError: a part is none.
            FreneticError: a rule is out of range.
        """
        spec = Spec(strategy=Part(usual)).replaced(self.given())
        return spec if self.objective is None else replace(spec, objective=self.objective)


class RunFile(DriveFile, kw_only=True):
    """The entries of a run's file."""

    strategy: str | None = None
    odd: str | dict[str, Any] | None = None
    """File of a domain, or its entries with a ``name``."""
    margin: NotNegative | None = None
    lane_width: Positive | None = None
    simulations: Count | None = None
    time: Positive | str | None = None
    """s, or a text such as ``"8h"``."""
    failures: Count | None = None
    start_from: list[str] = field(name="from", default_factory=list)
    from_roads: str | None = None
    seed: Index | None = None
    lookahead: Count | None = None
    """Roads that are proposed ahead."""
    workers: Count | str | None = None
    """Roads driven at once, or the address of a Dask scheduler."""

    def spec(self, usual: str | None = "frenetic") -> Spec:
        """The spec; it has a budget, seed and lookahead only as far as the file says them."""
        limits: dict[str, Any] = {
            "simulations": self.simulations,
            "time": parse_duration(self.time) if self.time is not None else None,
            "failures": self.failures,
        }
        others: dict[str, Any] = {
            name: value
            for name in ("margin", "lane_width", "from_roads", "seed", "lookahead")
            if (value := getattr(self, name)) is not None
        }
        if any(limits.values()):
            others["budget"] = Budget(**limits)
        others["start_from"] = tuple(EarlierCampaign(folder) for folder in self.start_from)
        spec = super().spec(usual)
        if self.from_roads is not None and self.roads is None:
            from frenetic.road.stretches import shown_class  # numba takes its time

            spec = spec.replaced(
                {
                    "road_class": shown_class(self.from_roads),
                    "map_size": self.map_size,
                    "layers": self.conditions,
                    **self.rules(),
                }
            )
        if self.odd is not None:
            domain = read_domain(self.odd)
            options = {
                "domain": domain,
                "map_size": self.map_size,
                "layers": self.conditions,
                **self.rules(),
            }
            roads = domain.road_class if self.roads is None else None
            spec = spec.replaced({**options, "road_class": roads})
        return replace(spec, **others)


AnyFile = TypeVar("AnyFile", bound=DriveFile)
Entries = TypeVar("Entries", bound=Struct)


def read_run_file(path: Path | str) -> tuple[Spec, RunFile]:
    """The spec of a run's file, with the defaults of the command line, and its entries.

    Raises:
        FreneticError: there is no such file, or it is wrong; the message names the place in it.
    """
    if (inside := Path(path) / NAME).is_file():
        raise FreneticError(f"{path} is a campaign's folder: its file is {inside}")
    return read_file(path, RunFile, "a run")


def read_file(
    path: Path | str,
    kind: type[AnyFile],
    what: str,
    usual: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[Spec, AnyFile]:
    """The spec of a file, with the defaults of the command line, and its entries.

    Args:
        path: of the file.
        kind: of its entries.
        what: it says, for messages.
        usual: entries that hold where the file says nothing.

    Raises:
        FreneticError: there is no such file, or it is wrong; the message names the place in it.
    """
    entries = read_entries(Path(path), kind, what, usual)
    try:
        return entries.spec(), entries
    except ValueError as error:
        raise FreneticError(f"{path} does not say {what}: {error}") from None
    except FreneticError as error:
        raise FreneticError(f"{path}: {error}") from None


def read_entries(
    path: Path, kind: type[Entries], what: str, usual: Mapping[str, Any] = MappingProxyType({})
) -> Entries:
    """The entries of a file in TOML; arguments and errors are those of `read_file`."""
    data = read_bounded(path)
    try:
        return convert({**usual, **read_toml(data)}, kind)
    except ValueError as error:
        raise FreneticError(f"{path} does not say {what}: {error}") from None


def write_run_file(spec: Spec, folder: Path) -> None:
    """Writes the file of a campaign into its folder, if its parts have names.

    Raises:
        FreneticError: it cannot be written.
    """
    is_whole = all(getattr(spec, kind).name is not None for kind in PARTS)
    if not is_whole or spec.budget is None or not isinstance(spec.seed, int | None):
        return
    entries: dict[str, Any] = {
        **spec.strategy_entry(),
        **file_entries(spec),
        "odd": None if spec.domain is None else spec.domain.entries(),
        "margin": spec.margin,
        "lane_width": spec.lane_width,
        **asdict(spec.budget),
        "from": [earlier.folder for earlier in spec.start_from],
        "from_roads": spec.from_roads,
        "seed": spec.seed,
        "lookahead": spec.lookahead,
        "workers": spec.cluster or spec.workers,
    }
    what = f"What ran in this folder; 'frenetic run {NAME}' does it again in another."
    write_entries(entries, folder / NAME, what)


def file_entries(spec: Spec) -> dict[str, Any]:
    """The entries of a `DriveFile` for a spec whose parts have names."""
    criteria = spec.rules.criteria
    return {
        **(spec.drive_entries() or {}),
        "criteria": criteria.entry() if criteria else None,
        "roads": class_entry(spec.road_class),
        "map_size": spec.map_size,
        "objective": spec.objective,
    }


def write_entries(entries: Mapping[str, Any], path: Path, what: str) -> None:
    """Writes a file, but for entries that say nothing, under a line about it.

    Raises:
        FreneticError: it cannot be written.
    """
    kept = {name: value for name, value in entries.items() if value not in (None, {}, [])}
    text = f"# {what}\n{tomli_w.dumps(kept)}"
    write_file(path, text, remedy="make room, or let it be written")


def next_campaign(spec: Spec, folder: Path, *, has_drives: bool) -> str:
    """Return the advice to start another campaign with the parts of one as they are now.

    It is a command and no file, because only a command may name code of the user's own.

    Args:
        spec: of the campaign.
        folder: of the campaign.
        has_drives: whether it holds a drive that says something of the driver. Then the other one
            starts from it, with another seed; without, it is the same search with the same seed.
    """
    words = ["frenetic", "run", str(folder / NAME)]
    words += ["--from", str(folder)] if has_drives else []
    for kind in PARTS:
        part: Part = getattr(spec, kind)
        if part.name is not None and (kind == "driver" or REGISTRIES[kind].is_own(part.name)):
            words += part.words(kind)
    if REGISTRIES["objective"].is_own(spec.objective):
        words += ["--objective", spec.objective]
    if not has_drives:
        return f"start it anew, with the same seed: {shlex.join(words)}"
    advice = "start a new campaign from this one"
    if isinstance(spec.seed, int):
        advice += ", with another seed so that its random roads are new"
        words += ["--seed", str(spec.seed + 1)]
    return f"{advice}: {shlex.join(words)}"
