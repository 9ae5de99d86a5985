"""Distinct failures that a search finds with and without foresight; all drives count.

    python benchmarks/foresight.py --out RUNS [--seeds 1-5] [--simulations 200] [-- OPTIONS]

For each seed there are two searches: with the strategy ``frenetic``, and with ``foresight``, whose
twin learns from the drives of the search. OPTIONS are options of ``frenetic run``, such as

    -- --simulator metadrive --driver metadrive-idm,target_speed=50 --criteria speed_limit=50

Without OPTIONS, the benchmark searches each of `DRIVERS`. Complete runs in the folder RUNS are not
run again, and interrupted runs continue.
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
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.campaign.summary import facts_text

DRIVERS: Final = {
    "stanley,lateral_acceleration=7.5,offset_gain=0.8,braking=4": "a law of the twin's, tuned",
    "highway-env": "a law of its own",
    "planner": "the law, parameters and car with which the twin begins: the ceiling, no evidence",
}
"""Driver -> how its law is related to the twin's."""

STRATEGIES: Final = ("frenetic", "foresight")


def search(folder: Path, options: list[str], strategy: str, seed: int, simulations: int) -> None:
    """Run a search to its end, unless it has ended."""
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
    """Search with both strategies, and print their failures."""
    runs: dict[str, list[tuple[int, int]]] = {strategy: [] for strategy in STRATEGIES}
    for seed in seeds:
        for strategy, counts in runs.items():
            run_folder = folder / f"{strategy}-{seed}"
            search(run_folder, options, strategy, seed, simulations)
            with CampaignStore.open(run_folder) as store:
                distinct, failed = len(distinct_failures(store)), store.counts().failed
                twin_text = facts_text(store.fact(SEARCH_FACTS))
            counts.append((distinct, failed))
            text = f"seed {seed} {strategy}: {distinct} distinct of {failed} failures"
            print(f"{text}; {twin_text}" if twin_text else text, flush=True)
    for strategy, counts in runs.items():
        columns = zip(("distinct", "failures"), zip(*counts, strict=True), strict=True)
        texts = [
            f"{np.median(values):g} ({min(values)} to {max(values)}) {name}"
            for name, values in columns
        ]
        print(f"{strategy}: median {', '.join(texts)}")
    plain_counts, foresight_counts = (
        [distinct for distinct, _ in runs[strategy]] for strategy in STRATEGIES
    )
    ratio = sum(foresight_counts) / max(sum(plain_counts), 1)
    more = sum(f > p for f, p in zip(foresight_counts, plain_counts, strict=True))
    print(
        f"foresight finds {ratio:.2f} times as many distinct failures, more"
        f" with {more} of {len(seeds)} seeds",
        flush=True,
    )


def seeds_of(text: str) -> list[int]:
    """Return the seeds of a text such as ``1-3`` or ``1,5``."""
    first, dash, last = text.partition("-")
    return [*range(int(first), int(last) + 1)] if dash else [int(seed) for seed in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("1-5"), help="1-5 or 1,3")
    parser.add_argument("--simulations", type=int, default=200, help="of a search")
    words, run_options = sys.argv[1:], []
    if "--" in words:
        words, run_options = words[: words.index("--")], words[words.index("--") + 1 :]
    options = parser.parse_args(words)
    if run_options:
        compare(options.out, run_options, options.seeds, options.simulations)
        return
    for driver, law in DRIVERS.items():
        print(f"{driver}: {law}", flush=True)
        folder = options.out / driver.partition(",")[0]
        compare(folder, ["--driver", driver], options.seeds, options.simulations)


if __name__ == "__main__":
    main()
