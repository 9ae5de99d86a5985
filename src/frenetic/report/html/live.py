"""The report as a page of this computer that grows with its campaign: `LiveReport`."""

from __future__ import annotations

import json
import logging
import os
import platform
import secrets
import threading
import time
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from typing import Any, Final, Self
from urllib.parse import urlsplit

from frenetic._support.file_locks import find_holder
from frenetic.campaign.log import LOG
from frenetic.campaign.store import DATABASE, LOCK, CampaignStore
from frenetic.campaign.watch import CampaignState, CampaignWatcher, Status
from frenetic.errors import CampaignError, FreneticError, describe_error
from frenetic.report.failures import FAILURES
from frenetic.report.html.blocks import to_json
from frenetic.report.html.campaign import GrowingReport
from frenetic.report.html.page import Report, made_by, render
from frenetic.report.html.tests import DriveData
from frenetic.report.minimised import MINIMISED
from frenetic.report.state_text import census, doubt, message_line, progress_line, status_name

HOST: Final = "127.0.0.1"
"""The only address that is listened on: that of this computer for itself."""
NAMES: Final = frozenset({HOST, "localhost", "::1"})
"""Names by which a request may call this computer, so that no page of another name reads it."""
SHARE: Final = 0.1
"""Largest share of a processor's time that making the report takes."""
KILLED: Final = "killed"
"""The status of a campaign whose process has ended without a word."""
QUIET: Final = 2.0
"""Time without a new line of the log after which it is asked who writes the campaign, in s."""
PATIENCE: Final = 2.0
"""Time that closing waits for a report that is being made, in s."""
MESSAGES: Final = 4
"""Warnings and errors that the page shows."""
_LONGEST: Final = 40  # characters of an edition's name
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class LiveState:
    """The present state of a campaign, in words."""

    status: str
    """``running``, ``finished``, ``killed`` and the like."""
    has_ended: bool
    """Whether its process has ended, as far as can be told."""
    note: str
    """What the status leaves open; mostly empty."""
    progress: str
    """Progress in a line; empty before the first."""
    budget_spent: float
    """0..1."""
    workers: str
    """Numbers of workers by activity; empty if it does not run."""
    messages: tuple[str, ...]
    """The latest warnings and errors."""


