"""Types of options and arguments: they read and check a text of the command line."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click

from frenetic._support.files import check_writable
from frenetic._support.words import parse_duration
from frenetic.errors import FreneticError
from frenetic.spec import MAX_WORKERS

# Numbers and times

WORKERS_TYPE: Final = click.IntRange(1, MAX_WORKERS)
"""Option type of a number of workers."""


# ParamType takes a type parameter only from click 8.4 on.
class ParsedText(click.ParamType):  # type: ignore[type-arg]
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

# Folders and files


def _parse_folder(text: str) -> Path:
    """Return the path of a folder.

    Raises:
        ValueError: the text is empty, which would be the current folder.
    """
    if not text:
        raise ValueError("an empty name; write . for the current folder")
    return Path(text)


FOLDER_TYPE: Final = ParsedText("folder", _parse_folder)
"""Option type of a folder for results, which need not exist; the value is its path."""


class NewFile(click.Path):
    """Option type of a file to write or replace; a file that cannot be written is refused at once.

    Args:
        is_picture: whether the suffix has to name a picture format, such as .png.
        is_trace: whether the suffix has to be .csv or .mcap.
    """

    def __init__(self, *, is_picture: bool = False, is_trace: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_picture = is_picture
        self.is_trace = is_trace

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of a file that can be written.

        Raises:
            click.BadParameter: the file cannot be written, its suffix is wrong, or the extra for
                its format is missing.
        """
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx is not None and ctx.resilient_parsing:  # a shell completes the line
            return path
        try:
            if self.is_picture:
                from frenetic.report.style import form_of  # matplotlib imports slowly

                form_of(path)  # raises for a suffix that is no format
            if self.is_trace:
                from frenetic.export.trace_files import trace_form_of  # imports slowly

                trace_form_of(path)
            check_writable(path, remedy="choose another file")
        except FreneticError as error:
            self.fail(str(error), param, ctx)
        return path


# Ranges


@dataclass(frozen=True)
class NamedRange:
    """A condition or feature with its range, as the command line names them.

    An unknown name and a reversed range are refused later, by `frenetic.rerun.variations.Variation`
    for a condition and by `frenetic.analysis.listing.list_tests` for a feature.
    """

    name: str
    """The name, which is not empty."""
    limits: tuple[float, float] | None
    """The two ends of the range, which are finite; None if the command line names no range."""


def range_type(example: str, *, allows_value: bool = True) -> ParsedText:
    """Return the option type of NAME=LOW:HIGH, NAME=VALUE or NAME; the value is a `NamedRange`.

    Args:
        example: an example of a range, for the message about a mistake.
        allows_value: whether NAME=VALUE is accepted, as the range from VALUE to VALUE.
    """
    forms = "NAME=LOW:HIGH, NAME=VALUE or NAME" if allows_value else "NAME=LOW:HIGH or NAME"

    def parse(text: str) -> NamedRange:
        name, equals, range_text = text.partition("=")
        limits = _parse_limits(range_text, allows_value=allows_value) if equals else None
        if not name.strip() or (equals and limits is None):
            raise ValueError(f"{text!r} is not {forms}, as in {example}")
        return NamedRange(name.strip(), limits)

    return ParsedText("name=low:high", parse)


def _parse_limits(text: str, *, allows_value: bool) -> tuple[float, float] | None:
    """Return the two ends of the range LOW:HIGH or VALUE; None if the text is no such range.

    Args:
        text: text of the range.
        allows_value: whether VALUE is accepted, as the range from VALUE to VALUE.
    """
    low_text, colon, high_text = text.partition(":")
    if not colon:
        if not allows_value:
            return None
        high_text = low_text
    try:
        limits = float(low_text), float(high_text)
    except ValueError:
        return None
    return limits if all(map(math.isfinite, limits)) else None


# Amounts


def amount_type(example: str, *, allows_name: bool = False) -> ParsedText:
    """Return the option type of NAME=AMOUNT; the value is the pair, in which the amount is finite.

    An unknown name is refused later, by `frenetic.conditions.condition.condition_named`.

    Args:
        example: an example, for the message about a mistake.
        allows_name: whether NAME is accepted, too, as the pair of NAME and None.
    """
    forms = "NAME or NAME=AMOUNT" if allows_name else "NAME=AMOUNT"

    def parse(text: str) -> tuple[str, float | None]:
        name, equals, amount_text = (part.strip() for part in text.partition("="))
        if name and allows_name and not equals:
            return name, None
        limits = _parse_limits(amount_text, allows_value=True)
        if not name or limits is None or ":" in amount_text:
            raise ValueError(f"{text!r} is not {forms}, as in {example}")
        return name, limits[0]

    return ParsedText("name=amount", parse)
