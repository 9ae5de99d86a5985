"""Messages of a process in which foreign code runs: framed, bounded and typed.

The receiving process trusts nothing: a frame has a mark, a length below a bound and a checksum, and
its body is decoded as the expected type. Nothing is unpickled.

| bytes | of a frame |
| --- | --- |
| 4 | mark |
| 1 | kind of the message |
| 4 | number of the call that it belongs to |
| 4 | length of the body |
| 4 | CRC-32 of kind, number, length and body |
| length | body, in MessagePack |

All numbers are little-endian. An array is a list of dtype, shape and raw bytes.
"""

from __future__ import annotations

import os
import selectors
import struct
import sys
import time
import zlib
from collections.abc import Iterator
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import PurePath
from typing import Any, Final, NamedTuple

from msgspec import msgpack

from frenetic._support.scalars import is_numpy_scalar

MOST_BYTES: Final = 1 << 28
"""Longest body of a message from foreign code, in bytes: a drive of 42 hours."""
MOST_BYTES_OF_OURS: Final = (1 << 32) - 1
"""Longest body of a message to foreign code, in bytes: a driver with its network, say."""
_MARK: Final = b"\xf7Frn"
_FIELDS: Final = struct.Struct("<BII")  # kind, number, length
_CHECKSUM: Final = struct.Struct("<I")
_HEADER_SIZE: Final = len(_MARK) + _FIELDS.size + _CHECKSUM.size
_READ_SIZE: Final = 1 << 20  # bytes that are read at once
_LONGEST_WAIT: Final = 3600.0  # [s] for room to write, before the deadline is looked at again
_DTYPES: Final = frozenset({"<f8", "<i8", "|u1", "|b1"})  # of arrays


class ProtocolError(Exception):
    """Bytes that are no message, or an unexpected message."""


class Frame(NamedTuple):
    """A message with an undecoded body."""

    kind: int
    number: int
    """Number of the message's call, from 0."""
    body: bytes


