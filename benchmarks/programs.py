"""What a step costs that a program drives, beside the same law in Python.

    python benchmarks/programs.py [--drives 30]

The C++ driver of docs/programs.md is compiled by g++. It drives one road by binary records, a
driver in Python with the same law drives it in this process, and the page's driver in Python drives
it by JSON. The benchmark prints the least wall time of a step over all drives, in microseconds. A
step includes the simulator, the observation and the judge.
"""

from __future__ import annotations

import argparse
import math
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from frenetic import Controls, Driver, DriveSetup, EmbeddedSimulator, Observation, Road
from frenetic.drivers import CommandDriver

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "programs.md"
ROAD: Final = Road([0.0] * 5 + [0.02] * 5 + [-0.02] * 5 + [0.0] * 5, 10.0)
BENDS: Final = 16.0 * np.arange(40)
"""Square of the speed by which a car brakes by 4 m/s² up to each point ahead, in m²/s²."""


class Pursuit:
    """The law of docs/programs.md in Python."""

    def reset(self, setup: DriveSetup) -> None:
        """Note the setup."""
        self._setup = setup

    def act(self, observation: Observation) -> Controls:
        """Steer towards a point 8 m ahead, at a speed for the bends ahead."""
        x, y = observation.ahead[4].tolist()
        bends = 6.0 / np.maximum(np.abs(observation.curvature_ahead), 1e-3) + BENDS
        excess = min(self._setup.speed_limit, math.sqrt(bends.min())) - observation.speed
        return Controls(
            math.atan(2.0 * self._setup.wheelbase * y / (x * x + y * y)),
            min(max(excess, 0.0), 1.0),
            min(max(-0.5 * excess, 0.0), 1.0),
        )


def file_of_page(name: str, folder: Path) -> Path:
    """Write a file of the page into a folder; return its path."""
    blocks = re.findall(r"^```\w+\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (text,) = (block for block in blocks if f" file: {name}" in block.partition("\n")[0])
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def step_time(driver: Driver, drives: int) -> float:
    """Return the least wall time of a step over some drives, in microseconds."""
    simulator, times = EmbeddedSimulator(), []
    for _ in range(drives):
        start = time.perf_counter()
        drive = simulator.drive(ROAD, driver)
        times.append((time.perf_counter() - start) / len(drive.trajectory))
        assert drive.trouble is None, drive.trouble.reason
    return 1e6 * min(times)


def main() -> None:
    """Print the time of a step for each driver."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=30)
    drives = parser.parse_args().drives
    with TemporaryDirectory() as name:
        folder = Path(name)
        source, built = file_of_page("pursuit.cpp", folder), folder / "pursuit"
        command = ["g++", "-O2", "-std=c++17", str(source), "-o", str(built)]
        subprocess.run(command, check=True)
        json_driver = [sys.executable, str(file_of_page("json_driver.py", folder))]
        python = step_time(Pursuit(), drives)
        for title, driver in (
            ("C++, binary records", CommandDriver(shlex.quote(str(built)))),
            ("Python, JSON lines", CommandDriver(shlex.join(json_driver))),
        ):
            step = step_time(driver, drives)
            print(f"{title:20s} {step:6.1f} us a step, {step - python:5.1f} more than in Python")
        print(f"{'in this process':20s} {python:6.1f} us a step")


if __name__ == "__main__":
    main()
