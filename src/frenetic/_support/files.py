"""Files that are written whole or not at all, and read up to a size."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Final, TypeVar

from frenetic.errors import FreneticError

T = TypeVar("T")

MAX_BYTES: Final = 4 * 2**20
"""Largest file of a run, a bench or a calibration that is read, in bytes (our choice)."""
_MAX_NAME: Final = 80
"""Largest number of characters of a file's name in the name of its unfinished copy."""


def open_file(path: Path) -> BufferedReader:
    """Open a file to read its bytes, unless it is a pipe or a device, see `refuse_pipe`.

    Raises:
        OSError: the file is missing or unreadable, or it is a pipe or a device.
        ValueError: the path has a NUL.
    """
    refuse_pipe(path)
    return path.open("rb")


def refuse_pipe(path: Path) -> None:
    """Refuse a pipe or a device, which a process may wait forever to open.

    Pipes under ``/dev`` are allowed: the shell makes and fills them, as for ``<(...)``.

    Raises:
        OSError: there is no such file, or it is a pipe or a device.
        ValueError: the path has a NUL.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or path.is_relative_to("/dev")):
        raise OSError(errno.EINVAL, "it is a pipe or a device, where a file is needed")


def read_bounded(path: Path) -> bytes:
    """Return the content of a file of at most `MAX_BYTES`.

    Raises:
        FreneticError: the file is missing, unreadable or too large.
    """
    try:
        with open_file(path) as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise FreneticError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:  # a ValueError for a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise FreneticError(f"{path} cannot be read: {reason}") from None
    if len(data) > MAX_BYTES:
        raise FreneticError(f"{path} is too large: it has more than {MAX_BYTES} bytes")
    return data


def write_file(
    path: Path | str,
    content: str | bytes,
    *,
    remedy: str,
    error: type[FreneticError] = FreneticError,
    durable: bool = False,
    parents: bool = False,
) -> None:
    """Replace a file whole. A text is written as UTF-8, with its line ends unchanged.

    Args:
        path: path of the file.
        content: the file's whole content.
        remedy: advice to the user if the file cannot be written.
        error: class of the error in that case.
        durable: whether the file must survive a power failure right afterwards.
        parents: whether to make the file's folder and the folders above it.

    Raises:
        FreneticError: the file cannot be written; of the class ``error``.
    """
    path = Path(path)
    try:
        if parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, durable=durable) as partial:
            partial.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    except OSError as reason:
        raise error(f"{path} cannot be written: {reason.strerror or reason}; {remedy}") from None


def check_writable(path: Path, *, remedy: str) -> None:
    """Refuse a file that cannot be written, before its content is computed; write nothing.

    Args:
        path: path of the file.
        remedy: advice to the user if the file cannot be written.

    Raises:
        FreneticError: the file's folder is missing or takes no file, or a folder has its name.
    """
    reason = ""
    try:
        if path.is_dir():
            reason = os.strerror(errno.EISDIR)
        elif not path.parent.is_dir():
            reason = f"there is no folder {path.parent}"
        else:
            partial = _partial(path)
            partial.touch()
            partial.unlink()
    except OSError as error:
        reason = error.strerror or str(error)
    if reason:
        raise FreneticError(f"{path} cannot be written: {reason}; {remedy}")


def require_list(name: str, items: Iterable[T], of: str = "folders") -> tuple[T, ...]:
    """Return the items of a list as a tuple; a single item in place of a list is refused.

    Args:
        name: name of the argument, for the message.
        items: a list or another iterable, which is iterated once. A text is refused, since it
            would be read letter by letter.
        of: plural noun for the items, for the message.

    Raises:
        FreneticError: the argument is a single item.
    """
    if isinstance(items, (str, bytes, os.PathLike)) or not isinstance(items, Iterable):
        single = repr(str(items) if isinstance(items, os.PathLike) else items)
        example = "" if items is None else f", such as [{single}]"
        raise FreneticError(f"{name} is {single}: a list of {of} is needed{example}")
    return tuple(items)


class FolderInUse:
    """A folder that is recognised after somebody moved or deleted it while it was in use.

    Args:
        path: the folder, which has to exist.
    """

    def __init__(self, path: Path) -> None:
        self._handle: int | None = None
        """Descriptor of the folder, wherever it is; None on Windows, or after `close`."""
        self._path = path
        self._opened = path.stat()
        with suppress(OSError):  # Windows cannot open folders, nor move a folder that is in use
            self._handle = os.open(path, os.O_RDONLY)

    def holds(self, name: str, file: os.stat_result) -> bool:
        """Return whether a file is still in the folder, wherever the folder is now.

        Args:
            name: name of the file.
            file: status of the file at its opening, which identifies it.
        """
        with suppress(OSError):
            if self._handle is None:
                return os.path.samestat((self._path / name).stat(), file)
            return os.path.samestat(os.stat(name, dir_fd=self._handle), file)
        return False

    def fate(self) -> str:
        """Return what happened to the folder, such as ``was moved to PATH``; empty for nothing."""
        with suppress(OSError):
            if os.path.samestat(self._path.stat(), self._opened):
                return ""
        if self._handle is None:
            return "was moved or deleted"
        path = self.place()
        if path is not None:
            return f"was moved to {path}"
        return "was moved" if os.fstat(self._handle).st_nlink > 0 else "was deleted"

    def place(self) -> Path | None:
        """Return the folder's present path; None if deleted, or without Linux's /proc."""
        with suppress(OSError):
            path = Path(f"/proc/self/fd/{self._handle}").readlink()
            if os.path.samestat(path.stat(), self._opened):
                return path
        return None

    def close(self) -> None:
        """Close the handle of the folder; closing twice does no harm."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def __del__(self) -> None:
        self.close()


@contextmanager
def replacing(path: Path, *, durable: bool = False) -> Iterator[Path]:
    """Yield the path of a new file beside ``path``, which replaces ``path`` at the end.

    If the context raises anything, the old file stays and the new file is removed.

    Args:
        path: path of the file.
        durable: whether the new file must survive a power failure right afterwards.

    Raises:
        OSError: the file cannot be written.
    """
    partial = _partial(path)
    try:
        yield partial
        if durable:
            flush(partial)
        partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def _partial(path: Path) -> Path:
    """Return the path of a file's unfinished copy, beside the file."""
    return path.with_name(f".{path.name[:_MAX_NAME]}-{os.getpid()}.part")


def flush(path: Path) -> None:
    """Flush a file from the system's memory to the disk.

    Raises:
        OSError: the disk does not take the file.
    """
    file = os.open(path, os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)
