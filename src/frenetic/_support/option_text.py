"""Texts of parts with options on a command line, such as ``planner,aggression=1.2``."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

from frenetic._support.json_value import plain
from frenetic._support.outside_text import BeyondLimitsError, read_json

COMMAND: Final = "command"
"""Name of a part that is a program of any language."""
PROGRAM: Final = "program"
"""Name of its option with the program and the program's arguments."""
_COMMAND: Final = f"{COMMAND}:"
"""Beginning of such a part's text, as in ``command:./controller --gain 2``."""
_PYTHON_CONSTANTS: Final = {"True": True, "False": False, "None": None}


def read_setting(text: str) -> Any:
    """Return the value of NAME=VALUE on a command line: JSON or a number if possible, else a text.

    ``True``, ``False`` and ``None`` are read as in Python, too.

    Raises:
        ValueError: the text is JSON with too deep nesting or too large a number.
    """
    if text in _PYTHON_CONSTANTS:
        return _PYTHON_CONSTANTS[text]
    for read in (read_json, float):
        try:
            value = read(text)
            if isinstance(value, int):
                float(value)  # raises for a number too large to calculate with
        except (BeyondLimitsError, OverflowError) as error:
            raise ValueError(f"{text[:20]}...: {error}") from None
        except ValueError:
            continue
        return value
    return text


_PIECE: Final = re.compile(r'"(?:[^"\\]|\\.)*"|[^,"\[\]{}]+|[\[\]{},"]')
"""Pattern of a piece of a part's text: a quoted text, a bracket, a comma, or what lies between."""


def read_part(text: str) -> tuple[str | None, dict[str, Any]]:
    """Return name and options of ``planner,aggression=1.2``; None for options without a name.

    A comma separates, unless it is quoted or within brackets: ``sites=[1,2]``, ``path="a,b"``. All
    that follows ``command:`` is the option ``program`` of the part ``command``.

    Raises:
        ValueError: an option has no value, is there twice, or its value cannot be read.
    """
    if text.lstrip().startswith(_COMMAND):
        return COMMAND, {PROGRAM: text.partition(":")[2].strip()}
    first, *others = _split_at_commas(text)
    is_quoted = first.startswith('"')
    has_name = is_quoted or "=" not in first
    part_name = str(read_setting(first)) if is_quoted else first.strip()
    options: dict[str, Any] = {}
    for item in others if has_name else [first, *others]:
        name, equals, value = item.partition("=")
        if not equals or not name.strip():
            example = f"{part_name or 'name'},option=1.2"
            raise ValueError(f"{item!r} is not OPTION=VALUE, as in {example}")
        if name.strip() in options:
            raise ValueError(f"the option {name.strip()} is there twice")
        options[name.strip()] = read_setting(value)
    return part_name if has_name else None, options


def _split_at_commas(text: str) -> list[str]:
    """Return the items of a part's text between the commas that separate."""
    commas, depth = [], 0
    for piece in _PIECE.finditer(text):
        depth += (piece[0] in "[{") - (piece[0] in "]}")
        if piece[0] == "," and depth == 0:
            commas.append(piece.start())
    return [text[before + 1 : after] for before, after in pairwise([-1, *commas, len(text)])]


def part_word(name: str | None, options: Mapping[str, Any]) -> str:
    """Return a part's text, from which `read_part` reads name and options back."""
    if name == COMMAND and [*options] == [PROGRAM]:
        return f"{_COMMAND}{options[PROGRAM]}"
    items = [f"{option}={_setting_text(value)}" for option, value in options.items()]
    if name is not None:
        needs_quotes = not set(name).isdisjoint(',="[]{}')
        items.insert(0, json.dumps(name) if needs_quotes else name)
    return ",".join(items)


def _setting_text(value: object) -> str:
    """Return a value's text, from which `read_setting` reads the value back."""
    if isinstance(value, str):
        is_plain = not set(value) & set(',"[]{}') and read_setting(value) == value
        return value if is_plain else json.dumps(value)
    return json.dumps(value, default=plain)


def split_command(command: str) -> list[str]:
    """Return program and arguments of a command, split as a shell of this system does.

    Raises:
        ValueError: a quotation has no end.
    """
    words = shlex.split(command, posix=sys.platform != "win32")
    # On Windows a backslash is no escape, and quotes stay around their words.
    return [word.strip('"') for word in words] if sys.platform == "win32" else words


def join_command(words: Sequence[str]) -> str:
    """Return a command that `split_command` splits into these words."""
    return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def number_word(value: object) -> str:
    """Return a number for a command line: ``4`` for 4.0."""
    return str(value).removesuffix(".0")
