"""The options that choose driver, simulator and rules, as `frenetic.spec` declares them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import click
from click.shell_completion import CompletionItem

from frenetic.cli.beamng import beamng_options, with_beamng
from frenetic.cli.options import Decorator, Setting, with_options
from frenetic.drivers.loading import LAYERS
from frenetic.registry import DRIVERS, SIMULATORS, STRATEGIES
from frenetic.spec import NUMBERS, Spec, drive_options, usual_wall_limit

P = ParamSpec("P")
R = TypeVar("R")

PROFILE: Final = "profile"
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
) -> Decorator:
    """The options for a part and for its own options."""
    is_simulator = kind == "simulator"
    options = [
        click.option(
            f"--{kind}",
            default=default,
            show_default=show_default,
            is_eager=is_simulator,
            metavar=kind[0].upper(),
            help=help,
            shell_complete=names_of(kind),
        ),
        click.option(
            f"--{kind}-option",
            f"{kind}_options",
            type=Setting(),
            multiple=True,
            callback=with_beamng if is_simulator else None,
            help=f"An option of the {kind}, such as {_EXAMPLES[kind]}; may be repeated.",
        ),
    ]
    return lambda command: with_options(options, command)


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
    return with_options([profile_option(), *options], beamng_options(command))


def profile_option() -> Decorator:
    """The option for the profile of a twin."""
    return click.option(
        "--profile",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Drive with the twin of this profile ('frenetic calibrate'): its driver, car and"
        " rules, unless other options are given.",
    )


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
    return with_options([profile_option(), *options], beamng_options(command))


def was_given(context: click.Context, name: str) -> bool:
    """Whether the command line gives an option, so that its value is no default."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def given_options(context: click.Context) -> dict[str, Any]:
    """Name -> value of the options of `driver_options` that the command line gives."""
    names = (PROFILE, *drive_options())
    return {name: context.params[name] for name in names if was_given(context, name)}


def asked_spec(context: click.Context, options: Mapping[str, Any], **others: Any) -> Spec:
    """The spec of a command line with `driver_options`, for roads yet to be made or placed.

    Args:
        context: of the command.
        options: as for `Spec.from_options`, with defaults.
        others: likewise.

    Raises:
        FreneticError: the profile cannot be read, or an option is out of range.
    """
    spec, given = Spec.from_options(options, **others), given_options(context)
    return with_given(spec, given, has_roads=False) if PROFILE in given else spec


def with_given(spec: Spec, given: Mapping[str, Any], *, has_roads: bool = True) -> Spec:
    """A spec with the twin of a profile, if one is given, and then with the given options.

    Args:
        spec: what holds otherwise.
        given: values of the options of `driver_options` or `part_options`, None if not given.
        has_roads: as for `frenetic.profile.Profile.over`.

    Raises:
        FreneticError: the profile cannot be read, or an option is out of range.
    """
    path = given.get(PROFILE)
    if path is None:
        return spec.replaced(given)
    from frenetic.profile import Profile  # msgspec takes its time

    return Profile.read(path).over(spec, given, has_roads=has_roads)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _or_usual_limit(ctx: click.Context, _: click.Parameter, value: float | None) -> float:
    return usual_wall_limit(ctx.params["simulator"]) if value is None else value
