"""Makes the pictures of README and docs: ``python docs/make_pictures.py``.

Those of the report need Playwright and a Chromium, as the tests do.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import chdir
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from frenetic import (
    Budget,
    Campaign,
    CampaignStore,
    EmbeddedSimulator,
    Frenetic,
    Outcome,
    Planner,
    RandomSearch,
    draw_drive,
)
from frenetic.analysis import compare
from frenetic.analysis.failures import representative_failures
from frenetic.cli import cli
from frenetic.report import draw_gallery
from frenetic.report.comparison import draw_comparison

IMAGES = Path(__file__).resolve().parent / "images"
SEED = 1
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
TO_TOP = "section => section.scrollIntoView({ behavior: 'instant' })"


def main() -> None:
    """Runs campaigns and draws their failures."""
    draw_failures()
    draw_strategies()
    draw_report()


def draw_failures() -> None:
    """Runs one campaign and draws its failures."""
    with tempfile.TemporaryDirectory() as folder:
        Campaign(
            strategy=Frenetic(seed=SEED),
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=1000),
            folder=Path(folder) / "campaign",
        ).run()
        with CampaignStore.open(Path(folder) / "campaign") as store:
            # The representative failure on the longest road makes the README's picture.
            tests = [
                store.test(record.candidate.id) for record in representative_failures(store, 12)
            ]
            assert all(test.outcome is Outcome.FAIL for test in tests)
            drawn = [(test, test.drive) for test in tests if test.drive is not None]
            test, drive = max(drawn, key=lambda pair: pair[0].road.length)
            draw_drive(test.road, drive, IMAGES / "failure.png", title=f"Test {test.id}: FAIL")
            draw_gallery(
                [(f"Test {t.id}", t.road, d) for t, d in drawn],
                IMAGES / "gallery.png",
                title=f"Twelve failures of the planner, seed {SEED}",
            )


def draw_strategies() -> None:
    """Runs two strategies six times and draws their comparison."""
    with tempfile.TemporaryDirectory() as folder:
        groups: dict[str, list[Path]] = {"frenetic": [], "random": []}
        for name, strategy in (("frenetic", Frenetic), ("random", RandomSearch)):
            for seed in range(6):
                groups[name].append(Path(folder) / f"{name}-{seed}")
                Campaign(
                    strategy=strategy(seed=seed),
                    simulator=EmbeddedSimulator(),
                    driver=Planner(),
                    budget=Budget(simulations=250),
                    folder=groups[name][-1],
                ).run()
        draw_comparison(compare(groups), IMAGES / "comparison.svg")


def draw_report() -> None:
    """Runs a campaign, drives its failures again, and photographs its report."""
    with (
        tempfile.TemporaryDirectory() as parent,
        chdir(parent),  # the report names the folder as the command does
        sync_playwright() as playwright,
    ):
        for words in (
            ["run", "--simulations", "1000", "--seed", str(SEED), "--out", "night"],
            ["robustness", "night", "--vary", "friction=0.93:1.07", "--top", "20"],
            ["report", "night"],
        ):
            cli.main(words, standalone_mode=False)
        is_root = hasattr(os, "geteuid") and os.geteuid() == 0  # whom Chromium denies its sandbox
        browser = playwright.chromium.launch(
            executable_path=next(filter(None, map(shutil.which, CHROMIUMS)), None),
            args=["--no-sandbox"] if is_root else [],
        )
        page = browser.new_page(viewport={"width": 1180, "height": 1010})
        page.goto(Path("night/report.html").resolve().as_uri())
        photograph(page, "top")
        page.set_viewport_size({"width": 1180, "height": 860})
        page.locator("#failures").evaluate(TO_TOP)
        photograph(page, "failures")
        page.locator("#map").evaluate(TO_TOP)
        page.locator(".cell[class*=severity-6]").last.click()
        page.mouse.move(0.0, 0.0)
        photograph(page, "map")
        page.emulate_media(color_scheme="dark")
        page.set_viewport_size({"width": 1180, "height": 940})
        page.locator("#failures .card").nth(2).click()
        page.keyboard.press("End")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("ArrowLeft")
        page.locator("#scrub").evaluate("slider => slider.blur()")
        photograph(page, "player")
        browser.close()


def photograph(page: Page, name: str) -> None:
    """Takes a picture of what a page shows."""
    page.screenshot(path=IMAGES / f"report-{name}.png")


if __name__ == "__main__":
    main()
