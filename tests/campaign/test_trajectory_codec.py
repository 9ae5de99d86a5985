"""What a stored trajectory keeps, and what a damaged one does."""

from __future__ import annotations

import random
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.campaign.trajectory_codec import MAX_RECORDS, RESOLUTIONS, decode, encode, rounded
from frenetic.errors import CampaignError
from frenetic.simulators.drive import Trajectory

HALF_STEPS = 0.5 * np.array(list(RESOLUTIONS.values()))


def winding_drive(records: int = 500, seed: int = 0) -> Trajectory:
    """A car on curves at 0 to 20 m/s, recorded at 20 Hz; its driver holds each control a while."""
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
    """Any numbers within reason: rough, smooth, constant, jumping, empty."""
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
def test_values_come_back_within_half_a_resolution(trajectory: Trajectory) -> None:
    back = decode(encode(trajectory)).to_rows()
    original = trajectory.to_rows()
    rounding = 4.0 * np.finfo(float).eps * np.abs(original)
    assert back.shape == original.shape
    assert (np.abs(back - original) <= HALF_STEPS + rounding).all()


@given(trajectories())
def test_encoding_again_gives_the_same_bytes(trajectory: Trajectory) -> None:
    data = encode(trajectory)
    assert encode(decode(data)) == data


@given(trajectories())
def test_rounding_without_encoding_gives_the_same_bits(trajectory: Trajectory) -> None:
    again, direct = decode(encode(trajectory)), rounded(trajectory)
    for name in RESOLUTIONS:
        assert getattr(direct, name).tobytes() == getattr(again, name).tobytes(), name


def test_regular_times_come_back_as_decimal_numbers() -> None:
    time = decode(encode(winding_drive())).time
    assert time.tolist() == [round(0.05 * k, 2) for k in range(500)]


def test_a_usual_drive_takes_a_few_kilobytes() -> None:
    assert len(encode(winding_drive())) < 8_000


def test_box_corners_move_by_less_than_a_millimetre() -> None:
    trajectory = winding_drive()
    stored = decode(encode(trajectory))

    def corner(of: Trajectory) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        ahead, left = 2.3, 0.9
        return np.stack(
            [
                of.x + ahead * np.cos(of.heading) - left * np.sin(of.heading),
                of.y + ahead * np.sin(of.heading) + left * np.cos(of.heading),
            ]
        )

    assert np.hypot(*(corner(stored) - corner(trajectory))).max() < 2e-4


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e20])
@pytest.mark.parametrize("name", ["time", "y", "brake"])
def test_numbers_that_cannot_be_stored_are_refused(name: str, value: float) -> None:
    rows = winding_drive(10).to_rows()
    rows[7, Trajectory.names().index(name)] = value
    with pytest.raises(ValueError, match=f"{name} of record 7 is .*: a finite number"):
        encode(Trajectory.from_rows(rows))


def test_too_many_records_are_refused() -> None:
    rows = np.zeros((MAX_RECORDS + 1, len(RESOLUTIONS)))
    with pytest.raises(ValueError, match="at most 1000000"):
        encode(Trajectory.from_rows(rows))


# Damage


def with_header(data: bytes, version: int = 1, count: int = 500, width: int | None = None) -> bytes:
    widths = data[5:16] if width is None else bytes([width] * 11)
    return struct.pack("<BI", version, count) + widths + data[16:]


def with_body(data: bytes, body: bytes) -> bytes:
    return data[:16] + zlib.compress(body)


DATA = encode(winding_drive())
BODY = zlib.decompress(DATA[16:])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "0 bytes are less than its header"),
        (DATA[:15], "15 bytes"),
        (with_header(DATA, version=2), "format 2"),
        (with_header(DATA, count=499), "do not fill"),
        (with_header(DATA, count=501), "do not fill"),
        (with_header(DATA, count=0), "do not fill"),
        (with_header(DATA, count=MAX_RECORDS + 1), "claims 1000001 records"),
        (with_header(DATA, count=2**32 - 1), "claims 4294967295 records"),
        (with_header(DATA, width=9), "9 bytes per value"),
        (with_header(DATA, width=255), "255 bytes per value"),
        (DATA[:16], "do not fill"),
        (DATA[:-1], "do not fill"),
        (DATA + b"\0", "do not fill"),
        (DATA[:-4] + b"abcd", "incorrect data check"),
        (DATA[:16] + b"no zlib stream", "header"),
        (with_body(DATA, BODY + b"\0"), "do not fill"),
        (with_body(DATA, BODY[:-1]), "do not fill"),
        (with_body(DATA, b"\0" * 50_000_000), "do not fill"),
        (with_body(DATA, b"\x7f" * len(BODY)), "out of range"),
    ],
)
def test_damaged_data_is_named(data: bytes, message: str) -> None:
    with pytest.raises(CampaignError, match=message) as caught:
        decode(data)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=200))
def test_arbitrary_bytes_raise_nothing_else(data: bytes) -> None:
    for attempt in (data, b"\x01" + data, DATA[:16] + data):
        with pytest.raises(CampaignError):
            decode(attempt)


@given(st.binary(max_size=11), st.integers(0, 300), st.binary(max_size=3000))
@settings(max_examples=100)
def test_arbitrary_bodies_decode_to_finite_numbers_or_are_refused(
    widths: bytes, count: int, body: bytes
) -> None:
    header = struct.pack("<BI", 1, count) + bytes(w % 9 for w in widths.ljust(11, b"\0"))
    needed = 11 * 8 * min(count, 2) + max(count - 2, 0) * sum(header[5:])
    for attempt in (body, (body or b"\xff").ljust(needed, body[:1] or b"\xff")[:needed]):
        try:
            trajectory = decode(header + zlib.compress(attempt))
        except CampaignError:
            continue
        assert len(trajectory) == count
        assert np.isfinite(trajectory.to_rows()).all()


def test_flipped_bytes_are_noticed() -> None:
    # Header and checksum leave only the column widths without protection, and those are checked
    # against the length.
    picker = random.Random(5)
    for _ in range(300):
        data = bytearray(DATA)
        data[picker.randrange(len(data))] ^= 1 << picker.randrange(8)
        try:
            decode(bytes(data))
        except CampaignError:
            continue
        # The one thing that goes unnoticed: a flag in the zlib header that changes no value.
        assert decode(bytes(data)).to_rows().tolist() == decode(DATA).to_rows().tolist()
