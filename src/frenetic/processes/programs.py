"""Programs of the user's in any language, which answer messages on their standard streams.

Messages and answers alternate: the program reads a message, and writes one answer. A message is a
JSON object in a line, or a record of bytes whose length both sides know. A program that takes too
long is killed with all that it has started. What it prints to stderr is passed on.
"""

from __future__ import annotations

import math
import os
import select
import shutil
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, TypeVar

from msgspec import Struct
from msgspec.json import Encoder

from frenetic._support.option_text import split_command
from frenetic._support.outside_text import read_json
from frenetic._support.printable import printable
from frenetic.errors import FreneticError
from frenetic.processes.children import ending_of
from frenetic.processes.groups import kill_tree

START_LIMIT: Final = 60.0
"""Time that a program has for the answer to its first message, in s (our choice)."""
_MOST_BYTES: Final = 2**20
"""Largest number of bytes of an answer (our choice)."""
_MOST_TEXT: Final = 300
"""Largest number of characters of a text that a program sends for people (our choice)."""
_LAST_WORDS: Final = 500
"""Largest number of bytes of stderr that an error quotes (our choice)."""
_QUOTED: Final = 80
"""Largest number of characters of an answer that an error quotes (our choice)."""
_END_LIMIT: Final = 1.0
"""Time in which a program ends after its input or its output is closed, in s (our choice)."""
_MOST_WAIT: Final = 0.5
"""Longest time between two looks at the deadline, in s (our choice)."""
_CHUNK: Final = 1 << 16

_encoder = Encoder()


class ProgramError(Exception):
    """A program that gave no usable answer; the message follows the program's name."""


class ProgramEnded(ProgramError):  # noqa: N818  # it is an event
    """The program ended, or closed its output."""


class ProgramLate(ProgramError):  # noqa: N818
    """The program took too long, and was killed."""


class AnswerError(ProgramError):
    """The program's answer cannot be read."""


class ProgramReport(ProgramError):  # noqa: N818
    """The program reports that it cannot go on."""


class Answer(Struct, forbid_unknown_fields=True):
    """An answer of a program, to a message that asks for nothing more."""

    error: str = ""
    """Why the program cannot go on; empty if it can."""


AnswerT = TypeVar("AnswerT", bound=Answer)


def command_words(command: str) -> tuple[str, ...]:
    """Return program and arguments of a command, split as a shell does; no shell runs.

    Raises:
        FreneticError: the command is empty, has a quotation without end, or names no program.
    """
    try:
        words = split_command(command)
    except ValueError as error:
        raise FreneticError(f"the command {command!r} cannot be split: {error}") from None
    if not words:
        raise FreneticError("the command is empty: a program with its arguments is needed")
    if shutil.which(words[0]) is None:
        raise FreneticError(
            f"the program {words[0]!r} is missing, or is not executable: name one that is in the"
            " current folder, such as ./controller, or that your shell finds"
        )
    return tuple(words)


def command_files(words: Sequence[str]) -> tuple[str, ...]:
    """Return the files among the words of a command: the program, and arguments that are files."""
    program = shutil.which(words[0])
    files = [word for word in words[1:] if os.path.isfile(word)]  # noqa: PTH113  # any text
    return tuple([program] if program else []) + tuple(files)


