"""Texts about counts, rates, distances and times, and times from texts."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number with its noun, such as "1 failure" and "2 failures"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def capitalised(text: str) -> str:
    """Return a text with a capital first letter and its other letters unchanged."""
    return text[:1].upper() + text[1:]


def in_short(names: Sequence[str], most: int = 3) -> str:
    """Return names joined by commas and "and"; of many names, the first and the number of others.

    Args:
        names: one or more names.
        most: largest number of items in the list.
    """
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} others"]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


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


def rounded_seconds(seconds: float | None) -> float | None:
    """Return a time in s, rounded for JSON and tables: 9.45 in place of 9.450000000000001."""
    return None if seconds is None else round(seconds, 6)


_UNIT_SECONDS: Final = {"h": 3600.0, "m": 60.0, "s": 1.0}
"""Unit of a time -> its length, in s."""
_NUMBER: Final = r"\d+(?:\.\d+)?"
_DURATION: Final = re.compile(
    rf"(?:(?P<h>{_NUMBER})h)?(?:(?P<m>{_NUMBER})m)?(?:(?P<s>{_NUMBER})s)?|(?P<alone>{_NUMBER})"
)
"""Pattern of a time with units, or of a number of seconds alone."""


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
