"""A generator of the official pipeline in its own process."""

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
from frenetic.plugins.competition import SEED
from frenetic.processes.children import ending_of, kill_process

HOST: Final = Path(__file__).with_name("host.py")
"""The script of the process."""
ONE_THREAD: Final = {"OMP_NUM_THREADS": "1"}
"""For torch, BLAS and the like, unless the user sets another number: runs have the other cores."""
MOST_LOGGED: Final = 10 * 1024 * 1024
"""Most bytes kept of a generator's output."""
LONGEST_MESSAGE: Final = 32 * 1024 * 1024
"""Bytes of a message."""

_LEAVING_LIMIT: Final = 2.0  # s
_LOOK: Final = 0.5  # s between two looks whether the process is there
_LEFT_OUT: Final = b"\n[the rest is left out]\n"


class GeneratorLostError(Exception):
    """The process has ended without a message, or sent nonsense."""


class GeneratorProcess:
    """A process that runs a generator; a context manager that ends it and all that it started.

    Both sides send JSON objects, a line each. The generator's output goes into a file.

    Args:
        assignment: the generator and its terms; the first message to the process.
        folder: the working directory of the generator, made if need be.
        log: file for what it prints.
        python: the interpreter; by default the one that runs this.
    """

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
        self._received: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        """Start the process.

        Raises:
            OSError: it cannot be started.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        seed = str(self._assignment["seed"])
        # Not resolved: the interpreter of a virtual environment must stay a link.
        python = sys.executable if self._python is None else str(self._python.absolute())
        own_group: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            own_group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        self._process = subprocess.Popen(  # noqa: S603 - the user's own interpreter, no shell
            [python, "-u", str(HOST)],
            cwd=self._folder,
            env=ONE_THREAD | os.environ | {"PYTHONHASHSEED": seed, SEED: seed},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            **own_group,
        )
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._threads = [
            threading.Thread(target=target, args=(stream,), daemon=True)
            for target, stream in (
                (self._read, self._process.stdout),
                (self._keep, self._process.stderr),
            )
        ]
        for thread in self._threads:
            thread.start()
        with suppress(GeneratorLostError):  # `receive` will find out
            self.send(self._assignment)
        return self

    def __exit__(self, *_: object) -> None:
        """End the process and the rest of its group."""
        # The process id stays taken until it is waited for, so the group is surely its own.
        kill_process(self._process)
        self._process.wait()
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        for thread in self._threads:
            # A process outside the group may keep a stream open for ever.
            thread.join(_LEAVING_LIMIT)

    def send(self, message: Mapping[str, Any]) -> None:
        """Send an object.

        Raises:
            GeneratorLostError: the process has gone.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise GeneratorLostError(self._ending()) from error

    def receive(self, timeout: float) -> dict[str, Any] | None:
        """Return the next object; None if none comes within so many s.

        Raises:
            GeneratorLostError: the process has gone or sent something else.
        """
        line = self._received_line(timeout)
        if line is None:
            return None
        if not line:
            self._received.put(line)
            raise GeneratorLostError(self._ending())
        try:
            message = read_json(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            raise GeneratorLostError("its process sent what is no message")
        return message

    def _received_line(self, timeout: float) -> bytes | None:
        """Return the next line, empty if there are no more; None if none comes in time."""
        deadline = time.monotonic() + timeout
        while True:
            # A forked child may keep the connection open after the process has ended.
            has_ended = self._process.poll() is not None
            left = deadline - time.monotonic()
            try:
                return self._received.get(timeout=max(0.0, min(left, _LOOK)))
            except queue.Empty:
                if has_ended:
                    return b""
                if left <= _LOOK:
                    return None

    def _read(self, stream: IO[bytes]) -> None:
        """Passes lines on, closes the stream; an empty line marks the end."""
        with suppress(OSError, ValueError), stream:
            while line := stream.readline(LONGEST_MESSAGE):
                self._received.put(line)
        self._received.put(b"")

    def _keep(self, stream: IO[bytes]) -> None:
        """Write the generator's output into its file, up to a limit, and close the stream."""
        room = MOST_LOGGED
        with suppress(OSError, ValueError), stream, self._log.open("wb", buffering=0) as file:
            while data := stream.read1(65536):  # type: ignore[attr-defined]
                if room > 0:
                    file.write(data if len(data) < room else data[:room] + _LEFT_OUT)
                room -= len(data)

    def _ending(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING_LIMIT)
        return f"its process {ending_of(self._process.returncode)}"
