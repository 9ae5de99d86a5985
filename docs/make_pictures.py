"""Makes the picture of two strategies in the docs: ``python docs/make_pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Planner, RandomSearch
from frenetic.analysis import compare
from frenetic.report.comparison import draw_comparison


def main() -> None:
    """Runs both six times and draws their comparison."""
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
        draw_comparison(compare(groups), Path(__file__).parent / "images" / "comparison.svg")


if __name__ == "__main__":
    main()
