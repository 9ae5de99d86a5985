"""Time and memory that it takes to show, check, report and export a large campaign.

    python benchmarks/big_campaign.py [--tests 10000 100000] [--folder DIR]
    python benchmarks/big_campaign.py --campaign FOLDER

The benchmark makes campaigns of the given sizes, or takes an existing one, runs each command on
them in a process of its own, and prints wall time, CPU time and largest resident memory.

To make a large campaign within seconds, the default driver drives 400 different roads, and the
tests repeat these drives in turn, with their trajectories: 66 % pass, 30 % fail, 4 % are INVALID.
Measures leave repeats out, so `show` and `report` take longer for a campaign that searched. The
campaigns go into a new folder inside DIR (the system's folder for temporary files by default),
which is removed afterwards: 100,000 tests need 500 MB, their exports another 6 GB.

Before the commands come the CPU times of packing a trajectory, of measuring its segment and of
storing the result, each the smallest of several runs.

Needs the extra `tables`, and Linux or macOS.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from frenetic.campaign.record import Attempt
    from frenetic.search import Candidate

SEED: Final = 1
ROADS_PER_OUTCOME: Final = {"PASS": 264, "FAIL": 120, "INVALID": 16}
SECONDS_PER_TEST: Final = 0.0015
"""Wall time recorded for each test, in s."""

FRENETIC: Final = ("-m", "frenetic")
FRAME: Final = "import sys, frenetic; frenetic.data_frame(sys.argv[1], sys.argv[2])"
COMMANDS: Final = (
    ("nothing: `frenetic --version`", (*FRENETIC, "--version")),
    ("`show`", (*FRENETIC, "show", "{campaign}")),
    ("`show --sort mean_speed`", (*FRENETIC, "show", "{campaign}", "--sort", "mean_speed")),
    ("`check`", (*FRENETIC, "check", "{campaign}")),
    ("`report`", (*FRENETIC, "report", "{campaign}", "--out", "{out}/report.html")),
    ("`data_frame`", ("-c", FRAME, "{campaign}", "tests")),
    ("`export`, parquet, no trajectories", ("parquet", "none")),
    ("`export`, parquet", ("parquet", "all")),
    ("`export`, csv, no trajectories", ("csv", "none")),
    ("`export`, csv", ("csv", "all")),
    ("`export`, json, no trajectories", ("json", "none")),
    ("`export`, json", ("json", "all")),
    ("`export`, competition", ("competition", "all")),
)
"""Name -> the arguments of Python, or format and trajectories of an export."""
STORED: Final = 500
"""Number of tests that are packed, measured and stored."""
RUNS: Final = 5
"""Number of runs of which the smallest CPU time counts."""


@dataclass(frozen=True)
class CommandCost:
    """What a command took."""

    seconds: float
    """Wall time, in s."""
    cpu_seconds: float
    memory: float
    """Largest resident memory, in MB."""


def different_drives() -> list[tuple[Candidate, Attempt]]:
    """Return roads and their results, `ROADS_PER_OUTCOME` of each outcome."""
    from frenetic.campaign import RoadTester
    from frenetic.drivers import Planner
    from frenetic.search import RandomSearch
    from frenetic.simulators import EmbeddedSimulator

    tester = RoadTester(EmbeddedSimulator(), Planner())
    strategy = RandomSearch(seed=SEED, max_redraws=0)
    missing = dict(ROADS_PER_OUTCOME)
    drives = []
    while any(missing.values()):
        candidate = strategy.ask()
        attempt = replace(tester.test(candidate), seconds=SECONDS_PER_TEST)
        if missing.get(attempt.result.outcome, 0):
            missing[attempt.result.outcome] -= 1
            drives.append((candidate, attempt.pack()))
    return drives


def make_campaign(folder: Path, tests: int) -> None:
    """Write a campaign that repeats the different drives, and print how long that took."""
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
    simulations = 0
    start = time.perf_counter()
    with CampaignStore.create(folder, campaign.configuration()) as store:
        for number, outcome in enumerate(outcomes, start=1):
            candidate, attempt = drives[(number - 1) % len(drives)]
            candidate = replace(candidate, id=number)
            store.add_candidate(candidate)
            simulations += outcome is not Outcome.INVALID
            elapsed = number * SECONDS_PER_TEST
            test = Test.of(
                candidate,
                attempt,
                result_number=number,
                budget_spent=budget.spent({"simulations": simulations}),
                elapsed=elapsed,
                finished_at=present_moment(),
            )
            store.add_result(test, attempt.packed)
        seconds = tests * SECONDS_PER_TEST
        store.finish(seconds=seconds, interrupted=False, budget=asdict(budget))
    seconds = time.perf_counter() - start
    size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
    print(f"\n{tests:,} tests, {size:,.0f} MB, written in {seconds:.1f} s\n", flush=True)


def run(arguments: list[str]) -> CommandCost:
    """Run Python with these arguments, silently.

    Raises:
        RuntimeError: Python ended with an error; the message is its last line.
    """
    with tempfile.TemporaryFile() as error_file:
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=error_file
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            error_file.seek(0)
            lines = error_file.read().decode(errors="replace").splitlines()
            raise RuntimeError(lines[-1] if lines else f"exit status {process.returncode}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes of ru_maxrss
    return CommandCost(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)


def measure_commands(campaign: Path, parent: Path) -> Iterator[tuple[str, CommandCost, int]]:
    """Run each command; yield its name, its cost and the number of bytes that it wrote."""
    for number, (name, step) in enumerate(COMMANDS):
        out = parent / f"{campaign.name}-{number}"
        if step[0].startswith("-"):
            out.mkdir()
            arguments = [argument.format(campaign=campaign, out=out) for argument in step]
        else:
            arguments = [*FRENETIC, "export", str(campaign), "--out", str(out)]
            arguments += ["--format", f"{step[0]},trajectories={step[1]}"]
        cost = run(arguments)
        yield name, cost, sum(file.stat().st_size for file in out.glob("*"))


def least_cpu(calls: Iterable[Callable[[], object]]) -> float:
    """Return the smallest CPU time of some calls, in s."""
    times = []
    for call in calls:
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def measure_storing(campaign: Path, parent: Path) -> None:
    """Print the CPU times of packing, measuring and storing a test of a campaign."""
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.record import Attempt

    with CampaignStore.open(campaign) as store:
        config = dict(store.config)
        read = store.tests(limit=STORED, with_trajectory=True)
        tests = [replace(test, result_number=k) for k, test in enumerate(read, start=1)]
    attempts = [Attempt(test.id, test.result, test.pose, test.trajectory) for test in tests]
    packed = [attempt.pack(keep_exact=True).packed for attempt in attempts]

    def pack() -> None:
        for attempt in attempts:
            attempt.pack(keep_exact=True).stored_trajectory()

    def measure() -> None:
        for test in tests:
            replace(test).measure()

    def store_all(folder: Path) -> None:
        with CampaignStore.create(folder, config) as store:
            for test, data in zip(tests, packed, strict=True):
                store.add_candidate(test.candidate)
                store.add_result(test, data)
                store.write()

    costs = {
        "packing": least_cpu([pack] * RUNS),
        "measuring": least_cpu([measure] * RUNS),
        # A test keeps its measured segment, so that all runs but the first store alone.
        "storing": least_cpu([partial(store_all, parent / f"stored-{run}") for run in range(RUNS)]),
    }
    texts = [f"{name} {1e6 * seconds / len(tests):.0f} us" for name, seconds in costs.items()]
    print(f"CPU time of a test: {', '.join(texts)}\n", flush=True)


def report(campaign: Path, parent: Path) -> None:
    """Print what a campaign costs: a line about storing, and a table of commands."""
    # In another process: the memory of this process would count for the measured commands.
    subprocess.run([sys.executable, __file__, "--store", str(campaign)], check=True)
    print("| | wall s | CPU s | peak MB | written MB |\n| --- | ---: | ---: | ---: | ---: |")
    for name, cost, written in measure_commands(campaign, parent):
        figures = f"{cost.seconds:.1f} | {cost.cpu_seconds:.1f} | {cost.memory:.0f}"
        print(f"| {name} | {figures} | {written / 1e6:,.1f} |", flush=True)


def make_and_report(sizes: list[int], parent: Path) -> None:
    """Make campaigns, each in a process of its own, and print what each costs."""
    for tests in sizes:
        campaign = parent / f"campaign-{tests}"
        make = [sys.executable, __file__, "--make", str(campaign), "--tests", str(tests)]
        subprocess.run(make, check=True)
        report(campaign, parent)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tests",
        type=int,
        nargs="+",
        default=[10_000, 100_000],
        metavar="N",
        help="sizes of the campaigns",
    )
    parser.add_argument("--folder", type=Path, metavar="DIR", help="folder for the campaigns")
    parser.add_argument("--campaign", type=Path, metavar="FOLDER", help="an existing campaign")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if min(options.tests) < 1:
        parser.error("--tests must be at least 1")
    if options.make is not None:
        make_campaign(options.make, options.tests[0])
        return 0
    try:
        with tempfile.TemporaryDirectory(dir=options.folder, prefix="frenetic-big-") as parent:
            if options.store is not None:
                measure_storing(options.store, Path(parent))
            elif options.campaign is not None:
                report(options.campaign, Path(parent))
            else:
                make_and_report(options.tests, Path(parent))
    except (OSError, RuntimeError, subprocess.CalledProcessError) as error:
        print(f"big_campaign: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
