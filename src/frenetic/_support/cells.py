"""Cells of tables that spreadsheets open."""

from __future__ import annotations

import re
from typing import Final

_UNPRINTED: Final = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters but the line's end, and what no UTF-8 file can hold."""
_FORMULA: Final = ("=", "+", "-", "@", "\n")


def printable(text: str) -> str:
    r"""A text whose control characters are escaped, such as ``\x1b``, but for line ends."""
    return _UNPRINTED.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def text_cell(text: str) -> str:
    """A printable text that a spreadsheet takes for text.

    One that it would take for a formula gets a leading apostrophe. Numbers need none of this: they
    may begin with a minus.
    """
    text = printable(text)
    return f"'{text}" if text.startswith(_FORMULA) else text
