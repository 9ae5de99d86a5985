"""The report of a large campaign as a browser shows it, see ``browsing``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from html_campaigns import make_large, make_searched
from playwright.sync_api import Page, expect

from frenetic.report.html import feature_map, write_report

pytest_plugins = ["browsing"]


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """The report of a campaign of 600 tests, and how many of them failed."""
    folder = tmp_path_factory.mktemp("large")
    failures = make_large(folder / "large", make_searched(folder / "searched", 60), 600)
    assert failures > 200
    with pytest.MonkeyPatch.context() as patch:
        # It has more than are mapped.
        patch.setattr(feature_map, "MAPPED", 500)
        patch.setattr(feature_map, "MAPPED_PASSED", 160)
        return write_report(folder / "large"), failures


def test_a_large_report_opens_and_maps_every_failure(
    show: Callable[..., Page], large: tuple[Path, int]
) -> None:
    path, failures = large
    assert path.stat().st_size < 5e6
    page = show(path)
    expect(page.locator("h1")).to_contain_text("in 600 simulations")
    expect(page.locator("#map .lead")).to_contain_text(f"All {failures} failures and ")
    expect(page.locator("#map .lead")).to_contain_text(
        f"of the {600 - failures} tests that passed, evenly over the campaign, are mapped."
    )
    shown = page.locator(".cell").all_text_contents()
    assert sum(int(text or 0) for text in shown) == failures
    page.locator(".cell[class*=severity]").first.click()
    expect(page.locator(".map-panel h3")).to_contain_text("mapped tests")
    expect(page.locator(".block-switch .legend button")).to_have_count(4)
    expect(page.get_by_role("button", name="Show more of 600")).to_be_visible()
