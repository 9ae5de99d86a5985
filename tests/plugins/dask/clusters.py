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
"""Parts of campaigns are in files here, which workers find as if they were installed there."""
SHARED = HERE.parents[1] / "shared"
SOURCES = HERE.parents[2] / "src"
ONE_SEAT = ("--nthreads", "1", "--resources", "simulator=1")


class Cluster:
    """A scheduler; workers are started as a test wants them, and all ended with the cluster."""

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
            except (FileNotFoundError, json.JSONDecodeError):  # not yet, or half of it
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
        """Starts a worker, or as many as the options say; it finds modules in the path, too."""
        usual = [
            *("--local-directory", str(self.folder), "--memory-limit", "0"),
            *("--preload", "clusters"),  # see `dask_setup`
        ]
        return self._start("worker", self.address, *usual, *options, path=path)

    @contextmanager
    def started(self, *options: str, path: Path = HERE) -> Iterator[subprocess.Popen[bytes]]:
        """A worker for as long as it is needed."""
        process = self.start(*options, path=path)
        try:
            yield process
        finally:
            end(process)

    def close(self) -> None:
        self._stack.close()

    def _start(self, what: str, *options: str, path: Path = HERE) -> subprocess.Popen[bytes]:
        self._count += 1
        log = self._stack.enter_context((self.folder / f"{what}-{self._count}.log").open("wb"))
        process = subprocess.Popen(
            [
                *(sys.executable, "-m", f"distributed.cli.dask_{what}", "--host", "127.0.0.1"),
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
    """Called by each worker at its start: nothing may depend on when garbage is collected."""
    gc.disable()


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a process with all that it has started."""
    with ending(lambda: family):
        family = descendants(process.pid)
        process.kill()
        process.wait()
