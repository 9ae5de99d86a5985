"""Messages between the bench and a generator's process: JSON objects, a line each.

The process sends and receives them by its `Parent`, the bench by its `GeneratorProcess`.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, Final, NoReturn

Message = Mapping[str, Any]

ORPHANED: Final = 3
"""Exit code when the parent is gone."""

_PR_SET_PDEATHSIG: Final = 1  # of linux/prctl.h


@dataclass(frozen=True)
class Assignment:
    """A generator and its terms: the bench's first message."""

    module: str
    """``package.module``, or a file whose name ends with ``.py``."""
    class_name: str
    path: str | None
    """Folder that is put on the module path."""
    pipeline: str | None
    """Folder with the pipeline's own modules; None for a generator that comes without them."""
    seed: int
    """Seed of `random` and of numpy's global generator."""
    map_size: float
    """Map size in m, as an integer if it is a whole number."""
    time_budget: float
    """Budget in virtual s."""
    seconds_per_test: float
    """Virtual s that every executed test costs."""
    oob_tolerance: float
    """Share 0..1 of the car that may be outside the lane."""
    speed_limit: float
    """km/h."""
    result_folder: str

    @property
    def is_file(self) -> bool:
        """Whether the module is given as a file."""
        return self.module.endswith(".py")


@dataclass(frozen=True)
class Answer:
    """Result of a test that the generator asked for."""

    outcome: str
    """PASS, FAIL, ERROR or INVALID."""
    description: str
    records: list[Any]
    """Record of the drive: rows with the values of `SimulationDataRecord`."""
    spent: float
    """Virtual s of the budget so far."""

    @property
    def is_executed(self) -> bool:
        """Whether it cost a simulation."""
        return self.outcome != "INVALID"


@dataclass(frozen=True)
class End:
    """End of a generator: its process's last message."""

    how: str
    """``over``: the budget was spent; ``returned`` or ``exit``, of its process: by itself before
    that; ``crashed``: it raised."""
    detail: str = ""
    """One line."""
    seconds: float = 0.0
    """Wall time since ``start`` was called or the bench last got any, in s."""
    kind: str = "end"
    """Kind of the message."""


class Parent:
    """Sends and receives JSON objects, a line each.

    This process ends as soon as its parent has gone.

    Args:
        incoming: the stream from the parent.
        outgoing: the stream to the parent.

    """

    def __init__(self, incoming: BinaryIO, outgoing: BinaryIO) -> None:
        self._incoming = incoming
        self._outgoing = outgoing
        self._received: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._read, name="frenetic bench", daemon=True)
        """Receives."""
        self.thread.start()

    def send(self, message: Message) -> None:
        """Send an object."""
        try:
            self._outgoing.write(json.dumps(message).encode() + b"\n")
            # The buffer stays empty, since a process that the generator forks would inherit it.
            self._outgoing.flush()
        except OSError:
            leave()

    def receive(self) -> Message:
        """Return the next object, waiting for it."""
        return self._received.get()

    def ask(self, message: Message) -> Message:
        """Send an object and return the answer."""
        self.send(message)
        return self.receive()

    @property
    def has_spoken(self) -> bool:
        """Whether a message waits."""
        return not self._received.empty()

    def _read(self) -> None:
        try:
            for line in self._incoming:
                self._received.put(json.loads(line))
        finally:
            leave()


def leave() -> NoReturn:
    """End this process and, if it leads its group, all that the generator started there."""
    if sys.platform != "win32" and os.getpgrp() == os.getpid():
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(ORPHANED)


def leave_with_parent() -> None:
    """End with the parent, even while the generator lets no other thread run.

    Call it in the main thread. It helps against a generator that keeps the interpreter's lock, such
    as an endless regular expression: that handles signals, while the reading thread waits. It only
    works on Linux.
    """
    if sys.platform != "linux":
        return
    parent = os.getppid()

    def leave_if_orphaned(_: int, __: object) -> None:
        if os.getppid() != parent:  # it was not just the thread that has started this process
            leave()

    with suppress(Exception):  # the reading thread will notice
        import ctypes  # which not every Python has

        # Not SIGKILL, which would leave the group running.
        signal.signal(signal.SIGRTMIN, leave_if_orphaned)
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGRTMIN))
