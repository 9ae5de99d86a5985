"""Words for people."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """A number with its noun, such as "1 failure" and "2 failures"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def capitalised(text: str) -> str:
    """A text with a capital first letter; the others stay."""
    return text[:1].upper() + text[1:]


def rate_words(rate: float | None) -> str:
    """Tests per second, or per minute or hour where they are few."""
    if rate is None:
        return "-"
    if rate == 0.0:
        return "0 tests/s"
    units = {"s": 1.0, "min": 60.0, "h": 3600.0}
    unit = next((unit for unit, seconds in units.items() if rate * seconds >= 1.0), "h")
    number = rate * units[unit]
    return f"{number:.{0 if number >= 100.0 else 1}f} tests/{unit}"