class LiveReport:
    """The report of a campaign as a page of this computer, which grows while the campaign runs.

    A context manager: the page is there until its end. The campaign may be written by this process
    or another one, may not have begun, or have ended; its database is opened only to be read, and
    only while a page asks. No other computer can reach the page, but everyone on this one can::

        with LiveReport("night") as live:
            print(live.address)
            campaign.run()

    Args:
        folder: of the campaign, which may come later.
        port: to listen on; 0 for any that is free.
        interval: s between two questions of a page.

    Raises:
        CampaignError: the folder is a file.
        FreneticError: the port cannot be listened on.
    """

    def __init__(self, folder: Path | str, *, port: int = 0, interval: float = 1.0) -> None:
        self._folder = Path(folder)
        if os.path.lexists(self._folder) and not self._folder.is_dir():
            raise CampaignError(f"{self._folder} is not a folder: that of a campaign is needed")
        self._interval = interval
        self._watcher = CampaignWatcher(self._folder)
        self._lock = threading.Lock()
        self._report, self._pieces = GrowingReport(), _Pieces()
        self._created: object = None
        self._seen: object = None  # the campaign as of the last report
        self._status_seen = ""
        self._trouble = ""
        self._is_closed = False
        self._is_asked, self._is_due = threading.Event(), threading.Event()
        try:
            self._server = _Server(self, port)
        except OSError as error:
            raise FreneticError(
                f"cannot listen on port {port} of {HOST}: {error.strerror or error}; choose another"
                " one, or 0 for any that is free"
            ) from error
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True),
            threading.Thread(target=self._grow, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the page and frees the port; closing twice does no harm."""
        self._is_closed = True
        self._is_asked.set()
        self._is_due.set()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join(PATIENCE)

    def state(self) -> LiveState:
        """The campaign's present state."""
        with self._lock:
            state, trouble = self._watcher.look(), self._trouble
        status, note = self._status(state)
        has_begun = state.status is not Status.WAITING
        is_running = status in (Status.RUNNING, Status.SILENT)
        now = datetime.now(UTC)
        return LiveState(
            status=status,
            has_ended=state.status.is_end or status == KILLED,
            note=" ".join(text for text in (note, trouble) if text),
            progress=progress_line(state) if has_begun else "",
            budget_spent=state.progress.budget_spent,
            workers=census(state.workers) if is_running else "",
            messages=tuple(message_line(one, now) for one in state.messages[-MESSAGES:]),
        )

    def page(self) -> str:
        """The page, as yet without contents, which it asks for."""
        folder = self._folder.resolve().name
        return render(Report(folder, (), made_by=made_by()), interval=self._interval)

    def news(self, known: str) -> str:
        """What of the report is newer than an edition of that name, as JSON."""
        with self._lock:
            return self._pieces.since(known)

    def state_json(self) -> str:
        """The present state, and the name of the report's edition, as JSON."""
        state = self.state()
        if state.has_ended and state.status != self._status_seen:
            self._is_due.set()  # nothing runs that could be slowed down
        self._is_asked.set()
        with self._lock:
            return _json(asdict(state) | {"edition": self._pieces.name})

    def _status(self, state: CampaignState) -> tuple[str, str]:
        """(status, note) of a campaign."""
        if state.status is Status.WAITING and not (self._folder / LOG).is_file():
            if (self._folder / DATABASE).is_file():
                return "stored", f"there is no {LOG}, so nothing says whether the campaign runs"
            return Status.WAITING, f"there is no campaign in {self._folder} yet"
        if self._was_killed(state):
            return KILLED, f"'frenetic resume {self._folder}' goes on"
        return status_name(state), doubt(state, datetime.now(UTC))

    def _was_killed(self, state: CampaignState) -> bool:
        """Whether the log ends without an end, and nobody on its computer, this one, writes it."""
        lock = self._folder / LOCK
        return (
            state.status in (Status.RUNNING, Status.SILENT)
            and state.quiet_seconds >= QUIET
            and state.setup.host == platform.node()
            and lock.is_file()
            and find_holder(lock) is None
        )

    def _grow(self) -> None:
        """Makes the report anew whenever a page asks and there is news, but not all the time."""
        while True:
            self._is_asked.wait()
            if self._is_closed:
                return
            self._is_asked.clear()
            self._is_due.clear()
            started = time.thread_time()
            self._look()
            spent = time.thread_time() - started
            self._is_due.wait(max(self._interval, spent * (1.0 / SHARE - 1.0)))

    def _look(self) -> None:
        """Takes over what is new in the campaign's database."""
        status = self.state().status
        self._status_seen = status
        seen = status, self._files()
        if seen == self._seen or not (self._folder / DATABASE).is_file():
            return
        trouble = ""
        try:
            with CampaignStore.open(self._folder) as store:
                created = store.facts.get("created_at")
                is_same = created == self._created and store.stored() >= self._report.told
                if not is_same:
                    self._report, self._created = GrowingReport(), created
                report = self._report.make(store, is_running=status == Status.RUNNING)
            pieces = self._pieces if is_same else _Pieces()
            new = pieces.prepare(report)
        except Exception as error:  # this thread goes on, for what comes may be better
            said = error if isinstance(error, FreneticError) else describe_error(error)
            trouble = f"The report cannot be made: {said}."
            self._created = object()  # what is half made is not gone on with
            logger.debug("the report cannot be made", exc_info=True)
        else:
            with self._lock:
                pieces.take(new)
                self._pieces = pieces
        with self._lock:
            self._trouble = trouble
        self._seen = seen

    def _files(self) -> tuple[object, ...]:
        """What changes with the campaign's database and with the files that a report names."""
        found: list[object] = []
        for name in (DATABASE, f"{DATABASE}-wal", FAILURES, MINIMISED):
            try:
                status = (self._folder / name).stat()
            except OSError:
                found.append(None)
            else:  # a reader leaves an empty log behind
                found.append((status.st_mtime_ns, status.st_size) if status.st_size else None)
        return tuple(found)


@dataclass(frozen=True)
class _Piece:
    """A piece of a report, as JSON."""

    edition: int
    """Number of the edition in which it was new."""
    text: str
    of: object = None
    """What it was made from."""


@dataclass(frozen=True)
class _Edition:
    """A report in pieces."""

    number: int
    head: str
    tests: str
    sections: dict[str, _Piece]
    drives: dict[int, _Piece]


class _Pieces:
    """A report that changes, in pieces: who knows an edition is told only what is new since."""

    def __init__(self) -> None:
        self._key = secrets.token_hex(4)  # so that no edition of another one is taken for known
        self._edition = _Edition(0, "{}", "null", {}, {})

    @property
    def name(self) -> str:
        """Name of the latest edition."""
        return f"{self._key}-{self._edition.number}"

    def prepare(self, report: Report) -> _Edition:
        """The next edition."""
        last = self._edition
        number = last.number + 1
        head = to_json(replace(report, sections=(), tests=None, drives=()))
        sections = {}
        for section in report.sections:
            text, old = _json(to_json(section)), last.sections.get(section.id)
            is_old = old is not None and old.text == text
            sections[section.id] = old if old and is_old else _Piece(number, text)
        return _Edition(
            number,
            _json({name: head[name] for name in head.keys() - {"sections", "tests", "drives"}}),
            _json(to_json(report.tests)),
            sections,
            {drive.id: self._piece_of(drive, number) for drive in report.drives},
        )

    def _piece_of(self, drive: DriveData, number: int) -> _Piece:
        old = self._edition.drives.get(drive.id)
        return old if old and old.of == drive else _Piece(number, _json(to_json(drive)), drive)

    def take(self, edition: _Edition) -> None:
        """Takes over an edition that was prepared, unless nothing in it is new."""
        last = self._edition
        pieces = *edition.sections.values(), *edition.drives.values()
        if (
            any(piece.edition == edition.number for piece in pieces)
            or (edition.head, edition.tests) != (last.head, last.tests)
            or list(edition.sections) != list(last.sections)
        ):
            self._edition = edition

    def since(self, known: str) -> str:
        """The pieces that are newer than an edition; all if it is not one of this report."""
        key, _, number = known[:_LONGEST].partition("-")
        is_known = key == self._key and number.isascii() and number.isdecimal()
        after, edition = int(number) if is_known else 0, self._edition
        sections, drives = (
            ",".join(piece.text for piece in pieces.values() if piece.edition > after)
            for pieces in (edition.sections, edition.drives)
        )
        return (
            f'{{"edition":{_json(self.name)},"whole":{_json(not is_known)},"head":{edition.head},'
            f'"order":{_json(list(edition.sections))},"tests":{edition.tests},'
            f'"sections":[{sections}],"drives":[{drives}]}}'
        )


def _json(value: Any) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


class _Server(ThreadingTCPServer):
    """The server of a live report."""

    daemon_threads = True
    # On Windows two servers could listen on one port, then.
    allow_reuse_address = os.name == "posix"

    def __init__(self, live: LiveReport, port: int) -> None:
        self.live = live
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """Logs what breaks while a request is answered, such as a browser that has gone."""
        logger.debug("a request broke", exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    """Answers one request; no path of it is that of a file."""

    server: _Server
    server_version = "frenetic"
    sys_version = ""
    timeout = 30.0  # s

    def do_GET(self) -> None:
        """The page, the state, or what is new in the report."""
        path, _, query = self.path.partition("?")
        live = self.server.live
        if not self._calls_this_computer():
            name = f"{HOST} or localhost"
            self._answer(HTTPStatus.FORBIDDEN, f"This page is for {name} only.\n")
        elif path == "/":
            self._answer(HTTPStatus.OK, live.page(), "text/html")
        elif path == "/state":
            self._answer(HTTPStatus.OK, live.state_json(), "application/json")
        elif path == "/news":
            self._answer(HTTPStatus.OK, live.news(query), "application/json")
        elif path == "/favicon.ico":
            self._answer(HTTPStatus.NO_CONTENT)
        else:
            self._answer(HTTPStatus.NOT_FOUND, "There is no such page here.\n")

    def _calls_this_computer(self) -> bool:
        """Whether the request names this computer, whatever its port is called further away."""
        try:
            return urlsplit(f"//{self.headers.get('Host', '')}").hostname in NAMES
        except ValueError:
            return False

    def _answer(self, status: HTTPStatus, text: str = "", kind: str = "text/plain") -> None:
        data = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Logs a request."""
        logger.debug(format, *args)
