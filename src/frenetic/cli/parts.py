"""The options that choose driver, simulator and rules, as `frenetic.spec` declares them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import click
from click.shell_completion import CompletionItem

from frenetic.cli.console import shell
from frenetic.cli.options import Decorator, GroupedOption, Setting, with_options
from frenetic.drivers.loading import LAYERS
from frenetic.registry import DRIVERS, SIMULATORS, STRATEGIES
from frenetic.spec import NUMBERS, Spec, drive_options, usual_wall_limit

P = ParamSpec("P")
R = TypeVar("R")

AS: Final = "driven_as"
"""Name of the parameter of ``--as``."""
_EXAMPLES: Final = {
    "strategy": "threshold=-0.2",
    "driver": "aggression=1.2",
    "simulator": "friction=0.7",
}


_REGISTRIES: Final = {"strategy": STRATEGIES, "driver": DRIVERS, "simulator": SIMULATORS}


def names_of(
    kind: str,
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Completes the names of a kind of part; anything else is a file, as in file.py:Class."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        names = [
            CompletionItem(entry.name, help=entry.summary or None)
            for entry in _REGISTRIES[kind].entries()
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
    whose: str | None = None,
) -> Decorator:
    """The options for a part and for its own options.

    Args:
        kind: of the part.
        help: of the option for the part, as the next three.
        default: its default.
        show_default: its words for that.
        required: whether it has to be given.
        name: its name if that is not the kind.
        whose: words for what has the options, such as "the new version".
    """
    is_simulator, name, whose = kind == "simulator", name or kind, whose or f"the {kind}"
    options = [
        click.option(
            f"--{name}",
            default=default,
            show_default=show_default,
            required=required,
            is_eager=is_simulator,
            metavar=kind[0].upper(),
            help=help,
            shell_complete=names_of(kind),
        ),
        click.option(
            f"--{name}-option",
            f"{name.replace('-', '_')}_options",
            type=Setting(),
            multiple=True,
            callback=with_beamng if is_simulator else None,
            help=f"An option of {whose}, such as {_EXAMPLES[kind]}; may be repeated.",
        ),
    ]
    return lambda command: with_options(options, command)


_as_option: Final = click.option(
    "--as",
    AS,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Drive as this file says, that of a campaign's failing road or a twin's profile"
    " ('frenetic calibrate'): driver, simulator and rules, unless other options are given.",
)


def driver_options(command: Callable[P, R], *, is_recorded: bool = False) -> Callable[P, R]:
    """The options that choose a driver, a simulator and the rules.

    Args:
        command: takes them.
        is_recorded: whether a road's file or campaign may say them; the help then says so.
    """

    def shown(default: object) -> bool | str:
        return f"as recorded, or {default}" if is_recorded and default is not None else True

    options: list[Decorator] = [
        part_choice(
            "driver",
            "Who drives: a name ('frenetic drivers'), package.module:Class, file.py:Class or a"
            " neural network, model.onnx.",
            Spec.driver.name,
            show_default=shown(Spec.driver.name),
        ),
        *(
            click.option(f"--{layer.name}", type=float, metavar=layer.unit.upper(), help=layer.help)
            for layer in LAYERS
        ),
        part_choice(
            "simulator",
            "What moves the car (see 'frenetic simulators').",
            Spec.simulator.name,
            show_default=shown(Spec.simulator.name),
        ),
        *(
            click.option(
                _option(number.name),
                type=float,
                default=number.default,
                show_default=shown(number.default),
                callback=_or_usual_limit if number.default is None else None,
                help=number.help,
            )
            for number in NUMBERS
        ),
    ]
    return with_options([_as_option, *options], beamng_options(command))


def recorded_options(command: Callable[P, R]) -> Callable[P, R]:
    """The same options for roads whose file or campaign may say how they were driven."""
    return driver_options(command, is_recorded=True)


def part_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose other parts than the recorded ones; None if not given."""
    options: list[Decorator] = [
        part_choice("driver", "Another driver than the campaign's."),
        *(
            click.option(
                f"--{layer.name}", type=float, metavar=layer.unit.upper(), help=layer.another
            )
            for layer in LAYERS
        ),
        part_choice("simulator", "Another simulator than the campaign's."),
        *(
            click.option(
                _option(number.name), type=float, metavar=number.metavar, help=number.another
            )
            for number in NUMBERS
            if number.another
        ),
    ]
    return with_options([_as_option, *options], beamng_options(command))


