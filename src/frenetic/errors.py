"""Errors that a user can cause, and the description of errors in a user's code."""

from __future__ import annotations

import linecache
import os
import sys
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

# Most characters of texts, all our choice. Code of users may raise errors with texts of any length.
_MOST_DESCRIPTION: Final = 450  # of the line about an error
_MOST_MESSAGE: Final = 2_000  # of a Frenetic error's message
_MOST_CLASS_NAME: Final = 100
_MOST_PATH: Final = 100  # of a file's path, whose beginning is cut
_MOST_SOURCE: Final = 80  # of a line of source
_MOST_TRACEBACK: Final = 20_000  # of a traceback, whose middle is cut

_OUR_FOLDER: Final = f"{Path(__file__).parent}{os.sep}"
_STANDARD_LIBRARY: Final = f"{Path(os.__file__).parent}{os.sep}"
_PACKAGE_FOLDERS: Final = (f"{os.sep}site-packages{os.sep}", f"{os.sep}dist-packages{os.sep}")
"""Parts of a path by which a file belongs to an installed package."""


def describe_error(error: BaseException) -> str:
    """Return class and text of an error in a user's code, in one line of at most 450 characters."""
    return _one_line(error)[:_MOST_DESCRIPTION]


def describe_raised(error: BaseException) -> str:
    """Return class, text and place of an error in a user's code, in at most 450 characters.

    An example is ``ZeroDivisionError: division by zero (mpc.py:42: x = 1 / v)``.
    """
    place = place_of(error)
    if not place:
        return describe_error(error)
    place = f" ({place})"
    return _one_line(error)[: _MOST_DESCRIPTION - len(place)] + place


def _one_line(error: BaseException) -> str:
    """Return class and text of an error in one line."""
    name = _class_name(error)
    text = " ".join(_text_of(error, _MOST_MESSAGE).split())
    return f"{name}: {text}" if text else name


def _class_name(error: BaseException) -> str:
    """Return the name of an error's class.

    It is read past the class, which may be a user's and override attributes.
    """
    name: str = vars(type)["__name__"].__get__(type(error))
    return _encodable(name[:_MOST_CLASS_NAME])


def _cause_of(error: BaseException) -> BaseException | None:
    """Return the error from which an error was raised, read past the class as in `_class_name`."""
    cause: BaseException | None = vars(BaseException)["__cause__"].__get__(error)
    return cause


def _text_of(error: BaseException, most: int) -> str:
    """Return the text of an error, cut to `most` characters."""
    try:
        return _encodable(str.__str__(str(error)[:most]))
    except BaseException:  # a user's class may raise anything here
        return "an error without a readable text"


def _encodable(text: str) -> str:
    """Return a text that files and databases accept, without halves of characters."""
    return text.encode(errors="backslashreplace").decode()


def place_of(error: BaseException) -> str:
    """Return where the user's code raised: file, line and source, as ``mpc.py:42: x = 1 / v``.

    The place is the deepest call outside Frenetic, Python and installed packages. Without such a
    call it is the deepest call in the package that Frenetic called, and without that it is empty.
    The file's path starts from the entry of `sys.path` from which the file is imported.
    """
    place = _call_of(error)
    if place is None:
        return ""
    file, line = place
    source = " ".join(linecache.getline(file, line).split())
    if len(source) > _MOST_SOURCE:
        source = f"{source[: _MOST_SOURCE - 3]}..."
    return f"{_short_path(file)}:{line}{': ' if source else ''}{source}"


def _call_of(error: BaseException) -> tuple[str, int] | None:
    """Return file and line at which the user's code raised, see `place_of`; None if unknown."""
    calls = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(vars(BaseException)["__traceback__"].__get__(error))
        if _is_foreign(frame.f_code.co_filename)
    ]
    if not calls:
        return None
    user_calls = [call for call in calls if not any(part in call[0] for part in _PACKAGE_FOLDERS)]
    if user_calls:
        return user_calls[-1]
    called_package = _package_of(calls[0][0])
    return [call for call in calls if _package_of(call[0]) == called_package][-1]


HANGS: Final = "hangs"
"""Kind of the fault of a driver that takes too long."""
ENDS_ITS_PROCESS: Final = "ends its process"
"""Kind of the fault of a driver whose process dies while the driver acts."""
IS_KILLED: Final = "is killed"
"""Kind of the fault of a driver whose process is killed in each of two drives on a road: a single
kill may come from the system."""
BREAKS_PROTOCOL: Final = "breaks into its process's descriptors"
"""Kind of the fault of a driver that writes to its process's descriptors, or closes them."""
GIVES_NO_CONTROLS: Final = "gives no usable controls"
"""Kind of the fault of a driver that does not return controls with finite numbers."""
REPORTS: Final = "reports an error"
"""Kind of the fault of a driver's program that says that it cannot go on."""
OWN_KINDS: Final = (
    HANGS,
    ENDS_ITS_PROCESS,
    IS_KILLED,
    BREAKS_PROTOCOL,
    GIVES_NO_CONTROLS,
    REPORTS,
)
"""Kinds of faults that are not the name of an error's class."""


