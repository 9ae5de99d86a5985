"""The connection with the parent process."""

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
