"""Chromium without a window, run by Playwright, for the tests of pages.

``FRENETIC_CHROMIUM`` is the path of a Chromium that is not on the PATH.
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
    """A started Chromium."""
    path = find_chromium()
    if path is None:
        pytest.fail("there is no Chromium here: install one, or name it in FRENETIC_CHROMIUM")
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    with sync_playwright() as playwright:
        try:
            launched = playwright.chromium.launch(
                executable_path=path, args=["--no-sandbox"] if is_root else []
            )
        except Error as error:
            pytest.fail(f"{path} does not start: {error.message.splitlines()[0]}")
        yield launched
        launched.close()


VIEWPORT = {"width": 1280, "height": 900}  # pixels


class _Shared:
    """One page for the tests of a module: a new page would take half a second."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self._page: Page | None = None
        self._trouble = Trouble()
        self._used = False

    def opened(self, trouble: Trouble, viewport: Any, color_scheme: Any) -> Page:
        """Return the page as if it were new; `trouble` collects its errors and requests."""
        if self._page is None or self._page.is_closed():
            self._page = self._browser.new_context().new_page()
            _watch(self._page, lambda: self._trouble)
        self._page.set_viewport_size(viewport)
        self._page.emulate_media(media="null", color_scheme=color_scheme)
        self._trouble, self._used = trouble, True
        return self._page

    def clear(self) -> None:
        """Remove what a test has left in the browser."""
        for context in self._browser.contexts:
            if self._page is None or context is not self._page.context:
                context.close()
        page, self._used = (self._page if self._used else None), False
        if page is not None and not page.is_closed():
            page.evaluate("localStorage.clear()")
            page.context.clear_permissions()
            self._trouble = Trouble()
            page.goto("about:blank")
            page.mouse.move(0, 0)


def _watch(page: Page, trouble: Callable[[], Trouble]) -> None:
    page.on(
        "console",
        lambda m: trouble().errors.append(m.text) if m.type in ("error", "warning") else None,
    )
    page.on("pageerror", lambda error: trouble().errors.append(str(error)))
    page.on("request", lambda request: trouble().requests.append(request.url.split("#")[0]))


@pytest.fixture(scope="module")
def _shared(browser: Browser) -> _Shared:
    return _Shared(browser)


@pytest.fixture
def show(browser: Browser, _shared: _Shared) -> Iterator[Callable[..., Page]]:
    """Opens a file; after the test, asserts no errors and no requests for other files."""
    trouble = Trouble()
    addresses: list[str] = []

    def opened(
        path: Path,
        *,
        fragment: str = "",
        viewport: Any = VIEWPORT,
        color_scheme: Any = "light",
        **context: Any,
    ) -> Page:
        if context or addresses:
            options = {"viewport": viewport, "color_scheme": color_scheme, **context}
            page = browser.new_context(**options).new_page()
            _watch(page, lambda: trouble)
        else:
            page = _shared.opened(trouble, viewport, color_scheme)
        addresses.append(path.resolve().as_uri())
        page.goto(addresses[-1] + fragment)
        return page

    yield opened
    _shared.clear()
    assert trouble.errors == []
    assert set(trouble.requests) == set(addresses)
