"""Times as people write them."""

from __future__ import annotations

import math
import re
from typing import Final

_UNITS: Final = {"h": 3600.0, "m": 60.0, "s": 1.0}
_PATTERN: Final = re.compile(
    r"(?:(?P<h>\d+(?:\.\d+)?)h)?(?:(?P<m>\d+(?:\.\d+)?)m)?(?:(?P<s>\d+(?:\.\d+)?)s?)?"
)


def parse_duration(text: object) -> float:
    """Seconds in a time such as ``90``, ``90s``, ``10m`` or ``1h30m``.

    Raises:
        ValueError: it is no time, or not more than 0.
    """
    match = _PATTERN.fullmatch(str(text).strip().replace(" ", "").lower())
    if match is None or not any(match.groups()):
        raise ValueError(f"{text!r} is not a time: write 90s, 10m or 1h30m")
    seconds = sum(float(match[unit] or 0.0) * factor for unit, factor in _UNITS.items())
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ValueError(f"{text!r} is no time: more than 0 s is needed")
    return seconds


def format_duration(seconds: float) -> str:
    """A time for people: ``0:07``, ``12:34`` or ``1:02:03``."""
    whole = max(round(seconds), 0)
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"
