"""The process of a BeamNG.tech that is started here."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Final

from frenetic.processes.groups import kill_tree

LOOPBACK: Final = "127.0.0.1"
"""Address of this machine."""
QUIT_LIMIT: Final = 10.0
"""Time that BeamNG.tech has to end when asked, and again when forced, in s; our choice."""


@contextmanager
def child_deaf_to_interrupt() -> Iterator[None]:
    """Let processes that are started within ignore Ctrl-C, so that a drive is finished."""
    is_main = threading.current_thread() is threading.main_thread()
    if sys.platform == "win32" or not is_main:  # only a POSIX main thread can set a signal handler
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def end_process(process: subprocess.Popen[bytes]) -> None:
    """End a process that was started here, even if it hangs."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    # First it may end by itself. On Windows its children would outlive it: they are killed, too.
    kill_children_too = partial(kill_tree, process.pid)
    is_windows = sys.platform == "win32"
    means = (None, kill_children_too) if is_windows else (None, process.terminate, process.kill)
    for end in means:
        if end is not None:
            end()
        with suppress(subprocess.TimeoutExpired):
            process.wait(QUIT_LIMIT)
            return


def free_port() -> int:
    """Return a port of this machine that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
