"""Memory and disk of a long campaign, and whether memory grows with it.

    python benchmarks/memory.py [--tests 100000] [--strategy frenetic] [--folder DIR]

The benchmark runs a campaign in a process of its own, with the embedded simulator and the default
driver. It prints the resident memory after 1, 10 and 50 % of the tests and at the end, the peak
memory, and the size of the campaign on disk. The campaign goes into a new folder inside DIR (the
system's folder for temporary files by default), which is removed afterwards: 100,000 tests need
about 1 GB.

Needs Linux, because it reads /proc.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

STATUS: Final = Path("/proc/self/status")
SHARES: Final = (0.01, 0.1, 0.5)
"""Shares of the tests after which memory is read, beside start and end."""
SEED: Final = 1


@dataclass(frozen=True)
class Reading:
    """Progress and memory of a campaign at a moment."""

    tests: int
    seconds: float
    """Wall time since the start, in s."""
    resident: float
    """Resident memory, in MB."""
    peak: float
    """Largest resident memory so far, in MB."""


def memory() -> tuple[float, float]:
    """Return the resident memory of this process in MB: now, and at its peak."""
    rows = (line.split() for line in STATUS.read_text(encoding="ascii").splitlines())
    sizes = {row[0]: int(row[1]) * 1024 / 1e6 for row in rows if len(row) == 3 and row[2] == "kB"}
    return sizes["VmRSS:"], sizes["VmHWM:"]


def run_campaign(tests: int, strategy: str, folder: Path) -> None:
    """Run the campaign in the measured process; print readings as JSON, one a line."""
    from frenetic.campaign import Budget, Campaign, Event
    from frenetic.drivers import Planner
    from frenetic.parts.registry import STRATEGIES
    from frenetic.simulators import EmbeddedSimulator
    from frenetic.simulators.embedded import compile_kernels

    def read(tests_so_far: int) -> None:
        reading = Reading(tests_so_far, time.perf_counter() - start, *memory())
        print(json.dumps(asdict(reading)), flush=True)

    marks = {max(1, round(share * tests)) for share in SHARES}

    def on_event(event: Event) -> None:
        if event.kind == "result" and event.summary.tests in marks:
            read(event.summary.tests)

    compile_kernels()
    start = time.perf_counter()
    read(0)
    # Refused roads are tests but no simulations, so the campaign has a few tests more.
    summary = Campaign(
        strategy=STRATEGIES.make(strategy, seed=SEED),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=tests),
        folder=folder,
    ).run(on_event=on_event)
    read(summary.tests)


def readings(tests: int, strategy: str, folder: Path) -> Iterator[Reading]:
    """Run a campaign in a process of its own; yield its readings as they come.

    Raises:
        RuntimeError: the process ended with an error; the message is its last line.
    """
    command = [sys.executable, __file__, "--measure", "--tests", str(tests)]
    command += ["--strategy", strategy, "--folder", str(folder)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for line in process.stdout:
            yield Reading(**json.loads(line))
        errors = process.stderr.read().strip().splitlines()
    if process.returncode:
        raise RuntimeError(errors[-1] if errors else f"exit status {process.returncode}")


def report(tests: int, strategy: str, folder: Path) -> None:
    """Print the readings of a campaign as they come, and its size on disk."""
    print(f"{'tests':>9}{'resident MB':>13}{'peak MB':>10}{'tests/s since the line above':>31}")
    before: Reading | None = None
    tests_so_far = 0
    for now in readings(tests, strategy, folder):
        rate = ""
        if before is not None:
            rate = f"{(now.tests - before.tests) / (now.seconds - before.seconds):.0f}"
        print(f"{now.tests:>9}{now.resident:>13.0f}{now.peak:>10.0f}{rate:>31}", flush=True)
        before, tests_so_far = now, now.tests
    size = sum(file.stat().st_size for file in folder.iterdir())
    print(f"on disk {size / 1e6:.0f} MB, {size / 1e3 / tests_so_far:.1f} kB per test")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tests", type=int, default=100_000, help="of the campaign")
    parser.add_argument("--strategy", default="frenetic")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="folder for the campaign")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.tests < 1:
        parser.error("--tests must be at least 1")
    if options.measure:
        run_campaign(options.tests, options.strategy, options.folder)
        return 0
    if not STATUS.exists():
        print(f"memory: {STATUS} is missing: run this on Linux", file=sys.stderr)
        return 2
    try:
        with tempfile.TemporaryDirectory(dir=options.folder, prefix="frenetic-memory-") as folder:
            report(options.tests, options.strategy, Path(folder))
    except (OSError, RuntimeError) as error:
        print(f"memory: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
