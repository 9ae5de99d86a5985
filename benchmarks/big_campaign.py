"""Large campaigns: what it takes to look at one, check it and export it.

    python benchmarks/big_campaign.py [--tests 10000 100000] [--folder DIR]

Makes campaigns of so many tests, runs each command on them in its own process, and prints wall
time, CPU time and largest resident memory. Memory should not depend on the size.

To have a large campaign within seconds, 400 different roads are driven by the default driver, and
the tests repeat them in turn, with their trajectories: 66 % pass, 30 % fail, 4 % are INVALID. The
campaigns go into a new folder inside DIR (the system's folder for temporary files by default),
which is removed afterwards: 100,000 tests need 400 MB, what is exported of them another 3 GB.

Needs the extra `tables`, and Linux or macOS.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from frenetic.campaign.record import Attempt
    from frenetic.search import Candidate

SEED: Final = 1
WANTED: Final = {"PASS": 264, "FAIL": 120, "INVALID": 16}
"""Different roads per outcome."""
SECONDS_PER_TEST: Final = 0.0015
"""Wall time recorded for each test, in s."""

FRENETIC: Final = ("-m", "frenetic")
FRAME: Final = "import sys, frenetic; frenetic.data_frame(sys.argv[1], sys.argv[2])"
STEPS: Final = (
    ("nothing: `frenetic --version`", (*FRENETIC, "--version")),
    ("`show`", (*FRENETIC, "show", "{campaign}")),
    ("`check --quick`", (*FRENETIC, "check", "{campaign}", "--quick")),
    ("`check`", (*FRENETIC, "check", "{campaign}")),
    ("`data_frame`", ("-c", FRAME, "{campaign}", "tests")),
    ("`export`, parquet, no trajectories", ("parquet", "none")),
    ("`export`, parquet", ("parquet", "all")),
    ("`export`, csv, no trajectories", ("csv", "none")),
    ("`export`, csv", ("csv", "all")),
    ("`export`, json, no trajectories", ("json", "none")),
)
"""Measured commands: the arguments of Python, or format and trajectories of an export."""


@dataclass(frozen=True)
class Measured:
    """A command that has run."""

    seconds: float
    """Wall time, in s."""
    cpu_seconds: float
    memory: float
    """MB, largest resident memory."""


def different_drives() -> list[tuple[Candidate, Attempt]]:
    """Roads and their results, as many of each outcome as wanted."""
    from frenetic.campaign import RoadTester
    from frenetic.drivers import Planner
    from frenetic.search import RandomSearch
    from frenetic.simulators import EmbeddedSimulator

    tester = RoadTester(EmbeddedSimulator(), Planner())
    strategy = RandomSearch(seed=SEED, max_redraws=0)
    missing = dict(WANTED)
    drives = []
    while any(missing.values()):
        candidate = strategy.ask()
        attempt = replace(tester.test(candidate), seconds=SECONDS_PER_TEST)
        if missing.get(attempt.result.outcome, 0):
            missing[attempt.result.outcome] -= 1
            drives.append((candidate, attempt.pack()))
    return drives


def make_campaign(folder: Path, tests: int) -> None:
    """Writes a campaign in which different drives are repeated, and prints how long that took."""
    from frenetic._support.words import present_moment
    from frenetic.campaign import Budget, Campaign, CampaignStore, Test
    from frenetic.drivers import Planner
    from frenetic.oracle.outcome import Outcome
    from frenetic.search import RandomSearch
    from frenetic.simulators import EmbeddedSimulator

    drives = different_drives()
    outcomes = [drives[k % len(drives)][1].result.outcome for k in range(tests)]
    budget = Budget(simulations=sum(outcome is not Outcome.INVALID for outcome in outcomes))
    campaign = Campaign(
        strategy=RandomSearch(seed=SEED, max_redraws=0),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=budget,
        folder=folder,
    )
    simulations = failures = 0
    start = time.perf_counter()
    with CampaignStore.create(folder, campaign.configuration()) as store:
        for number, outcome in enumerate(outcomes, start=1):
            candidate, attempt = drives[(number - 1) % len(drives)]
            candidate = replace(candidate, id=number)
            store.add_candidate(candidate)
            simulations += outcome is not Outcome.INVALID
            failures += outcome is Outcome.FAIL
            elapsed = number * SECONDS_PER_TEST
            test = Test.of(
                candidate,
                attempt,
                result_number=number,
                budget_spent=budget.spent(simulations, elapsed, failures),
                elapsed=elapsed,
                finished_at=present_moment(),
            )
            store.add_result(test, attempt.packed)
        seconds = tests * SECONDS_PER_TEST
        store.finish(seconds=seconds, interrupted=False, budget=asdict(budget))
    seconds = time.perf_counter() - start
    size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
    print(f"\n{tests:,} tests, {size:,.0f} MB, written in {seconds:.1f} s\n", flush=True)


def run(arguments: list[str]) -> Measured:
    """Runs Python with these arguments, silently.

    Raises:
        RuntimeError: it failed; its last line of complaint.
    """
    with tempfile.TemporaryFile() as complaint:
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=complaint
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            complaint.seek(0)
            lines = complaint.read().decode(errors="replace").splitlines()
            raise RuntimeError(lines[-1] if lines else f"exit status {process.returncode}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return Measured(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)


def measured_steps(campaign: Path, parent: Path) -> Iterator[tuple[str, Measured, int]]:
    """Measurements of each command, with the bytes it wrote."""
    for number, (name, step) in enumerate(STEPS):
        out = parent / f"{campaign.name}-{number}"
        if step[0].startswith("-"):
            arguments = [argument.format(campaign=campaign) for argument in step]
        else:
            arguments = [*FRENETIC, "export", str(campaign), "--out", str(out)]
            arguments += ["--format", f"{step[0]},trajectories={step[1]}"]
        result = run(arguments)
        yield name, result, sum(file.stat().st_size for file in out.glob("*"))


def report(sizes: list[int], parent: Path) -> None:
    """Makes the campaigns and prints a table for each."""
    for tests in sizes:
        campaign = parent / f"campaign-{tests}"
        # In another process: a new one is charged with the memory of its parent.
        make = [sys.executable, __file__, "--make", str(campaign), "--tests", str(tests)]
        subprocess.run(make, check=True)
        print("| | wall s | CPU s | peak MB | written MB |\n| --- | ---: | ---: | ---: | ---: |")
        for name, step, written in measured_steps(campaign, parent):
            figures = f"{step.seconds:.1f} | {step.cpu_seconds:.1f} | {step.memory:.0f}"
            print(f"| {name} | {figures} | {written / 1e6:,.1f} |", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tests", type=int, nargs="+", default=[10_000, 100_000], metavar="N")
    parser.add_argument("--folder", type=Path, metavar="DIR")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if min(options.tests) < 1:
        parser.error("--tests of at least 1 is needed")
    if options.make is not None:
        make_campaign(options.make, options.tests[0])
        return 0
    try:
        with tempfile.TemporaryDirectory(dir=options.folder, prefix="frenetic-big-") as parent:
            report(options.tests, Path(parent))
    except (OSError, RuntimeError, subprocess.CalledProcessError) as error:
        print(f"big_campaign: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