class Program:
    """A program that is started at its first message, and again after it was lost.

    Args:
        words: the program and its arguments.
        deadline: wall time for each answer but the first, in s.
        on_start: called after each start, before the first message; it may ask the program.
    """

    def __init__(
        self, words: Sequence[str], deadline: float, on_start: Callable[[], object] | None = None
    ) -> None:
        self._words = words
        self._deadline = deadline
        self._on_start = on_start
        self._running: _Running | None = None

    def ask(self, message: Mapping[str, Any], kind: type[AnswerT]) -> AnswerT:
        """Send a JSON object in a line, and return the answer, a JSON object in a line, too.

        Raises:
            ProgramError: the program ended, took too long, wrote something else, or reports that it
                cannot go on.
            FreneticError: the program cannot be started.
        """
        line = self._answer(lambda running: running.line(_encoder.encode(message) + b"\n"))
        try:
            answer = read_json(line, kind)
        except ValueError as error:
            self.close()
            raise AnswerError(f"answered {_quoted(line)}: {error}{_hint(line)}") from None
        if answer.error:
            self.close()
            raise ProgramReport(f"reports: {text_of(answer.error)}")
        return answer

    def exchange(self, record: bytes | memoryview, size: int) -> bytes:
        """Send a record, and return the record of the answer, `size` bytes.

        Raises:
            ProgramError: the program ended, took too long, or wrote more.
            FreneticError: the program cannot be started.
        """
        return self._answer(lambda running: running.record(record, size))

    def start(self) -> None:
        """Start the program unless it runs.

        Raises:
            ProgramError: it ended at once, or answered `on_start` wrongly.
            FreneticError: it cannot be started.
        """
        if self._running is None:
            self._running = _Running(self._words, self._deadline)
            if self._on_start is not None:
                self._on_start()

    def close(self) -> None:
        """End the program by closing its input, and kill all that it has started."""
        running, self._running = self._running, None
        if running is not None:
            running.close()

    def _answer(self, call: Callable[[_Running], bytes]) -> bytes:
        """Return the answer of the running program; a program that gives none is killed."""
        self.start()
        assert self._running is not None
        try:
            return call(self._running)
        except BaseException:  # also Ctrl-C and a limit of the drive: an answer is still to come
            self.close()
            raise


class _Running:
    """A running program, with a thread that kills it when it is late, and one that reads stderr."""

    def __init__(self, words: Sequence[str], deadline: float) -> None:
        new_group: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            new_group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        try:
            self._process = subprocess.Popen(  # noqa: S603  # the user's own program, no shell
                list(words),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                **new_group,
            )
        except OSError as error:
            raise FreneticError(
                f"the program {words[0]!r} cannot be started: {error.strerror or error}"
            ) from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._unasked: Any = None  # notices what the program writes before it is asked
        if sys.platform != "win32":
            self._unasked = select.poll()
            self._unasked.register(self._stdout, select.POLLIN)
        self._guard = _Guard(self._process, deadline)
        self._end = weakref.finalize(self, _end, self._process, self._guard)

    def line(self, message: bytes) -> bytes:
        """Send a line, and return the line of the answer, without its end."""
        answer = b""
        with self._guard:
            self._write(message)
            while not answer.endswith(b"\n"):
                answer += self._read(answer)
                if len(answer) > _MOST_BYTES:
                    raise AnswerError(f"wrote more than {_MOST_BYTES:,} bytes as one answer")
        first, _, rest = answer.partition(b"\n")
        if rest:
            raise AnswerError(
                f"wrote more than one line as an answer: {_quoted(first)}, then {_quoted(rest)}"
                f"{_hint(first)}"
            )
        return first

    def record(self, message: bytes | memoryview, size: int) -> bytes:
        """Send a record, and return the record of the answer, of `size` bytes."""
        with self._guard:
            self._write(message)
            answer = self._read(b"")
            while len(answer) < size:
                answer += self._read(answer)
        if len(answer) > size:
            raise AnswerError(f"wrote more than a record of {size} bytes as an answer")
        return answer

    def close(self) -> None:
        """End the program, see `_end`."""
        self._end()

    def _write(self, message: bytes | memoryview) -> None:
        if self._unasked is not None and self._unasked.poll(0):
            written = os.read(self._stdout, _CHUNK)
            if written:  # otherwise the program has ended
                raise AnswerError(f"wrote {_quoted(written)} before it was asked{_hint(written)}")
        view = memoryview(message)
        try:
            while len(view):
                view = view[os.write(self._stdin, view) :]
        except OSError:
            raise self._lost(b"") from None

    def _read(self, before: bytes) -> bytes:
        """Return the next bytes of the answer that began with `before`."""
        try:
            chunk = os.read(self._stdout, _CHUNK)
        except OSError:
            chunk = b""
        if not chunk:
            raise self._lost(before)
        return chunk

    def _lost(self, answer: bytes) -> ProgramError:
        """Return the error about a program that has closed its streams after part of an answer."""
        if self._guard.is_late:
            return ProgramLate(f"took more than {self._guard.limit:g} s for an answer")
        self._guard.rest()
        exit_code: int | None = None
        with suppress(subprocess.TimeoutExpired):
            exit_code = self._process.wait(_END_LIMIT)
        text = "closed its output" if exit_code is None else ending_of(exit_code)
        if answer:
            text += f" within an answer, after {_quoted(answer)}"
        words = self._guard.last_words()
        return ProgramEnded(f"{text}: {words}" if words else text)


