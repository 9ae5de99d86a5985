"""The options of BeamNG.tech: short forms of options of the simulator ``beamng``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, ParamSpec, TypeVar

import click

from frenetic.cli.console import shell
from frenetic.cli.options import Decorator, GroupedOption, with_options

P = ParamSpec("P")
R = TypeVar("R")

NAME: Final = "beamng"
GROUP: Final = "BeamNG.tech options (with --simulator beamng)"
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
    return simulator == NAME or simulator.endswith(":BeamngSimulator")


def without_place(options: Mapping[str, Any]) -> dict[str, Any]:
    """Recorded options of the simulator without those that `place_options` give."""
    return {k: v for k, v in options.items() if k not in (*_STARTING, "host", "port")}


def place_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that say where BeamNG.tech is and change no drive."""
    options = [
        _option(
            "--beamng-home",
            metavar="DIR",
            help="Start BeamNG.tech from this installation. [default: what BNG_HOME says]",
        ),
        _option("--beamng-user", metavar="DIR", help="Folder for what it writes."),
        _option("--headless", is_flag=True, default=None, help="Start it without a window."),
        _option("--no-gpu", is_flag=True, default=None, help="Start it without a graphics card."),
        _option("--beamng-host", metavar="HOST", help="Connect to one that runs there."),
        _option(
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
        _option("--beamng-vehicle", metavar="MODEL", help="The car. [default: etk800]"),
        _option(
            "--aggression", type=float, help="Of BeamNG.AI, --driver beamng-ai. [default: 0.7]"
        ),
        _option(
            "--steps-per-second",
            type=int,
            metavar="N",
            help="Steps of a simulated second, a multiple of 20. [default: 60]",
        ),
    ]
    return place_options(with_options(options, command))


def _option(name: str, **how: Any) -> Decorator:
    # Eager, so that all are known when `with_beamng` collects them.
    return click.option(
        name,
        cls=GroupedOption,
        group=GROUP,
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
            f"{option} is for --simulator {NAME}, but the simulator is {simulator!r}"
        )
    return {_OPTIONS[name]: value for name, (_, value) in given.items()}
