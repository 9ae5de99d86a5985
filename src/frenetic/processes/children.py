"""Child processes: their start, their end, and the signals that reach them.

A child is killed with all that it has started. It leaves Ctrl-C to its parent and ends when its
parent ends. On Linux it runs under a keeper, see `frenetic.processes.keeper`.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any, Final

from frenetic.processes.groups import kill_tree, lead_group
from frenetic.processes.interrupt import ENDING
from frenetic.processes.keeper import END_LIMIT, LOST_PARENT

if sys.platform == "linux":
    from frenetic.processes.keeper import fork_under_keeper

if TYPE_CHECKING:
    from multiprocessing.context import (  # type: ignore[attr-defined, unused-ignore]
        ForkServerContext,  # not on Windows
        SpawnContext,
    )

_FORK_SERVER: Final = "forkserver"
"""Name of the method by which a server forks processes."""
_SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Environment variable by which Python does not look for modules in the current folder."""
_SET_BY_US: Final = "frenetic"
"""Value of that variable if we have set it: any text will do."""
PRELOADED: Final = (
    "frenetic.simulators.embedded.preloading",
    "frenetic.campaign.workers.local",
)
"""Modules that the server of processes imports, so that its forks need not import them."""


# In the parent


def process_context(preloaded: Sequence[str] = ()) -> ForkServerContext | SpawnContext:
    """Return the context in which processes are started.

    On Linux they are forked in milliseconds from a server that has loaded our code. Elsewhere
    forking is missing (Windows) or unsafe with the system's libraries (macOS), and they start anew.

    Args:
        preloaded: modules that the server imports beside `PRELOADED` unless it runs already;
            modules that are not installed are left out silently.
    """
    if platform.system() == "Linux":
        context = multiprocessing.get_context(_FORK_SERVER)
        context.set_forkserver_preload([*preloaded, *PRELOADED])
        return context
    return multiprocessing.get_context("spawn")


def start_process(
    context: Any, target: Callable[..., None], *args: object, name: str
) -> tuple[BaseProcess, Connection]:
    """Start a process that calls ``target(connection, *args)``; return it and our connection.

    The process leaves Ctrl-C to this process. End it by `kill_process`.

    Raises:
        OSError: there are too many processes.
        EOFError: the server that makes them was killed.
    """
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # not on Windows

        # First, since starting the tracker unblocks Ctrl-C. It ignores all signals but SIGHUP.
        with _shielded({signal.SIGHUP}):
            resource_tracker.ensure_running()
    shield: AbstractContextManager[None] = _shielded({signal.SIGINT, *ENDING})
    if context.get_start_method() == _FORK_SERVER:
        from multiprocessing import forkserver  # not on Windows

        with shield:
            forkserver.ensure_running()
        # The server's forks inherit its shield. A start may take a while, so Ctrl-C is let through.
        shield = nullcontext()
    connection, child_connection = context.Pipe()
    try:
        process = context.Process(
            target=_run_alone, args=(child_connection, target, *args), name=name
        )
        with shield:
            process.start()
    except BaseException:
        connection.close()
        raise
    finally:
        child_connection.close()
    return process, connection


@contextmanager
def _shielded(signals: Set[signal.Signals]) -> Iterator[None]:
    """Shield processes that start in the block from signals, and from files of the current folder.

    A closed terminal signals its whole group, and a file ``random.py`` in the current folder would
    take the place of Python's own module. In the block the signals are blocked in this thread, too.
    """
    if sys.platform == "win32":
        yield
        return
    is_unset = _SAFE_PATH not in os.environ
    if is_unset:
        os.environ[_SAFE_PATH] = _SET_BY_US
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_unset:
            del os.environ[_SAFE_PATH]


def kill_process(process: BaseProcess | subprocess.Popen[bytes]) -> None:
    """Kill a child with all that it has started."""
    assert process.pid is not None
    if sys.platform == "linux" and isinstance(process, BaseProcess):
        process.terminate()  # the process is the keeper, which kills the child and what it started
        with suppress(OSError):  # the process has ended
            os.kill(process.pid, signal.SIGCONT)  # since a driver may have stopped it
        process.join(END_LIMIT)
    kill_tree(process.pid)
    process.kill()


def ending_of(exit_code: int | None) -> str:
    """Return how a child ended, to follow "its process": ``ended with exit code 1``."""
    if exit_code is None:
        return "closed its connection"
    if exit_code < 0:
        with suppress(ValueError):
            return f"was killed by {signal.Signals(-exit_code).name}"
        return f"was killed by signal {-exit_code}"
    return f"ended with exit code {exit_code}"


# In the child


def _run_alone(connection: Connection, target: Callable[..., None], *args: object) -> None:
    """Call the target in a process that leaves Ctrl-C to its parent and ends with it.

    What the process prints goes to stderr: stdout is for the parent's results.
    """
    with suppress(OSError):  # there is no stderr
        os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.environ.get(_SAFE_PATH) == _SET_BY_US:
        del os.environ[_SAFE_PATH]
    lead_group()
    if sys.platform != "win32":
        # The child heads a group now, so it no longer gets the signals of the parent's group.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    _leave_servers()
    if sys.platform == "linux":
        fork_under_keeper(connection)
    else:
        threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()
    target(connection, *args)


def _leave_servers() -> None:
    """Close the pipes to the parent's servers of processes and resources.

    The child needs neither server, and anything that a driver writes to the pipes would end them. A
    driver that starts processes gets servers of its own.
    """
    if sys.platform != "win32":
        from multiprocessing import forkserver, resource_tracker  # not on Windows

        servers: tuple[tuple[Any, str], ...] = (
            (resource_tracker._resource_tracker, "_fd"),
            (forkserver._forkserver, "_forkserver_alive_fd"),
        )
        for server, name in servers:
            if (descriptor := getattr(server, name, None)) is not None:
                setattr(server, name, None)
                with suppress(OSError):
                    os.close(descriptor)


def _die_with_parent() -> None:
    """End this process, and all that it started, when its parent has ended."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        kill_tree(os.getpid())
        os._exit(LOST_PARENT)
