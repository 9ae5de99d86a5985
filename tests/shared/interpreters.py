"""Run commands and code in separate processes that start at once.

One process imports Frenetic and loads its kernels. Each job runs in a fork of this process, so that
no job changes the next. The fork ends as an interpreter does, but does not free what it has loaded:
that would take longer than most jobs.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import pkgutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
import types
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from multiprocessing import util
from pathlib import Path
from typing import Any, NoReturn

import pytest

import frenetic

# Modules that take long to import, and that Frenetic imports only where it needs them.
PRELOADED = (
    "command_line",
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "rich.live",
    "scipy.cluster.hierarchy",
    "scipy.interpolate",
    "scipy.stats",
)
# Modules of Frenetic that few commands need and that make forking slow.
LEFT_OUT = {"__main__", "beamng", "dask", "metadrive", "metrics", "standins", "tables"}


@dataclass(frozen=True)
class Ended:
    """Exit code and output of a process."""

    code: int
    """Exit code, or minus the number of the signal that ended the process."""
    stdout: str
    """Text on stdout."""
    stderr: str
    """Text on stderr."""

    @property
    def output(self) -> str:
        """Text on stdout, then on stderr."""
        return self.stdout + self.stderr


class Interpreter:
    """Runs each job in a new Python interpreter; works on every platform."""

    def frenetic(self, *arguments: str, folder: Path, drawn: Iterable[str] | None = None) -> Ended:
        """Run a command line of Frenetic in a folder; pictures not `drawn` may be empty."""
        names = None if drawn is None else list(drawn)
        return self._run({"arguments": arguments, "drawn": names}, folder)

    def python(self, code: str, *, folder: Path) -> Ended:
        """Run code in a folder as `python -W error -c` does; files of the folder are modules."""
        return self._run({"code": code}, folder)

    def close(self) -> None:
        """End the processes that this interpreter has started."""

    def _run(self, job: dict[str, Any], folder: Path) -> Ended:
        arguments = ["-W", "error", "-c", job["code"]] if "code" in job else ["-m", "frenetic"]
        done = subprocess.run(
            [sys.executable, *arguments, *job.get("arguments", ())],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(folder)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
        )
        written = (text.decode(errors="replace") for text in (done.stdout, done.stderr))
        return Ended(done.returncode, *written)


class WarmInterpreter(Interpreter):
    """Runs each job in a fork of an interpreter that has already loaded everything."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        """End the loaded interpreter."""
        self._process.communicate()

    def _run(self, job: dict[str, Any], folder: Path) -> Ended:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with tempfile.NamedTemporaryFile() as out, tempfile.NamedTemporaryFile() as err:
            files = {"stdout": out.name, "stderr": err.name}
            print(
                json.dumps(job | {"folder": str(folder)} | files),
                file=self._process.stdin,
                flush=True,
            )
            code = int(self._process.stdout.readline())
            return Ended(code, *(file.read().decode(errors="replace") for file in (out, err)))


@pytest.fixture(scope="session")
def interpreter(pytestconfig: pytest.Config) -> Iterator[Interpreter]:
    """Runs command lines and code in separate processes.

    A warm interpreter takes as long to start as a handful of jobs: only heavy tests use it.
    """
    is_warm = sys.platform == "linux" and pytestconfig.getoption("--all")
    interpreter = WarmInterpreter() if is_warm else Interpreter()
    yield interpreter
    interpreter.close()


def load_kernels() -> None:
    """Drive and judge a road, so that all kernels are compiled."""
    from frenetic import EmbeddedSimulator, Planner, Road, judge

    road, verdict = Road([0.0, 0.01, -0.01, 0.0]).placed()
    assert road is not None
    assert verdict.valid
    judge(road, EmbeddedSimulator().drive(road, Planner()))


def _serve() -> None:
    """Read a job from each line of stdin, run it in a fork and print its exit code."""
    gc.set_threshold(50_000)  # as the command line does
    modules = [module.name for module in pkgutil.walk_packages(frenetic.__path__, "frenetic.")]
    for name in (*PRELOADED, *(name for name in modules if not set(name.split(".")) & LEFT_OUT)):
        importlib.import_module(name)
    load_kernels()
    gc.collect()
    gc.freeze()  # else each fork looks through all objects when it ends
    for line in sys.stdin:
        child = _fork()
        if child == 0:
            _do(**json.loads(line))
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        sys.stdout.flush()


def _fork() -> int:
    with warnings.catch_warnings():
        # Python 3.12 warns of threads; the threads of the linear algebra library are idle.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _do(
    folder: str,
    stdout: str,
    stderr: str,
    arguments: list[str] | None = None,
    code: str | None = None,
    drawn: list[str] | None = None,
) -> NoReturn:
    """Run a job as a new interpreter would, and end the process."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(stdout, os.O_WRONLY | os.O_APPEND), 1)
    os.dup2(os.open(stderr, os.O_WRONLY | os.O_APPEND), 2)
    os.chdir(folder)
    os.environ["PYTHONPATH"] = folder
    sys.path[0] = folder  # instead of the folder of this file
    sys.modules["__main__"] = main = types.ModuleType("__main__")
    if code is None:
        sys.warnoptions.clear()  # also of the processes that it starts
        warnings.resetwarnings()
        assert arguments is not None
        sys.argv = ["frenetic", *arguments]
        code = "from frenetic.cli import main; main()"
    else:
        sys.argv = ["-c"]
    from command_line import empty_pictures  # a plug-in of some tests, which pytest imports

    _keep_a_fork_server_ready()
    with nullcontext() if drawn is None else empty_pictures(*drawn):
        ended = _exit_code(code, main)
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(ended)


def _exit_code(code: str, main: types.ModuleType) -> int:
    """Run code and return the exit code that an interpreter would give."""
    try:
        exec(compile(code, "<string>", "exec"), main.__dict__)
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        sys.stderr.write(f"{end.code}\n")
        return 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _keep_a_fork_server_ready() -> None:
    """Fork a copy of this process that becomes the server from which workers are forked.

    The server that multiprocessing starts would load everything again.
    """
    here, there = socket.socketpair()
    server = _fork()
    if server == 0:
        here.close()
        _become_fork_server(there)
    there.close()
    start = util.spawnv_passfds

    def start_with_fork(path: bytes, args: Sequence[Any], passfds: Sequence[int]) -> int:
        code = str(args[-1])
        if "forkserver" not in code or here.fileno() < 0:
            return start(path, args, passfds)
        socket.send_fds(here, [json.dumps([code, list(passfds)]).encode()], list(passfds))
        here.close()
        return server

    util.spawnv_passfds = start_with_fork


def _become_fork_server(requests: socket.socket) -> NoReturn:
    """Run the code of a request, with its files under the numbers that the request names."""
    try:
        data, received, *_ = socket.recv_fds(requests, 1 << 16, 8)
        if data:
            code, wanted = json.loads(data)
            # Numbers that no file of the request uses.
            copies = [os.dup2(file, 500 + i) for i, file in enumerate(received)]
            requests.close()
            for file, number in zip(copies, wanted, strict=True):
                os.dup2(file, number)
                os.close(file)
            for file in set(received) - set(wanted):
                os.close(file)
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # as Frenetic starts it
            exec(code, {})
    except SystemExit:  # the server has ended
        pass
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    _serve()
