"""Distinct failures of a driver's next version, with and without a warm start.

    python benchmarks/warm_start.py [--simulations 200] [--earlier 200] [--seeds 101-106]

Each pair is a driver and its next version. For each seed, the driver is searched once with the next
seed, in a campaign of ``--earlier`` simulations. Its next version is then searched twice, with the
same seed and budget: afresh, and starting from that campaign. *New* are distinct failures of which
none differs by at most 2 m from a failure of the earlier campaign, by the marks of the warm start
itself (`Cluster.was_known`). All drives are in the embedded simulator, ordered as with ``--seed``;
the table holds medians.
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
class Found:
    """What a campaign found."""

    distinct: int
    known: int
    to_first: int
    """Simulations to the first failure, one more than all of them without one."""


def search(
    folder: Path, driver: Driver, seed: int, simulations: int, start_from: tuple[Path, ...] = ()
) -> Found:
    """Searches in a folder."""
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
        told = [test.result_number for test in store.tests(Outcome.FAIL, limit=1)]
    return Found(len(clusters), clusters.known, (told or [simulations + 1])[0])


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--simulations", type=int, default=200)
    parser.add_argument("--earlier", type=int, default=200, help="simulations of the earlier one")
    parser.add_argument("--seeds", default="101-106")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    print("| driver | next version | afresh | with `--from` | new ones of these | to the first |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, driver, next_name, version in PAIRS:
        afresh, warm = [], []
        for seed in seeds:
            with tempfile.TemporaryDirectory() as parent:
                old = Path(parent, "old")
                search(old, driver, seed + 1, given.earlier)
                afresh.append(search(Path(parent, "afresh"), version, seed, given.simulations))
                warm.append(search(Path(parent, "warm"), version, seed, given.simulations, (old,)))
        cells = (
            f"{median(one.distinct for one in afresh):g}",
            f"{median(one.distinct for one in warm):g}",
            f"{median(one.distinct - one.known for one in warm):g}",
            " and ".join(f"{median(one.to_first for one in some):g}" for some in (afresh, warm)),
        )
        print(f"| {name} | {next_name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
