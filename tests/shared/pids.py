"""Which processes are there, by their ids; what is started in a test is ended by it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LIMIT = 120.0
"""s that a test waits at most for what should happen soon."""


def is_running(pid: int) -> bool:
    """Whether there is such a process, other than one that has ended and was not asked how."""
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
    """Ids of the processes that a process has started; empty where there is no /proc."""
    found: list[int] = []
    for listing in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += [int(child) for child in listing.read_text().split()]
    return found


def descendants(pid: int) -> list[int]:
    """Ids of its children, of theirs and so on."""
    found = children(pid)
    for child in found:
        found += descendants(child)
    return found


def until(condition: Callable[[], object], what: str) -> None:
    """Waits until a condition holds; fails if that takes too long."""
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"waited for {LIMIT:g} s: {what}"
        time.sleep(0.002)


def until_gone(pids: Iterable[int]) -> None:
    """Waits until none of these processes runs."""
    left = set(pids)

    def gone() -> bool:
        left.difference_update([pid for pid in left if not is_running(pid)])
        return not left

    until(gone, "processes end")


@contextmanager
def ending(pids: Callable[[], Iterable[int]]) -> Iterator[None]:
    """Ends the processes that are left, whatever happened."""
    try:
        yield
    finally:
        for pid in pids():
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
