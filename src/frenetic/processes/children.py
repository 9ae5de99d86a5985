"""Child processes: their start, their end, and the signals that reach them.

A child is killed with all that it has started. It leaves Ctrl-C to its parent and ends with it.
On Linux it runs under a keeper, a process without foreign code between it and its parent: what the
child starts stays the keeper's descendant, whatever session it makes for itself, and is killed when
the child or the parent ends.
"""

from __future__ import annotations

import ctypes
import mmap
import multiprocessing
import os
import platform
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from multiprocessing import parent_process, reduction
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

from frenetic.processes.interrupt import ENDING

if TYPE_CHECKING:
    from multiprocessing.context import (  # type: ignore[attr-defined, unused-ignore]
        ForkServerContext,  # not on Windows
        SpawnContext,
    )

END_LIMIT: Final = 5.0
"""Time that a child's keeper has to kill all that the child has started, in s (ours)."""
LOST_PARENT: Final = 1
"""Exit code of a child whose parent is gone."""
FORKED: Final = 82
"""Exit code of a fork that came out of foreign code."""

_FORKED: Final = "forkserver"
_SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Variable by which Python does not look for modules in the current folder."""
_OURS: Final = "frenetic"
"""Value of that variable where we have set it; any text will do."""
PRELOADED: Final = (
    "frenetic.simulators.embedded.preloading",
    "frenetic.campaign.workers.local",
)
"""Modules that the server of processes imports, so that these have kernels and code at once."""


# In the parent


def process_context(preloaded: Sequence[str] = ()) -> ForkServerContext | SpawnContext:
    """Return the way to make processes: on Linux forked in milliseconds from a fully loaded server.

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
    """Start a process that calls ``target(connection, *args)``; return it and our connection.

    The process leaves Ctrl-C to this one, and is killed by `kill_process`.

    Raises:
        OSError: there are too many processes.
        EOFError: the server that makes them was killed.
    """
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # not on Windows

        with _sparing({signal.SIGHUP}):  # the tracker ignores the others
            resource_tracker.ensure_running()  # first, since it lets Ctrl-C through again
    sparing: AbstractContextManager[None] = _sparing({signal.SIGINT, *ENDING})
    if context.get_start_method() == _FORKED:
        from multiprocessing import forkserver  # not on Windows

        with sparing:
            forkserver.ensure_running()
        sparing = nullcontext()  # it takes a while now, and children get it from their server
    connection, child_connection = context.Pipe()
    try:
        process = context.Process(
            target=_run_alone, args=(child_connection, target, *args), name=name
        )
        with sparing:
            process.start()
    except BaseException:
        connection.close()
        raise
    finally:
        child_connection.close()
    return process, connection


@contextmanager
def _sparing(signals: Set[signal.Signals]) -> Iterator[None]:
    """Spare processes that are started meanwhile from signals to the group, and from its folder.

    A closed terminal signals its whole group, and a file ``random.py`` in the current folder would
    take the place of Python's own module. This thread has the signals blocked for the moment.
    """
    if sys.platform == "win32":
        yield
        return
    is_ours = _SAFE_PATH not in os.environ
    if is_ours:
        os.environ[_SAFE_PATH] = _OURS
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_ours:
            del os.environ[_SAFE_PATH]


def kill_process(process: BaseProcess | subprocess.Popen[bytes]) -> None:
    """Kill a child with all that it has started."""
    assert process.pid is not None
    if sys.platform == "linux" and isinstance(process, BaseProcess):
        process.terminate()  # its keeper kills the others
        with suppress(OSError):  # it has ended
            os.kill(process.pid, signal.SIGCONT)  # a driver may have stopped it
        process.join(END_LIMIT)
    kill_tree(process.pid)
    process.kill()


