"""Stored trajectories: their precision and size, and damaged ones."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from campaigns import refused
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.campaign.trajectory_codec import (
    MAX_RECORDS,
    RESOLUTIONS,
    decode,
    encode,
    encode_and_round,
    rounded,
)
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Trajectory

HALF_STEPS = 0.5 * np.array(list(RESOLUTIONS.values()))


def winding_drive(records: int = 500, seed: int = 0) -> Trajectory:
    """A car on curves at 0 to 20 m/s, recorded at 20 Hz; controls change once a second."""
    rng = np.random.default_rng(seed)
    time = 0.05 * np.arange(records, dtype=np.float64)
    holds = 20
    throttle, brake, steering_input = (
        np.repeat(rng.uniform(low, 1.0, records // holds + 1), holds)[:records]
        for low in (0.0, 0.0, -1.0)
    )
    steering_input = 0.2 * steering_input
    steering = np.convolve(np.pad(steering_input, (5, 0), "edge"), np.full(6, 1 / 6), "valid")
    speed = 10.0 - 10.0 * np.cos(time / 4.0)
    yaw_rate = speed * np.tan(steering) / 2.6
    heading = np.pi / 2 + np.cumsum(yaw_rate) * 0.05
    return Trajectory(
        time=time,
        x=100.0 + np.cumsum(speed * np.cos(heading)) * 0.05,
        y=20.0 + np.cumsum(speed * np.sin(heading)) * 0.05,
        heading=heading,
        speed=speed,
        lateral_speed=-0.05 * speed * yaw_rate,
        yaw_rate=yaw_rate,
        steering=steering,
        steering_input=steering_input,
        throttle=throttle,
        brake=brake,
    )


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Trajectories that are rough, smooth, constant, jumping or empty."""
    records = draw(st.integers(0, 40))
    seed = draw(st.integers(0, 2**32 - 1))
    scale = draw(st.sampled_from([0.0, 1e-5, 1e-2, 1.0, 1e3, 1e9]))
    rng = np.random.default_rng(seed)
    rows = scale * rng.normal(size=(records, len(RESOLUTIONS)))
    if draw(st.booleans()):
        rows = np.cumsum(rows, axis=0)
    if records:
        edge = draw(st.sampled_from([0.0, -0.0, 1e-300, 1e10, -1e10]))
        rows[draw(st.integers(0, records - 1)), draw(st.integers(0, rows.shape[1] - 1))] = edge
    return Trajectory.from_rows(rows)


@given(trajectories())
def test_a_round_trip_is_within_half_a_resolution_and_a_second_is_exact(
    trajectory: Trajectory,
) -> None:
    data, original = encode(trajectory), trajectory.to_rows()
    decoded = decode(data)
    rounding = 4.0 * np.finfo(float).eps * np.abs(original)
    assert decoded.to_rows().shape == original.shape
    assert (np.abs(decoded.to_rows() - original) <= HALF_STEPS + rounding).all()
    assert encode(decoded) == data
    assert rounded(trajectory).to_rows().tobytes() == decoded.to_rows().tobytes()
    packed, stored_trajectory = encode_and_round(trajectory)
    assert packed == data
    assert stored_trajectory.to_rows().tobytes() == decoded.to_rows().tobytes()


def test_a_usual_drive_takes_a_few_kilobytes() -> None:
    assert len(DATA) < 8_000
    times = [round(0.05 * k, 2) for k in range(500)]  # s, exactly as written in decimals
    assert decode(DATA).time.tolist() == times


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_largest_value_comes_back(sign: float) -> None:
    rows = winding_drive(10).to_rows()
    x = Trajectory.names().index("x")
    rows[7, x] = sign * 2.0**51 * RESOLUTIONS["x"]
    assert decode(encode(Trajectory.from_rows(rows))).to_rows()[7, x] == rows[7, x]


