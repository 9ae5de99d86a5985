"""The options that choose driver, simulator and rules, and the specs that they give."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from frenetic._support.words import read_part
from frenetic.cli.options import Decorator, Read, with_options
from frenetic.quantities import quantities, quantity
from frenetic.registry import SIMULATORS
from frenetic.spec import Part, Spec, drive_options, usual_of
from frenetic.trust import REGISTRIES

P = ParamSpec("P")
R = TypeVar("R")

AS: Final = "driven_as"
"""Name of the parameter of ``--as``."""
_EXAMPLES: Final = {
    "strategy": "frenetic-2021,threshold=-0.2",
    "driver": "planner,aggression=1.2",
    "simulator": "embedded,friction=0.7",
}


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


def _give(context: click.Context, name: str, value: object) -> None:
    """Sets a parameter as if the command line gave it."""
    context.params[name] = value
    context.set_parameter_source(name, ParameterSource.COMMANDLINE)


def part_choice(kind: str, help: str) -> Decorator:  # noqa: A002
    """The option for a part with its own options: ``planner,aggression=1.2``.

    Options alone, ``aggression=1.2``, are those of the part that is taken otherwise.
    """

    def split(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
        """Gives the options a parameter of their own; returns the name."""
        try:
            given, options = (None, {}) if value is None else read_part(value)
        except ValueError as error:
            raise click.BadParameter(str(error), ctx, param) from None
        ctx.params[f"{kind}_options"] = ()
        if options:
            _give(ctx, f"{kind}_options", tuple(options.items()))
        if given is None:
            ctx.set_parameter_source(kind, ParameterSource.DEFAULT)
        return given

    return click.option(
        f"--{kind}",
        metavar=kind.upper(),
        help=f"{help} With options: {_EXAMPLES[kind]}.",
        shell_complete=names_of(kind),
        callback=split,
    )


def _once(
    _: click.Context, __: click.Parameter, amounts: tuple[tuple[str, float], ...]
) -> tuple[tuple[str, float], ...]:
    names = [name for name, _ in amounts]
    if twice := {name for name in names if names.count(name) > 1}:
        raise click.BadParameter(f"{', '.join(sorted(twice))} is there twice")
    return amounts


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
    return name, amount if amount == row.nothing else row.require(amount)


def _entry(name: str, function: str) -> Read:
    """The type of what a function of `frenetic.drive_entries` reads."""

    def read(text: str) -> Any:
        from frenetic import drive_entries  # too slow for help

        return getattr(drive_entries, function)(text)

    return Read(name, read)


def _give_rules(ctx: click.Context, _: click.Parameter, rules: dict[str, Any] | None) -> None:
    for name, value in (rules or {}).items():
        _give(ctx, name, value)


roads_option: Final = click.option(
    "--roads",
    "road_class",
    type=_entry("class", "read_class"),
    help="Roads that may exist: rural-80, say, or FILE.toml ('frenetic list roads')."
    " [default: competition]",
)
odd_option: Final = click.option(
    "--odd",
    "domain",
    type=_entry("file", "read_domain"),
    metavar="FILE",
    help="Domain (TOML): roads, conditions to search.",
)
map_size_option: Final = click.option(
    "--map-size", type=float, help="m, side of the map. [default: 200]"
)
criteria_option: Final = click.option(
    "--criteria",
    "rules",
    type=_entry("profile", "read_rules"),
    expose_value=False,
    callback=_give_rules,
    help="What fails beside leaving the lane, or FILE.toml ('frenetic list criteria'). With rules:"
    " competition,speed_limit=70,oob_tolerance=0.95, the default.",
)
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
    options: list[Decorator] = [
        as_option,
        part_choice(
            "driver",
            "Who drives: a name ('frenetic list drivers'), package.module:Class, file.py:Class or"
            " model.onnx. [default: as recorded, or planner]",
        ),
        click.option(
            "--with",
            "layers",
            type=Read("name=value", _read_amount),
            multiple=True,
            callback=_once,
            help="A condition: delay=0.1, friction=0.5; may be repeated ('frenetic list"
            " quantities').",
        ),
        part_choice(
            "simulator",
            "What moves the car ('frenetic list simulators'). [default: as recorded, or embedded]",
        ),
    ]
    return with_options(options, command)


def was_given(context: click.Context, name: str) -> bool:
    """Whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE


