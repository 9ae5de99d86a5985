"""The work of a worker process: it tests the candidates from its connection."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Final

from frenetic.campaign.tester import Placement, RoadTester
from frenetic.campaign.workers.messages import (
    Logged,
    Message,
    Ready,
    WorkerFailed,
    decode_task,
    encode_message,
)
from frenetic.errors import FreneticError, describe_error
from frenetic.registry import load_user_file
from frenetic.search.records import Candidate

if sys.platform == "linux":
    import fcntl


LOST_PARENT: Final = 1
"""Exit code of a worker whose campaign is gone."""


def serve(connection: Connection, user_files: Sequence[str], tester: bytes) -> None:
    """Tests candidates from the connection until it ends or a None comes.

    Args:
        connection: gives candidates, takes messages.
        user_files: the user's own modules, to load first.
        tester: a pickled `RoadTester`, from the process that started this one.
    """
    stand_alone()
    campaign = _Campaign(connection)
    logger = logging.getLogger("frenetic")
    logger.addHandler(_Sending(campaign.send))
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.INFO)
    try:
        for file in user_files:
            load_user_file(file)
        # Made by our own parent a moment ago and given to us alone, so it may be unpickled.
        the_tester: RoadTester = pickle.loads(tester)  # noqa: S301
        while _serve_one_start(campaign, the_tester):
            pass
    except _GoneError:
        pass
    except BaseException as error:  # also what a driver's sys.exit() raises
        with suppress(_GoneError):
            campaign.send(WorkerFailed(reason_of(error)))
    finally:
        connection.close()  # which says that the simulator has ended


def _serve_one_start(campaign: _Campaign, tester: RoadTester) -> bool:
    """Serves while the simulator works; returns whether to start it again."""
    with tester.simulator:
        campaign.send(Ready())
        while True:
            candidate, placement = campaign.receive()
            if candidate is None:
                return False
            attempt = tester.attempt(candidate, placement)
            campaign.send(attempt)
            if attempt.simulator_broke:
                return True


def reason_of(error: BaseException) -> str:
    """One line about an error of a simulator or driver; our own errors stay as they are."""
    return str(error) if isinstance(error, FreneticError) else describe_error(error)


class _GoneError(Exception):
    """The campaign has gone, or no longer needs this worker."""


class _Campaign:
    """The campaign at the other end of a worker's connection."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def send(self, message: Message) -> None:
        """Sends a message, from any thread.

        Raises:
            _GoneError: the campaign has gone. A simulator's own connection errors are different.
        """
        data = encode_message(message)
        with self._lock:
            try:
                self._connection.send_bytes(data)
            except OSError as error:
                raise _GoneError from error

    def receive(self) -> tuple[Candidate | None, Placement | None]:
        """The next candidate, None at the end, and its placement."""
        try:
            return decode_task(self._connection.recv_bytes())
        except (EOFError, OSError):
            return None, None


def stand_alone() -> None:
    """Makes this process leave Ctrl-C to its parent and end with it.

    It becomes the head of a group, which can be ended as a whole.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setsid"):
        with suppress(OSError):  # it is the head of one already
            os.setsid()
    threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()


def _die_with_parent() -> None:
    """Ends this process, and all that it started, when the campaign's process has ended."""
    parent = parent_process()
    if parent is not None:
        _die_with(parent.sentinel)
        wait([parent.sentinel])
        kill_group(os.getpid())
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


def kill_group(process_id: int) -> None:
    """Kills the processes of the group that a worker heads; nothing where there are no groups."""
    if hasattr(os, "killpg"):
        with suppress(OSError):  # gone already, or not yet a group
            os.killpg(process_id, signal.SIGKILL)


class _Sending(logging.Handler):
    """Sends log records to the campaign."""

    def __init__(self, send: Callable[[Message], None]) -> None:
        super().__init__(logging.INFO)
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._send(Logged(record.levelno, record.name, record.getMessage()))
        except _GoneError:
            pass  # and with it the log
        except Exception:
            self.handleError(record)
