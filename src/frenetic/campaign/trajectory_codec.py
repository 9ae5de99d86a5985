"""Codec of trajectories: a few kilobytes for every drive in a campaign's database.

A trajectory is smooth and sampled 20 times a second, so its second differences are small. `encode`
rounds each column to its resolution, takes differences, and compresses them. `decode` returns the
rounded values, each within half a resolution of the original; encoding them again gives the same
bytes.

| columns | resolution | stored as |
| --- | --- | --- |
| time | 0.1 ms | second differences |
| x, y | 0.1 mm | second differences |
| heading | 1e-5 rad | second differences |
| speed, lateral_speed | 1 mm/s | second differences |
| yaw_rate, steering | 1e-4 rad/s, 1e-4 rad | second differences |
| steering_input | 1e-4 rad | first differences (a driver holds and jumps) |
| throttle, brake | 0.001 | first differences |

A point of the car's box moves by less than 0.2 mm, so an oracle that judges the stored trajectory
finds the oob distances that it found in the original one, to well within 1 mm.

Layout, all numbers little-endian: CRC-32 of the rest (4 bytes), number of records n (4 bytes),
number of columns k (1 byte), bytes per difference (1 byte), for each column its index in
`RESOLUTIONS` (1 byte), then one zlib stream of the differences, the first of which are from 0. The
differences are zigzag-coded (the sign in the lowest bit) and ordered byte by byte: first the lowest
bytes of all differences, then the next higher bytes and so on, so that the high bytes, which are
mostly 0, follow each other.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Trajectory

MAX_RECORDS: Final = 1_000_000
"""Number of records of the longest trajectory that is stored: almost 14 hours at 20 Hz."""

RESOLUTIONS: Final = {
    "time": 1e-4,  # [s]
    "x": 1e-4,  # [m]
    "y": 1e-4,  # [m]
    "heading": 1e-5,  # [rad]
    "speed": 1e-3,  # [m/s]
    "lateral_speed": 1e-3,  # [m/s]
    "yaw_rate": 1e-4,  # [rad/s]
    "steering": 1e-4,  # [rad]
    "steering_input": 1e-4,  # [rad]
    "throttle": 1e-3,  # share
    "brake": 1e-3,  # share
}
"""Column -> the step to which its values are rounded, in the column's own unit.

A stored trajectory names its columns by their indices here, so a new column comes at the end."""

_HEADER: Final = struct.Struct("<IBB")
_CRC: Final = struct.Struct("<I")
_COLUMN_INDICES: Final = bytes(range(len(RESOLUTIONS)))
_ZLIB_LEVEL: Final = 1  # our choice: the highest levels save 5 % of the bytes at twice the time
_COLUMN_COUNT: Final = len(RESOLUTIONS)
_SMOOTH_COUNT: Final = 8
"""Number of columns that are stored as second differences; the others are stored as first ones."""
_STEPS_PER_UNIT: Final = np.rint(1.0 / np.array(list(RESOLUTIONS.values())))[:, np.newaxis]
_MOST_STEPS: Final = 2.0**51
"""Largest value in steps of a resolution: up to it a float64 is exact to half a step."""

assert tuple(RESOLUTIONS) == Trajectory.names()

_Steps = npt.NDArray[np.int64]  # (11, n), values in units of their column's resolution


def encode(trajectory: Trajectory) -> bytes:
    """Return the trajectory as a few kilobytes, rounded to `RESOLUTIONS`.

    Raises:
        ValueError: a value is NaN, infinite or beyond 2**51 steps (2e11 m for a position), or there
            are more than `MAX_RECORDS` records.
    """
    count = len(trajectory)
    if count > MAX_RECORDS:
        raise ValueError(f"the trajectory has {count} records: at most {MAX_RECORDS} can be stored")
    differences = np.diff(_to_steps(trajectory), axis=1, prepend=0)
    differences[:_SMOOTH_COUNT] = np.diff(differences[:_SMOOTH_COUNT], axis=1, prepend=0)
    # Zigzag: 0, -1, 1, -2 .. become 0, 1, 2, 3 .., so that differences near 0 have few bytes.
    codes = ((differences << 1) ^ (differences >> 63)).astype("<u8", copy=False)
    width = (int(codes.max(initial=0)).bit_length() + 7) // 8
    planes = codes.view(np.uint8).reshape(_COLUMN_COUNT, count, 8)[..., :width].transpose(2, 0, 1)
    data = _HEADER.pack(count, _COLUMN_COUNT, width) + _COLUMN_INDICES + _compress(planes.tobytes())
    return _CRC.pack(zlib.crc32(data)) + data


def decode(data: bytes) -> Trajectory:
    """Return the trajectory in `data`.

    Raises:
        CampaignError: `data` is not what `encode` writes.
    """
    return Trajectory(*decode_columns(data))


def rounded(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory that `decode(encode(trajectory))` would return, bit for bit.

    Raises:
        ValueError: a value is NaN, infinite or out of range, see `encode`.
    """
    return Trajectory(*(_to_steps(trajectory) / _STEPS_PER_UNIT))


