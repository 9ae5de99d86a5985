"""Runs a road generator (an entrant of the bench) in a process and exchanges messages with it."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final, Self

from frenetic._support.outside_text import read_json
from frenetic.plugins.competition import SEED_VARIABLE
from frenetic.processes.children import ending_of, kill_process

HOST: Final = Path(__file__).with_name("host.py")
"""The script that the process runs."""
ONE_THREAD: Final = {"OMP_NUM_THREADS": "1"}
"""Environment that keeps torch, BLAS and the like to one core, since runs share the cores.

Variables that the user has set win.
"""
MAX_LOG_SIZE: Final = 10 * 1024 * 1024
"""Largest number of bytes that the log keeps of a generator's output; our choice."""
MAX_MESSAGE_SIZE: Final = 32 * 1024 * 1024
"""Largest number of bytes of a line that the process sends; our choice.

A longer line is cut, so it is no JSON object.
"""

_CLOSING_TIMEOUT: Final = 2.0  # [s] for a thread, or for the process once it closed its connection
_POLL_INTERVAL: Final = 0.5  # [s] between two checks whether the process has ended
_EXIT_POLL_INTERVAL: Final = 0.01  # [s] between checks of a process about to end; our choice
_LOG_CHUNK: Final = 65536  # [bytes]
_LOG_CUT: Final = b"\n[the rest is left out]\n"


class GeneratorLostError(Exception):
    """A generator's process has ended, or broke the protocol: a line is no JSON object."""


class GeneratorProcess:
    """A process that runs a generator; a context manager that kills it with all that it started.

    A generator is a class of the official pipeline, written by an entrant, that makes roads. Both
    sides send JSON objects, a line each; `frenetic.plugins.bench.host` lists them. The generator's
    output goes into a file.

    Args:
        assignment: the generator and its terms, the first message to the process, as
            `frenetic.plugins.bench.runs.assignment` returns it.
        folder: the working directory of the generator, created if it does not exist.
        log: file for what the generator prints; the process sends it as stderr.
        python: the interpreter; by default the one that runs this code.
    """

    _process: subprocess.Popen[bytes]
    _threads: list[threading.Thread]

    def __init__(
        self,
        assignment: Mapping[str, Any],
        *,
        folder: Path,
        log: Path,
        python: Path | None = None,
    ) -> None:
        self._assignment = assignment
        self._folder = folder
        self._log = log
        self._python = python
        # Lines from the process; an empty one says that there are no more.
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        """Start the process.

        Raises:
            OSError: the folder or the log cannot be written, or the process cannot be started.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        seed = str(self._assignment["seed"])
        # Not resolved: the interpreter of a virtual environment must stay a link.
        python = sys.executable if self._python is None else str(self._python.absolute())
        new_group: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            new_group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        log = self._log.open("wb", buffering=0)
        try:
            self._process = subprocess.Popen(  # noqa: S603 - the user's own interpreter, no shell
                [python, "-u", str(HOST)],
                cwd=self._folder,
                env=ONE_THREAD | os.environ | {"PYTHONHASHSEED": seed, SEED_VARIABLE: seed},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                **new_group,
            )
        except BaseException:
            log.close()
            raise
        stdout, stderr = self._process.stdout, self._process.stderr
        assert stdout is not None
        assert stderr is not None
        self._threads = [
            threading.Thread(target=self._queue_lines, args=(stdout,), daemon=True),
            threading.Thread(target=_log_output, args=(stderr, log), daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        with suppress(GeneratorLostError):  # `receive` raises it, with all that came before
            self.send(self._assignment)
        return self

    def __exit__(self, *_: object) -> None:
        """Kill the process and the rest of its group."""
        # `_exit_code` has not reaped the process, so no other process has its id or its group's.
        kill_process(self._process)
        self._process.wait()
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        for thread in self._threads:
            # A process outside the group may keep a stream open for ever.
            thread.join(_CLOSING_TIMEOUT)

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a JSON object.

        Raises:
            GeneratorLostError: the process has ended, or closed its connection.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise GeneratorLostError(self._loss_reason()) from error

    def receive(self, timeout: float) -> dict[str, Any] | None:
        """Return the next JSON object; None if none comes within ``timeout`` s.

        Raises:
            GeneratorLostError: the process has ended, or sent a line that is no JSON object.
        """
        line = self._next_line(timeout)
        if line is None:
            return None
        if not line:
            self._lines.put(line)  # for the next call
            raise GeneratorLostError(self._loss_reason())
        try:
            message = read_json(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            raise GeneratorLostError("its process sent a line that is no JSON object")
        return message

    def _next_line(self, timeout: float) -> bytes | None:
        """Return the next line, empty if there are no more; None if none comes in time.

        The end of the process counts as the end of the lines, too: a child that it has forked may
        keep the connection open. Therefore the wait has slices of `_POLL_INTERVAL`, before each of
        which the process is checked; the last slice is what remains of the time.
        """
        deadline = time.monotonic() + timeout
        while True:
            # Checked before the slice, in which lines from before the end still arrive.
            has_ended = self._exit_code() is not None
            remaining = deadline - time.monotonic()
            try:
                return self._lines.get(timeout=max(0.0, min(remaining, _POLL_INTERVAL)))
            except queue.Empty:
                if has_ended:
                    return b""
                if remaining <= _POLL_INTERVAL:  # this was the last slice
                    return None

    def _queue_lines(self, stream: IO[bytes]) -> None:
        """Queue the lines of a stream, then an empty line; close the stream."""
        with suppress(OSError, ValueError), stream:
            while line := stream.readline(MAX_MESSAGE_SIZE):
                self._lines.put(line)
        self._lines.put(b"")

    def _loss_reason(self) -> str:
        """Return how the process ended, in words; wait up to 2 s if it is about to end."""
        deadline = time.monotonic() + _CLOSING_TIMEOUT
        while (exit_code := self._exit_code()) is None and time.monotonic() < deadline:
            time.sleep(_EXIT_POLL_INTERVAL)
        return f"its process {ending_of(exit_code)}"

    def _exit_code(self) -> int | None:
        """Return the exit code as `subprocess.Popen` gives it; None while the process runs.

        Linux keeps the id of a process until the process is reaped. Popen would reap it, and then
        `__exit__` might kill a stranger's group; so the exit code is read without that. On macOS
        Python 3.11 cannot do so: there the id stays taken only while a member of the group lives.
        """
        if sys.platform != "linux":
            return self._process.poll()
        if self._process.returncode is not None:
            return self._process.returncode
        flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
        try:
            end = os.waitid(os.P_PID, self._process.pid, flags)
        except ChildProcessError:  # reaped by the system, since this process ignores SIGCHLD
            return self._process.poll()
        if end is None:
            return None
        return end.si_status if end.si_code == os.CLD_EXITED else -end.si_status


def _log_output(stream: IO[bytes], log: IO[bytes]) -> None:
    """Write a stream into a log, up to `MAX_LOG_SIZE`; read it to its end and close both.

    The stream is read on where the log is full or the disk is: a generator that prints into a
    closed stream would break.
    """
    room = MAX_LOG_SIZE
    with suppress(OSError, ValueError), stream, log:
        while data := stream.read1(_LOG_CHUNK):  # type: ignore[attr-defined]
            if room > 0:
                with suppress(OSError):
                    log.write(data if len(data) < room else data[:room] + _LOG_CUT)
            room -= len(data)
