"""The process that has started this one, and how to talk with it."""

from __future__ import annotations

import json
import os
import queue
import threading
from collections.abc import Mapping
from typing import Any, BinaryIO, Final, NoReturn

ORPHANED: Final = 3
"""Exit code when the parent is gone."""

Message = Mapping[str, Any]


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
            _leave()

    def receive(self) -> Message:
        """Return the next object, waiting for it."""
        return self._received.get()

    def ask(self, message: Message) -> Message:
        """Send an object and return the answer.

        If the parent has said something unasked, that is the answer and nothing is sent: it says
        so when the budget is over.
        """
        try:
            return self._received.get_nowait()
        except queue.Empty:
            self.send(message)
            return self.receive()

    def _read(self) -> None:
        try:
            for line in self._incoming:
                self._received.put(json.loads(line))
        finally:
            _leave()


def _leave() -> NoReturn:
    os._exit(ORPHANED)
