"""Messages of a process in which foreign code runs: framed, bounded and typed.

The receiving process trusts nothing: a frame has a mark, a length below a bound and a checksum, and
its body is decoded as the expected type. Nothing is unpickled.

| bytes | of a frame |
| --- | --- |
| 4 | mark |
| 1 | kind of the message |
| 4 | number of the call to which the message belongs |
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

MAX_FOREIGN_BYTES: Final = 1 << 28
"""Longest body of a message from foreign code, in bytes: a drive of 42 hours (our choice)."""
MAX_OWN_BYTES: Final = (1 << 32) - 1
"""Longest body of a message to foreign code, in bytes: as the length's 4 bytes allow."""
_MARK: Final = b"\xf7Frn"
"""First bytes of each frame."""
_FIELDS: Final = struct.Struct("<BII")
"""Kind, number and length in the header."""
_CHECKSUM: Final = struct.Struct("<I")
"""Checksum in the header."""
_HEADER_SIZE: Final = len(_MARK) + _FIELDS.size + _CHECKSUM.size
"""Length of the header, in bytes."""
_READ_SIZE: Final = 1 << 20
"""Largest number of bytes that are read at once (our choice)."""
_MAX_WAIT: Final = 3600.0
"""Longest wait for room to write in one call of the system, in s; longer waits repeat it."""
_DTYPES: Final = frozenset({"<f8", "<i8", "|u1", "|b1"})
"""Types of arrays that can be received: float64, int64, bytes and truth values."""


class ProtocolError(Exception):
    """Bytes that are no message, or an unexpected message."""


class Frame(NamedTuple):
    """A message whose body is not decoded yet."""

    kind: int
    """Kind of the message, from 0 to 255; its meaning is the caller's."""
    number: int
    """Number of the message's call, from 0."""
    body: bytes


def to_bytes(frame: Frame, max_bytes: int = MAX_FOREIGN_BYTES) -> bytes:
    """Return the bytes of a frame.

    Args:
        frame: the frame.
        max_bytes: longest body allowed, in bytes.

    Raises:
        ValueError: the body is too long.
    """
    if len(frame.body) > max_bytes:
        raise ValueError(f"a message has {len(frame.body)} bytes: at most {max_bytes} are allowed")
    fields = _FIELDS.pack(frame.kind, frame.number, len(frame.body))
    checksum = _CHECKSUM.pack(zlib.crc32(frame.body, zlib.crc32(fields)))
    return b"".join((_MARK, fields, checksum, frame.body))


class FrameReader:
    """A buffer that cuts a stream of bytes into frames.

    Its memory grows with the received bytes, not with the length that a frame claims.

    Args:
        max_bytes: longest body allowed, in bytes.
    """

    def __init__(self, max_bytes: int = MAX_FOREIGN_BYTES) -> None:
        self._max_bytes = max_bytes
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Yield the frames that further bytes complete.

        Raises:
            ProtocolError: the bytes are no frame.
        """
        self._buffer += data
        while (frame := self._take_frame()) is not None:
            yield frame

    def _take_frame(self) -> Frame | None:
        """Remove the first frame from the buffer and return it; None if it is not complete.

        Raises:
            ProtocolError: the buffer does not begin with a frame.
        """
        mark = bytes(self._buffer[: len(_MARK)])
        if not _MARK.startswith(mark):
            raise ProtocolError("it is no message")
        if len(self._buffer) < _HEADER_SIZE:
            return None
        fields = bytes(self._buffer[len(_MARK) : len(_MARK) + _FIELDS.size])
        kind, number, length = _FIELDS.unpack(fields)
        if length > self._max_bytes:
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
        TypeError: the value holds an object of another type.
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
    except Exception as error:  # of decoder, hook or class, for foreign bytes
        raise ProtocolError(f"it is not what was asked for: {error}") from error


@cache
def _decoder(kind: Any) -> msgpack.Decoder[Any]:
    return msgpack.Decoder(kind, dec_hook=_from_plain)


def _as_plain(value: Any) -> Any:
    """Return a numpy value or path in types that MessagePack knows.

    Raises:
        TypeError: the value has another type.
    """
    if is_numpy_scalar(value):
        return value.item()
    if type(value).__module__ == "numpy" and hasattr(value, "dtype"):
        return [value.dtype.str, value.shape, value.tobytes()]
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"a {type(value).__name__} cannot be sent to another process")


def _from_plain(kind: Any, value: Any) -> Any:
    """Return the array or path that `_as_plain` made plain.

    Raises:
        ValueError: the value is no array of `_DTYPES`.
    """
    if isinstance(kind, type) and issubclass(kind, PurePath):
        return kind(value)
    import numpy as np  # imports slowly

    dtype, shape, data = value
    if dtype not in _DTYPES or not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError(f"an array of {dtype} cannot be received")
    return np.frombuffer(data, dtype).reshape(shape)


# Sending and receiving bytes


class Channel:
    """One end of the connection between two processes.

    Processes that this one starts do not inherit it. On POSIX it is a socket, on Windows a pipe.

    Args:
        connection: the connection; on POSIX it is closed, and the channel has its own descriptor.
        blocks: whether `receive` waits until bytes have come.
    """

    def __init__(self, connection: Connection, *, blocks: bool) -> None:
        self._blocks = blocks
        if sys.platform == "win32":
            self._connection = connection
        else:
            self._descriptor = os.dup(connection.fileno())  # a copy that no program inherits
            connection.close()
            os.set_blocking(self._descriptor, blocks)
            self._identity = _identity(self._descriptor)

    @property
    def handle(self) -> Any:
        """Object for which `multiprocessing.connection.wait` can wait: bytes have come."""
        if sys.platform == "win32":
            return self._connection
        return self._descriptor

    @property
    def is_whole(self) -> bool:
        """Whether the descriptor is open and still belongs to this connection.

        Foreign code in this process may have closed it, and its number may have been reused.
        """
        if sys.platform == "win32":
            return not self._connection.closed
        try:
            return _identity(self._descriptor) == self._identity
        except OSError:
            return False

    def receive(self) -> bytes:
        """Return some of the bytes that have come; empty if there are none and it does not block.

        Raises:
            EOFError: the other end is closed.
            OSError: this end is closed.
        """
        if sys.platform == "win32":
            if not self._blocks and not self._connection.poll():
                return b""
            return self._connection.recv_bytes(MAX_OWN_BYTES)
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
        """Send bytes, and wait until the other end takes them.

        Args:
            data: whole frames.
            deadline: time of `time.monotonic` until which to wait, in s; not kept on Windows.

        Raises:
            TimeoutError: the other end has not taken the bytes by the deadline.
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
    """Return device and inode of a descriptor, which identify the connection."""
    status = os.fstat(descriptor)
    return status.st_dev, status.st_ino


def _await_room(descriptor: int, seconds: float) -> bool:
    """Wait until a descriptor takes bytes, for some seconds; return whether to try again."""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_WRITE)
        has_room = bool(selector.select(max(0.0, min(seconds, _MAX_WAIT))))
    return has_room or seconds > _MAX_WAIT
