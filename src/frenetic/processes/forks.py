"""The end of processes that a user's code forks and lets return into ours."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

FORKED: Final = 82
"""Exit code of a process that a user's code forked and that returned from this code."""


@contextmanager
def one_process() -> Iterator[None]:
    """Let only the process that enters the block leave it; put it around a user's code.

    A fork that the code made and that leaves the block is ended at once, before it can write to
    files and connections that it shares with its parent.
    """
    owner = os.getpid()
    try:
        yield
    finally:
        if os.getpid() != owner:
            with suppress(OSError):
                text = f"frenetic: process {os.getpid()} came out of a fork of {owner}: it is ended"
                os.write(2, f"{text}\n".encode())
            os._exit(FORKED)
