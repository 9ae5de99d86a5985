"""Options that several commands share, and the types that check their values."""

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

DEFAULT_SIMULATIONS: Final = 1000
"""Budget of a search without --simulations, --time and --failures, in drives (our choice)."""
SEED_LIMIT: Final = 2**31
"""Drawn seeds are below this number, so that every random generator takes them."""
WORKERS_TYPE: Final = click.IntRange(1, MAX_WORKERS)
"""Option type of a number of workers."""

P = ParamSpec("P")
R = TypeVar("R")
Decorator: TypeAlias = Callable[[Any], Any]
"""A decorator that adds an option to a command."""


def with_options(options: Sequence[Decorator], command: Callable[P, R]) -> Callable[P, R]:
    """Return the command with all these options, in this order in its help."""
    for option in reversed(options):  # click puts the option that is added last first
        command = option(command)
    return command


class ParsedText(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """Option type: a text parsed by a function, whose errors become usage errors.

    Args:
        name: name of the type, which click shows in the help.
        function: parses the text; may raise `ValueError` or `FreneticError`.
    """

    def __init__(self, name: str, function: Callable[[str], Any]) -> None:
        self.name = name
        self.function = function

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the parsed value.

        Raises:
            click.BadParameter: the function refuses the text.
        """
        try:
            return self.function(value)
        except (ValueError, FreneticError) as error:
            self.fail(str(error), param, ctx)


DURATION_TYPE: Final = ParsedText("time", parse_duration)
"""Option type of a time such as 90, 90s, 10m or 1h30m; the value is in s."""


def _parse_folder(text: str) -> Path:
    """Return the path of a folder.

    Raises:
        ValueError: the text is empty, which would be the current folder.
    """
    if not text:
        raise ValueError("an empty name; write . for the current folder")
    return Path(text)


class NewFile(click.Path):
    """Option type of a file to write or replace; one that cannot be written is refused at once.

    Args:
        is_picture: whether the suffix has to name a picture format, such as .png.
    """

    def __init__(self, *, is_picture: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_picture = is_picture

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of a file that can be written.

        Raises:
            click.BadParameter: it cannot be written, or names no picture format.
        """
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx is not None and ctx.resilient_parsing:  # a shell completes the line
            return path
        try:
            if self.is_picture:
                from frenetic.report.style import form_of  # matplotlib imports slowly

                form_of(path)  # raises for a suffix that is no format
            check_writable(path, remedy="choose another file")
        except FreneticError as error:
            self.fail(str(error), param, ctx)
        return path


campaign_argument = click.argument("campaign", type=click.Path(path_type=Path))
"""Adds the argument CAMPAIGN, the folder of a campaign."""


def source_arguments(command: Callable[P, R]) -> Callable[P, R]:
    """Add the arguments SOURCE, a campaign's folder or a road file, and IDs of tests."""
    arguments = [
        click.argument("source", type=click.Path(path_type=Path), metavar="CAMPAIGN|ROAD"),
        click.argument("test_ids", type=int, nargs=-1, metavar="[ID]..."),
    ]
    return with_options(arguments, command)


@dataclass(frozen=True)
class NamedRange:
    """A condition or feature with its range, as the command line names them."""

    name: str
    limits: tuple[float, float] | None
    """Lowest and highest value; None if the command line names no range."""


def range_type(example: str, *, allows_value: bool = True) -> ParsedText:
    """Return the option type of NAME=LOW:HIGH, NAME=VALUE or NAME.

    Args:
        example: an example of a range, for the message about a mistake.
        allows_value: whether NAME=VALUE is accepted, as the range from VALUE to VALUE.
    """
    forms = "NAME=LOW:HIGH, NAME=VALUE or NAME" if allows_value else "NAME=LOW:HIGH or NAME"

    def parse(text: str) -> NamedRange:
        name, equals, range_text = text.partition("=")
        if not equals:
            return NamedRange(name.strip(), limits=None)
        low_text, colon, high_text = range_text.partition(":")
        if not colon and allows_value:
            high_text = low_text
        try:
            limits = float(low_text), float(high_text)
        except ValueError:
            raise ValueError(f"{text!r} is not {forms}, as in {example}") from None
        if not name.strip() or not all(map(math.isfinite, limits)):
            raise ValueError(f"{text!r} is not {forms}, as in {example}")
        return NamedRange(name.strip(), limits)

    return ParsedText("name=low:high", parse)


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
    folder_type = ParsedText("folder", _parse_folder)
    return click.option("--out", type=folder_type, metavar="DIR", help=help)


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


lane_option = click.option(
    "--lane",
    type=int,
    metavar="ID",
    help="OpenDRIVE: lane to drive on; a lane on the left (above 0) is driven opposite to the"
    " road's direction. [default: the innermost driving lane, on the right if possible]",
)
road_option = click.option(
    "--road",
    "map_roads",
    metavar="ID[,ID..]",
    help="OpenDRIVE: roads of a map, where they lie. Roads that follow each other are driven as"
    " one; ID@240 starts 240 m along the road. Quote an ID that holds a comma: '\"7,left\",8'.",
)
workers_option = click.option(
    "--workers",
    type=WORKERS_TYPE,
    default=1,
    show_default=True,
    metavar="N",
    help="Drive on N roads at once, each in its own process.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@contextmanager
def as_usage_error() -> Iterator[None]:
    """Turn a `ValueError` of the library into a usage error, which is one line."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None
