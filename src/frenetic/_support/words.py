"""Words for people, and from them: counts, rates, times, settings, texts in cells of tables."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, Final

from frenetic._support.json_value import plain
from frenetic._support.outside_text import BeyondLimitsError, read_json


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number with its noun, such as "1 failure" and "2 failures"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def capitalised(text: str) -> str:
    """Return a text with a capital first letter and its other letters unchanged."""
    return text[:1].upper() + text[1:]


def present_moment() -> str:
    """Return the present date and time: UTC, ISO 8601 with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def pip_install(extra: str) -> str:
    """Return the advice to install an extra of Frenetic in its clone."""
    return f'pip install ".[{extra}]" in the clone of Frenetic'


def signed(value: float | None, digits: int = 2, none: str = "–") -> str:
    """Return a number with the sign − for minus.

    Args:
        value: the number; None if it is unknown.
        digits: number of decimals.
        none: text for an unknown number.
    """
    return none if value is None else f"{value:.{digits}f}".replace("-", "−")


def oob_words(oob: float | None, lane_width: float) -> str:
    """Return an oob distance beside the largest possible: ``1.74 of 1.75 m``, ``−0.52 m`` outside.

    Args:
        oob: oob distance, in m; None if it is unknown.
        lane_width: width of the lane, in m: half of it is the largest oob distance.
    """
    if oob is None:
        return signed(oob)
    if oob < 0.0:
        return f"{signed(oob)} m"
    return f"{oob:.2f} of {0.5 * lane_width:.2f} m"


def lane_words(oob: float, lane_width: float) -> str:
    """Return where the car was: ``1.74 of 1.75 m inside its lane``, ``0.52 m outside its lane``.

    Args:
        oob: oob distance of the car's centre, in m.
        lane_width: width of the lane, in m.
    """
    if oob < 0.0:
        return f"{-oob:.2f} m outside its lane"
    return f"{oob_words(oob, lane_width)} inside its lane"


def oob_unit(lane_width: float) -> str:
    """Return the unit of a column of oob distances: ``m, at most 1.75``."""
    return f"m, at most {0.5 * lane_width:.2f}"


def rate_words(rate: float | None) -> str:
    """Return a rate as a text, per second, minute or hour, so that its number is at least 1.

    Args:
        rate: tests per second; None if it is unknown.
    """
    if rate is None:
        return "-"
    if rate == 0.0:
        return "0 tests/s"
    units = {"s": 1.0, "min": 60.0, "h": 3600.0}
    unit = next((unit for unit, seconds in units.items() if rate * seconds >= 1.0), "h")
    number = rate * units[unit]
    return f"{number:.{0 if number >= 100.0 else 1}f} tests/{unit}"


def simulated_time(seconds: float | None) -> float | None:
    """Return a time in s, rounded for JSON and tables: 9.45 in place of 9.450000000000001."""
    return None if seconds is None else round(seconds, 6)


def number_word(value: object) -> str:
    """Return a number for a command line: ``4`` for 4.0."""
    return str(value).removesuffix(".0")


_UNIT_SECONDS: Final = {"h": 3600.0, "m": 60.0, "s": 1.0}
"""Unit of a time -> its length, in s."""
_NUMBER: Final = r"\d+(?:\.\d+)?"
_DURATION: Final = re.compile(
    rf"(?:(?P<h>{_NUMBER})h)?(?:(?P<m>{_NUMBER})m)?(?:(?P<s>{_NUMBER})s)?|(?P<alone>{_NUMBER})"
)
"""Pattern of a time with units, or of a number of seconds alone."""

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

    A comma separates, unless it is quoted or within brackets: ``sites=[1,2]``, ``path="a,b"``.

    Raises:
        ValueError: an option has no value, is there twice, or its value cannot be read.
    """
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


def parse_duration(text: object) -> float:
    """Return a time such as ``90``, ``90s``, ``10m`` or ``1h30m`` in s.

    Raises:
        ValueError: the text is no time, or the time is 0.
    """
    match = _DURATION.fullmatch(str(text).strip().replace(" ", "").lower())
    if match is None or not any(match.groups()):
        raise ValueError(f"{text!r} is not a time: write 90s, 10m or 1h30m")
    seconds = sum(float(match[unit] or 0.0) * length for unit, length in _UNIT_SECONDS.items())
    seconds += float(match["alone"] or 0.0)
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ValueError(f"{text!r} is no time: more than 0 s is needed")
    return seconds


def format_duration(seconds: float) -> str:
    """Return a time as minutes and seconds or with hours: ``0:07``, ``12:34``, ``1:02:03``."""
    whole = max(round(seconds), 0)
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


_UNPRINTED: Final = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Characters that are escaped: control characters other than the end of a line, signs that change
the direction of writing or end a line, and surrogates, which no UTF-8 file can hold."""
_FORMULA_STARTS: Final = ("=", "+", "-", "@", "\n")
"""First characters of texts that a spreadsheet may read as a formula."""


def printable(text: str) -> str:
    r"""Return a text with control characters escaped, as in ``\x1b``; line ends stay."""
    return _UNPRINTED.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def shortened(text: str, most: int) -> str:
    """Return a text; if it has more than ``most`` characters, with " ... " for its middle."""
    if len(text) <= most:
        return text
    end_length = most // 3
    start_length = most - end_length - len(" ... ")
    return f"{text[:start_length]} ... {text[-end_length:]}"


def text_cell(text: str) -> str:
    """Return a printable text that a spreadsheet reads as text.

    A text that it would read as a formula gets a leading apostrophe. Numbers, which may begin with
    a minus, are not for this function.
    """
    text = printable(text)
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text
