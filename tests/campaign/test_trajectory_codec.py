"""Stored trajectories: their precision and size, and damaged ones."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from campaigns import refused
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.campaign.trajectory_codec import MAX_RECORDS, RESOLUTIONS, decode, encode, rounded
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
WIDTH, PLACES, STREAM = DATA[9], DATA[10:21], DATA[21:]
BODY = zlib.decompress(STREAM)


def stored(
    count: int = 500, width: int = WIDTH, places: bytes = PLACES, stream: bytes = STREAM
) -> bytes:
    """Bytes of a stored trajectory, with the right checksum."""
    content = struct.pack("<IBB", count, len(places), width) + places + stream
    return struct.pack("<I", zlib.crc32(content)) + content


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
        (stored(count=501), "do not fill"),
        (stored(count=0), "do not fill"),
        (stored(count=MAX_RECORDS + 1), "claims 1000001 records"),
        (stored(width=9), "500 records of 9 bytes"),
        (stored(stream=b""), "do not fill"),
        (stored(stream=STREAM[:-1]), "do not fill"),
        (stored(stream=STREAM + b"\0"), "do not fill"),
        (stored(stream=STREAM[:-4] + b"abcd"), "incorrect data check"),
        (stored(stream=b"no zlib stream"), "header"),
        (stored(stream=zlib.compress(BODY + b"\0")), "do not fill"),
        (stored(stream=zlib.compress(BODY[:-1])), "do not fill"),
        (stored(stream=zlib.compress(b"\0" * 50_000_000)), "do not fill"),
        (stored(width=8, stream=zlib.compress(b"\x7f" * 8 * 11 * 500)), "out of range"),
    ],
)
def test_damaged_data_is_refused(data: bytes, message: str) -> None:
    assert stored() == DATA
    with refused(message):
        decode(data)


@given(st.binary(max_size=200))
def test_arbitrary_bytes_raise_a_campaign_error(data: bytes) -> None:
    for damaged in (data, struct.pack("<I", zlib.crc32(data)) + data, stored(stream=data)):
        with pytest.raises(CampaignError):
            decode(damaged)


@given(st.integers(0, 8), st.integers(0, 300), st.binary(max_size=3000))
@settings(max_examples=100)
def test_arbitrary_bodies_decode_to_finite_numbers_or_are_refused(
    width: int, count: int, body: bytes
) -> None:
    needed = 11 * count * width
    for filled in (body, (body or b"\xff").ljust(needed, body[:1] or b"\xff")[:needed]):
        try:
            trajectory = decode(stored(count, width, stream=zlib.compress(filled)))
        except CampaignError:
            continue
        assert len(trajectory) == count
        assert np.isfinite(trajectory.to_rows()).all()
