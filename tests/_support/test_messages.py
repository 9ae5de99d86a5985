"""Messages between processes: sent values arrive unchanged, anything else is refused."""

from __future__ import annotations

import os
import pickle
import struct
import sys
import time
from dataclasses import dataclass
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Share
from frenetic._support.messages import (
    MAX_FOREIGN_BYTES,
    Channel,
    Frame,
    FrameReader,
    ProtocolError,
    decode,
    encode,
    to_bytes,
)

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX descriptors")

FRAMES = st.lists(
    st.builds(Frame, st.integers(0, 255), st.integers(0, 2**32 - 1), st.binary(max_size=300)),
    max_size=5,
)


@given(FRAMES, st.lists(st.integers(1, 40), min_size=1))
def test_frames_arrive_however_the_stream_is_cut(frames: list[Frame], sizes: list[int]) -> None:
    stream = b"".join(map(to_bytes, frames))
    reader = FrameReader()
    received: list[Frame] = []
    while stream:
        for size in sizes:
            received += reader.feed(stream[:size])
            stream = stream[size:]
    assert received == frames


@given(st.binary(min_size=1, max_size=100), FRAMES)
def test_nonsense_between_frames_is_refused(nonsense: bytes, frames: list[Frame]) -> None:
    """The reader returns earlier frames, and refuses the stream at the next whole frame."""
    reader = FrameReader()
    received: list[Frame] = []
    with pytest.raises(ProtocolError):  # noqa: PT012
        for frame in frames:
            received += reader.feed(to_bytes(frame))
        received += reader.feed(nonsense + to_bytes(Frame(1, 2, b"three")))
        received += reader.feed(bytes(2**20))
    assert received == frames


@pytest.mark.parametrize("length", [MAX_FOREIGN_BYTES + 1, 2**32 - 1])
def test_a_too_long_frame_is_refused_by_its_header(length: int) -> None:
    with pytest.raises(ProtocolError, match=f"claims {length} bytes"):
        list(FrameReader().feed(b"\xf7Frn" + struct.pack("<BIII", 1, 2, length, 0)))


def test_a_changed_byte_is_refused() -> None:
    data = bytearray(to_bytes(Frame(1, 2, b"three")))
    data[-1] ^= 1
    with pytest.raises(ProtocolError, match="checksum"):
        list(FrameReader().feed(bytes(data)))


@dataclass(frozen=True)
class Answer:
    rows: FloatArray
    share: Share = 0.0
    folder: Path = Path()


def test_values_arrive_unchanged() -> None:
    rows = np.arange(6.0).reshape(2, 3)
    answer = Answer(rows, np.float64(0.5), Path("a/b"))
    decoded = decode(encode(answer), Answer)
    np.testing.assert_array_equal(decoded.rows, rows)
    assert (type(decoded.share), decoded.share, decoded.folder) == (float, 0.5, Path("a/b"))


class Bomb:
    """An object that ends the process that unpickles it."""

    def __reduce__(self) -> Any:
        return os._exit, (9,)


@pytest.mark.parametrize(
    "data",
    [
        pickle.dumps(Bomb()),
        b"",
        b"\xc1",
        b"\x81" * 100_000,
        encode({"rows": ["<f8", [2], b"12345678"]}),
        encode({"rows": ["<f8", [-1], b"12345678"]}),
        encode({"rows": ["<f8", [2**40, 2**40], b""]}),
        encode({"rows": ["|O", [1], b"12345678"]}),
        encode({"rows": 1}),
        encode({"rows": ["<f8", [1], b"12345678"], "share": 2.0}),
        encode([1, 2]),
    ],
)
def test_a_message_of_another_type_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError, match="it is not what was asked for"):
        decode(data, Answer)


def test_an_object_that_is_not_plain_is_not_sent() -> None:
    with pytest.raises(TypeError, match="a Bomb cannot be sent"):
        encode(Bomb())


@posix_only
def test_sending_ends_at_its_deadline_if_nobody_reads() -> None:
    sender, receiver = Pipe()
    channel = Channel(sender, blocks=False)
    with receiver, pytest.raises(TimeoutError):
        channel.send(bytes(10**8), deadline=time.monotonic() + 0.01)
    channel.close()


@posix_only
def test_a_channel_notices_that_its_descriptor_was_replaced(tmp_path: Path) -> None:
    sender, receiver = Pipe()
    channel = Channel(sender, blocks=False)
    before = channel.is_whole
    os.close(channel.handle)
    assert (before, channel.is_whole) == (True, False)
    with (tmp_path / "file").open("w") as file:
        os.dup2(file.fileno(), channel.handle)
        assert not channel.is_whole
        channel.close()  # does not close the other file
        os.close(channel.handle)
    receiver.close()
