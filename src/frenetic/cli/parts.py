"""The options that choose driver, simulator and rules, as `frenetic.spec` declares them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import click
from click.shell_completion import CompletionItem

from frenetic._support.words import read_part
from frenetic.cli.options import Decorator, with_options
from frenetic.errors import FreneticError
from frenetic.quantities import quantities, quantity
from frenetic.registry import SIMULATORS
from frenetic.spec import NUMBERS, Part, Spec, drive_options, usual_of
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


def part_choice(
    kind: str,
    help: str,  # noqa: A002
    default: str | None = None,
    *,
    show_default: bool | str = True,
    required: bool = False,
    name: str | None = None,
) -> Decorator:
    """The option for a part with its own options: ``planner,aggression=1.2``.

    Options alone, ``aggression=1.2``, are those of the part that is taken otherwise.

    Args:
        kind: of the part.
        help: of the option.
        default: its default.
        show_default: its words for that.
        required: whether it has to be given.
        name: its name if that is not the kind.
    """
    name = name or kind

    def split(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
        """Gives the options a parameter of their own; returns the name."""
        try:
            given, options = (None, {}) if value is None else read_part(value)
        except ValueError as error:
            raise click.BadParameter(str(error), ctx, param) from None
        assert param.name is not None
        source = ctx.get_parameter_source(param.name)
        ctx.params[f"{param.name}_options"] = tuple(options.items())
        if options and source is not None:
            ctx.set_parameter_source(f"{param.name}_options", source)
        if given is None and value is not None:
            if required:
                raise click.BadParameter("a name is needed before the options", ctx, param)
            ctx.set_parameter_source(param.name, click.core.ParameterSource.DEFAULT)
            return default
        return given

    option = click.option(
        f"--{name}",
        default=default,
        show_default=show_default,
        required=required,
        metavar=kind.upper(),
        help=f"{help} With options: {_EXAMPLES[kind]}.",
        shell_complete=names_of(kind),
        callback=split,
    )
    return lambda command: with_options([option], command)


class Amount(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """NAME=VALUE for a quantity."""

    name = "name=value"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        """(name, amount)."""
        name, equals, text = (part.strip() for part in str(value).partition("="))
        row = quantity(name)
        try:
            amount = float(text) if equals else math.nan
        except ValueError:
            amount = math.nan
        if math.isnan(amount):
            self.fail(f"{value!r} is not NAME=VALUE, as in {name}={row.usual[1]:g}", param, ctx)
        try:
            return name, amount if amount == row.nothing else row.require(amount)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Read(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """What a function of `frenetic.run_file` reads from a text.

    Args:
        name: of such a text.
        function: its name, since that module is too slow for help.
    """

    def __init__(self, name: str, function: str) -> None:
        self.name = name
        self.function = function

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """What it reads."""
        from frenetic import run_file  # too slow for help

        try:
            return getattr(run_file, self.function)(value)
        except (ValueError, FreneticError) as error:
            self.fail(str(error), param, ctx)


roads_option: Final = click.option(
    "--roads",
    "road_class",
    type=Read("class", "read_class"),
    help="Roads that may exist: rural-80, say, or FILE.toml ('frenetic list roads')."
    " [default: competition]",
)


odd_option: Final = click.option(
    "--odd",
    "domain",
    type=Read("file", "read_domain"),
    metavar="FILE",
    help="Domain (TOML, OpenODD): roads, conditions to search.",
)


_criteria_option: Final = click.option(
    "--criteria",
    type=Read("profile", "read_criteria"),
    help="What fails beside leaving the lane, or FILE.toml ('frenetic list criteria').  [default:"
    " competition]",
)
_with_option: Final = click.option(
    "--with",
    "layers",
    type=Amount(),
    multiple=True,
    help="A condition: delay=0.1, friction=0.5; may be repeated ('frenetic list quantities').",
)
as_option: Final = click.option(
    "--as",
    AS,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Drive as this file says: a campaign's (campaign.toml), its failing road's or a twin's"
    " profile. Other options win.",
)


def _shown(default: object, is_recorded: bool) -> bool | str:
    return f"as recorded, or {default}" if is_recorded and default is not None else True


def part_choices(command: Callable[P, R], *, is_recorded: bool = False) -> Callable[P, R]:
    """The options that choose a driver, its conditions and a simulator; as for `driver_options`."""
    options: list[Decorator] = [
        part_choice(
            "driver",
            "Who drives: a name ('frenetic list drivers'), package.module:Class, file.py:Class or"
            " model.onnx.",
            Spec.driver.name,
            show_default=_shown(Spec.driver.name, is_recorded),
        ),
        _with_option,
        part_choice(
            "simulator",
            "What moves the car ('frenetic list simulators').",
            Spec.simulator.name,
            show_default=_shown(Spec.simulator.name, is_recorded),
        ),
    ]
    return with_options(options, command)


def driver_options(command: Callable[P, R], *, is_recorded: bool = False) -> Callable[P, R]:
    """The options that choose a driver, a simulator and the rules.

    Args:
        command: takes them.
        is_recorded: whether a road's file or campaign may say them; the help then says so.
    """
    numbers: list[Decorator] = [
        click.option(
            number.option,
            type=float,
            default=number.default,
            show_default=_shown(number.default, is_recorded),
            help=number.help,
        )
        for number in NUMBERS
    ]
    options = _criteria_option(with_options(numbers, command))
    return as_option(part_choices(options, is_recorded=is_recorded))


def recorded_options(command: Callable[P, R]) -> Callable[P, R]:
    """The same options for roads whose file or campaign may say how they were driven."""
    return driver_options(command, is_recorded=True)


def part_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose other parts than the recorded ones; None if not given."""
    options: list[Decorator] = [
        as_option,
        part_choice("driver", "Another driver than the recorded one."),
        _with_option,
        part_choice("simulator", "Another simulator than the recorded one."),
    ]
    return with_options(options, command)


def was_given(context: click.Context, name: str) -> bool:
    """Whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def given_options(context: click.Context) -> dict[str, Any]:
    """Name -> value of the options of `driver_options` that the command line gives."""
    names = (AS, *drive_options())
    return {name: context.params[name] for name in names if was_given(context, name)}


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


def asked_spec(context: click.Context, **usual: Any) -> Spec:
    """The spec of a command line with `driver_options`, for roads yet to be made or placed.

    Args:
        context: of the command.
        usual: values of options in place of those of the command line.

    Raises:
        FreneticError: the file cannot be read, or an option is out of range.
    """
    params = {**context.params, **usual}
    if params.get("road_class") is not None:  # which says these, unless they are given
        for name in ("map_size", "speed_limit"):
            if not was_given(context, name):
                params.pop(name)
    spec, given = Spec.from_options(params), given_options(context)
    return with_given(spec, given, has_roads=False) if AS in given else spec


def with_given(spec: Spec, given: Mapping[str, Any], *, has_roads: bool = True) -> Spec:
    """A spec that drives as a file says, if one is given, and then with the given options.

    Args:
        spec: what holds otherwise.
        given: values of the options of `driver_options` or `part_options`, None if not given.
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
