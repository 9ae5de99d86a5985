"""Options of commands that are entries of a `Spec`, and the specs that they give.

Each option is parsed to a spec with its entry alone; `Given.of` merges them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem
from msgspec import Meta, structs

from frenetic._support.words import part_word, read_part, read_setting
from frenetic.cli.console import Log
from frenetic.cli.options import Decorator, with_options
from frenetic.conditions.condition import amounts_in, condition_named
from frenetic.errors import FreneticError
from frenetic.parts.named_code import NOT_DRIVING, REGISTRIES, Parts, named_code
from frenetic.parts.registry import SIMULATORS
from frenetic.parts.trust import is_here
from frenetic.spec import Signed, Spec, sign_driven, usual_of
from frenetic.spec.part_record import PARTS

P = ParamSpec("P")
R = TypeVar("R")

AS: Final = "driven_as"
"""Name of the parameter of ``--as``."""
_NAMES: Final = {"conditions": "with", "start_from": "from"}
"""Entries whose options have another name than their attribute."""
_EXAMPLES: Final = {
    "strategy": "frenetic-2021,threshold=-0.2",
    "driver": "planner,aggression=1.2",
    "simulator": "embedded,friction=0.7",
}
_SEVERAL: Final = ("conditions", "start_from")
"""Entries whose option may be repeated."""


def names_of(
    kind: str,
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Return a completion of the names of a kind of part; any other word is a file."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        names = [
            CompletionItem(entry.name, help=entry.summary or None)
            for entry in REGISTRIES[kind].entries()
            if entry.name.startswith(incomplete)
        ]
        return names or [CompletionItem(incomplete, type="file")]

    return complete


class _SpecOption(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """Type of an option, for click: it reads a text into a spec with one entry.

    Args:
        entry: name of the attribute of `Spec`.
    """

    def __init__(self, entry: str) -> None:
        self.name = self.entry = entry

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Spec:
        """Return the spec."""
        if isinstance(value, Spec):
            return value
        try:
            return Spec(**{self.entry: self._read(value)})
        except (ValueError, FreneticError) as error:
            self.fail(str(error), param, ctx)

    def _read(self, text: str) -> Any:
        """Return the value of the entry."""
        if self.entry == "conditions":
            return dict([_read_amount(text)])
        if self.entry == "start_from":
            return (text,)
        return text if _takes_text(self.entry) else read_setting(text)


_HINTS: Final[Mapping[str, Any]] = get_type_hints(Spec, include_extras=True)
_KINDS: Final[Mapping[str, Any]] = get_type_hints(Spec)


def _takes_text(entry: str) -> bool:
    """Tell whether an entry may be a text, so that its option is not read as a number."""
    hint = _KINDS[entry]
    return any(str in (kind, get_origin(kind)) for kind in (hint, *get_args(hint)))


def _read_amount(text: str) -> tuple[str, float]:
    """Return name and amount of a condition from NAME=VALUE."""
    name, equals, amount_text = (part.strip() for part in text.partition("="))
    row = condition_named(name)
    try:
        amount = float(amount_text) if equals else math.nan
    except ValueError:
        amount = math.nan
    if math.isnan(amount):
        raise ValueError(f"{text!r} is not NAME=VALUE, as in {name}={row.usual[1]:g}")
    return name, amount


def _meta(entry: str) -> Meta:
    """Return the declared description of an entry."""
    hint = _HINTS[entry]
    assert get_origin(hint) is Annotated, f"{entry} has no option"
    return next(item for item in get_args(hint)[1:] if isinstance(item, Meta) and item.description)


def entry_option(entry: str, help: str = "") -> Decorator:  # noqa: A002
    """Return the option for an entry of a spec, with the help text of its declaration.

    Args:
        entry: name of the attribute of `Spec`.
        help: text of the option; by default the text of the declaration.
    """
    meta = _meta(entry)
    text = help or meta.description or ""
    metavar = (meta.extra or {}).get("metavar") or entry.upper()
    if entry in PARTS:
        text += f" With options: {_EXAMPLES[entry]}."
    return click.option(
        f"--{_NAMES.get(entry, entry).replace('_', '-')}",
        entry,
        type=_SpecOption(entry),
        metavar=metavar,
        multiple=entry in _SEVERAL,
        help=text,
        shell_complete=names_of(entry) if entry in PARTS else None,
        callback=_once if entry == "conditions" else None,
    )


def entry_options(*entries: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that adds the options for several entries, in this order."""

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        return with_options([entry_option(entry) for entry in entries], command)

    return decorate


