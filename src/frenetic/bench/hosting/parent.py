"""The process that has started this one, and how to talk with it."""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from contextlib import suppress
from typing import BinaryIO, Final, NoReturn

from frenetic.bench.hosting.messages import Message

ORPHANED: Final = 3
"""Exit code when the parent is gone."""

_PR_SET_PDEATHSIG: Final = 1  # of linux/prctl.h


class Parent:
    """Sends and receives JSON objects, a line each.

    When the parent is gone this process ends at once: there is nobody to run a generator for.

    Args:
        incoming: what the parent sends.
        outgoing: what it is sent.

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
            # Nothing stays in the buffer, which a process that the generator forks would have, too.
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
        """Whether it has said something that was not received yet."""
        return not self._received.empty()

    def _read(self) -> None:
        try:
            for line in self._incoming:
                self._received.put(json.loads(line))
        finally:
            leave()


def leave() -> NoReturn:
    """End this process and, if it leads its group, what the generator has started in that."""
    if sys.platform != "win32" and os.getpgrp() == os.getpid():
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(ORPHANED)


def leave_with_parent() -> None:
    """Leave when the parent has ended, even while the generator lets no other thread run.

    To be called by the main thread. It is for a generator that keeps the lock of the interpreter,
    as a regular expression does that goes back and forth without end: that looks for signals,
    while the thread that reads what the parent sends waits. It does nothing but on Linux.
    """
    if sys.platform != "linux":
        return
    parent = os.getppid()

    def leave_if_orphaned(_: int, __: object) -> None:
        if os.getppid() != parent:  # it was not just the thread that has started this process
            leave()

    with suppress(Exception):  # the reading thread will notice
        import ctypes  # which not every Python has

        # Not SIGKILL, which would come before anybody could end the group.
        signal.signal(signal.SIGRTMIN, leave_if_orphaned)
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGRTMIN))
