"""The keeper of a child on Linux: a process without a user's code between child and parent.

What the child starts stays a descendant of the keeper, whatever session it makes for itself. The
keeper kills it when the child or the parent ends.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import time
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, NoReturn

from frenetic.processes.groups import kill_tree, lead_group

END_LIMIT: Final = 5.0
"""Time that a keeper has to kill all that its child has started, in s (our choice)."""
LOST_PARENT: Final = 1
"""Exit code of a child whose parent has ended."""

if sys.platform == "linux":
    _SET_PARENT_DEATH_SIGNAL: Final = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    _SET_CHILD_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER of linux/prctl.h
    _POLL_INTERVAL: Final = 0.02
    """Time between two looks for processes to kill, in s (our choice)."""
    _OOM_SCORE: Final = "500"
    """Adjustment from -1000 to 1000 by which Linux, short of memory, kills the child first (our
    choice)."""
    _MOST_SIGNALS: Final = 512
    """Largest number of signals, one byte each, that are read at once."""

    def fork_under_keeper(connection: Connection) -> None:
        """Fork: the child process returns, while this process becomes its keeper and never does.

        Args:
            connection: the child's connection to the parent, which the keeper closes.
        """
        parent = parent_process()
        assert parent is not None
        _prctl(_SET_CHILD_SUBREAPER, 1)
        # Signals write their numbers into a pipe, so the keeper can wait for them with `poll`.
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)  # ignored but for the pipe
        keeper = os.getpid()
        child = os.fork()
        if child:
            try:
                connection.close()
                _keep(child, parent.sentinel, reading)
            finally:
                os._exit(LOST_PARENT)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        for descriptor in (reading, writing):
            os.close(descriptor)
        _prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != keeper:  # the keeper ended before the signal was set
            os._exit(LOST_PARENT)
        lead_group()
        with suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE, encoding="ascii")

    def _prctl(option: int, value: int) -> None:
        """Set an attribute of this process; where the kernel refuses, nothing happens."""
        ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), *(ctypes.c_ulong(0),) * 3)

    def _keep(child: int, sentinel: int, signals: int) -> NoReturn:
        """Wait for the end of the child or the parent, kill all that is left, end as the child did.

        Args:
            child: process id.
            sentinel: descriptor that is readable when the parent has ended.
            signals: descriptor from which the numbers of signals are read.
        """
        poller = select.poll()
        for descriptor in (sentinel, signals):
            poller.register(descriptor, select.POLLIN)
        status = None
        while status is None:
            ready = {descriptor for descriptor, _ in poller.poll()}
            received = os.read(signals, _MOST_SIGNALS) if signals in ready else b""
            if sentinel in ready or signal.SIGTERM in received:
                break
            status = _reap(child)
        _kill_descendants(child, signals)
        _end_as(LOST_PARENT if status is None else os.waitstatus_to_exitcode(status))

    def _reap(child: int) -> int | None:
        """Reap all children that have ended; return the status of `child`, None while it runs."""
        status = None
        with suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == child:
                    status = ended[1]
        return status

    def _kill_descendants(child: int, signals: int) -> None:
        """Kill the child's group, and all children of this process until none is left.

        This process is a subreaper: the children of a killed process become its own.
        """
        deadline = time.monotonic() + END_LIMIT
        kill_tree(child)
        while time.monotonic() < deadline:
            for pid in _children():
                with suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            try:
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
            except ChildProcessError:
                return
            if select.select([signals], [], [], _POLL_INTERVAL)[0]:  # a child has ended
                os.read(signals, _MOST_SIGNALS)

    def _children() -> list[int]:
        """Return the ids of this process's children; empty where the kernel does not list them."""
        try:
            listing = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii")
        except OSError:
            return []
        return [int(pid) for pid in listing.split()]

    def _end_as(exit_code: int) -> NoReturn:
        """End this process as the child ended: with an exit code, or by a signal if negative."""
        if exit_code < 0:
            import resource  # not on Windows

            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # no second core dump
            with suppress(OSError):  # some signals cannot be handled
                signal.signal(-exit_code, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {-exit_code})
            os.kill(os.getpid(), -exit_code)
        os._exit(exit_code if exit_code >= 0 else LOST_PARENT)