def _once(_: click.Context, __: click.Parameter, specs: tuple[Spec, ...]) -> tuple[Spec, ...]:
    names = [name for spec in specs for name in spec.conditions]
    if twice := {name for name in names if names.count(name) > 1}:
        raise click.BadParameter(f"{', '.join(sorted(twice))} is there twice")
    return specs


as_option: Final = click.option(
    "--as",
    AS,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Drive as this file says: campaign.toml, the file of a failing road, a twin's profile."
    " Other options win.",
)


def part_options(command: Callable[P, R]) -> Callable[P, R]:
    """Add the options that choose a driver, conditions and a simulator."""
    return with_options(
        [as_option, *map(entry_option, ("driver", "conditions", "simulator"))], command
    )


trust_option: Final = click.option(
    "--trust",
    "is_trusted",
    is_flag=True,
    help="Load the code that the file or campaign names.",
)


def was_given(context: click.Context, name: str) -> bool:
    """Tell whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE


@dataclass(frozen=True)
class PartsSource:
    """A file or campaign that names parts which a command makes."""

    path: Path
    spec: Spec
    """The named parts, with the signature of the file or campaign."""
    others: Parts = field(default_factory=dict)
    """Parts that are named beside the spec, such as a bench's entrants."""
    sources: object = None
    """The stored sources of the parts."""
    sign: Callable[[Signed], None] | None = None
    """Function that signs the source anew; None for a TOML, which the user's list holds."""


@dataclass(frozen=True)
class CommandOptions:
    """Options of a command that choose how roads are driven and searched."""

    spec: Spec = field(default_factory=Spec)
    """Entries that the options set."""
    driven_as: Path | None = None
    """File of ``--as``."""
    is_trusted: bool = False
    """Whether ``--trust`` is given."""
    others: Parts = field(default_factory=dict)
    """Other named parts, such as a bench's entrants."""
    kinds: Collection[str] = ()
    """Names of the command's parameters."""

    @classmethod
    def of(cls, context: click.Context) -> CommandOptions:
        """Return the options of a command, given in any order.

        Raises:
            click.UsageError: two of them give the amount of one condition.
        """
        values = [v for name, v in context.params.items() if was_given(context, name)]
        rows = (value if isinstance(value, tuple) else (value,) for value in values)
        said: dict[str, Any] = {}
        for spec in (value for row in rows for value in row if isinstance(value, Spec)):
            repeated = {
                "conditions": {**said.get("conditions", {}), **spec.conditions},
                "start_from": (*said.get("start_from", ()), *spec.start_from),
            }
            said |= spec.user_values | repeated
        kinds = {parameter.name or "" for parameter in context.command.params}
        is_trusted = context.params.get("is_trusted", False)
        options = cls(Spec(**said), context.params.get(AS), is_trusted, kinds=kinds)
        simulator_options = options.spec.part("simulator").options
        for name in options.spec.conditions:
            if condition_named(name).attribute in simulator_options:
                raise click.UsageError(f"{name} is there twice, in --with and in --simulator")
        return options

    def __bool__(self) -> bool:
        return bool(self.spec.user_values) or self.driven_as is not None

    def says(self, *entries: str) -> bool:
        """Tell whether an option sets one of these entries."""
        return not self.spec.user_values.keys().isdisjoint(entries)

    @property
    def parts(self) -> list[str]:
        """Kinds of the parts that the command line names; options alone name no part."""
        texts = {kind: text for kind in PARTS if (text := getattr(self.spec, kind))}
        named = [kind for kind, text in texts.items() if read_part(text)[0] is not None]
        return named + [kind for kind in ("objective", "workers") if self.says(kind)]

    def over(self, spec: Spec, *, has_roads: bool = True) -> Spec:
        """Return the spec with the driving entries of ``--as``, if given, and then the options.

        Args:
            spec: what holds otherwise.
            has_roads: whether the roads exist, with a map and a lane width of their own.

        Raises:
            FreneticError: the file cannot be read, or an option is out of range.
        """
        if (source := self._as_source) is not None:
            spec = Spec.of(
                spec.without_driving(has_roads=has_roads),
                source.spec.driving_spec(has_roads=has_roads),
            )
        return Spec.of(spec, self.spec)

    @cached_property
    def _as_source(self) -> PartsSource | None:
        """The file of ``--as``."""
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
            spec: of the parts, as `over` gives it.
            source: that it was merged with, if any.
            left_out: kinds of parts that the command does not make.
            of_file: kinds of parts that ``--as`` replaces.
            others: other parts that it makes, such as a bench's entrants.
            noted: kinds of parts whose folder the command has noted before.

        Returns:
            The spec, and the folder in which it has to be made: what comes from another folder has
            absolute paths.

        Raises:
            FreneticError: the user has not trusted a file or campaign that names code.
        """
        here = Path.cwd()
        parts = {kind: part for kind, part in spec.parts.items() if kind not in left_out}
        needed: Parts = {**parts, **others}
        names = {kind: part for kind, part in self.spec.parts.items() if kind in self.parts}
        named: Parts = {**names, **self.others}
        if self._as_source is None:
            of_file = ()
        folders: dict[str, Path] = {}
        for file, its in (
            (self._as_source, {kind: part for kind, part in needed.items() if kind in of_file}),
            (source, {kind: part for kind, part in needed.items() if kind not in of_file}),
        ):
            if file is not None:
                folder = self._trusted_folder(file, named, its)
                folders |= {k: here if k in named else folder for k in named_code(its)}
        place = next((folder for folder in folders.values() if not is_here(folder)), here)
        for kind, folder in folders.items():
            if not is_here(folder) and kind not in {"workers", *noted}:
                Log().print(f"Note: {needed[kind][0]} is loaded from {folder}", markup=False)
        elsewhere = {
            kind: folders.get(kind, here)
            for kind in named_code(needed)
            if kind in REGISTRIES and folders.get(kind, here) != place
        }
        return spec.with_files_in(elsewhere), place

    def _trusted_folder(self, source: PartsSource, named: Parts, needed: Parts) -> Path:
        """Return the folder of a source's code; with ``--trust``, sign the source."""
        spec = source.spec
        folder = spec.require_trusted(
            source.path,
            others=source.others,
            named=named,
            needed=needed,
            is_trusted=self.is_trusted,
            sources=source.sources,
            is_toml=source.sign is None,
            optional=self.kinds,
        )
        if self.is_trusted and source.sign is not None:
            signed = spec.signed_in(folder, source.sources, source.others).signed
            if signed is not None and signed != spec.signed:
                source.sign(signed)
        return folder

    def conditions(self, spec: Spec) -> list[str]:
        """Return the conditions whose amounts the command line sets, instead of the tests.

        Args:
            spec: as `over` gives it.
        """
        conditions = [*self.spec.conditions]
        if self.driven_as is not None:
            return [*conditions, *spec.amounts]
        return [*conditions, *amounts_in(self.spec.part("simulator").options)]

    def check_drawn(self, spec: Spec) -> None:
        """Refuse an amount of a condition that the spec's domain draws.

        Raises:
            click.UsageError: the command line gives one.
        """
        for name in CommandOptions(self.spec).conditions(Spec()):
            if spec.domain is not None and name in spec.domain.conditions:
                raise click.UsageError(
                    f"{name} is given, and {spec.domain.name} draws it: leave out one of the two"
                )


