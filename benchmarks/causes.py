"""How often is a certain cause the planted one? ``python benchmarks/causes.py``.

Drivers with one planted fault each are searched, and the causes of their failures are tried. The
table says which share of the failures has a certain cause, and which share of these the planted
one. The drivers are in `tests/shared/planted_drivers.py`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "shared"))

import planted_drivers as planted

from frenetic import Budget, Campaign, CampaignStore, EmbeddedSimulator, Frenetic
from frenetic.analysis.cause_trials import Certainty
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.explained import ExplainedCause, explained_causes
from frenetic.rerun.cause_trials import examples_of, try_failures
from frenetic.segments.causes import Kind

PLANTED: Final[Mapping[type[planted.Sound], tuple[Kind, ...]]] = {
    planted.BrakesLate: (Kind.BRAKES_LATE,),
    planted.WeakSteering: (Kind.TOO_LITTLE,),
    planted.ShortWheelbase: (Kind.TOO_LITTLE,),
    planted.Lagging: (Kind.OSCILLATES,),
    planted.Limited: (Kind.HELD,),
    planted.WrongSign: (Kind.WRONG_WAY,),
    planted.TooFast: (Kind.TOO_FAST,),
    planted.CutsBends: (Kind.CUTS,),
    planted.Stops: (Kind.STANDS,),
    planted.WrongFeedForward: (Kind.WRONG_WAY,),
    planted.RateLimited: (Kind.SLOW_STEERING,),
    planted.WindUp: (Kind.OSCILLATES,),
    planted.Degrees: (Kind.BEYOND,),
    planted.LateSpeed: (Kind.BRAKES_LATE, Kind.TOO_FAST),
    planted.DeadBand: (Kind.TOO_LITTLE, Kind.OSCILLATES, Kind.BRAKES_LATE),
    planted.BothPedals: (Kind.BOTH_PEDALS,),
}
"""Driver -> kinds of cause that are right."""


def main() -> None:
    """Print a row for each driver, and all together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--simulations", type=int, default=100)
    options = parser.parse_args()
    totals = [0, 0, 0]
    print(f"{'driver':18s} failures  certain  planted")
    for driver, kinds in PLANTED.items():
        causes = causes_of(driver(), options.seed, options.simulations)
        failures = sum(cause.group.failures for cause in causes)
        certain = [cause for cause in causes if cause.certainty is Certainty.CERTAIN]
        is_right = [cause for cause in certain if cause.tried and Kind[cause.tried.kind] in kinds]
        row = [failures, *(sum(c.group.failures for c in some) for some in (certain, is_right))]
        totals = [total + number for total, number in zip(totals, row, strict=True)]
        print(f"{driver.__name__:18s} {row[0]:8d} {row[1]:8d} {row[2]:8d}", flush=True)
    print(f"{'all':18s} {totals[0]:8d} {totals[1]:8d} {totals[2]:8d}")
    print(f"certain: {totals[1] / totals[0]:.0%}; of these planted: {totals[2] / totals[1]:.1%}")


def causes_of(driver: planted.Sound, seed: int, simulations: int) -> tuple[ExplainedCause, ...]:
    """Return the causes of a driver's failures in a search, after their trials."""
    with TemporaryDirectory() as folder:
        campaign = Campaign(
            strategy=Frenetic(seed=seed),
            simulator=EmbeddedSimulator(),
            driver=driver,
            budget=Budget(simulations=simulations),
            folder=folder,
        )
        campaign.run()
        with CampaignStore.open(folder) as store:
            clusters = distinct_failures(store)
        try_failures(folder, examples_of(clusters.causes), campaign.tester)
        with CampaignStore.open(folder) as store:
            return explained_causes(store, clusters)


if __name__ == "__main__":
    main()
