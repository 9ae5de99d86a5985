"""Makes the pictures of README and docs: ``python docs/make_pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

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
from frenetic.report import draw_gallery
from frenetic.report.comparison import draw_comparison

IMAGES = Path(__file__).parent / "images"
SEED = 1


def main() -> None:
    """Runs campaigns and draws their failures."""
    draw_failures()
    draw_strategies()


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


if __name__ == "__main__":
    main()