def given_options(context: click.Context) -> dict[str, Any]:
    """Name -> value of the options that say how roads are driven and are given.

    Raises:
        click.UsageError: two of them say the amount of a quantity.
    """
    names = (AS, "domain", *drive_options())
    given = {name: context.params[name] for name in names if was_given(context, name)}
    options = dict(given.get("simulator_options") or ())
    for name, _ in given.get("layers") or ():
        if quantity(name).attribute in options:
            raise click.UsageError(f"{name} is there twice, in --with and in --simulator")
    return given


def given_quantities(spec: Spec, given: Mapping[str, Any]) -> list[str]:
    """Quantities whose amounts the command line says, in place of those of tests.

    Args:
        spec: with the given options.
        given: as for `with_given`.
    """
    layers = dict(given.get("layers") or ())
    if given.get(AS) is not None:
        return [*layers, *spec.conditions]
    options = dict(given.get("simulator_options") or ())
    return [*layers, *(row.name for row in quantities().values() if row.attribute in options)]


def check_drawn(spec: Spec, given: Mapping[str, Any]) -> None:
    """Refuses an amount of a condition that the spec's domain draws.

    Raises:
        click.UsageError: the command line gives one.
    """
    for name in given_quantities(Spec(), {**given, AS: None}):
        if spec.domain is not None and name in spec.domain.conditions:
            raise click.UsageError(
                f"{name} is given, and {spec.domain.name} draws it: leave out one of the two"
            )


def with_given(spec: Spec, given: Mapping[str, Any], *, has_roads: bool = True) -> Spec:
    """A spec that drives as a file says, if one is given, and then with the given options.

    Args:
        spec: what holds otherwise.
        given: values of options that are given, see `given_options`.
        has_roads: as for `Spec.driven_as`.

    Raises:
        FreneticError: the file cannot be read, or an option is out of range.
    """
    path = given.get(AS)
    if path is None:
        return spec.replaced(given)
    from frenetic.run_file import read_run_file  # too slow for help

    other = read_run_file(path)[0] if path.suffix.lower() == ".toml" else Spec.read(path)
    return spec.driven_as(other, given, source=path, has_roads=has_roads)


place_option: Final = part_choice(
    "simulator", "Where the simulator is now, if it has moved: host=pc,port=25252 or home=/opt/b."
)


def without_place(simulator: Part) -> Part:
    """A simulator without the options that say where it is; a user's own one is not loaded."""
    name = simulator.name or ""
    if not simulator.options or SIMULATORS.is_own(name):
        return simulator
    return _placed(simulator, usual_of(name).place_options, {})


def moved(recorded: Part, name: str | None, options: tuple[tuple[str, Any], ...]) -> Part:
    """A campaign's simulator, where `place_option` says that it is now.

    Raises:
        click.UsageError: it says more than a place, or the simulator is another.
    """
    place = dict(options)
    if name is None and not place:
        return recorded
    known = usual_of(recorded.name or "").place_options
    if name not in (None, recorded.name) or not place.keys() <= {*known}:
        only = f"can only say where {recorded.name} is ({', '.join(known)})"
        raise click.UsageError(
            f"--simulator {only if known else f'is for one that moves, unlike {recorded.name}'}:"
            " all else would be another campaign"
        )
    return _placed(recorded, known, place)


def _placed(simulator: Part, known: Collection[str], place: Mapping[str, Any]) -> Part:
    kept = {name: value for name, value in simulator.options.items() if name not in known}
    return replace(simulator, options={**kept, **place})