class _Guard:
    """Kills a program that is late, and passes on what it prints to stderr.

    In a ``with`` block the program owes an answer.
    """

    def __init__(self, process: subprocess.Popen[bytes], deadline: float) -> None:
        self.limit = max(START_LIMIT, deadline)
        """Wall time for the present answer, in s."""
        self.is_late = False
        """Whether the program was killed because it was late."""
        self.over = threading.Event()
        """Set when the program is no longer needed."""
        self._process = process
        self._deadline = deadline
        self._until = math.inf
        self._words = b""  # the last that it printed to stderr
        self._threads = [
            threading.Thread(target=target, name=name, daemon=True)
            for name, target in (("program-deadline", self._kill), ("program-stderr", self._pass))
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> None:
        self._until = time.monotonic() + self.limit

    def __exit__(self, *_: object) -> None:
        self.rest()

    def rest(self) -> None:
        """End the watch until the program owes the next answer."""
        self._until, self.limit = math.inf, self._deadline

    def last_words(self) -> str:
        """Return the end of what the program printed to stderr, in one line."""
        self._threads[1].join(_END_LIMIT)  # it ends with the program
        return printable(" ".join(self._words.decode(errors="replace").split()))

    def _kill(self) -> None:
        """Kill the program when its answer is late."""
        while not self.over.wait(min(self._deadline / 4.0, _MOST_WAIT)):
            if time.monotonic() > self._until:
                self.is_late = True
                kill_tree(self._process.pid)
                self._process.kill()
                return

    def _pass(self) -> None:
        """Pass stderr of the program on to ours, and keep its end."""
        assert self._process.stderr is not None
        with suppress(OSError, ValueError):  # it was closed
            while chunk := os.read(self._process.stderr.fileno(), _CHUNK):
                self._words = (self._words + chunk)[-_LAST_WORDS:]
                with suppress(OSError, ValueError):  # nobody reads our stderr
                    sys.stderr.write(chunk.decode(errors="replace"))


def _end(process: subprocess.Popen[bytes], guard: _Guard) -> None:
    """End a program by closing its input; kill it, and all that it has started, a second later."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(_END_LIMIT)
    guard.over.set()
    kill_tree(process.pid)
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            with suppress(OSError):
                stream.close()


def text_of(text: str) -> str:
    """Return a program's text in one line that can be printed."""
    return printable(" ".join(text[:_MOST_TEXT].split()))


def _hint(line: bytes) -> str:
    """Return the end of a sentence about a line that is not for us; empty for an object."""
    return "" if line.startswith(b"{") else "; what is for people belongs on stderr"


def _quoted(data: bytes) -> str:
    """Return the beginning of what a program wrote, quoted."""
    text = printable(data.decode(errors="replace").rstrip("\r\n"))
    return repr(text if len(text) <= _QUOTED else f"{text[:_QUOTED]}...")
