"""Distinct failures that a search finds with and without a screen, in a slow simulator.

    python benchmarks/screening.py PROFILE --out RUNS [--seeds 1-10] [--simulations 100]
        -- --simulator metadrive --driver metadrive-idm,target_speed=50 ...

Each seed searches twice with the options after ``--``, once with the strategy ``screened`` over
PROFILE. A run that is there is not run again, and one that was interrupted goes on. The profile
comes from drives that
no run knows, such as those of a random search:

    frenetic run --simulator metadrive ... --strategy random --simulations 200 --out recorded
    frenetic calibrate recorded --driver stanley --vehicle metadrive --fit ... --out PROFILE

The drives that the profile was fitted to are not counted: compare with ``frenetic run`` of so many
more simulations, too.

distinct    distinct failures, see `frenetic.analysis.failures`
handed on   screened roads that the simulator drove, and kept: how many of them failed
rank, AUC   how the twin's MOOBD follows the simulator's on the controls
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

from frenetic.analysis.failures import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.campaign.asking import FACTS
from frenetic.campaign.summary import facts_in_words


def search(folder: Path, options: list[str], seed: int, simulations: int) -> None:
    """Runs a search to its end, unless it has ended."""
    words = ["run", *options, "--seed", str(seed), "--simulations", str(simulations)]
    words += ["--workers", "1", "--out", str(folder)]
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


def seeds_of(text: str) -> list[int]:
    """``1-3`` or ``1,5``."""
    first, dash, last = text.partition("-")
    return [*range(int(first), int(last) + 1)] if dash else [int(one) for one in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("profile", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("1-10"))
    parser.add_argument("--simulations", type=int, default=100)
    words, options = sys.argv[1:], []
    if "--" in words:
        words, options = words[: words.index("--")], words[words.index("--") + 1 :]
    asked = parser.parse_args(words)
    found: dict[str, list[int]] = {"without": [], "screened": []}
    for seed in asked.seeds:
        for how, numbers in found.items():
            folder = asked.out / f"{how}-{seed}"
            screen = ["--strategy", f"screened,profile={asked.profile}"]
            own = screen if how == "screened" else []
            search(folder, [*options, *own], seed, asked.simulations)
            with CampaignStore.open(folder) as store:
                counts, said = store.counts(), facts_in_words(store.fact(FACTS))
                numbers.append(len(distinct_failures(store)))
            told = f"; {said}" if said else ""
            text = f"seed {seed} {how}: {numbers[-1]} distinct of {counts.failed} failures{told}"
            print(text, flush=True)
    without, screened = (np.array(found[how]) for how in ("without", "screened"))
    for how, numbers in found.items():
        print(f"{how}: median {np.median(numbers):g}, {min(numbers)} to {max(numbers)} distinct")
    print(f"screened finds {screened.sum() / max(without.sum(), 1):.2f} times as many")


if __name__ == "__main__":
    main()
