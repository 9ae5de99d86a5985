"""Names by which other tools call the signals of a car, and how a name is recognised."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from frenetic._support.units import unit_spellings

_WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
"""A word of a name such as ``lateralDeviation`` or ``e_psi``."""
_IDLE_WORDS: Final = frozenset(
    ["in", "out", "input", "output", "signal", "sig", "value", "ego", "vehicle", "car"]
)
"""Words that do not say which signal it is."""
_UNIT_WORDS: Final = {
    spelling.removeprefix("1"): spelling
    for spelling in unit_spellings()
    if re.fullmatch(r"(1/)?[a-z][a-z0-9/]*", spelling)
}
"""Text with which a name may end -> the unit; "per" stands for a slash: ``kappa_per_m``."""
_MOST_UNIT_WORDS: Final = 5
"""Largest number of words of a unit: ``m_per_s_per_s`` has five."""


def bare_name(name: str) -> str:
    """Return the last part of a name with a path, without an index: ``e_y`` of ``lka.e_y[1]``."""
    return re.split(r"[./\\:]", re.sub(r"\[[\d, ]*\]$", "", name))[-1]


def compact(name: str) -> str:
    """Return a name without its path, separators and capital letters: ``epsi`` for ``e_psi``."""
    return re.sub(r"[^a-z0-9]", "", bare_name(name).lower())


def spellings(name: str) -> list[str]:
    """Return the compact spellings of a name, the fullest first.

    A unit at its end and words that say nothing, such as ``ego``, are left out in turn.
    """
    words = _words(name)
    count, _ = _unit_at_end(words)
    words = words[: len(words) - count]
    telling = [word for word in words if word not in _IDLE_WORDS]
    return list(dict.fromkeys([compact(name), "".join(words), "".join(telling)]))


def unit_in_name(name: str) -> str | None:
    """Return the unit that a name ends with: ``kmh`` of ``speed_kmh``; None without one."""
    _, unit = _unit_at_end(_words(name))
    return unit


def _unit_at_end(words: Sequence[str]) -> tuple[int, str | None]:
    """Return the number of words with which a name says a unit, and the unit; 0 without one."""
    for count in range(min(_MOST_UNIT_WORDS, len(words) - 1), 0, -1):
        text = "".join("/" if word == "per" else word for word in words[-count:])
        if text in _UNIT_WORDS:
            return count, _UNIT_WORDS[text]
    return 0, None


def recognised(name: str, names: Mapping[str, Iterable[str]]) -> str | None:
    """Return the signal that a name stands for; None if it is not known.

    Args:
        name: name in another tool, such as ``Lateral deviation``.
        names: signal -> its other names, in compact spelling.
    """
    for spelling in spellings(name):
        for signal, others in names.items():
            if spelling == compact(signal) or spelling in others:
                return signal
    return None


def _words(name: str) -> list[str]:
    """Return the words of a name without its path, in small letters."""
    return [word.lower() for word in _WORD.findall(bare_name(name))]
