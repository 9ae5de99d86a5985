"""Commands and code that run in processes of their own, yet at once.

A process imports Frenetic and loads its kernels once. Whatever is to run gets a fork of it, so that
nothing leaks from one to the next. It ends as an interpreter of its own does, but without freeing
what it has loaded, which takes longer than most jobs.
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

# What takes long to import and Frenetic imports where it needs it.
LOADED = (
    "command_line",
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "rich.live",
    "scipy.cluster.hierarchy",
    "scipy.interpolate",
    "scipy.stats",
)
# Of ours: what few commands need and makes forking slow.
LEFT_OUT = {"__main__", "beamng", "dask", "metadrive", "metrics", "standins", "tables"}


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    """Its exit code; minus the signal's number if one ended it."""
    stdout: str
    """What it wrote to stdout."""
    stderr: str
    """What it wrote to stderr."""

    @property
    def output(self) -> str:
        """All that it wrote."""
        return self.stdout + self.stderr


class Interpreter:
    """Runs each job in an interpreter that is started for it; works everywhere."""

    def frenetic(self, *arguments: str, folder: Path, drawn: Iterable[str] | None = None) -> Ended:
        """Runs a command line of Frenetic in a folder; pictures but the drawn may be empty."""
        names = None if drawn is None else list(drawn)
        return self._run({"arguments": arguments, "drawn": names}, folder)

    def python(self, code: str, *, folder: Path) -> Ended:
        """Runs code in a folder as `python -W error -c` does; files of the folder are modules."""
        return self._run({"code": code}, folder)

    def close(self) -> None:
        """Ends what it has started."""

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
    """Runs each job in a fork of an interpreter that has started before."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        """Ends it."""
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
    """Runs command lines and code in processes of their own.

    One that is warm takes as long to start as a handful of jobs: it pays for heavy tests only.
    """
    is_warm = sys.platform == "linux" and pytestconfig.getoption("--all")
    one = WarmInterpreter() if is_warm else Interpreter()
    yield one
    one.close()


def load_kernels() -> None:
    """Drives and judges a road, so that everything compiled is there."""
    from frenetic import EmbeddedSimulator, Planner, Road, judge

    road, verdict = Road([0.0, 0.01, -0.01, 0.0]).placed()
    assert road is not None
    assert verdict.valid
    judge(road, EmbeddedSimulator().drive(road, Planner()))


def _serve() -> None:
    """Forks for each line of stdin, which holds a job, and answers with its exit code."""
    gc.set_threshold(50_000)  # as the command line does
    ours = [module.name for module in pkgutil.walk_packages(frenetic.__path__, "frenetic.")]
    for name in (*LOADED, *(name for name in ours if not set(name.split(".")) & LEFT_OUT)):
        importlib.import_module(name)
    load_kernels()
    gc.collect()
    gc.freeze()  # or each fork would look through all of this when it ends
    for line in sys.stdin:
        child = _fork()
        if child == 0:
            _do(**json.loads(line))
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        sys.stdout.flush()


def _fork() -> int:
    with warnings.catch_warnings():
        # Python 3.12 warns of threads; those of the linear algebra library are idle.
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
    """Becomes what an interpreter that was started for this job would be."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(stdout, os.O_WRONLY | os.O_APPEND), 1)
    os.dup2(os.open(stderr, os.O_WRONLY | os.O_APPEND), 2)
    os.chdir(folder)
    os.environ["PYTHONPATH"] = folder
    sys.path[0] = folder  # instead of this file's
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
    """Runs code; with what an interpreter would end."""
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
    """Lets a fork of this process, as it is now, be the server from which workers are forked.

    The interpreter that multiprocessing starts for it would load everything anew.
    """
    ours, theirs = socket.socketpair()
    server = _fork()
    if server == 0:
        ours.close()
        _become_fork_server(theirs)
    theirs.close()
    start = util.spawnv_passfds

    def start_with_fork(path: bytes, args: Sequence[Any], passfds: Sequence[int]) -> int:
        code = str(args[-1])
        if "forkserver" not in code or ours.fileno() < 0:
            return start(path, args, passfds)
        socket.send_fds(ours, [json.dumps([code, list(passfds)]).encode()], list(passfds))
        ours.close()
        return server

    util.spawnv_passfds = start_with_fork


def _become_fork_server(asked: socket.socket) -> NoReturn:
    """Runs the code that comes, with the files that come under the same numbers as there."""
    try:
        data, got, *_ = socket.recv_fds(asked, 1 << 16, 8)
        if data:
            code, wanted = json.loads(data)
            out_of_the_way = [os.dup2(file, 500 + i) for i, file in enumerate(got)]
            asked.close()
            for file, number in zip(out_of_the_way, wanted, strict=True):
                os.dup2(file, number)
                os.close(file)
            for file in set(got) - set(wanted):
                os.close(file)
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # as Frenetic starts it
            exec(code, {})
    except SystemExit:  # its end
        pass
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    _serve()
