"""Copies of drivers and simulators for other processes."""

from __future__ import annotations

import io
import pickle
from functools import partial
from typing import Any

from frenetic.errors import CampaignError, describe_error
from frenetic.registry import made_by


def pack(part: object, known: object = None) -> bytes:
    """A part as bytes for a process that has loaded the user's files.

    What cannot be pickled, such as a loaded network, is made anew there, if it was made by name.

    Args:
        part: a driver, a simulator, or what holds them.
        known: a part of it that the other process has already.

    Raises:
        CampaignError: it cannot be copied.
    """
    try:
        return _pickled(part, known, by_name=False)
    except Exception as error:
        with_names = _or_none(part, known)
        if with_names is None:
            raise CampaignError(
                "the driver or simulator cannot be copied to another process"
                f" ({describe_error(error)}): define it in a module of its own, or drive it in this"
                " process, with a Campaign of objects and one worker"
            ) from error
        return with_names


def unpack(data: bytes, known: object = None) -> Any:
    """The part in bytes from `pack`; any error for other bytes."""
    return _Unpickler(data, known).load()


def _or_none(part: object, known: object) -> bytes | None:
    try:
        return _pickled(part, known, by_name=True)
    except Exception:
        return None


def _pickled(part: object, known: object, *, by_name: bool) -> bytes:
    file = io.BytesIO()
    _Pickler(file, known, by_name).dump(part)
    return file.getvalue()


class _Pickler(pickle.Pickler):
    """Leaves out a known part, and writes the names of others."""

    def __init__(self, file: io.BytesIO, known: object, by_name: bool) -> None:
        super().__init__(file)
        self._known = known
        self._by_name = by_name

    def persistent_id(self, part: object) -> str | None:
        return "known" if part is self._known and part is not None else None

    def reducer_override(self, part: object) -> Any:
        made = made_by(part) if self._by_name else None
        if made is None:
            return NotImplemented
        return partial(made.factory, **made.arguments), ()


class _Unpickler(pickle.Unpickler):
    """Puts the known part in its place; the bytes come from our own process."""

    def __init__(self, data: bytes, known: object) -> None:
        super().__init__(io.BytesIO(data))
        self._known = known

    def persistent_load(self, pid: str) -> object:  # noqa: ARG002 - there is one
        return self._known
