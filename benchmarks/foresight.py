"""Distinct failures that a search finds with and without foresight; all drives count.

    python benchmarks/foresight.py --out RUNS [--seeds 1-5] [--simulations 200] [-- OPTIONS]

For each seed there are two searches: with the strategy ``frenetic``, and with ``foresight``, whose
twin learns from the drives of the search. OPTIONS are options of ``frenetic run``, such as

    -- --simulator metadrive --driver mine.py:Mine

Without OPTIONS, the benchmark searches each of `CASES`. Complete runs in the folder RUNS are not
run again, and interrupted runs continue. ``--laws`` measures the twin whose driver is a law, as
for a driver that cannot drive in the twin.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np

from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.campaign.summary import facts_text

OWN: Final = Path(__file__).with_name("foresight_drivers.py")
CASES: Final = tuple(
    (simulator, driver)
    for simulator, drivers in {
        "metadrive": (
            "planner",
            "stanley,lateral_acceleration=7.5,offset_gain=0.8,braking=4",
            f"{OWN}:Pursuit",
            f"{OWN}:Feedforward",
        ),
        "commonroad": ("stanley", "opendbc", f"{OWN}:Pursuit", f"{OWN}:Feedforward"),
    }.items()
    for driver in drivers
)
"""Simulator and driver: two built-in laws, another project's driver, and two of a user's own."""


def search(folder: Path, options: list[str], strategy: str, seed: int, simulations: int) -> float:
    """Run a search to its end, unless it has ended; return its CPU time, in s."""
    words = ["run", *options, "--strategy", strategy, "--seed", str(seed)]
    words += ["--simulations", str(simulations), "--workers", "1", "--out", str(folder)]
    if (folder / "campaign.sqlite").is_file():
        with CampaignStore.open(folder) as store:
            if "finished_at" in store.facts:
                return 0.0
        words = ["resume", str(folder), "--workers", "1"]
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "frenetic", *words],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = os.times()
    return (
        after.children_user + after.children_system - before.children_user - before.children_system
    )


def compare(
    folder: Path, options: list[str], seeds: list[int], simulations: int, foresight: str
) -> None:
    """Search with both strategies, and print their failures and CPU time."""
    strategies = ("frenetic", foresight)
    runs: dict[str, list[tuple[int, int]]] = {strategy: [] for strategy in strategies}
    for seed in seeds:
        for strategy, counts in runs.items():
            run_folder = folder / f"{strategy}-{seed}"
            seconds = search(run_folder, options, strategy, seed, simulations)
            with CampaignStore.open(run_folder) as store:
                distinct, failed = len(distinct_failures(store)), store.counts().failed
                twin_text = facts_text(store.fact(SEARCH_FACTS))
            counts.append((distinct, failed))
            text = f"seed {seed} {strategy}: {distinct} distinct of {failed} failures"
            if seconds:
                text += f", {seconds:.0f} s of CPU time"
            print(f"{text}; {twin_text}" if twin_text else text, flush=True)
    for strategy, counts in runs.items():
        columns = zip(("distinct", "failures"), zip(*counts, strict=True), strict=True)
        texts = [
            f"{np.median(values):g} ({min(values)} to {max(values)}) {name}"
            for name, values in columns
        ]
        print(f"{strategy}: median {', '.join(texts)}")
    plain_counts, foresight_counts = (
        [distinct for distinct, _ in runs[strategy]] for strategy in strategies
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
    parser.add_argument("--laws", action="store_true", help="with a law for a driver")
    words, run_options = sys.argv[1:], []
    if "--" in words:
        words, run_options = words[: words.index("--")], words[words.index("--") + 1 :]
    options = parser.parse_args(words)
    foresight = "foresight,laws=true" if options.laws else "foresight"
    if run_options:
        compare(options.out, run_options, options.seeds, options.simulations, foresight)
        return
    for simulator, driver in CASES:
        print(f"{simulator}, {driver}", flush=True)
        name = re.sub(r"\W+", "-", Path(driver.partition(",")[0]).name)
        folder = options.out / f"{simulator}-{name}"
        words = ["--simulator", simulator, "--driver", driver]
        compare(folder, words, options.seeds, options.simulations, foresight)


if __name__ == "__main__":
    main()