def kill_tree(process_id: int) -> None:
    """Kill a process with all that it has started.

    On POSIX these are the group that it heads: a process that leaves the group is not killed. On
    Windows they are its children, their children and so on, as long as it lives.
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
    """Return words for the end of a child, after "its process"."""
    if exit_code is None:
        return "closed its connection"
    if exit_code < 0:
        with suppress(ValueError):
            return f"was killed by {signal.Signals(-exit_code).name}"
        return f"was killed by signal {-exit_code}"
    return f"ended with exit code {exit_code}"


class SharedFlag:
    """A flag that a child sets and this process reads.

    The flag is an argument of the child's target; the child's copy is a number, see `open_flag`.
    On POSIX this process reads the flag's file instead of mapping it: a driver may truncate the
    file, and reading a map of a truncated file would kill this process.
    """

    def __init__(self) -> None:
        if sys.platform == "win32":
            self._name = f"frenetic-{os.getpid()}-{id(self)}"
            self._map = mmap.mmap(-1, 1, tagname=self._name)
        else:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - see close
            self._file.write(b"\0")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any]]:
        if sys.platform == "win32":
            return open_flag, (self._name,)
        return open_flag, (reduction.DupFd(self._file.fileno()),)

    @property
    def is_set(self) -> bool:
        """Whether the child has set it; also True if its file is damaged."""
        if sys.platform == "win32":
            return self._map[0] != 0
        return os.pread(self._file.fileno(), 1, 0) != b"\0"

    def close(self) -> None:
        """Close this process's end of the flag."""
        if sys.platform == "win32":
            self._map.close()
        else:
            self._file.close()


# In the child


def open_flag(handle: Any) -> Any:
    """Return the child's copy of a `SharedFlag`, whose ``value`` it sets."""
    if sys.platform == "win32":
        memory = mmap.mmap(-1, 1, tagname=handle)
    else:
        descriptor = handle.detach()
        memory = mmap.mmap(descriptor, 1)
        os.close(descriptor)
    return ctypes.c_byte.from_buffer(memory)


def _run_alone(connection: Connection, target: Callable[..., None], *args: object) -> None:
    """Call the target in a process that leaves Ctrl-C to its parent and ends with it.

    What it prints goes to stderr: stdout is for the parent's results.
    """
    with suppress(OSError):  # there is none
        os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.environ.get(_SAFE_PATH) == _OURS:
        del os.environ[_SAFE_PATH]
    _lead_group()
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # of its own group
    _leave_servers()
    if sys.platform == "linux":
        _fork_under_keeper(connection)
    else:
        threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()
    target(connection, *args)


def _lead_group() -> None:
    """Make this process the head of a group, which can be killed as a whole."""
    if sys.platform != "win32":
        with suppress(OSError):  # it is the head of one already
            os.setsid()


def _leave_servers() -> None:
    """Close the pipes to the parent's servers of processes and resources.

    The child needs neither, and nonsense that a driver writes there would end the servers. A
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


# The keeper of a child, on Linux

if sys.platform == "linux":
    _SET_PARENT_DEATH_SIGNAL: Final = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    _SET_CHILD_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER of linux/prctl.h
    _LOOK_INTERVAL: Final = 0.02  # [s] between two looks for processes to kill
    _OOM_SCORE: Final = "500"  # of -1000..1000: short of memory, Linux kills the child first

    def _fork_under_keeper(connection: Connection) -> None:
        """Return in a child process; this one becomes its keeper and never returns."""
        parent = parent_process()
        assert parent is not None
        _prctl(_SET_CHILD_SUBREAPER, 1)
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)  # the pipe tells of it
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
        if os.getppid() != keeper:
            os._exit(LOST_PARENT)
        _lead_group()
        with suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE, encoding="ascii")

    def _prctl(option: int, value: int) -> None:
        """Set an attribute of this process; without effect where the kernel refuses."""
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
            received = os.read(signals, 512) if signals in ready else b""
            if sentinel in ready or signal.SIGTERM in received:
                break
            status = _reap(child)
        _kill_descendants(child, signals)
        _end_as(LOST_PARENT if status is None else os.waitstatus_to_exitcode(status))

    def _reap(child: int) -> int | None:
        """Reap all children that have ended; return the status of this one, None if it runs."""
        status = None
        with suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == child:
                    status = ended[1]
        return status

    def _kill_descendants(child: int, signals: int) -> None:
        """Kill the child's group, and all children of this process until there are none.

        Those that a killed process leaves become this process's, since it is their subreaper.
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
            if select.select([signals], [], [], _LOOK_INTERVAL)[0]:  # one has ended
                os.read(signals, 512)

    def _children() -> list[int]:
        """Return the ids of this process's children; empty where the kernel does not list them."""
        try:
            listing = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii")
        except OSError:
            return []
        return [int(pid) for pid in listing.split()]

    def _end_as(exit_code: int) -> NoReturn:
        """End this process with an exit code, or by the signal of a negative one."""
        if exit_code < 0:
            import resource  # not on Windows

            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            with suppress(OSError):  # some cannot be handled
                signal.signal(-exit_code, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {-exit_code})
            os.kill(os.getpid(), -exit_code)
        os._exit(exit_code if exit_code >= 0 else LOST_PARENT)


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
