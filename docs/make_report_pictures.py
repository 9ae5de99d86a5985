"""Makes the pictures of the report's page: ``python docs/make_report_pictures.py``.

Needs Playwright and a Chromium, as the report's tests do.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from frenetic import CampaignStore, EmbeddedSimulator, Planner
from frenetic.analysis.clusters import representative_failures
from frenetic.cli import cli
from frenetic.report.html import write_report
from frenetic.rerun.rerun import rerun
from frenetic.rerun.variations import Variation

IMAGES = Path(__file__).resolve().parent / "images"
SEED = 1


def main() -> None:
    """Runs a campaign, writes its report and takes pictures of it."""
    found = os.environ.get("FRENETIC_CHROMIUM") or shutil.which("chromium")
    if found is None:
        sys.exit("there is no Chromium: install one, or name it in FRENETIC_CHROMIUM")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        os.chdir(folder)  # its name would be in the pictures
        report = make_report(Path("reported")).resolve()
        options = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=found, args=options)
        take_pictures(browser, report)
        browser.close()
        os.chdir(IMAGES)  # the folder goes


def make_report(folder: Path) -> Path:
    """The report of a campaign whose most severe failures were driven again."""
    cli.main(["run", "--seed", str(SEED), "--out", str(folder)], standalone_mode=False)
    with CampaignStore.open(folder) as store:
        shown = [test.id for test in representative_failures(store, 8)]
    rerun(
        folder,
        EmbeddedSimulator(),
        Planner(),
        tests=shown,
        times=20,
        vary=[Variation("friction", 0.9, 1.3), Variation("start", -0.2, 0.2)],
    )
    return write_report(folder)


def take_pictures(browser: Browser, report: Path) -> None:
    """The page's top, its map, the player, light and dark, and a phone."""
    page = opened(browser, report, 1180, 1010)
    save(page, "report-top")
    page.set_viewport_size({"width": 1180, "height": 860})
    page.locator(".cell.severity.depth-5, .cell.severity.depth-4").first.click()
    page.locator("#map").scroll_into_view_if_needed()
    page.evaluate("document.getElementById('map').scrollIntoView({behavior: 'instant'})")
    save(page, "report-map")
    dark = opened(browser, report, 1180, 940, dark=True)
    dark.locator(".gallery .card").nth(2).click()
    dark.keyboard.press("End")
    for _ in range(2):
        dark.keyboard.press("ArrowLeft")
    dark.evaluate("document.activeElement.blur()")
    save(dark, "report-player")


def opened(browser: Browser, report: Path, width: int, height: int, *, dark: bool = False) -> Page:
    """The report in a window of its own."""
    page = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if dark else "light",
        reduced_motion="reduce",
    ).new_page()
    page.goto(report.as_uri())
    page.locator(".uplot canvas").first.wait_for()
    return page


def save(page: Page, name: str) -> None:
    """A picture of the visible part."""
    page.screenshot(path=IMAGES / f"{name}.png")


if __name__ == "__main__":
    main()
