"""Options of commands that are entries of a `Spec`.

Each option is parsed to a spec with this entry alone; `frenetic.cli.command_options` merges them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Final, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem
from msgspec import Meta

from frenetic._support.option_text import read_setting
from frenetic.cli.options import Decorator, with_options
from frenetic.conditions.condition import condition_named
from frenetic.errors import FreneticError
from frenetic.parts.named_code import REGISTRIES
from frenetic.spec import Spec
from frenetic.spec.parts import PARTS

P = ParamSpec("P")
R = TypeVar("R")

AS_PARAMETER: Final = "driven_as"
"""Name of the option ``--as`` in Python, where ``as`` is a keyword."""
_OPTION_NAMES: Final = {"conditions": "with", "start_from": "from"}
"""Attribute of `Spec` -> name of its option, where the two differ."""
_EXAMPLES: Final = {
    "strategy": "frenetic-2021,threshold=-0.2",
    "driver": "planner,aggression=1.2",
    "simulator": "embedded,friction=0.7",
}
"""Kind of a part -> example with options, for the help."""
_REPEATABLE: Final = ("conditions", "start_from")
"""Entries whose option may be repeated."""
_DECLARATIONS: Final[Mapping[str, Any]] = get_type_hints(Spec, include_extras=True)
"""Attribute of `Spec` -> its type with bounds and help."""
_TYPES: Final[Mapping[str, Any]] = get_type_hints(Spec)
"""Attribute of `Spec` -> its type alone."""


def complete_names(
    kind: str,
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Return the shell completion for a kind of part: the known names, else files."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        names = [
            CompletionItem(entry.name, help=entry.summary or None)
            for entry in REGISTRIES[kind].entries()
            if entry.name.startswith(incomplete)
        ]
        return names or [CompletionItem(incomplete, type="file")]

    return complete


# ParamType takes a type parameter only from click 8.4 on.
class _SpecOption(click.ParamType):  # type: ignore[type-arg]
    """Option type: a text read into a spec with one entry.

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
        """Return the value of the entry that a text stands for."""
        if self.entry == "conditions":
            name, amount = _read_amount(text)
            return {name: amount}
        if self.entry == "start_from":
            return (text,)
        return text if _takes_text(self.entry) else read_setting(text)


def _takes_text(entry: str) -> bool:
    """Return whether an entry may be a text, so that its option is not read as a number."""
    entry_type = _TYPES[entry]
    return str in (entry_type, *get_args(entry_type))


def _read_amount(text: str) -> tuple[str, float]:
    """Return name and amount of a condition from NAME=VALUE.

    Raises:
        ValueError: VALUE is no number, or missing.
        FreneticError: no condition has this name.
    """
    name, _, amount_text = (part.strip() for part in text.partition("="))
    condition = condition_named(name)
    with suppress(ValueError):
        if not math.isnan(amount := float(amount_text)):
            return name, amount
    raise ValueError(f"{text!r} is not NAME=VALUE, as in {name}={condition.usual[1]:g}")


def _declared_help(entry: str) -> Meta:
    """Return the help that the declaration of an entry holds, with the option's placeholder."""
    declaration = _DECLARATIONS[entry]
    assert get_origin(declaration) is Annotated, f"{entry} has no option"
    _, *metas = get_args(declaration)
    return next(meta for meta in metas if isinstance(meta, Meta) and meta.description)


def entry_option(entry: str, help: str = "", *, parameter: str = "") -> Decorator:  # noqa: A002
    """Return the option for an entry of a spec.

    Args:
        entry: name of the attribute of `Spec`.
        help: help of the option; by default the help in the entry's declaration.
        parameter: name of the command's parameter; by default the name of the entry.
    """
    meta = _declared_help(entry)
    text = help or meta.description or ""
    metavar = (meta.extra or {}).get("metavar") or entry.upper()
    if entry in PARTS:
        text += f" With options: {_EXAMPLES[entry]}."
    return click.option(
        f"--{_OPTION_NAMES.get(entry, entry).replace('_', '-')}",
        parameter or entry,
        type=_SpecOption(entry),
        metavar=metavar,
        multiple=entry in _REPEATABLE,
        help=text,
        shell_complete=complete_names(entry) if entry in PARTS else None,
        callback=_refuse_repeated if entry == "conditions" else None,
    )


def entry_options(*entries: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that adds the options for several entries, in this order."""

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        return with_options([entry_option(entry) for entry in entries], command)

    return decorate


def _refuse_repeated(
    _: click.Context, __: click.Parameter, specs: tuple[Spec, ...]
) -> tuple[Spec, ...]:
    """Return the specs of ``--with``, each of another condition.

    Raises:
        click.BadParameter: two specs set one condition.
    """
    names = [name for spec in specs for name in spec.conditions]
    if repeated := {name for name in names if names.count(name) > 1}:
        raise click.BadParameter(f"{', '.join(sorted(repeated))} is there twice")
    return specs


as_option: Final = click.option(
    "--as",
    AS_PARAMETER,
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
    """Return whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE
