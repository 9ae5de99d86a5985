"""Dask clusters of real processes on this machine, for tests."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pids import descendants, ending, until

HERE = Path(__file__).parent
"""Folder with parts of campaigns, which workers can import as if they were installed."""
SHARED = HERE.parents[1] / "shared"
SOURCES = HERE.parents[2] / "src"
ONE_SEAT = ("--nthreads", "1", "--resources", "simulator=1")


class Cluster:
    """A scheduler, to which a test adds workers; all processes end with the cluster."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._stack = ExitStack()
        self._count = 0
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", self._file)
        self.address = ""

        def address() -> str:
            assert self.scheduler.poll() is None, "the scheduler ended"
            try:
                self.address = json.loads(Path(self._file).read_text())["address"]
            except (FileNotFoundError, json.JSONDecodeError):  # the file is missing or incomplete
                return ""
            return self.address

        try:
            until(address, "the scheduler starts")
        except BaseException:
            self.close()
            raise

    @property
    def _file(self) -> str:
        return str(self.folder / "scheduler.json")

    def start(self, *options: str, path: Path = HERE) -> subprocess.Popen[bytes]:
        """Start one or more workers, as the options say; they import modules from the path, too."""
        defaults = [
            *("--local-directory", str(self.folder), "--memory-limit", "0"),
            *("--preload", "clusters"),  # see `dask_setup`
        ]
        return self._start("worker", self.address, *defaults, *options, path=path)

    @contextmanager
    def started(self, *options: str, path: Path = HERE) -> Iterator[subprocess.Popen[bytes]]:
        """Start a worker, and end it with the context."""
        process = self.start(*options, path=path)
        try:
            yield process
        finally:
            end(process)

    def close(self) -> None:
        self._stack.close()

    def _start(self, role: str, *options: str, path: Path = HERE) -> subprocess.Popen[bytes]:
        self._count += 1
        log = self._stack.enter_context((self.folder / f"{role}-{self._count}.log").open("wb"))
        process = subprocess.Popen(
            [
                *(sys.executable, "-m", f"distributed.cli.dask_{role}", "--host", "127.0.0.1"),
                *("--no-dashboard", "--dashboard-address", "127.0.0.1:0", *options),
            ],
            stdout=log,
            stderr=subprocess.STDOUT,
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join(map(str, (path, HERE, SHARED, SOURCES)))},
        )
        self._stack.callback(end, process)
        return process


def dask_setup(worker: object) -> None:
    """Stop garbage collection in a worker at its start: no test may depend on its time."""
    gc.disable()


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process with its children."""
    with ending(lambda: family):
        family = descendants(process.pid)
        process.kill()
        process.wait()
