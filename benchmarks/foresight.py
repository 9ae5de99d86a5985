"""Distinct failures that a search finds with and without foresight; all drives are counted.

    python benchmarks/foresight.py --out RUNS [--seeds 1-5] [--simulations 200] [-- OPTIONS]

Each seed searches twice, with the strategy ``frenetic`` and with ``foresight``, whose twin learns
from the search's own drives. OPTIONS are those of ``frenetic run``, such as

    -- --simulator metadrive --driver metadrive-idm,target_speed=50 --criteria speed_limit=50

Without any, `DRIVERS` are searched, one after the other. A run that is there is not run again, and
one that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np

from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.campaign.guarded_strategy import FACTS
from frenetic.campaign.summary import facts_text

DRIVERS: Final = {
    "stanley,lateral_acceleration=7.5,offset_gain=0.8,braking=4": "a law of the twin's, tuned",
    "highway-env": "a law of its own",
    "planner": "the law, parameters and car with which the twin begins: the ceiling, no evidence",
}
"""Driver -> how its law is related to the twin's."""

STRATEGIES: Final = ("frenetic", "foresight")


def search(folder: Path, options: list[str], strategy: str, seed: int, simulations: int) -> None:
    """Runs a search to its end, unless it has ended."""
    words = ["run", *options, "--strategy", strategy, "--seed", str(seed)]
    words += ["--simulations", str(simulations), "--workers", "1", "--out", str(folder)]
    if (folder / "campaign.sqlite").is_file():
        with CampaignStore.open(folder) as store:
            if "finished_at" in store.facts:
                return
        words = ["resume", str(folder), "--workers", "1"]
    subprocess.run(
        [sys.executable, "-m", "frenetic", *words],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def compare(folder: Path, options: list[str], seeds: list[int], simulations: int) -> None:
    """Searches with both strategies, and prints what they found."""
    found: dict[str, list[tuple[int, int]]] = {strategy: [] for strategy in STRATEGIES}
    for seed in seeds:
        for strategy, numbers in found.items():
            place = folder / f"{strategy}-{seed}"
            search(place, options, strategy, seed, simulations)
            with CampaignStore.open(place) as store:
                distinct, failed = len(distinct_failures(store)), store.counts().failed
                said = facts_text(store.fact(FACTS))
            numbers.append((distinct, failed))
            told = f"; {said}" if said else ""
            text = f"seed {seed} {strategy}: {distinct} distinct of {failed} failures{told}"
            print(text, flush=True)
    for strategy, numbers in found.items():
        words = [
            f"{np.median(one):g} ({min(one)} to {max(one)}) {what}"
            for what, one in zip(("distinct", "failures"), zip(*numbers, strict=True), strict=True)
        ]
        print(f"{strategy}: median {', '.join(words)}")
    without, foreseen = (sum(one for one, _ in found[strategy]) for strategy in STRATEGIES)
    more = sum(with_it[0] > plain[0] for plain, with_it in zip(*found.values(), strict=True))
    print(
        f"foresight finds {foreseen / max(without, 1):.2f} times as many distinct failures, more"
        f" with {more} of {len(seeds)} seeds",
        flush=True,
    )


def seeds_of(text: str) -> list[int]:
    """``1-3`` or ``1,5``."""
    first, dash, last = text.partition("-")
    return [*range(int(first), int(last) + 1)] if dash else [int(one) for one in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("1-5"))
    parser.add_argument("--simulations", type=int, default=200)
    words, options = sys.argv[1:], []
    if "--" in words:
        words, options = words[: words.index("--")], words[words.index("--") + 1 :]
    asked = parser.parse_args(words)
    if options:
        compare(asked.out, options, asked.seeds, asked.simulations)
        return
    for driver, law in DRIVERS.items():
        print(f"{driver}: {law}", flush=True)
        folder = asked.out / driver.partition(",")[0]
        compare(folder, ["--driver", driver], asked.seeds, asked.simulations)


if __name__ == "__main__":
    main()
