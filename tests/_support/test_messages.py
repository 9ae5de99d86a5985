"""Messages between processes: what was sent comes back, and nothing else is believed."""

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
    MOST_BYTES,
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
def test_frames_come_back_however_the_stream_is_cut(frames: list[Frame], sizes: list[int]) -> None:
    stream = b"".join(map(to_bytes, frames))
    reader = FrameReader()
    received: list[Frame] = []
    while stream:
        for size in sizes:
            received += reader.feed(stream[:size])
            stream = stream[size:]
    assert received == frames


@given(st.binary(min_size=1, max_size=100), FRAMES)
def test_nonsense_between_frames_is_no_frame(nonsense: bytes, frames: list[Frame]) -> None:
    """What came before it is heard; it is refused when a whole frame has come after it."""
    reader = FrameReader()
    received: list[Frame] = []
    with pytest.raises(ProtocolError):  # noqa: PT012
        for frame in frames:
            received += reader.feed(to_bytes(frame))
        received += reader.feed(nonsense + to_bytes(Frame(1, 2, b"three")))
        received += reader.feed(bytes(2**20))
    assert received == frames


@pytest.mark.parametrize("length", [MOST_BYTES + 1, 2**32 - 1])
def test_a_length_beyond_the_bound_is_refused_before_it_comes(length: int) -> None:
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


def test_values_come_back_unchanged() -> None:
    rows = np.arange(6.0).reshape(2, 3)
    there = Answer(rows, np.float64(0.5), Path("a/b"))
    back = decode(encode(there), Answer)
    np.testing.assert_array_equal(back.rows, rows)
    assert (type(back.share), back.share, back.folder) == (float, 0.5, Path("a/b"))


class Bomb:
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
def test_a_message_that_is_no_answer_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError, match="it is not what was asked for"):
        decode(data, Answer)


def test_an_object_that_is_not_plain_is_not_sent() -> None:
    with pytest.raises(TypeError, match="a Bomb cannot be sent"):
        encode(Bomb())


@posix_only
def test_sending_ends_at_its_deadline_if_nobody_listens() -> None:
    ours, theirs = Pipe()
    channel = Channel(ours, blocks=False)
    with theirs, pytest.raises(TimeoutError):
        channel.send(bytes(10**8), deadline=time.monotonic() + 0.01)
    channel.close()


@posix_only
def test_a_channel_knows_when_its_descriptor_is_another(tmp_path: Path) -> None:
    ours, theirs = Pipe()
    channel = Channel(ours, blocks=False)
    before = channel.is_whole
    os.close(channel.handle)
    assert (before, channel.is_whole) == (True, False)
    with (tmp_path / "file").open("w") as file:
        os.dup2(file.fileno(), channel.handle)
        assert not channel.is_whole
        channel.close()  # leaves the other alone
        os.close(channel.handle)
    theirs.close()