@dataclass(frozen=True)
class Fault:
    """A fault in the code of the driver or the simulator, which ended a drive."""

    part: Literal["driver", "simulator"]
    kind: str
    """Name of the error's class, or one of `OWN_KINDS`."""
    file: str = ""
    """File in which the user's code raised, see `place_of`; empty if unknown."""
    line: int = 0
    """Line in this file; 0 if unknown."""

    @classmethod
    def of(cls, part: Literal["driver", "simulator"], error: BaseException) -> Fault:
        """Return the fault behind an error; for a Frenetic error, behind its cause."""
        if issubclass(type(error), FreneticError) and (cause := _cause_of(error)) is not None:
            error = cause
        file, line = _call_of(error) or ("", 0)
        kinds = {
            ControlsError: GIVES_NO_CONTROLS,
            DriverEndedError: ENDS_ITS_PROCESS,
            DriverLateError: HANGS,
            DriverReportError: REPORTS,
        }
        known = (kinds[known] for known in kinds if issubclass(type(error), known))
        kind = next(known, None) or _class_name(error)
        return cls(part, kind, file and _short_path(file), line)

    def __str__(self) -> str:
        text = self.kind if self.kind in OWN_KINDS else f"raises {self.kind}"
        return f"{text} at {self.file}:{self.line}" if self.file else text

    def is_like(self, other: Fault | None) -> bool:
        """Return whether two faults are equal but for their lines, which edits of a file move."""
        return other is not None and replace(self, line=0) == replace(other, line=0)


@dataclass(frozen=True)
class Trouble:
    """An error that ended a drive: the reason, and the traceback and the fault if known."""

    reason: str
    """The reason, in one line."""
    traceback: str = ""
    """Traceback for the campaign's log, see `traceback_of`; empty if there is none."""
    fault: Fault | None = None
    """The fault in somebody's code; None if unknown."""

    @classmethod
    def of(
        cls,
        error: BaseException,
        part: Literal["driver", "simulator"] = "driver",
        reason: str | None = None,
    ) -> Trouble:
        """Return the trouble of an error in a part's code.

        Args:
            error: the error.
            part: the part whose code raised the error.
            reason: reason of the trouble; None for the error's description.
        """
        text = reason_of(error) if reason is None else reason
        return cls(text, traceback_of(error), Fault.of(part, error))


def _is_foreign(file: str) -> bool:
    """Return whether the code in a file is neither Frenetic's nor Python's nor generated."""
    if file.startswith((_OUR_FOLDER, "<frozen ", "<string>")):  # "<string>" is a dataclass's code
        return False
    # Packages may be installed in a folder of the standard library.
    return not file.startswith(_STANDARD_LIBRARY) or any(part in file for part in _PACKAGE_FOLDERS)


def _package_of(file: str) -> str:
    """Return the folder of the installed package to which a file belongs."""
    for part in _PACKAGE_FOLDERS:
        head, separator, tail = file.partition(part)
        if separator:
            return head + separator + tail.partition(os.sep)[0]
    return str(Path(file).parent)


def _short_path(file: str) -> str:
    """Return a file's path from the entry of `sys.path` from which the file is imported."""
    roots = [f"{root.rstrip(os.sep)}{os.sep}" for root in sys.path if Path(root).is_absolute()]
    longest = max((len(root) for root in roots if file.startswith(root)), default=0)
    return file[longest:][-_MOST_PATH:]


def traceback_of(error: BaseException) -> str:
    """Return the traceback of an error; for a Frenetic error the traceback of its cause.

    Empty for a Frenetic error without a cause.
    """
    if issubclass(type(error), FreneticError):
        if (cause := _cause_of(error)) is None:
            return ""
        error = cause
    try:
        lines = traceback.format_exception(type(error), error, error.__traceback__)
        text = _encodable("".join(lines))
    except BaseException:  # a user's class may raise anything here
        text = f"{describe_error(error)}, without a readable traceback"
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
    """A campaign that cannot be run, resumed, stored or read as asked."""


class CampaignGoneError(CampaignError):
    """A campaign's folder or database was moved, deleted or replaced while it was in use."""

    place: Path | None = None
    """Path of the folder now, with all results; None if unknown, or if the results are gone."""


class BrokenDriverError(CampaignError):
    """A driver that broke on each of the first roads, which ends the search."""


class StrategyError(CampaignError):
    """A strategy that raised, or whose roads are all refused, which ends the search."""


class DriverError(FreneticError):
    """A driver that cannot be loaded, or that broke its contract during a drive."""


class ControlsError(DriverError):
    """A driver that returned no `Controls`, or numbers in them that are not finite."""


class DriverEndedError(DriverError):
    """A driver whose program ended, or closed its output, instead of an answer."""


class DriverLateError(DriverError):
    """A driver whose program took too long for an answer."""


class DriverReportError(DriverError):
    """A driver whose program reports that it cannot go on."""


class UnknownNameError(FreneticError, LookupError):
    """A name that no strategy, driver, simulator or other part is registered under."""


def reason_of(error: BaseException) -> str:
    """Return the message of a Frenetic error, or else one line about an error in a user's code."""
    if issubclass(type(error), FreneticError):
        return _text_of(error, _MOST_MESSAGE)
    return describe_raised(error)
