"""Options of a command merged with a file's or campaign's spec, and trust in the code they name."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from frenetic._support.option_text import read_part
from frenetic.cli.console import Log
from frenetic.cli.entries import AS_PARAMETER, was_given
from frenetic.conditions.condition import amounts_in, condition_named
from frenetic.parts.named_code import NOT_DRIVING, REGISTRIES, Parts, named_code
from frenetic.parts.trust import is_here, require_trusted
from frenetic.spec import Signed, Spec, sign_driven
from frenetic.spec.parts import PARTS


@dataclass(frozen=True)
class PartsSource:
    """A file or campaign that names parts of a run."""

    path: Path
    """The file, or the campaign's folder."""
    spec: Spec
    """The named parts, with the signature of the file or campaign."""
    others: Parts = field(default_factory=dict)
    """Parts that are named beside the spec, such as a bench's entrants."""
    sources: object = None
    """Texts of the parts' files, as a campaign stores them: name -> text."""
    sign: Callable[[Signed], None] | None = None
    """Function that writes a new signature; None for a TOML file, which the user's list holds."""


@dataclass(frozen=True)
class CommandOptions:
    """Options of a command that choose how roads are driven and searched."""

    spec: Spec = field(default_factory=Spec)
    """Entries that the options set."""
    driven_as: Path | None = None
    """File of ``--as``; None without the option."""
    is_trusted: bool = False
    """Whether the command line has ``--trust``."""
    others: Parts = field(default_factory=dict)
    """Parts that the command line names beside the spec, such as a bench's entrants."""
    parameters: Collection[str] = ()
    """Names of all parameters of the command, whether they are used or not."""

    @classmethod
    def of(cls, context: click.Context) -> CommandOptions:
        """Return the options on the command line of a command.

        Raises:
            click.UsageError: two options give the amount of one condition.
        """
        options = cls(
            Spec(**_entries_of(context)),
            context.params.get(AS_PARAMETER),
            is_trusted=context.params.get("is_trusted", False),
            parameters={parameter.name or "" for parameter in context.command.params},
        )
        simulator_options = options.spec.part("simulator").options
        for name in options.spec.conditions:
            if condition_named(name).attribute in simulator_options:
                raise click.UsageError(f"{name} is there twice, in --with and in --simulator")
        return options

    def __bool__(self) -> bool:
        """Whether an option changes how roads are driven or searched."""
        return bool(self.spec.user_values) or self.driven_as is not None

    def says(self, *entries: str) -> bool:
        """Return whether an option sets one of these entries."""
        return not self.spec.user_values.keys().isdisjoint(entries)

    @property
    def named_parts(self) -> Parts:
        """Parts that the command line names; ``--driver aggression=1.2`` names no part."""
        kinds = {kind for kind in ("objective", "workers") if self.says(kind)}
        for kind in PARTS:
            text = getattr(self.spec, kind)
            if text and read_part(text)[0] is not None:
                kinds.add(kind)
        parts = {kind: part for kind, part in self.spec.parts.items() if kind in kinds}
        return {**parts, **self.others}

    def over(self, spec: Spec, *, roads_are_given: bool = True) -> Spec:
        """Return a spec with the driving entries of the file of ``--as``, and the options over it.

        Args:
            spec: the spec of a file or campaign, or an empty one.
            roads_are_given: whether the roads are read from a campaign or a file, see
                `Spec.driving_spec`.

        Raises:
            FreneticError: the file cannot be read, or an option is out of range.
        """
        if (source := self._as_source) is not None:
            spec = Spec.of(
                spec.without_driving(roads_are_given=roads_are_given),
                source.spec.driving_spec(roads_are_given=roads_are_given),
            )
        return Spec.of(spec, self.spec)

    @cached_property
    def _as_source(self) -> PartsSource | None:
        """The file of ``--as`` as a source of parts; None without the option."""
        if (path := self.driven_as) is None:
            return None
        if path.suffix.lower() == ".toml":
            return PartsSource(path, Spec.read(path))
        return PartsSource(path, Spec.read_driven(path), sign=partial(sign_driven, path))

    def trusted(
        self,
        spec: Spec,
        source: PartsSource | None = None,
        *,
        left_out: Collection[str] = NOT_DRIVING,
        of_file: Collection[str] = ("driver", "simulator"),
        others: Parts = MappingProxyType({}),
        noted: Collection[str] = (),
    ) -> tuple[Spec, Path]:
        """Check that a command may make its parts, see `frenetic.parts.trust`.

        Args:
            spec: the merged spec, as `over` returns it.
            source: the file or campaign with which the options were merged, if any.
            left_out: kinds of parts that the command does not make.
            of_file: kinds of parts that the file of ``--as`` replaces.
            others: parts beside the spec that the command makes, such as a bench's entrants.
            noted: kinds of parts whose folder the command has already printed.

        Returns:
            The spec, and the folder in which its parts have to be made. Parts from another folder
            have absolute paths.

        Raises:
            FreneticError: the user has not trusted a file or campaign that names code.
        """
        parts = {kind: part for kind, part in spec.parts.items() if kind not in left_out}
        needed: Parts = {**parts, **others}
        folders: dict[str, Path] = {}  # kind of a part with code -> folder of the code
        if self._as_source is None:
            of_file = ()
        else:
            replaced = {kind: part for kind, part in needed.items() if kind in of_file}
            folders |= self._trusted_folders(self._as_source, replaced)
        if source is not None:
            remaining = {kind: part for kind, part in needed.items() if kind not in of_file}
            folders |= self._trusted_folders(source, remaining)
        here = Path.cwd()
        code_folder = next((folder for folder in folders.values() if not is_here(folder)), here)
        for kind, folder in folders.items():
            if not is_here(folder) and kind not in {"workers", *noted}:
                Log().print(f"Note: {needed[kind][0]} is loaded from {folder}", markup=False)
        elsewhere = {
            kind: folder
            for kind in named_code(needed)
            if kind in REGISTRIES and (folder := folders.get(kind, here)) != code_folder
        }
        return spec.with_files_in(elsewhere), code_folder

    def _trusted_folders(self, source: PartsSource, needed: Parts) -> dict[str, Path]:
        """Return kind -> folder of the code of needed parts; with ``--trust``, sign the source.

        Code that the command line names is in the current folder.

        Raises:
            FreneticError: the user has not trusted the source.
        """
        spec, named = source.spec, self.named_parts
        folder = require_trusted(
            source.path,
            spec.code_claim(others=source.others, sources=source.sources),
            named=named,
            needed=needed,
            is_trusted=self.is_trusted,
            is_toml=source.sign is None,
            optional=self.parameters,
        )
        if self.is_trusted and source.sign is not None:
            signed = spec.signed_in(folder, source.sources, source.others).signed
            if signed is not None and signed != spec.signed:
                source.sign(signed)
        here = Path.cwd()
        return {kind: here if kind in named else folder for kind in named_code(needed)}

    def overridden_conditions(self, spec: Spec) -> list[str]:
        """Return the conditions whose amounts the command line sets in place of a test's own.

        Args:
            spec: the merged spec, as `over` returns it.
        """
        conditions = [*self.spec.conditions]
        if self.driven_as is not None:
            return [*conditions, *spec.amounts]
        return [*conditions, *amounts_in(self.spec.part("simulator").options)]

    def check_drawn(self, spec: Spec) -> None:
        """Refuse an amount of a condition that the spec's domain draws.

        Raises:
            click.UsageError: the command line sets such an amount.
        """
        for name in CommandOptions(self.spec).overridden_conditions(Spec()):
            if spec.domain is not None and name in spec.domain.conditions:
                raise click.UsageError(
                    f"{name} is given, and {spec.domain.name} draws it: leave out one of the two"
                )


def _entries_of(context: click.Context) -> dict[str, Any]:
    """Return the entries that the options on a command line set; repeated options add up."""
    entries: dict[str, Any] = {}
    for name, value in context.params.items():
        if not was_given(context, name):
            continue
        for spec in value if isinstance(value, tuple) else (value,):
            if isinstance(spec, Spec):
                repeatable = {
                    "conditions": {**entries.get("conditions", {}), **spec.conditions},
                    "start_from": (*entries.get("start_from", ()), *spec.start_from),
                }
                entries |= spec.user_values | repeatable
    return entries
