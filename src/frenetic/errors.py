"""Errors that a user can cause, each with a message for the reader."""

from __future__ import annotations

import linecache
import os
import sys
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

_MOST = 450  # characters of a line about an error
_MOST_SOURCE = 80  # characters of a line of source
_MOST_TRACEBACK = 20_000  # characters of a traceback, whose middle is cut
_OURS = f"{Path(__file__).parent}{os.sep}"
_STANDARD = f"{Path(os.__file__).parent}{os.sep}"
_INSTALLED = (f"{os.sep}site-packages{os.sep}", f"{os.sep}dist-packages{os.sep}")


def describe_error(error: BaseException) -> str:
    """Class and text of an error in foreign code, in one line of at most 450 characters."""
    return _described(error)[:_MOST]


def describe_raised(error: BaseException) -> str:
    """The same with the place in the user's code, see `place_of`; still at most 450 characters."""
    place = place_of(error)
    if not place:
        return describe_error(error)
    return f"{_described(error)[: _MOST - len(place) - 3]} ({place})"


def _described(error: BaseException) -> str:
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = "an error without a readable text"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place_of(error: BaseException) -> str:
    """File, line and source line at which the user's code raised, as ``mpc.py:42: x = 1 / v``.

    It is the deepest call that is neither ours nor of Python or an installed package; if all are,
    the deepest in the package that we called. The file is given as seen from the entry of
    `sys.path` that it is imported from. Empty if there is no such call.
    """
    place = _call_of(error)
    if place is None:
        return ""
    file, line = place
    source = " ".join(linecache.getline(file, line).split())
    if len(source) > _MOST_SOURCE:
        source = f"{source[: _MOST_SOURCE - 3]}..."
    return f"{_short(file)[-100:]}:{line}{': ' if source else ''}{source}"


def _call_of(error: BaseException) -> tuple[str, int] | None:
    """File and line at which the user's code raised, see `place_of`."""
    calls = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if _is_foreign(frame.f_code.co_filename)
    ]
    if not calls:
        return None
    own = [call for call in calls if not any(part in call[0] for part in _INSTALLED)]
    first = _package_of(calls[0][0])
    return (own or [call for call in calls if _package_of(call[0]) == first])[-1]


HANGS: Final = "hangs"
"""Kind of the fault of a driver that takes too long."""
ENDS_ITS_PROCESS: Final = "ends its process"
"""Kind of the fault of a driver whose process dies while it is asked."""
GIVES_NO_CONTROLS: Final = "gives no usable controls"
"""Kind of the fault of a driver that returns what is none, or no finite numbers."""


@dataclass(frozen=True)
class Fault:
    """A fault of the driver or the simulator that broke a drive."""

    part: Literal["driver", "simulator"]
    kind: str
    """Name of the error's class; `HANGS`, `ENDS_ITS_PROCESS` or `GIVES_NO_CONTROLS`."""
    file: str = ""
    """File in which the user's code raised, see `place_of`; empty if unknown."""
    line: int = 0
    """Line in this file; 0 if unknown."""

    @classmethod
    def of(cls, part: Literal["driver", "simulator"], error: BaseException) -> Fault:
        """The fault that an error tells of; one of ours tells of its cause."""
        if isinstance(error, FreneticError) and error.__cause__ is not None:
            error = error.__cause__
        file, line = _call_of(error) or ("", 0)
        kind = GIVES_NO_CONTROLS if isinstance(error, ControlsError) else type(error).__name__
        return cls(part, kind, file and _short(file)[-100:], line)

    def __str__(self) -> str:
        own = self.kind in (HANGS, ENDS_ITS_PROCESS, GIVES_NO_CONTROLS)
        what = self.kind if own else f"raises {self.kind}"
        return f"{what} at {self.file}:{self.line}" if self.file else what

    def is_like(self, other: Fault | None) -> bool:
        """Whether it is the same fault, in an edited file or not."""
        return other is not None and replace(self, line=0) == replace(other, line=0)


def _is_foreign(file: str) -> bool:
    """Whether a file is neither ours nor Python's, nor what a dataclass generates."""
    if file.startswith((_OURS, "<frozen ", "<string>")):
        return False
    return not file.startswith(_STANDARD) or any(part in file for part in _INSTALLED)


def _package_of(file: str) -> str:
    """The folder of the installed package that a file belongs to."""
    for part in _INSTALLED:
        head, found, tail = file.partition(part)
        if found:
            return head + found + tail.partition(os.sep)[0]
    return str(Path(file).parent)


def _short(file: str) -> str:
    """A file's path from the entry of `sys.path` that it is imported from."""
    roots = [f"{root.rstrip(os.sep)}{os.sep}" for root in sys.path if Path(root).is_absolute()]
    return file[max((len(root) for root in roots if file.startswith(root)), default=0) :]


def traceback_of(error: BaseException) -> str:
    """The whole traceback of an error; that of its cause if we raised it to describe that."""
    if isinstance(error, FreneticError):
        if error.__cause__ is None:
            return ""
        error = error.__cause__
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    half = _MOST_TRACEBACK // 2
    return text if len(text) <= _MOST_TRACEBACK else f"{text[:half]}\n...\n{text[-half:]}"


class FreneticError(Exception):
    """A mistake or a circumstance that the user can fix.

    The message is one line: what was given, what is allowed, what to do. The command line prints it
    and exits with code 2.
    """


class RoadError(FreneticError, ValueError):
    """Values or points that do not describe a road."""


class CampaignError(FreneticError):
    """A campaign's folder or database that cannot be used as asked."""


class CampaignGoneError(CampaignError):
    """A campaign's folder or database was moved, deleted or replaced while it was in use."""

    place: Path | None = None
    """Where the folder is now, with all results; None if that is not known, or they are gone."""


class BrokenDriverError(CampaignError):
    """A driver that broke on each of the first roads, which ends the search."""


class StrategyError(CampaignError):
    """A strategy that raised, or whose roads are all refused, which ends the search."""


class DriverError(FreneticError):
    """A driver that cannot be loaded, or that broke its contract during a drive."""


class ControlsError(DriverError):
    """A driver returned no `Controls`, or no finite numbers in them."""


class UnknownNameError(FreneticError, LookupError):
    """The name of an unregistered strategy, driver or simulator."""


def reason_of(error: BaseException) -> str:
    """One line about an error of a simulator or driver; our own errors stay as they are."""
    return str(error) if isinstance(error, FreneticError) else describe_raised(error)
