"""What the tests of pages in a browser share, see ``browsing``."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass, field
from pathlib import Path

from playwright.sync_api import Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_chromium() -> str | None:
    named = os.environ.get("FRENETIC_CHROMIUM")
    return named or next((path for name in NAMES if (path := shutil.which(name))), None)


@dataclass
class Trouble:
    """What went wrong in a page."""

    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


def background(page: Page) -> int:
    """How light the page is, 0..765."""
    found = page.evaluate("getComputedStyle(document.body).backgroundColor")
    return sum(int(part) for part in re.findall(r"\d+", found)[:3])


def luminance(colour: str) -> float:
    """Relative luminance of an opaque CSS colour, ``rgb(0, 80, 255)``, by WCAG 2: 0..1."""
    shares = [int(part) / 255 for part in re.findall(r"\d+", colour)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return sum(w * s for w, s in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(first: str, second: str) -> float:
    """Contrast of two opaque CSS colours by WCAG 2: 1..21."""
    dark, light = sorted(luminance(colour) for colour in (first, second))
    return (light + 0.05) / (dark + 0.05)


LEAST_CONTRAST = 4.5
"""Of text with what is behind it: level AA of the Web Content Accessibility Guidelines, 1.4.3."""


def low_contrast(page: Page) -> list[str]:
    """Texts of a page as it stands that are hard to read."""
    script = (Path(__file__).parent / "contrast.js").read_text(encoding="utf-8")
    found = page.evaluate(script, LEAST_CONTRAST)
    assert found["texts"] > 50  # nothing is hidden from the measurement
    low: list[str] = found["low"]
    return low
