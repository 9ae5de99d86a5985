"""CPU time of a long search per test, and the share of proposing roads.

    python benchmarks/proposing.py [--tests 16000] [--driver planner]

A search with `frenetic` of one seed runs in this process with one worker, 16 candidates ahead, in
the embedded simulator. After each thousand tests the benchmark prints the CPU time per test, and
how much of it the strategy took to propose roads and to learn their results. At the end it prints
a digest of all roads and results: equal digests of two commits show equal searches.

The campaign goes into a new temporary folder, which is removed afterwards.
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
import time
from pathlib import Path
from typing import Final

from frenetic import Budget, Campaign, CampaignStore, Candidate, Evaluation, Frenetic
from frenetic.campaign import Event
from frenetic.parts.registry import DRIVERS
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.embedded import compile_kernels

SEED: Final = 5
EVERY: Final = 1000
"""Number of tests between two lines."""


class TimedFrenetic(Frenetic):
    """The search, which measures the CPU time of its two methods."""

    asking = telling = 0.0
    """CPU time in s."""

    def ask(self) -> Candidate:
        """Propose a road."""
        start = time.process_time()
        candidate = super().ask()
        self.asking += time.process_time() - start
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Learn a result."""
        start = time.process_time()
        super().tell(evaluation)
        self.telling += time.process_time() - start


class Lines:
    """Prints a line after every `EVERY` tests of a search."""

    def __init__(self, strategy: TimedFrenetic) -> None:
        self._strategy = strategy
        self._last = (time.process_time(), 0.0, 0.0)
        self._printed = 0

    def __call__(self, event: Event) -> None:
        """Print a line if there is one to print."""
        tests = event.summary.tests // EVERY
        if tests <= self._printed:
            return
        now = time.process_time(), self._strategy.asking, self._strategy.telling
        # In ms per test, as EVERY is 1000 and the times are in s.
        times = [after - before for after, before in zip(now, self._last, strict=True)]
        whole, asking, telling = times
        print(
            f"{tests * EVERY:>7,} tests: {whole:.2f} ms a test,"
            f" {asking:.2f} to propose, {telling:.2f} to learn",
            flush=True,
        )
        self._last, self._printed = now, tests


def digest(folder: Path) -> str:
    """Return a digest of the roads and results of a campaign, in the order of candidates."""
    hashed = hashlib.sha256()
    with CampaignStore.open(folder) as store:
        for row in store.rows("SELECT id, curvatures, outcome, moobd FROM test ORDER BY id"):
            hashed.update(repr(row).encode())
    return hashed.hexdigest()[:16]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tests", type=int, default=16_000, help="number of simulations")
    parser.add_argument("--driver", default="planner", help="name of a built-in driver")
    options = parser.parse_args()
    compile_kernels()
    strategy = TimedFrenetic(seed=SEED)
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(),
            driver=DRIVERS.make(options.driver),
            budget=Budget(simulations=options.tests),
            folder=Path(folder, "campaign"),
            max_in_flight=16,
        )
        campaign.run(on_event=Lines(strategy))
        print(f"digest {digest(campaign.folder)}")


if __name__ == "__main__":
    main()