@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e300, -1e20])
def test_unstorable_trajectories_are_refused(value: float) -> None:
    for name in ("time", "y", "brake"):
        rows = winding_drive(10).to_rows()
        rows[7, Trajectory.names().index(name)] = value
        with pytest.raises(ValueError, match=f"{name} of record 7 is .*: a finite number"):
            encode(Trajectory.from_rows(rows))
    rows = np.zeros((MAX_RECORDS + 1, len(RESOLUTIONS)))
    with pytest.raises(ValueError, match="at most 1000000"):
        encode(Trajectory.from_rows(rows))


# Damage


DATA = encode(winding_drive())
PLACES, PACKED = DATA[9:20], DATA[20:]


def stored(count: int = 500, places: bytes = PLACES, packed: bytes = PACKED) -> bytes:
    """Bytes of a stored trajectory, with the right checksum."""
    content = struct.pack("<IB", count, len(places)) + places + packed
    return struct.pack("<I", zlib.crc32(content)) + content


def blocks_of(*codes: int) -> bytes:
    """Packed bits of one record whose columns have these codes, each behind an escape."""
    bits, position = 0, 0
    for code in codes:
        length = max(code.bit_length(), 1)
        for value, size in ((1, 6), (2**20 - 1, 20), (length - 1, 6), (code, length)):
            bits |= value << position
            position += size
    return bits.to_bytes((position + 7) // 8, "little")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "checksum"),
        (DATA[:-1], "checksum"),
        (DATA + b"\0", "checksum"),
        (stored()[:4], "checksum"),
        (stored(places=PLACES[::-1]), "has the columns .10, 9, .*another one wrote it"),
        (stored(places=PLACES + b"\x0b"), "has the columns"),
        (stored(places=PLACES[:10]), "has the columns"),
        (stored(count=501), "is damaged"),
        (stored(count=600), "is damaged"),
        (stored(count=0), "do not hold 0 records"),
        (stored(count=MAX_RECORDS + 1), "claims 1000001 records"),
        (stored(count=MAX_RECORDS), "is damaged"),
        (stored(packed=b""), "its 0 bytes do not hold"),
        (stored(packed=PACKED[:-1]), "do not hold 500 records"),
        (stored(packed=PACKED + b"\0"), "do not hold 500 records"),
        (stored(packed=PACKED[:-1] + bytes([PACKED[-1] ^ 0x80])), "do not hold 500 records"),
        (stored(packed=b"\x3f" + PACKED[1:]), "do not hold 500 records"),
        (stored(count=1, packed=blocks_of(*[0] * 10, 2**52 + 2)), "out of range"),
        (stored(count=1, packed=blocks_of(*[0] * 10, 2**64 - 1)), "out of range"),
    ],
)
def test_damaged_data_is_refused(data: bytes, message: str) -> None:
    assert stored() == DATA
    with refused(message):
        decode(data)


def test_the_layout_is_as_it_is_described() -> None:
    codes = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 2**52]
    steps = [-1, 1, -2, 2, -3, 3, -4, 4, -5, 5, 2**51]  # zigzag
    decoded = decode(stored(count=1, packed=blocks_of(*codes)))
    assert decoded.to_rows()[0] == pytest.approx(np.array(steps) * list(RESOLUTIONS.values()))


@given(st.binary(max_size=200))
def test_arbitrary_bytes_raise_a_campaign_error(data: bytes) -> None:
    for damaged in (data, struct.pack("<I", zlib.crc32(data)) + data, stored(packed=data)):
        with pytest.raises(CampaignError):
            decode(damaged)


@given(st.integers(0, 300), st.binary(max_size=3000))
@settings(max_examples=100)
def test_arbitrary_bits_decode_to_finite_numbers_or_are_refused(count: int, packed: bytes) -> None:
    try:
        trajectory = decode(stored(count, packed=packed))
    except CampaignError:
        return
    assert len(trajectory) == count
    assert np.isfinite(trajectory.to_rows()).all()
