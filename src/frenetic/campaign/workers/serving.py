"""What a worker process does: it tests the candidates that come through its connection."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Final, NamedTuple, TypeAlias

from frenetic.campaign.tester import RoadTester, Tested
from frenetic.errors import FreneticError, describe_error
from frenetic.registry import load_user_file
from frenetic.search.records import Candidate


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class Finished(NamedTuple):
    """A candidate was tested; the next one may be sent, unless the simulator broke."""

    candidate_id: int
    seconds: float
    tested: Tested


class Hopeless(NamedTuple):
    """The simulator does not start."""

    reason: str


class Logged(NamedTuple):
    """Something for the campaign's log."""

    level: int
    name: str
    message: str


Message: TypeAlias = Ready | Finished | Hopeless | Logged

LOST_PARENT: Final = 1
"""Exit code of a worker whose campaign is gone."""


def serve(connection: Connection, user_files: Sequence[str], tester: bytes) -> None:
    """Tests candidates from the connection until it ends or a None comes.

    Args:
        connection: gives candidates, takes messages.
        user_files: the user's own modules, which have to be loaded first.
        tester: a pickled `RoadTester`, from the process that started this one.
    """
    _stand_alone()
    threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()
    lock = threading.Lock()

    def send(message: Message) -> None:
        with lock:
            connection.send(message)

    logger = logging.getLogger("frenetic")
    logger.addHandler(_Sending(send))
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.INFO)
    try:
        for file in user_files:
            load_user_file(file)
        # Made by our own parent a moment ago and given to us alone, so it may be unpickled.
        the_tester: RoadTester = pickle.loads(tester)  # noqa: S301
        while _serve_one_start(connection, send, the_tester):
            pass
    except (EOFError, ConnectionError):
        return  # the campaign is gone, or has no more use for this worker
    except Exception as error:
        send(Hopeless(str(error) if isinstance(error, FreneticError) else describe_error(error)))


def _serve_one_start(
    connection: Connection, send: Callable[[Message], None], tester: RoadTester
) -> bool:
    """Serves while the simulator works; returns whether it has to be started again."""
    with tester.simulator:
        send(Ready())
        while True:
            candidate: Candidate | None = connection.recv()
            if candidate is None:
                return False
            start = time.perf_counter()
            tested = tester.test(candidate).pack()
            send(Finished(candidate.id, time.perf_counter() - start, tested))
            if tested.simulator_broke:
                return True


def _stand_alone() -> None:
    """Leaves Ctrl-C to the campaign; becomes head of a group, which can be ended as a whole."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setsid"):
        with suppress(OSError):  # it is the head of one already
            os.setsid()


def _die_with_parent() -> None:
    """Ends this process, and what it started, when the campaign's process has ended."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        kill_group(os.getpid())
        os._exit(LOST_PARENT)


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
        except Exception:
            self.handleError(record)
