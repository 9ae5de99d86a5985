"""Process ids: which processes run, and how a test ends the processes that it started."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LIMIT = 120.0
"""Seconds that a test waits at most for something that should happen soon."""


def is_running(pid: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    with suppress(OSError):  # where there is no /proc
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state not in ("Z", "X")
    return True


def children(pid: int) -> list[int]:
    """Return the ids of a process's children; empty where there is no /proc."""
    ids: list[int] = []
    for listing in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            ids += [int(child) for child in listing.read_text().split()]
    return ids


def descendants(pid: int) -> list[int]:
    """Return the ids of a process's children, grandchildren and so on."""
    ids = children(pid)
    for child in ids:
        ids += descendants(child)
    return ids


def until(condition: Callable[[], object], event: str) -> None:
    """Wait until a condition holds; fail, with the name of the event, after `LIMIT` seconds."""
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"waited for {LIMIT:g} s: {event}"
        time.sleep(0.002)


def until_gone(pids: Iterable[int]) -> None:
    """Wait until none of these processes runs."""
    left = set(pids)

    def gone() -> bool:
        left.difference_update([pid for pid in left if not is_running(pid)])
        return not left

    until(gone, "processes end")


@contextmanager
def ending(pids: Callable[[], Iterable[int]]) -> Iterator[None]:
    """Kill these processes at the end, also after an error."""
    try:
        yield
    finally:
        for pid in pids():
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
