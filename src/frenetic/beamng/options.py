"""Valid values of the BeamNG.tech simulator's options."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from os import PathLike
from typing import Any, Final

from frenetic.beamng.car import LENGTHS, WIDTHS

RECORD_RATE: Final = 20
"""Rate of records and of a driver's decisions, in Hz."""


@dataclass(frozen=True)
class _Kind:
    """Values that an option takes."""

    allowed: str
    """Their description, to be followed by "is needed"."""
    fits: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return _is_number(value) and value == int(value)


def _between(low: float, high: float) -> _Kind:
    return _Kind(
        f"a number of m above {low:g} and below {high:g}",
        lambda value: _is_number(value) and low < value < high,
    )


_FOLDER: Final = _Kind(
    "the name of a folder", lambda value: isinstance(value, str | PathLike) and bool(str(value))
)
_NAME: Final = _Kind("a name", lambda value: isinstance(value, str) and bool(value.strip()))
_FLAG: Final = _Kind("true or false", lambda value: isinstance(value, bool))
_SECONDS: Final = _Kind(
    "a positive number of seconds", lambda value: _is_number(value) and value > 0.0
)
_KINDS: Final[Mapping[str, _Kind]] = {
    "home": _FOLDER,
    "user": _FOLDER,
    "host": _NAME,
    "port": _Kind(
        "a whole number from 1 to 65535", lambda value: _is_whole(value) and 0 < value < 65536
    ),
    "headless": _FLAG,
    "no_gpu": _FLAG,
    "restart_every": _Kind(
        "a whole number of at least 1", lambda value: _is_whole(value) and value >= 1
    ),
    "vehicle": _NAME,
    "aggression": _Kind(
        "a number above 0 and up to 2", lambda value: _is_number(value) and 0.0 < value <= 2.0
    ),
    "steps_per_second": _Kind(
        f"a multiple of {RECORD_RATE}",
        lambda value: _is_whole(value) and value >= RECORD_RATE and value % RECORD_RATE == 0,
    ),
    "level": _NAME,
    "ground": _Kind("a number of m", _is_number),
    "car_length": _between(*LENGTHS),
    "car_width": _between(*WIDTHS),
    "wall_limit": _SECONDS,
    "reply_limit": _SECONDS,
}


_LEFT_OUT: Final = frozenset(
    {"home", "user", "host", "port", "ground", "car_length", "car_width", "restart_every"}
)
"""Options that default to None."""


def check_options(given: Mapping[str, object]) -> None:
    """Refuses values that an option does not take, among arguments of which others are none.

    Raises:
        ValueError: the message names the option and its valid values.
    """
    for name, kind in _KINDS.items():
        value = given[name]
        if not (value is None and name in _LEFT_OUT) and not kind.fits(value):
            raise ValueError(f"{name} is {value!r}: {kind.allowed} is needed")
