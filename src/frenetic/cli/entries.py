"""Options of commands that are entries of a `Spec`, and the specs that they give.

Each option's value is a spec that says its entry, so what a command line says is a row of specs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem
from msgspec import Meta, structs

from frenetic._support.words import part_word, read_part, read_setting
from frenetic.cli.options import Decorator, with_options
from frenetic.description import PARTS
from frenetic.errors import FreneticError
from frenetic.quantities import quantities, quantity
from frenetic.registry import SIMULATORS
from frenetic.spec import Spec, usual_of
from frenetic.trust import REGISTRIES

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
_NUMBERS: Final = ("map_size", "simulations", "failures", "seed")
"""Entries that are numbers in their options."""
_SEVERAL: Final = ("conditions", "start_from")
"""Entries whose option may be repeated."""


def names_of(
    kind: str,
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Completes the names of a kind of part; anything else is a file, as in file.py:Class."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        names = [
            CompletionItem(entry.name, help=entry.summary or None)
            for entry in REGISTRIES[kind].entries()
            if entry.name.startswith(incomplete)
        ]
        return names or [CompletionItem(incomplete, type="file")]

    return complete


class _Entry(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """A spec that says one entry, whose value is a text.

    Args:
        entry: name of the attribute of `Spec`.
    """

    def __init__(self, entry: str) -> None:
        self.name = self.entry = entry

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Spec:
        """The spec."""
        if isinstance(value, Spec):
            return value
        try:
            return Spec(**{self.entry: self._read(value)})
        except (ValueError, FreneticError) as error:
            self.fail(str(error), param, ctx)

    def _read(self, text: str) -> Any:
        """The value of the entry."""
        if self.entry == "conditions":
            return dict([_read_amount(text)])
        if self.entry == "start_from":
            return (text,)
        return read_setting(text) if self.entry in _NUMBERS else text


_HINTS: Final[Mapping[str, Any]] = get_type_hints(Spec, include_extras=True)


def _read_amount(given: str) -> tuple[str, float]:
    """(name, amount) of a quantity, from NAME=VALUE."""
    name, equals, text = (part.strip() for part in given.partition("="))
    row = quantity(name)
    try:
        amount = float(text) if equals else math.nan
    except ValueError:
        amount = math.nan
    if math.isnan(amount):
        raise ValueError(f"{given!r} is not NAME=VALUE, as in {name}={row.usual[1]:g}")
    return name, amount


def _meta(entry: str) -> Meta:
    """What is said about an entry where it is declared."""
    hint = _HINTS[entry]
    assert get_origin(hint) is Annotated, f"{entry} has no option"
    return next(item for item in get_args(hint)[1:] if isinstance(item, Meta) and item.description)


def entry_option(entry: str, help: str = "") -> Decorator:  # noqa: A002
    """The option for an entry of a spec, as its declaration says.

    Args:
        entry: name of the attribute of `Spec`.
        help: another text than that of the declaration.
    """
    meta = _meta(entry)
    text = help or meta.description or ""
    metavar = (meta.extra or {}).get("metavar") or entry.upper()
    if entry in PARTS:
        text += f" With options: {_EXAMPLES[entry]}."
    return click.option(
        f"--{_NAMES.get(entry, entry).replace('_', '-')}",
        entry,
        type=_Entry(entry),
        metavar=metavar,
        multiple=entry in _SEVERAL,
        help=text,
        shell_complete=names_of(entry) if entry in PARTS else None,
        callback=_once if entry == "conditions" else None,
    )


def entry_options(*entries: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """The options for several entries, in this order."""

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
    help="Drive as this file says: a campaign's (campaign.toml), its failing road's or a twin's"
    " profile. Other options win.",
)


def part_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose a driver, its conditions and a simulator."""
    return with_options(
        [as_option, *map(entry_option, ("driver", "conditions", "simulator"))], command
    )


