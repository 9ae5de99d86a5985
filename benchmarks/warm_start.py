"""Distinct failures of a driver's next version, with and without a warm start.

    python benchmarks/warm_start.py [--simulations 200] [--earlier 200] [--seeds 101-106]

Each pair is a driver and its next version. For each seed, an earlier campaign of ``--earlier``
simulations searches the driver, with the seed that follows. Two campaigns then search the next
version, with the same seed and budget: one afresh, one with a warm start from the earlier campaign.
A distinct failure is *new* if all its failures differ by more than 2 m from every failure of the
earlier campaign, as the warm start itself marks failures (`Cluster.was_known`). All drives are in
the embedded simulator, ordered as with ``--seed``. The table gives medians.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Driver, Planner, Stanley
from frenetic.oracle.outcome import Outcome
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator

PAIRS: Final[tuple[tuple[str, Driver, str, Driver], ...]] = (
    ("`planner`", Planner(), "`lookahead_time=0.4`", Planner(lookahead_time=0.4)),
    (
        "`planner`, `lateral_acceleration=7`",
        Planner(lateral_acceleration=7.0),
        "`lateral_acceleration=7.5`",
        Planner(lateral_acceleration=7.5),
    ),
    (
        "`planner`, `lateral_acceleration=7`",
        Planner(lateral_acceleration=7.0),
        "`lookahead_time=0.35`, too",
        Planner(lateral_acceleration=7.0, lookahead_time=0.35),
    ),
    (
        "`planner`",
        Planner(),
        "`lateral_acceleration=7`",
        Planner(lateral_acceleration=7.0),
    ),
    ("`planner`", Planner(), "`stanley`", Stanley()),
)
"""A driver and its next version, each with its name."""


@dataclass(frozen=True)
class SearchResult:
    """Failures of a campaign."""

    distinct: int
    known: int
    """Distinct failures that the earlier campaign knew."""
    to_first: int
    """Simulations to the first failure; without failures, one more than all simulations."""


def search(
    folder: Path, driver: Driver, seed: int, simulations: int, start_from: tuple[Path, ...] = ()
) -> SearchResult:
    """Run a campaign in a folder, and count its failures."""
    Campaign(
        strategy=Frenetic(seed=seed),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=simulations),
        folder=folder,
        max_in_flight=16,
        start_from=start_from,
    ).run()
    with CampaignStore.open(folder) as store:
        clusters = distinct_failures(store)
        first_failure = [test.result_number for test in store.tests(Outcome.FAIL, limit=1)]
    to_first = (first_failure or [simulations + 1])[0]
    return SearchResult(len(clusters), clusters.known, to_first)


def main() -> None:
    """Run all campaigns, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--simulations", type=int, default=200, help="of a search")
    parser.add_argument(
        "--earlier", type=int, default=200, help="simulations of the earlier campaign"
    )
    parser.add_argument("--seeds", default="101-106", help="first and last seed")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    print("| driver | next version | without `--from` | with it | of these, new | to the first |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, driver, next_name, version in PAIRS:
        afresh, warm = [], []
        for seed in seeds:
            with tempfile.TemporaryDirectory() as parent:
                old = Path(parent, "old")
                search(old, driver, seed + 1, options.earlier)
                simulations = options.simulations
                afresh.append(search(Path(parent, "afresh"), version, seed, simulations))
                warm.append(search(Path(parent, "warm"), version, seed, simulations, (old,)))
        cells = (
            f"{median(run.distinct for run in afresh):g}",
            f"{median(run.distinct for run in warm):g}",
            f"{median(run.distinct - run.known for run in warm):g}",
            " and ".join(f"{median(run.to_first for run in runs):g}" for runs in (afresh, warm)),
        )
        print(f"| {name} | {next_name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
