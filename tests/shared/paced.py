"""A campaign in another process, which waits for a word of the test after each result.

Run as a script: ``python paced.py FOLDER SIMULATIONS``.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from events import on_test

from frenetic.campaign import Budget, Campaign
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.testing import DummyDriver, DummySimulator


def drift(road: Road) -> float:
    """Return the drift of a car, in m: it leaves its lane on sharp roads."""
    return 4.0 if abs(road.curvatures).max() > 0.06 else 0.5


def campaign(folder: Path, simulations: int = 20) -> Campaign:
    return Campaign(
        strategy=RandomSearch(seed=2),
        simulator=DummySimulator(drift),
        driver=DummyDriver(),
        budget=Budget(simulations=simulations),
        folder=folder,
    )


class Paced:
    """The process of the campaign, which has stored its first result."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.id = process.pid
        self._await_result()

    def go_on(self) -> None:
        """Let the campaign store one more result."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        self._await_result()

    def finish(self) -> None:
        """Let the campaign run to its end."""
        self._process.communicate()
        assert self._process.returncode == 0

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _await_result(self) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "stored\n"


@contextmanager
def paced(folder: Path, simulations: int = 20) -> Iterator[Paced]:
    """Start a campaign in another process; kill the process at the end."""
    command = [sys.executable, __file__, str(folder), str(simulations)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield Paced(process)
        finally:
            process.kill()


def wait_for_word(test: object) -> None:
    """Tell the test that a result is stored, and wait for a line."""
    sys.stdout.write("stored\n")
    sys.stdout.flush()
    sys.stdin.readline()


if __name__ == "__main__":
    campaign(Path(sys.argv[1]), int(sys.argv[2])).run(on_event=on_test(wait_for_word))