def decode_columns(data: bytes) -> FloatArray:
    """Return the columns in `data`, (11, n), in the order of `RESOLUTIONS`.

    Raises:
        CampaignError: `data` is not what `encode` writes.
    """
    content = data[_CRC.size :]
    if len(content) < _HEADER.size or zlib.crc32(content) != _CRC.unpack_from(data)[0]:
        raise CampaignError("a stored trajectory is damaged: it does not match its checksum")
    count, column_count, width = _HEADER.unpack_from(content)
    stream_start = _HEADER.size + column_count
    indices, stream = content[_HEADER.size : stream_start], content[stream_start:]
    if indices != _COLUMN_INDICES:
        raise CampaignError(
            f"a stored trajectory has the columns {list(indices)}, this version of frenetic reads"
            f" {list(_COLUMN_INDICES)}: another one wrote it"
        )
    if count > MAX_RECORDS or width > 8:
        raise CampaignError(
            f"a stored trajectory is damaged: it claims {count} records of {width} bytes"
        )
    body = np.frombuffer(_decompress(stream, _COLUMN_COUNT * count * width), np.uint8)
    planes = np.zeros((_COLUMN_COUNT, count, 8), np.uint8)
    planes[..., :width] = body.reshape(width, _COLUMN_COUNT, count).transpose(1, 2, 0)
    codes = planes.view("<u8")[..., 0].astype(np.uint64, copy=False)
    steps = (codes >> np.uint64(1)).view(np.int64) ^ -(codes & np.uint64(1)).view(np.int64)
    # Damaged data may overflow here: numpy's integers wrap around silently, and are checked below.
    np.cumsum(steps[:_SMOOTH_COUNT], axis=1, out=steps[:_SMOOTH_COUNT])
    np.cumsum(steps, axis=1, out=steps)
    if count and max(-int(steps.min()), int(steps.max())) > _MOST_STEPS:
        raise CampaignError("a stored trajectory is damaged: a value is out of range")
    columns: FloatArray = steps / _STEPS_PER_UNIT
    return columns


def _to_steps(trajectory: Trajectory) -> _Steps:
    """Return the columns as whole numbers of steps of their resolutions, (11, n).

    Raises:
        ValueError: a value is NaN, infinite or out of range.
    """
    columns = np.array([getattr(trajectory, name) for name in RESOLUTIONS])
    with np.errstate(over="ignore"):
        columns *= _STEPS_PER_UNIT
    # A NaN makes both extremes NaN, for which the comparisons are false.
    if columns.size and not (columns.min() >= -_MOST_STEPS and columns.max() <= _MOST_STEPS):
        is_bad = ~(np.abs(columns) <= _MOST_STEPS)
        k, record = np.argwhere(is_bad)[0]
        name = tuple(RESOLUTIONS)[k]
        raise ValueError(
            f"{name} of record {record} is {getattr(trajectory, name)[record]}: "
            f"a finite number below {_MOST_STEPS * RESOLUTIONS[name]:.0e} is needed"
        )
    steps: _Steps = np.rint(columns, out=columns).astype(np.int64)
    return steps


def _compress(data: bytes) -> bytes:
    """Return a zlib stream of `data`."""
    # A small window and few symbols per block need 40 KiB of working memory instead of 256 KiB. The
    # C library would get these from the system and return them each time, which takes twice as long
    # as compressing. A larger window would save nothing: a trajectory is about 10 kB.
    stream = zlib.compressobj(_ZLIB_LEVEL, zlib.DEFLATED, wbits=13, memLevel=7)
    return stream.compress(data) + stream.flush()


def _decompress(data: bytes, size: int) -> bytes:
    """Return the `size` bytes that are compressed in the zlib stream `data`.

    Raises:
        CampaignError: `data` is no whole stream, or holds another number of bytes.
    """
    stream = zlib.decompressobj()
    try:
        # One byte more than expected: so a stream that is too long is noticed, and a stream of the
        # right length is read to its end, where zlib compares the checksum.
        body = stream.decompress(data, size + 1)
    except zlib.error as error:
        raise CampaignError(f"a stored trajectory is damaged: {error}") from error
    if len(body) != size or not stream.eof or stream.unused_data:
        raise CampaignError(
            f"a stored trajectory is damaged: its records do not fill the {size} bytes they claim"
        )
    return body
