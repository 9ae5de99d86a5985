"""Make the pictures of road classes and of two strategies: ``python docs/make_pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from frenetic import (
    Budget,
    Campaign,
    EmbeddedSimulator,
    Frenetic,
    Outcome,
    Planner,
    RandomSearch,
    Rules,
)
from frenetic.analysis import compare
from frenetic.campaign import CampaignStore
from frenetic.report.picture import draw_test
from frenetic.report.plots import draw_comparison
from frenetic.road.classes import RoadClass

IMAGES = Path(__file__).parent / "images"
MOST_SEVERE = 20  # failures among which the longest drive is drawn
RUNS = 6  # campaigns of each strategy
FRICTIONS = {"urban-50": 0.25, "rural-80": 0.3, "rural-100": 0.4, "motorway-130": 0.45}
"""Road class -> friction at which the planner leaves its lane on some roads of the class."""


def draw_classes() -> None:
    """Draw the longest drive among the most severe failures in each road class."""
    for name, friction in FRICTIONS.items():
        road_class = RoadClass.of(name)
        rules = Rules(speed_limit=road_class.speed_limit)
        with tempfile.TemporaryDirectory() as folder:
            campaign = Campaign(
                strategy=Frenetic(seed=1, road_class=road_class),
                simulator=EmbeddedSimulator(rules=rules, friction=friction),
                driver=Planner(),
                budget=Budget(simulations=100),
                folder=Path(folder) / "campaign",
            )
            campaign.run()
            with CampaignStore.open(campaign.folder) as store:
                worst = store.tests(Outcome.FAIL, order_by="moobd", limit=MOST_SEVERE)
                longest = max(worst, key=lambda failure: failure.result.duration or 0.0)
                test = store.test(longest.id)  # with its trajectory
                draw_test(test, IMAGES / f"road-{name}.png", f"{name}, friction {friction:g}")


def draw_strategies() -> None:
    """Run two strategies several times each and draw their comparison."""
    with tempfile.TemporaryDirectory() as folder:
        groups: dict[str, list[Path]] = {"frenetic": [], "random": []}
        for name, strategy in (("frenetic", Frenetic), ("random", RandomSearch)):
            for seed in range(RUNS):
                campaign_folder = Path(folder) / f"{name}-{seed}"
                groups[name].append(campaign_folder)
                Campaign(
                    strategy=strategy(seed=seed),
                    simulator=EmbeddedSimulator(),
                    driver=Planner(),
                    budget=Budget(simulations=250),
                    folder=campaign_folder,
                ).run()
        draw_comparison(compare(groups), IMAGES / "comparison.svg")


def main() -> None:
    """Draw failures in road classes and the comparison of two strategies."""
    draw_classes()
    draw_strategies()


if __name__ == "__main__":
    main()
