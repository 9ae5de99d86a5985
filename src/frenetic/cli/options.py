"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeAlias, TypeVar

import click

from frenetic.cli.option_types import FOLDER_TYPE, WORKERS_TYPE

P = ParamSpec("P")
R = TypeVar("R")
Decorator: TypeAlias = Callable[[Any], Any]
"""A decorator that adds an option or argument to a command."""


def with_options(options: Sequence[Decorator], command: Callable[P, R]) -> Callable[P, R]:
    """Return the command with all these options or arguments, in this order in its help."""
    for option in reversed(options):  # click puts the option that is added last first
        command = option(command)
    return command


# Defaults of a new search

DEFAULT_SIMULATIONS: Final = 1000
"""Budget of a search without any limit, in drives (our choice)."""
SEED_LIMIT: Final = 2**31
"""Drawn seeds are below this number, so that every random generator takes them."""

# Errors of options


@contextmanager
def as_usage_error() -> Iterator[None]:
    """Turn a `ValueError`, with which the library refuses a value, into a usage error.

    An error that is only a `FreneticError` passes: `frenetic.cli.main` prints it in one line, too.
    """
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None


# Arguments

campaign_argument = click.argument("campaign", type=click.Path(path_type=Path))
"""Adds the argument CAMPAIGN, the folder of a campaign."""


def source_arguments(*, is_required: bool = True) -> Decorator:
    """Return the arguments SOURCE, a campaign's folder or a road file, and IDs of tests.

    Args:
        is_required: whether the command needs SOURCE.
    """
    name = "CAMPAIGN|ROAD" if is_required else "[CAMPAIGN|ROAD]"
    path_type = click.Path(path_type=Path)
    arguments = [
        click.argument("source", type=path_type, metavar=name, required=is_required),
        click.argument("test_ids", type=int, nargs=-1, metavar="[ID]..."),
    ]
    return lambda command: with_options(arguments, command)


# Options whose help differs between commands


def file_option(name: str, help: str, **attributes: Any) -> Decorator:  # noqa: A002
    """Return an option for a file.

    Args:
        name: name of the option, such as ``--out``.
        help: its help.
        attributes: further arguments of `click.option`, which win over the usual ones.
    """
    usual = {"type": click.Path(path_type=Path), "metavar": "FILE"}
    return click.option(name, **{**usual, **attributes}, help=help)


def folder_option(help: str) -> Decorator:  # noqa: A002
    """Return the option ``--out`` for the folder of results."""
    return click.option("--out", type=FOLDER_TYPE, metavar="DIR", help=help)


def count_option(
    name: str,
    help: str,  # noqa: A002
    *,
    least: int = 1,
    default: int | None = None,
) -> Decorator:
    """Return an option for a number of things, whose help shows the default.

    Args:
        name: name of the option, such as ``--top``.
        help: its help.
        least: least number allowed.
        default: number without the option; None if the command treats that itself.
    """
    number_type = click.IntRange(least)
    return click.option(
        name, type=number_type, default=default, show_default=True, metavar="N", help=help
    )


# Options that are alike in all commands

lane_option = click.option(
    "--lane",
    type=int,
    metavar="ID",
    help="OpenDRIVE: lane to drive on; a lane on the left (above 0) is driven opposite to the"
    " road's direction. [default: the innermost driving lane, on the right if possible]",
)
"""Option for the lane of an OpenDRIVE map."""
road_option = click.option(
    "--road",
    "map_roads",
    metavar="ID[,ID..]",
    help="OpenDRIVE: IDs of the map's roads to drive; joined roads count as one. ID@240 starts"
    " 240 m along the road. Quote an ID that holds a comma: '\"7,left\",8'.",
)
"""Option for roads of an OpenDRIVE map."""
workers_option = click.option(
    "--workers",
    type=WORKERS_TYPE,
    default=1,
    show_default=True,
    metavar="N",
    help="Drive on N roads at once, each in its own process.",
)
"""Option for the number of workers of a command that drives known roads."""
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
"""Option to print the result as JSON."""
