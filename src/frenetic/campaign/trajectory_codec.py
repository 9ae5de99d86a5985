"""Codec of trajectories: a few kilobytes for every drive in a campaign's database.

A trajectory is smooth and sampled 20 times a second, so its second differences are small. `encode`
rounds each column to its resolution, takes differences, and packs them by Rice's code, see
`frenetic.campaign.rice_code`. `decode` returns the rounded values, each within half a resolution of
the original; encoding them again gives the same bytes.

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
number of columns k (1 byte), for each column its index in `RESOLUTIONS` (1 byte), then the packed
differences.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.campaign.rice_code import OUT_OF_RANGE, pack, round_columns, unpack
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

_HEADER: Final = struct.Struct("<IB")
_CRC: Final = struct.Struct("<I")
_COLUMN_INDICES: Final = bytes(range(len(RESOLUTIONS)))
_COLUMN_COUNT: Final = len(RESOLUTIONS)
_SMOOTH_COUNT: Final = 8
"""Number of columns that are stored as second differences; the others are stored as first ones."""
_STEPS_PER_UNIT: Final = np.rint(1.0 / np.array(list(RESOLUTIONS.values())))
_MOST_STEPS: Final = 2.0**51
"""Largest value in steps of a resolution: up to it a float64 is exact to half a step."""

assert tuple(RESOLUTIONS) == Trajectory.names()


def encode(trajectory: Trajectory) -> bytes:
    """Return the trajectory as a few kilobytes, rounded to `RESOLUTIONS`.

    Raises:
        ValueError: a value is NaN, infinite or beyond 2**51 steps (2e11 m for a position), or there
            are more than `MAX_RECORDS` records.
    """
    return _pack(to_steps(trajectory))


def encode_and_round(trajectory: Trajectory) -> tuple[bytes, Trajectory]:
    """Return ``encode(trajectory)`` and ``rounded(trajectory)``, in less time.

    Raises:
        ValueError: a value is NaN, infinite or out of range, or there are too many records, see
            `encode`.
    """
    steps = to_steps(trajectory)
    return _pack(steps), _of_steps(steps)


def decode(data: bytes) -> Trajectory:
    """Return the trajectory in `data`.

    Raises:
        CampaignError: `data` is not what `encode` writes.
    """
    return Trajectory.of_block(decode_columns(data))


def rounded(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory that `decode(encode(trajectory))` would return, bit for bit.

    Raises:
        ValueError: a value is NaN, infinite or out of range, see `encode`.
    """
    return _of_steps(to_steps(trajectory))


def check_packed(data: bytes, records: int | None) -> None:
    """Check that `data` is unchanged since `encode` wrote it, without decoding it.

    Args:
        data: the packed trajectory.
        records: number of records that it should hold.

    Raises:
        CampaignError: the data are damaged, or hold another number of records.
    """
    count, _ = _count_and_packed(data)
    if count != records:
        raise CampaignError(f"a stored trajectory has {count} records, not {records}")


def decode_columns(data: bytes) -> FloatArray:
    """Return the columns in `data`, (11, n), in the order of `RESOLUTIONS`.

    Raises:
        CampaignError: `data` is not what `encode` writes.
    """
    count, packed = _count_and_packed(data)
    # Whole words of 4 bytes, and 8 zeros, which the kernel may read.
    words = np.frombuffer(packed.ljust(4 * ((len(packed) + 3) // 4) + 8, b"\0"), "<u4")
    words = words.astype(np.uint32, copy=False)
    answer, columns = unpack(
        words, len(packed), count, _STEPS_PER_UNIT, _SMOOTH_COUNT, int(_MOST_STEPS)
    )
    if answer == OUT_OF_RANGE:
        raise CampaignError("a stored trajectory is damaged: a value is out of range")
    if answer:
        raise CampaignError(
            f"a stored trajectory is damaged: its {len(packed)} bytes do not hold {count} records"
        )
    return columns


def _count_and_packed(data: bytes) -> tuple[int, bytes]:
    """Return the number of records in `data`, and their packed differences.

    Raises:
        CampaignError: the checksum or the header is not what `encode` writes.
    """
    content = data[_CRC.size :]
    if len(content) < _HEADER.size or zlib.crc32(content) != _CRC.unpack_from(data)[0]:
        raise CampaignError("a stored trajectory is damaged: it does not match its checksum")
    count, column_count = _HEADER.unpack_from(content)
    packed_start = _HEADER.size + column_count
    indices, packed = content[_HEADER.size : packed_start], content[packed_start:]
    if indices != _COLUMN_INDICES:
        raise CampaignError(
            f"a stored trajectory has the columns {list(indices)}, this version of frenetic reads"
            f" {list(_COLUMN_INDICES)}: another one wrote it"
        )
    if count > MAX_RECORDS:
        raise CampaignError(f"a stored trajectory is damaged: it claims {count} records")
    return count, packed


def _pack(steps: IntArray) -> bytes:
    """Return the bytes of columns in steps of their resolutions, (11, n)."""
    words, size = pack(steps, _SMOOTH_COUNT)
    header = _HEADER.pack(steps.shape[1], _COLUMN_COUNT) + _COLUMN_INDICES
    data = header + words.astype("<u4", copy=False).view(np.uint8)[:size].tobytes()
    return _CRC.pack(zlib.crc32(data)) + data


def to_steps(trajectory: Trajectory) -> IntArray:
    """Return the columns as whole numbers of steps of their resolutions, (11, n).

    Raises:
        ValueError: a value is NaN, infinite or out of range, or there are too many records.
    """
    count = len(trajectory)
    if count > MAX_RECORDS:
        raise ValueError(f"the trajectory has {count} records: at most {MAX_RECORDS} can be stored")
    columns = trajectory.block
    steps = np.empty((_COLUMN_COUNT, count), np.int64)
    bad = round_columns(columns, _STEPS_PER_UNIT, _MOST_STEPS, steps)
    if bad >= 0:
        k, record = divmod(bad, count)
        name = tuple(RESOLUTIONS)[k]
        raise ValueError(
            f"{name} of record {record} is {columns[k, record]}: "
            f"a finite number below {_MOST_STEPS * RESOLUTIONS[name]:.0e} is needed"
        )
    return steps


def _of_steps(steps: IntArray) -> Trajectory:
    """Return the trajectory of columns in steps of their resolutions, (11, n)."""
    return Trajectory.of_block(steps / _STEPS_PER_UNIT[:, np.newaxis])
