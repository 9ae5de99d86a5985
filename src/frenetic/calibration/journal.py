"""The state of a fit on disk: what was driven, line by line, so that a killed fit goes on.

The optimiser is never stored: with the same seed it proposes the same candidates again, and those
that are in the journal need no driving. A line is written whole and flushed to the disk before the
next generation is proposed; a torn last line is ignored.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.file_locks import try_to_lock
from frenetic.errors import FreneticError


class Journal:
    """A file of results, by key; a context manager.

    Args:
        path: of the file; None for no file.
        settings: digest of all that the results depend on. A file of other settings is replaced.
    """

    def __init__(self, path: Path | None, settings: str) -> None:
        self._path = path
        self._settings = settings
        self._known: dict[str, FloatArray] = {}
        self._file: Any = None
        self.found = 0
        """Number of results that an earlier call has left."""

    def __enter__(self) -> Self:
        """Reads what is there.

        Raises:
            FreneticError: it cannot be read or written, or another process writes it.
        """
        if self._path is None:
            return self
        head = json.dumps({"settings": self._settings}).encode()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.touch()
            self._file = self._path.open("r+b")
            try_to_lock(self._file.fileno())
            *lines, torn = self._file.read().split(b"\n")
            if lines and lines[0] == head:
                for line in lines[1:]:
                    with suppress(ValueError, KeyError, TypeError):
                        entry = json.loads(line)
                        self._known[str(entry["key"])] = np.array(entry["values"], dtype=np.float64)
                self._file.seek(-len(torn), os.SEEK_END)
                self._file.truncate()
            else:
                self._file.seek(0)
                self._file.truncate()
                self._file.write(head + b"\n")
                self._flush()
            self.found = len(self._known)
        except (BlockingIOError, PermissionError):
            self.close()
            raise FreneticError(
                f"{self._path} is being written by another process, or may not be: wait for that,"
                " or choose another place with --out"
            ) from None
        except OSError as error:
            self.close()
            raise FreneticError(
                f"{self._path} cannot be written: {error.strerror or error}; choose another place"
                " with --out"
            ) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the file, which stays."""
        self.close()

    def close(self) -> None:
        """Closes the file; later results are not kept."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def get(self, key: str, count: int) -> FloatArray | None:
        """The results under a key, (count, ...); None if they are not there."""
        found = self._known.get(key)
        return None if found is None or len(found) != count else found

    def put(self, key: str, values: FloatArray | Sequence[float]) -> None:
        """Stores results under a key."""
        if self._file is not None:
            entry = {"key": key, "values": np.asarray(values).tolist()}
            self._file.write(json.dumps(entry).encode() + b"\n")
            self._flush()

    def remove(self) -> None:
        """Removes the file, when it is no longer needed."""
        if self._path is not None:
            self.close()
            with suppress(OSError):
                self._path.unlink()

    def _flush(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())