def was_given(context: click.Context, name: str) -> bool:
    """Whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE


@dataclass(frozen=True)
class Given:
    """What a command line says of how roads are driven and searched."""

    spec: Spec = field(default_factory=Spec)
    """Entries that the options say."""
    driven_as: Path | None = None
    """File of ``--as``."""

    @classmethod
    def of(cls, context: click.Context) -> Given:
        """What the options of a command say, in whatever order.

        Raises:
            click.UsageError: two of them say the amount of a quantity.
        """
        values = [v for name, v in context.params.items() if was_given(context, name)]
        rows = (value if isinstance(value, tuple) else (value,) for value in values)
        said: dict[str, Any] = {}
        for spec in (value for row in rows for value in row if isinstance(value, Spec)):
            repeated = {
                "conditions": {**said.get("conditions", {}), **spec.conditions},
                "start_from": (*said.get("start_from", ()), *spec.start_from),
            }
            said |= spec.said | repeated
        given = cls(Spec(**said), context.params.get(AS))
        options = given.spec.part("simulator").options
        for name in given.spec.conditions:
            if quantity(name).attribute in options:
                raise click.UsageError(f"{name} is there twice, in --with and in --simulator")
        return given

    def __bool__(self) -> bool:
        return bool(self.spec.said) or self.driven_as is not None

    def says(self, *entries: str) -> bool:
        """Whether an option says one of these entries."""
        return not self.spec.said.keys().isdisjoint(entries)

    @property
    def parts(self) -> list[str]:
        """Kinds of the parts that it names, of which it does not only say options."""
        texts = {kind: text for kind in PARTS if (text := getattr(self.spec, kind))}
        named = [kind for kind, text in texts.items() if read_part(text)[0] is not None]
        return named + (["objective"] if self.says("objective") else [])

    def over(self, spec: Spec, *, has_roads: bool = True) -> Spec:
        """A spec that drives as ``--as`` says, if it is given, and then as the options say.

        Args:
            spec: what holds otherwise.
            has_roads: whether the roads exist, with a map and a lane width of their own.

        Raises:
            FreneticError: the file cannot be read, names code that is not loaded unasked
                (`frenetic.trust`), or an option is out of range.
        """
        if (path := self.driven_as) is not None:
            is_spec = path.suffix.lower() == ".toml"
            other = Spec.read(path) if is_spec else Spec.read_driven(path)
            other.require_trusted(path, ("strategy", "objective", *self.parts))
            spec = Spec.of(
                spec.without_driving(has_roads=has_roads), other.driving(has_roads=has_roads)
            )
        return Spec.of(spec, self.spec)

    def quantities(self, spec: Spec) -> list[str]:
        """Quantities whose amounts the command line says, in place of those of tests.

        Args:
            spec: as `over` gives it.
        """
        conditions = [*self.spec.conditions]
        if self.driven_as is not None:
            return [*conditions, *spec.amounts]
        options = self.spec.part("simulator").options
        attributes = (row.name for row in quantities().values() if row.attribute in options)
        return [*conditions, *attributes]

    def check_drawn(self, spec: Spec) -> None:
        """Refuses an amount of a condition that the spec's domain draws.

        Raises:
            click.UsageError: the command line gives one.
        """
        for name in Given(self.spec).quantities(Spec()):
            if spec.domain is not None and name in spec.domain.conditions:
                raise click.UsageError(
                    f"{name} is given, and {spec.domain.name} draws it: leave out one of the two"
                )


place_option: Final = entry_option(
    "simulator", "Where the simulator is now, if it has moved: host=pc,port=25252 or home=/opt/b."
)


def without_place(spec: Spec) -> Spec:
    """A spec without the options that say where its simulator is; a user's own is not loaded."""
    part = spec.part("simulator")
    if not part.options or SIMULATORS.is_own(part.name):
        return spec
    return _placed(spec, {})


def moved(recorded: Spec, given: Spec | None) -> Spec:
    """The spec of a campaign, whose simulator is where `place_option` says that it is now.

    Raises:
        click.UsageError: it says more than a place, or the simulator is another.
    """
    if given is None:
        return recorded
    name, known = (
        recorded.part("simulator").name,
        usual_of(recorded.part("simulator").name).place_options,
    )
    place = Spec.of({"simulator": name}, given).part("simulator")
    if place.name != name or not place.options.keys() <= {*known}:
        only = f"can only say where {name} is ({', '.join(known)})"
        raise click.UsageError(
            f"--simulator {only if known else f'is for one that moves, unlike {name}'}:"
            " all else would be another campaign"
        )
    return _placed(recorded, place.options)


def _placed(spec: Spec, place: Mapping[str, Any]) -> Spec:
    """The spec whose simulator has these options in place of those that say where it is."""
    name, options = spec.part("simulator")
    known = usual_of(name).place_options
    kept = {option: value for option, value in options.items() if option not in known}
    return structs.replace(spec, simulator=part_word(name, {**kept, **place}))