def to_bytes(frame: Frame, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the bytes of a frame.

    Raises:
        ValueError: the body is too long.
    """
    if len(frame.body) > most_bytes:
        raise ValueError(f"a message has {len(frame.body)} bytes: at most {most_bytes} are allowed")
    fields = _FIELDS.pack(frame.kind, frame.number, len(frame.body))
    checksum = _CHECKSUM.pack(zlib.crc32(frame.body, zlib.crc32(fields)))
    return b"".join((_MARK, fields, checksum, frame.body))


class FrameReader:
    """A buffer that cuts a stream of bytes into frames.

    Its memory grows with the bytes that have come, not with the length that a frame claims.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Return the frames that these bytes complete.

        Raises:
            ProtocolError: the bytes are no frame.
        """
        self._buffer += data
        while (frame := self._first()) is not None:
            yield frame

    def _first(self) -> Frame | None:
        """Remove the first frame from the buffer and return it; None if it is not complete."""
        mark = bytes(self._buffer[: len(_MARK)])
        if not _MARK.startswith(mark):
            raise ProtocolError("it is no message")
        if len(self._buffer) < _HEADER_SIZE:
            return None
        fields = bytes(self._buffer[len(_MARK) : len(_MARK) + _FIELDS.size])
        kind, number, length = _FIELDS.unpack(fields)
        if length > self._most_bytes:
            raise ProtocolError(f"it claims {length} bytes")
        end = _HEADER_SIZE + length
        if len(self._buffer) < end:
            return None
        (checksum,) = _CHECKSUM.unpack_from(self._buffer, len(_MARK) + _FIELDS.size)
        body = bytes(self._buffer[_HEADER_SIZE:end])
        del self._buffer[:end]
        if zlib.crc32(body, zlib.crc32(fields)) != checksum:
            raise ProtocolError("its checksum is wrong")
        return Frame(kind, number, body)


# Bodies


def encode(value: object) -> bytes:
    """Return a value of plain types, dataclasses and arrays as bytes.

    Raises:
        TypeError: the value holds something else.
        ValueError: the value holds a number or text that MessagePack cannot hold.
    """
    return msgpack.encode(value, enc_hook=_as_plain)


def decode(data: bytes, kind: Any) -> Any:
    """Return the value of the given type in bytes from `encode`.

    Raises:
        ProtocolError: the bytes are not MessagePack, or a value is of another type or out of its
            bounds.
    """
    try:
        return _decoder(kind).decode(data)
    except Exception as error:  # of the decoder, a hook or a class: the bytes are not ours
        raise ProtocolError(f"it is not what was asked for: {error}") from error


@cache
def _decoder(kind: Any) -> msgpack.Decoder[Any]:
    return msgpack.Decoder(kind, dec_hook=_from_plain)


def _as_plain(value: Any) -> Any:
    if is_numpy_scalar(value):
        return value.item()
    if type(value).__module__ == "numpy" and hasattr(value, "dtype"):
        return [value.dtype.str, value.shape, value.tobytes()]
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"a {type(value).__name__} cannot be sent to another process")


def _from_plain(kind: Any, value: Any) -> Any:
    if isinstance(kind, type) and issubclass(kind, PurePath):
        return kind(value)
    import numpy as np  # it takes its time

    dtype, shape, data = value
    if dtype not in _DTYPES or not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError(f"an array of {dtype} cannot be received")
    return np.frombuffer(data, dtype).reshape(shape)


# Sending and receiving bytes


class Channel:
    """One end of the connection between two processes.

    No process that this one starts inherits it. On POSIX it is a socket, on Windows a pipe.

    Args:
        connection: closed, in favour of a descriptor of its own.
        blocks: whether `receive` waits until something is there.
    """

    def __init__(self, connection: Connection, *, blocks: bool) -> None:
        self._blocks = blocks
        if sys.platform == "win32":
            self._connection = connection
        else:
            self._descriptor = os.dup(connection.fileno())  # which no program inherits
            connection.close()
            os.set_blocking(self._descriptor, blocks)
            self._identity = _identity(self._descriptor)

    @property
    def handle(self) -> Any:
        """Argument of `multiprocessing.connection.wait` that waits for bytes."""
        if sys.platform == "win32":
            return self._connection
        return self._descriptor

    @property
    def is_whole(self) -> bool:
        """Whether the descriptor is open and still belongs to this connection."""
        if sys.platform == "win32":
            return not self._connection.closed
        try:
            return _identity(self._descriptor) == self._identity
        except OSError:
            return False

    def receive(self) -> bytes:
        """Return some of the bytes that have come; empty if none have and it does not block.

        Raises:
            EOFError: the other end is closed.
            OSError: this end is closed.
        """
        if sys.platform == "win32":
            if not self._blocks and not self._connection.poll():
                return b""
            return self._connection.recv_bytes(MOST_BYTES_OF_OURS)
        while True:
            try:
                data = os.read(self._descriptor, _READ_SIZE)
            except BlockingIOError:
                if not self._blocks:
                    return b""
                wait([self._descriptor])
                continue
            if not data:
                raise EOFError
            return data

    def send(self, data: bytes, deadline: float = float("inf")) -> None:
        """Send bytes; on Windows they wait until the other end takes them.

        Args:
            data: whole frames.
            deadline: s on the monotonic clock.

        Raises:
            TimeoutError: the other end has not taken them by then.
            OSError: an end is closed.
        """
        if sys.platform == "win32":
            self._connection.send_bytes(data)
            return
        unsent = memoryview(data)
        while unsent:
            try:
                unsent = unsent[os.write(self._descriptor, unsent) :]
            except BlockingIOError:
                if not _await_room(self._descriptor, deadline - time.monotonic()):
                    raise TimeoutError from None

    def close(self) -> None:
        """Close this end, unless its descriptor belongs to something else by now."""
        if sys.platform == "win32":
            self._connection.close()
        elif self.is_whole:
            os.close(self._descriptor)


def _identity(descriptor: int) -> tuple[int, int]:
    """Return device and inode behind a descriptor, which identify the connection."""
    status = os.fstat(descriptor)
    return status.st_dev, status.st_ino


def _await_room(descriptor: int, seconds: float) -> bool:
    """Wait until a descriptor takes bytes; return whether to try to write again."""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_WRITE)
        return (
            bool(selector.select(max(0.0, min(seconds, _LONGEST_WAIT)))) or seconds > _LONGEST_WAIT
        )
