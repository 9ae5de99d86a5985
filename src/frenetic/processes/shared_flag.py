"""A flag that a child process sets and its parent reads."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
import tempfile
from collections.abc import Callable
from multiprocessing import reduction
from typing import Any


class SharedFlag:
    """A flag that a child sets and this process reads.

    Pass the flag to the child as an argument; there it is a number with a ``value``, see
    `open_flag`. On POSIX this process reads the flag's file instead of mapping it: a driver may
    truncate the file, and reading a map of a truncated file would kill this process.
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
        """Whether the child has set the flag; also True if its file is damaged."""
        if sys.platform == "win32":
            return self._map[0] != 0
        return os.pread(self._file.fileno(), 1, 0) != b"\0"

    def close(self) -> None:
        """Close this process's end of the flag."""
        if sys.platform == "win32":
            self._map.close()
        else:
            self._file.close()


def open_flag(handle: Any) -> Any:
    """Return a `SharedFlag` in the child: a number whose ``value`` the child sets to 0 or 1."""
    if sys.platform == "win32":
        memory = mmap.mmap(-1, 1, tagname=handle)
    else:
        descriptor = handle.detach()
        memory = mmap.mmap(descriptor, 1)
        os.close(descriptor)
    return ctypes.c_byte.from_buffer(memory)
