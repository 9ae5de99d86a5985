"""Size of the report of a long campaign, and the times to write and open it.

    python benchmarks/report.py [--simulations 5000 ...] [--openings 5] [--folder DIR]

The benchmark runs a campaign of `frenetic` with the default driver, writes the report in a process
of its own, and opens the page in Chromium without a window, each time in a new context. It prints
medians of the times from the start of the navigation: until something is painted, until the feature
map is there, until the page has loaded, until the charts are drawn. The campaign goes into a new
folder inside DIR (the system's folder for temporary files by default), which is removed afterwards.

Needs Playwright and a Chromium, as the tests do. If no Chromium is found, name it by
--chromium FILE.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Final

from playwright.sync_api import Browser, Error, sync_playwright

SEED: Final = 1
CHROMIUM_COMMANDS: Final = ("chromium", "chromium-browser", "google-chrome", "chrome")
MOMENTS: Final = ("painted", "map", "loaded", "charts")
WATCH_SCRIPT: Final = """
window.moments = {};
new MutationObserver((_, observer) => {
  const now = performance.now();
  if (document.querySelector(".cell")) moments.map ??= now;
  const charts = [...document.querySelectorAll(".chart")];
  if (charts.length && charts.every((chart) => chart.querySelector(".series"))) {
    moments.charts = now;
    observer.disconnect();
  }
}).observe(document, { subtree: true, childList: true });
"""
READ_SCRIPT: Final = """() => {
  const [navigation] = performance.getEntriesByType("navigation");
  const [paint] = performance.getEntriesByName("first-contentful-paint");
  return [paint.startTime, moments.map, navigation.loadEventEnd, moments.charts];
}"""
IS_COMPLETE_SCRIPT: Final = """() => moments.charts
  && performance.getEntriesByName("first-contentful-paint").length
  && performance.getEntriesByType("navigation")[0].loadEventEnd > 0"""


def make_report(simulations: int, folder: Path) -> Path:
    """Run a campaign, write its report and print the time; return the page."""
    from frenetic.campaign import Budget, Campaign, CampaignStore
    from frenetic.drivers import Planner
    from frenetic.oracle.outcome import Outcome
    from frenetic.search import Frenetic
    from frenetic.simulators import EmbeddedSimulator

    Campaign(
        strategy=Frenetic(seed=SEED),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    with CampaignStore.open(folder) as store:
        counts = store.counts()
    start, before = time.perf_counter(), os.times()
    command = [sys.executable, "-m", "frenetic", "report", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    seconds, after = time.perf_counter() - start, os.times()
    cpu = sum(after[2:4]) - sum(before[2:4])  # of processes that have ended
    page = folder / "report.html"
    print(
        f"{counts.simulations:,} simulations, {counts.by_outcome[Outcome.FAIL]:,} failures:"
        f" written in {seconds:.1f} s ({cpu:.1f} s of CPU time), {page.stat().st_size / 1e6:.1f} MB"
    )
    return page


def open_page(browser: Browser, report: Path) -> list[float]:
    """Open the page; return the s from the start of the navigation to each of `MOMENTS`."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.add_init_script(WATCH_SCRIPT)
    page.goto(report.resolve().as_uri())
    page.wait_for_function(IS_COMPLETE_SCRIPT, polling=500, timeout=120_000)
    times = [milliseconds / 1000.0 for milliseconds in page.evaluate(READ_SCRIPT)]
    context.close()
    return times


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--simulations", type=int, nargs="+", default=[5000], metavar="N", help="of each campaign"
    )
    parser.add_argument("--openings", type=int, default=5, metavar="N", help="of each page")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="folder for the campaigns")
    chromium = next((path for name in CHROMIUM_COMMANDS if (path := shutil.which(name))), None)
    parser.add_argument("--chromium", default=chromium, metavar="FILE", help="program to start")
    options = parser.parse_args()
    if min(options.simulations) < 1 or options.openings < 1:
        parser.error("--simulations and --openings must be at least 1")
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0  # Chromium has no sandbox for root
    try:
        with (
            tempfile.TemporaryDirectory(dir=options.folder, prefix="frenetic-report-") as parent,
            sync_playwright() as playwright,
        ):
            for simulations in options.simulations:
                report = make_report(simulations, Path(parent) / str(simulations))
                browser = playwright.chromium.launch(
                    executable_path=options.chromium, args=["--no-sandbox"] if is_root else []
                )
                times = [open_page(browser, report) for _ in range(options.openings)]
                browser.close()
                for name, seconds in zip(MOMENTS, zip(*times, strict=True), strict=True):
                    print(f"  {name:8} {median(seconds):.2f} s ({min(seconds):.2f} to", end=" ")
                    print(f"{max(seconds):.2f})")
    except (OSError, Error, subprocess.CalledProcessError) as error:
        print(f"report: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
