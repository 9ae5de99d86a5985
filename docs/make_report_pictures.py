"""Make the pictures of reports: ``python docs/make_report_pictures.py``.

This needs Playwright and a Chromium, as the report's tests do.
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
SEED = "1"  # seed of the campaign


def main() -> None:
    """Run a campaign, write its report and take pictures of it."""
    chromium = os.environ.get("FRENETIC_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no Chromium: install one, or name it in FRENETIC_CHROMIUM")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        os.chdir(folder)  # otherwise the pictures would show the temporary folder's path
        report = make_report(Path("reported")).resolve()
        is_root = hasattr(os, "geteuid") and os.geteuid() == 0
        options = ["--no-sandbox"] if is_root else []  # Chromium's sandbox refuses root
        browser = playwright.chromium.launch(executable_path=chromium, args=options)
        take_pictures(browser, report)
        take_sweep(browser, make_sweep(Path("swept")).resolve())
        browser.close()
        os.chdir(IMAGES)  # out of the temporary folder, which is deleted now


def make_report(folder: Path) -> Path:
    """Run a campaign, rerun its most severe failures, and return the path of its report."""
    cli.main(["run", "--seed", SEED, "--out", str(folder)], standalone_mode=False)
    with CampaignStore.open(folder) as store:
        failing_tests = [test.id for test in representative_failures(store, 8)]
    rerun(
        folder,
        EmbeddedSimulator(),
        Planner(),
        tests=failing_tests,
        times=20,
        vary=[Variation("friction", 0.9, 1.3), Variation("start", -0.2, 0.2)],
    )
    return write_report(folder)


def make_sweep(folder: Path) -> Path:
    """Run the sweep of the page on manoeuvres, and return the path of its report."""
    words = ["--strategy", "sweep", "--driver", "planner,aggression=1.3", "--out", str(folder)]
    cli.main(["run", "--seed", SEED, *words], standalone_mode=False)
    return write_report(folder)


def take_sweep(browser: Browser, report: Path) -> None:
    """Take a picture of the map of a sweep."""
    page = open_report(browser, report, width=900, height=900)
    page.locator(".block-sweepMap").screenshot(path=IMAGES / "report-sweep.png")


def take_pictures(browser: Browser, report: Path) -> None:
    """Take pictures of the report's top, of its map, and of its player in dark colours."""
    page = open_report(browser, report, width=1180, height=1010)
    save(page, "report-top")
    page.set_viewport_size({"width": 1180, "height": 860})
    page.locator(".cell.severity.depth-5, .cell.severity.depth-4").first.click()
    page.locator("#map").scroll_into_view_if_needed()
    page.evaluate("document.getElementById('map').scrollIntoView({behavior: 'instant'})")
    save(page, "report-map")
    dark = open_report(browser, report, width=1180, height=940, dark=True)
    dark.locator(".gallery .card").nth(2).click()
    # Show the drive a little before its end, without a frame around the focus.
    dark.keyboard.press("End")
    for _ in range(2):
        dark.keyboard.press("ArrowLeft")
    dark.evaluate("document.activeElement.blur()")
    save(dark, "report-player")


def open_report(
    browser: Browser, report: Path, width: int, height: int, *, dark: bool = False
) -> Page:
    """Return the report in a new window of this size, in pixels, when its plots are drawn."""
    page = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if dark else "light",
        reduced_motion="reduce",
    ).new_page()
    page.goto(report.as_uri())
    page.locator(".uplot canvas").first.wait_for()
    return page


def save(page: Page, name: str) -> None:
    """Write a picture of the visible part of a page to docs/images."""
    page.screenshot(path=IMAGES / f"{name}.png")


if __name__ == "__main__":
    main()
