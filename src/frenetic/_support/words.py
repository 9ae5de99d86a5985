"""Words for people."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """A number with its noun, such as "1 failure" and "2 failures"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def capitalised(text: str) -> str:
    """A text with a capital first letter; the others stay."""
    return text[:1].upper() + text[1:]
