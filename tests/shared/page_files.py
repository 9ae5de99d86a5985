"""Files that pages show as code, for tests that run them."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def page_file(page: str, name: str) -> str:
    """Return the text of a file that a page of `docs/` shows as a block of kind ``py``."""
    text = (DOCS / page).read_text(encoding="utf-8")
    match = re.search(rf"^```py\n(# file: {re.escape(name)}\n.*?)^```$", text, re.M | re.S)
    assert match is not None, f"{page} shows no file {name}"
    return match[1]
