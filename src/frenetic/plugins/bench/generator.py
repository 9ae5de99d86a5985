"""The bench's end of a process that runs a generator of the official pipeline."""

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
"""Largest number of bytes kept of a generator's output; our choice."""
MAX_MESSAGE_SIZE: Final = 32 * 1024 * 1024
"""Largest number of bytes of a line that the process sends; our choice.

A longer line is cut, so it is no JSON object.
"""

_CLOSING_TIMEOUT: Final = 2.0  # [s] for a thread, or for the process once it closed its connection
_POLL_INTERVAL: Final = 0.5  # [s] between two checks whether the process has ended
_LOG_CHUNK: Final = 65536  # [bytes]
_LOG_CUT: Final = b"\n[the rest is left out]\n"


class GeneratorLostError(Exception):
    """The process has ended, or sent a line that is no JSON object."""


class GeneratorProcess:
    """A process that runs a generator; a context manager that ends it and all that it started.

    Both sides send JSON objects, a line each. The generator's output goes into a file.

    Args:
        assignment: the generator and its terms, the first message to the process, as
            `frenetic.plugins.bench.runs.assignment` returns it.
        folder: the working directory of the generator, made if need be.
        log: file for what the generator prints; the process sends it as stderr.
        python: the interpreter; by default the one that runs this.
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
            OSError: the process cannot be started.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        seed = str(self._assignment["seed"])
        # Not resolved: the interpreter of a virtual environment must stay a link.
        python = sys.executable if self._python is None else str(self._python.absolute())
        new_group: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            new_group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        self._process = subprocess.Popen(  # noqa: S603 - the user's own interpreter, no shell
            [python, "-u", str(HOST)],
            cwd=self._folder,
            env=ONE_THREAD | os.environ | {"PYTHONHASHSEED": seed, SEED_VARIABLE: seed},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            **new_group,
        )
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._threads = [
            threading.Thread(target=target, args=(stream,), daemon=True)
            for target, stream in (
                (self._queue_lines, self._process.stdout),
                (self._log_output, self._process.stderr),
            )
        ]
        for thread in self._threads:
            thread.start()
        with suppress(GeneratorLostError):  # `receive` raises it, with all that came before
            self.send(self._assignment)
        return self

    def __exit__(self, *_: object) -> None:
        """End the process and the rest of its group."""
        # Not yet waited for, so no other process can have taken its id, and with it the group.
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
            GeneratorLostError: the process has ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise GeneratorLostError(self._end_text()) from error

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
            raise GeneratorLostError(self._end_text())
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
        keep the connection open.
        """
        deadline = time.monotonic() + timeout
        while True:
            # Checked before the wait, in which lines from before the end still arrive.
            has_ended = self._process.poll() is not None
            remaining = deadline - time.monotonic()
            try:
                return self._lines.get(timeout=max(0.0, min(remaining, _POLL_INTERVAL)))
            except queue.Empty:
                if has_ended:
                    return b""
                if remaining <= _POLL_INTERVAL:
                    return None

    def _queue_lines(self, stream: IO[bytes]) -> None:
        """Queue the lines of a stream, then an empty line; close the stream."""
        with suppress(OSError, ValueError), stream:
            while line := stream.readline(MAX_MESSAGE_SIZE):
                self._lines.put(line)
        self._lines.put(b"")

    def _log_output(self, stream: IO[bytes]) -> None:
        """Write a stream into the log, up to `MAX_LOG_SIZE`; read it to its end and close it."""
        room = MAX_LOG_SIZE
        with suppress(OSError, ValueError), stream, self._log.open("wb", buffering=0) as file:
            while data := stream.read1(_LOG_CHUNK):  # type: ignore[attr-defined]
                if room > 0:
                    file.write(data if len(data) < room else data[:room] + _LOG_CUT)
                room -= len(data)

    def _end_text(self) -> str:
        """Return how the process ended, in words; a process about to end is waited for, 2 s."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_CLOSING_TIMEOUT)
        return f"its process {ending_of(self._process.returncode)}"
