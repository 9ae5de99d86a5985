"""Texts from anywhere made fit to print: on a terminal, in a message, in a spreadsheet."""

from __future__ import annotations

import re
from typing import Final

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
