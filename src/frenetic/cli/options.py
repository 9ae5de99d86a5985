"""Shared parts of several commands' options: types, groups in help, checks."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeAlias, TypeVar

import click

from frenetic._support.files import check_writable
from frenetic._support.words import parse_duration
from frenetic.errors import FreneticError
from frenetic.spec import MAX_WORKERS

WORKERS: Final = click.IntRange(1, MAX_WORKERS)
"""Type of a number of workers."""

P = ParamSpec("P")
R = TypeVar("R")
Decorator: TypeAlias = Callable[[Any], Any]
"""A decorator that adds an option to a command."""


def with_options(options: Sequence[Decorator], command: Callable[P, R]) -> Callable[P, R]:
    """Return the command with all these options, in this order."""
    for option in reversed(options):
        command = option(command)
    return command


class Read(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """Type of an argument that a function reads from a text; its errors are a user's mistakes.

    Args:
        name: of such a text.
        function: raises `ValueError` or `FreneticError`.
    """

    def __init__(self, name: str, function: Callable[[str], Any]) -> None:
        self.name = name
        self.function = function

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value that the function reads."""
        try:
            return self.function(value)
        except (ValueError, FreneticError) as error:
            self.fail(str(error), param, ctx)


DURATION: Final = Read("time", parse_duration)
"""Type of a time such as 90, 90s, 10m or 1h30m, in s."""


def _read_folder(text: str) -> Path:
    if not str(text):
        raise ValueError("an empty name; write . for the current folder")
    return Path(text)


class NewFile(click.Path):
    """Type of a file to write or replace, which is refused at once if it cannot be written.

    Args:
        is_picture: whether the suffix has to name a picture format, such as .png.
    """

    def __init__(self, *, is_picture: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_picture = is_picture

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path, if it can be written."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx is not None and ctx.resilient_parsing:  # a shell completes the line
            return path
        try:
            if self.is_picture:
                from frenetic.report.style import form_of  # matplotlib imports slowly

                form_of(path)
            check_writable(path, remedy="choose another file")
        except FreneticError as error:
            self.fail(str(error), param, ctx)
        return path


campaign_argument = click.argument("campaign", type=click.Path(path_type=Path))


def source_arguments(command: Callable[P, R]) -> Callable[P, R]:
    """Add the arguments for tests of a campaign, or for the file of a road."""
    arguments = [
        click.argument("source", type=click.Path(path_type=Path), metavar="CAMPAIGN|ROAD"),
        click.argument("test_ids", type=int, nargs=-1, metavar="[ID]..."),
    ]
    return with_options(arguments, command)


@dataclass(frozen=True)
class AskedRange:
    """A condition and its range, as the command line names them."""

    name: str
    limits: tuple[float, float] | None
    """None if only the name was given."""


def ranges(example: str, *, values: bool = True) -> Read:
    """Return the type of NAME=LOW:HIGH, NAME=VALUE or NAME.

    Args:
        example: of a range, for the message about a mistake.
        values: whether NAME=VALUE is one.
    """

    def read(value: str) -> AskedRange:
        name, equals, text = value.partition("=")
        if not equals:
            return AskedRange(name.strip(), None)
        low, colon, high = text.partition(":")
        try:
            limits = float(low), float(low if values and not colon else high)
        except ValueError:
            limits = math.nan, math.nan
        if not all(map(math.isfinite, limits)):
            raise ValueError(f"{value!r} is not NAME=LOW:HIGH, as in {example}")
        return AskedRange(name.strip(), limits)

    return Read("name=low:high", read)


def file_option(name: str, help: str, **more: Any) -> Decorator:  # noqa: A002
    """Return an option for a file; ``more`` goes to click."""
    kind = click.Path(path_type=Path)
    return click.option(name, **{"type": kind, "metavar": "FILE", **more}, help=help)


def folder_option(help: str) -> Decorator:  # noqa: A002
    """Return the option for the folder of results."""
    return click.option("--out", type=Read("folder", _read_folder), metavar="DIR", help=help)


def count_option(
    name: str,
    help: str,  # noqa: A002
    *,
    least: int = 1,
    default: int | None = None,
) -> Decorator:
    """Return an option for a number of things, whose help shows the default."""
    kind = click.IntRange(least)
    return click.option(name, type=kind, default=default, show_default=True, metavar="N", help=help)


lane_option = click.option(
    "--lane",
    type=int,
    metavar="ID",
    help="OpenDRIVE: lane to drive on; a lane on the left (above 0) is driven against the road."
    " [default: the innermost driving lane, on the right if possible]",
)
road_option = click.option(
    "--road",
    "map_roads",
    metavar="ID[,ID..]",
    help="OpenDRIVE: roads of a map, where they lie. Roads that continue each other are driven"
    " as one; ID@240 begins 240 m along the road. An ID with a comma stands in double quotes:"
    " '\"7,left\",8'.",
)
workers_option = click.option(
    "--workers",
    type=WORKERS,
    default=1,
    show_default=True,
    metavar="N",
    help="Drive on N roads at once, each in its own process.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@contextmanager
def as_usage_error() -> Iterator[None]:
    """Turn a `ValueError` of the library into a user's mistake."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None