def was_given(context: click.Context, name: str) -> bool:
    """Whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def given_options(context: click.Context) -> dict[str, Any]:
    """Name -> value of the options of `driver_options` that the command line gives."""
    names = (AS, *drive_options())
    return {name: context.params[name] for name in names if was_given(context, name)}


def asked_spec(context: click.Context, options: Mapping[str, Any], **others: Any) -> Spec:
    """The spec of a command line with `driver_options`, for roads yet to be made or placed.

    Args:
        context: of the command.
        options: as for `Spec.from_options`, with defaults.
        others: likewise.

    Raises:
        FreneticError: the file cannot be read, or an option is out of range.
    """
    # 0 s of delay are a layer in a campaign's record; an infinite view never was one.
    none = {
        layer.name: None for layer in LAYERS if layer.nothing == math.inf == options.get(layer.name)
    }
    spec, given = Spec.from_options({**options, **none}, **others), given_options(context)
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
    return spec.driven_as(Spec.read(path), given, source=path, has_roads=has_roads)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _or_usual_limit(ctx: click.Context, _: click.Parameter, value: float | None) -> float:
    return usual_wall_limit(ctx.params["simulator"]) if value is None else value


# BeamNG.tech: short forms of options of its simulator

BEAMNG: Final = "beamng"
_GROUP: Final = "BeamNG.tech options (with --simulator beamng)"
_GIVEN: Final = "frenetic.beamng"
# Options of a BeamNG.tech that is started.
_STARTING: Final = ("home", "user", "headless", "no_gpu", "restart_every")
_PLACE: Final = ("home", "user", "headless", "no_gpu", "host", "port")
# Name of the parameter -> of the simulator's option.
_OPTIONS: Final = {
    "beamng_home": "home",
    "beamng_user": "user",
    "headless": "headless",
    "no_gpu": "no_gpu",
    "beamng_host": "host",
    "beamng_port": "port",
    "beamng_vehicle": "vehicle",
    "aggression": "aggression",
    "steps_per_second": "steps_per_second",
}


def is_beamng(simulator: str) -> bool:
    """Whether a simulator's name is that of BeamNG.tech."""
    return simulator == BEAMNG or simulator.endswith(":BeamngSimulator")


def without_place(options: Mapping[str, Any]) -> dict[str, Any]:
    """Recorded options of the simulator without those that `place_options` give."""
    return {k: v for k, v in options.items() if k not in (*_STARTING, "host", "port")}


def place_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that say where BeamNG.tech is and change no drive."""
    options = [
        _beamng(
            "--beamng-home",
            metavar="DIR",
            help="Start BeamNG.tech from this installation. [default: what BNG_HOME says]",
        ),
        _beamng("--beamng-user", metavar="DIR", help="Folder for what it writes."),
        _beamng("--headless", is_flag=True, default=None, help="Start it without a window."),
        _beamng("--no-gpu", is_flag=True, default=None, help="Start it without a graphics card."),
        _beamng("--beamng-host", metavar="HOST", help="Connect to one that runs there."),
        _beamng(
            "--beamng-port",
            type=click.IntRange(1, 65535),
            metavar="PORT",
            help="Where it listens. [default: 25252, or a free one if it is started]",
        ),
    ]
    return with_options(options, command)


def beamng_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options of BeamNG.tech, which become options of the simulator."""
    options = [
        _beamng("--beamng-vehicle", metavar="MODEL", help="The car. [default: etk800]"),
        _beamng(
            "--aggression", type=float, help="Of BeamNG.AI, --driver beamng-ai. [default: 0.7]"
        ),
        _beamng(
            "--steps-per-second",
            type=int,
            metavar="N",
            help="Steps of a simulated second, a multiple of 20. [default: 60]",
        ),
    ]
    return place_options(with_options(options, command))


def _beamng(name: str, **how: Any) -> Decorator:
    # Eager, so that all are known when `with_beamng` collects them.
    return click.option(
        name,
        cls=GroupedOption,
        group=_GROUP,
        is_eager=True,
        expose_value=False,
        callback=_remember,
        **how,
    )


def _remember(ctx: click.Context, param: click.Parameter, value: Any) -> None:
    if value is not None and param.name is not None:
        ctx.meta.setdefault(_GIVEN, {})[param.name] = (param.opts[0], value)


def with_beamng(
    ctx: click.Context, param: click.Parameter, value: tuple[tuple[str, Any], ...]
) -> tuple[tuple[str, Any], ...]:
    """Adds the given options of BeamNG.tech to those of the simulator.

    Raises:
        click.UsageError: the simulator is another.
    """
    given = _given(ctx, ctx.params.get("simulator"))
    if not given:
        return value
    assert param.name is not None
    ctx.set_parameter_source(param.name, click.core.ParameterSource.COMMANDLINE)
    return (*value, *given.items())


def place_words(context: click.Context) -> list[str]:
    """The given options of `place_options` as words of a command line."""
    given: dict[str, tuple[str, Any]] = context.meta.get(_GIVEN, {})
    words = []
    for name, (option, value) in given.items():
        if _OPTIONS[name] in _PLACE:
            words += [option] if value is True else [option, shell(str(value))]
    return words


def moved(simulator: str | None, recorded: Mapping[str, Any]) -> dict[str, Any]:
    """A campaign's options of its simulator, with what `place_options` say in their place.

    If BeamNG.tech was started and is now connected to, or the other way round, recorded options for
    that no longer hold.

    Raises:
        click.UsageError: the simulator is another.
    """
    given = _given(click.get_current_context(), simulator)
    ended: tuple[str, ...] = ()
    if "host" in given:
        ended = _STARTING
    elif "home" in given and "home" not in recorded:
        ended = ("host", "port")
    return {name: value for name, value in recorded.items() if name not in ended} | given


def _given(ctx: click.Context, simulator: str | None) -> dict[str, Any]:
    """The given options of BeamNG.tech, by their names for the simulator."""
    given: dict[str, tuple[str, Any]] = ctx.meta.get(_GIVEN, {})
    if given and simulator is not None and not is_beamng(simulator):
        (option, _), *_ = given.values()
        raise click.UsageError(
            f"{option} is for --simulator {BEAMNG}, but the simulator is {simulator!r}"
        )
    return {_OPTIONS[name]: value for name, (_, value) in given.items()}
