"""Helpers for tests of pages in a browser; ``browsing`` has the fixtures."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass, field
from pathlib import Path

from playwright.sync_api import Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_chromium() -> str | None:
    """Return the path of a Chromium, or None if there is none."""
    chosen = os.environ.get("FRENETIC_CHROMIUM")
    return chosen or next((path for name in NAMES if (path := shutil.which(name))), None)


@dataclass
class Trouble:
    """Errors of a page, and the addresses that it loaded."""

    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


def background(page: Page) -> int:
    """Return the sum of red, green and blue of the page's background, 0..765."""
    colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
    return sum(int(part) for part in re.findall(r"\d+", colour)[:3])


def luminance(colour: str) -> float:
    """Return the luminance by WCAG 2, 0..1, of an opaque CSS colour such as ``rgb(0, 80, 255)``."""
    shares = [int(part) / 255 for part in re.findall(r"\d+", colour)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return sum(w * s for w, s in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(first: str, second: str) -> float:
    """Return the contrast of two opaque CSS colours by WCAG 2: 1..21."""
    dark, light = sorted(luminance(colour) for colour in (first, second))
    return (light + 0.05) / (dark + 0.05)


LEAST_CONTRAST = 4.5
"""Least contrast of a text with its background: Web Content Accessibility Guidelines, 1.4.3, AA."""


def low_contrast(page: Page) -> list[str]:
    """Return the visible texts of a page whose contrast is too low."""
    script = (Path(__file__).parent / "contrast.js").read_text(encoding="utf-8")
    result = page.evaluate(script, LEAST_CONTRAST)
    assert result["texts"] > 50  # the script has seen the texts
    low: list[str] = result["low"]
    return low