place_option: Final = entry_option(
    "simulator", "Where the simulator is now, if it has moved: host=pc,port=25252 or home=/opt/b."
)


def without_place(spec: Spec) -> Spec:
    """Return the spec without the options that say where its simulator is."""
    part = spec.part("simulator")
    if not part.options or SIMULATORS.is_own(part.name):
        return spec
    return _placed(spec, {})


def moved(recorded: Spec, place_options: Spec | None) -> Spec:
    """Return the spec of a campaign with its simulator where `place_option` says.

    Raises:
        click.UsageError: it says more than a place, or the simulator is another.
    """
    if place_options is None:
        return recorded
    name, known_options = (
        recorded.part("simulator").name,
        usual_of(recorded.part("simulator").name).place_options,
    )
    place_part = Spec.of({"simulator": name}, place_options).part("simulator")
    if place_part.name != name or not place_part.options.keys() <= {*known_options}:
        only = f"can only say where {name} is ({', '.join(known_options)})"
        raise click.UsageError(
            f"--simulator {only if known_options else f'is for one that moves, unlike {name}'}:"
            " all else would be another campaign"
        )
    return _placed(recorded, place_part.options)


def _placed(spec: Spec, place: Mapping[str, Any]) -> Spec:
    """Return the spec with these options that say where its simulator is, and no others."""
    name, options = spec.part("simulator")
    known = usual_of(name).place_options
    others = {option: value for option, value in options.items() if option not in known}
    return structs.replace(spec, simulator=part_word(name, {**others, **place}))
