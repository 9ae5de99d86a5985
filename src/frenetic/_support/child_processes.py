"""Processes that work for this one: their start, their end, and whose a process is.

A child is killed with all that it has started. It leaves Ctrl-C to its parent and ends with it.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if sys.platform == "linux":
    import fcntl

if TYPE_CHECKING:
    from multiprocessing.context import (  # type: ignore[attr-defined, unused-ignore]
        ForkServerContext,  # not on Windows
        SpawnContext,
    )

LOST_PARENT: Final = 1
"""Exit code of a child whose parent is gone."""
FORKED: Final = 82
"""Exit code of a fork that came out of foreign code."""

_FORKED: Final = "forkserver"
PRELOADED: Final = (
    "frenetic.simulators.embedded.preloading",
    "frenetic.simulators.isolated",
    "frenetic.campaign.workers.local",
)
"""Modules that the server of processes imports, so that these have kernels and code at once."""


# In the parent


def process_context(preloaded: Sequence[str] = ()) -> ForkServerContext | SpawnContext:
    """The way to make processes: on Linux forked in milliseconds from a fully loaded server.

    Elsewhere forking is missing (Windows) or unsafe with the system's libraries (macOS).

    Args:
        preloaded: modules that the server imports beside `PRELOADED` if it does not run yet; it
            leaves out what is missing without a word.
    """
    if platform.system() == "Linux":
        context = multiprocessing.get_context(_FORKED)
        context.set_forkserver_preload([*preloaded, *PRELOADED])
        return context
    return multiprocessing.get_context("spawn")


def start_process(
    context: Any, target: Callable[..., None], *args: object, name: str
) -> tuple[BaseProcess, Connection]:
    """A new process that calls ``target(connection, *args)``, and our end of the connection.

    Raises:
        OSError: there are too many processes.
        EOFError: the server that makes them was killed.
    """
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # not on Windows

        resource_tracker.ensure_running()  # first, since it lets Ctrl-C through again
    sparing: AbstractContextManager[None] = _without_ctrl_c()
    if context.get_start_method() == _FORKED:
        from multiprocessing import forkserver  # not on Windows

        with sparing:
            forkserver.ensure_running()
        sparing = nullcontext()  # it takes a while now, and children get it from their server
    ours, theirs = context.Pipe()
    try:
        process = context.Process(target=target, args=(theirs, *args), name=name)
        with sparing:
            process.start()
    except BaseException:
        ours.close()
        raise
    finally:
        theirs.close()
    return process, ours


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Blocks Ctrl-C for a moment in this thread, and for good in processes started meanwhile."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def kill_process(process: BaseProcess | subprocess.Popen[bytes]) -> None:
    """Kills a child with all that it has started."""
    assert process.pid is not None
    kill_tree(process.pid)
    process.kill()


def kill_tree(process_id: int) -> None:
    """Kills a process with all that it has started.

    On POSIX these are the group that it heads, on Windows its children, theirs and so on, as long
    as it lives.
    """
    if sys.platform == "win32":
        tool = Path(os.environ.get("SYSTEMROOT", r"C:\Windows"), "System32", "taskkill.exe")
        with suppress(OSError):  # there is none
            subprocess.run(  # noqa: S603 - our own numbers
                [str(tool), "/F", "/T", "/PID", str(process_id)], capture_output=True, check=False
            )
    else:
        with suppress(OSError):  # gone already, or not yet a group
            os.killpg(process_id, signal.SIGKILL)


def ending_of(exit_code: int | None) -> str:
    """Words for the end of a child, after "its process"."""
    if exit_code is None:
        return "closed its connection"
    if exit_code < 0:
        with suppress(ValueError):
            return f"was killed by {signal.Signals(-exit_code).name}"
        return f"was killed by signal {-exit_code}"
    return f"ended with exit code {exit_code}"


# In the child


def stand_alone() -> None:
    """Makes this process leave Ctrl-C to its parent and end with it.

    It becomes the head of a group, which can be ended as a whole. What it prints goes to stderr:
    stdout is for the parent's results.
    """
    with suppress(OSError):  # there is none
        os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setsid"):
        with suppress(OSError):  # it is the head of one already
            os.setsid()
    threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()


def _die_with_parent() -> None:
    """Ends this process, and all that it started, when its parent has ended."""
    parent = parent_process()
    if parent is not None:
        _die_with(parent.sentinel)
        wait([parent.sentinel])
        kill_tree(os.getpid())
        os._exit(LOST_PARENT)


def _die_with(pipe: int) -> None:
    """Linux: lets the kernel kill the group when the pipe's other end is closed.

    So it ends even if a driver's compiled code blocks every thread of this process.
    """
    if sys.platform == "linux":
        with suppress(OSError):  # it is the pipe of an emulation, say
            fcntl.fcntl(pipe, fcntl.F_SETOWN, -os.getpid())
            fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)
            fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)


# In both


@contextmanager
def one_process() -> Iterator[None]:
    """Around foreign code: only the process that goes in goes on.

    A fork that comes out is ended at once, without a word to files or parents that it shares.
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
