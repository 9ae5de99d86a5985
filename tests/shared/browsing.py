"""Chromium without a window, driven by Playwright, for the tests of pages.

Without a Chromium these tests are skipped, unless ``FRENETIC_REQUIRE_BROWSER`` is set, as in CI.
``FRENETIC_CHROMIUM`` names one that is not found by itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from html_browser import Trouble, find_chromium
from playwright.sync_api import Browser, Error, Page, expect, sync_playwright

expect.set_options(timeout=30_000)  # ms; a busy machine draws slowly


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = find_chromium()
    missing = pytest.fail if os.environ.get("FRENETIC_REQUIRE_BROWSER") else pytest.skip
    if path is None:
        missing("there is no Chromium here: install one, or name it in FRENETIC_CHROMIUM")
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    with sync_playwright() as playwright:
        try:
            launched = playwright.chromium.launch(
                executable_path=path, args=["--no-sandbox"] if is_root else []
            )
        except Error as error:
            missing(f"{path} does not start: {error.message.splitlines()[0]}")
        yield launched
        launched.close()


@pytest.fixture
def show(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Opens a file and, at the end, asserts that nothing was complained about or loaded."""
    trouble = Trouble()
    addresses: list[str] = []

    def opened(path: Path, *, fragment: str = "", **context: Any) -> Page:
        given = {"viewport": {"width": 1280, "height": 900}, **context}
        page = browser.new_context(**given).new_page()
        page.on(
            "console",
            lambda m: trouble.errors.append(m.text) if m.type in ("error", "warning") else None,
        )
        page.on("pageerror", lambda error: trouble.errors.append(str(error)))
        page.on("request", lambda request: trouble.requests.append(request.url.split("#")[0]))
        addresses.append(path.resolve().as_uri())
        page.goto(addresses[-1] + fragment)
        return page

    yield opened
    for context in browser.contexts:
        context.close()
    assert trouble.errors == []
    assert set(trouble.requests) == set(addresses)
