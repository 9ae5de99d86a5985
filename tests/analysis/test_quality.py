"""Measures of how well a driver drives, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sample_drives import drive

from frenetic._support.arrays import FloatArray
from frenetic.analysis.oscillation import dominant_sway, reversals
from frenetic.analysis.quality import QUALITY, RADII, DriveQuality, bin_ends, drive_quality
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.road import Road

PERIOD = 0.05  # [s]
SPEED = 20.0  # [m/s]
STRAIGHT = Road(np.zeros(121), 10.0)
TIME = np.arange(0.0, 55.0, PERIOD)
PLACES = (10.0 + SPEED * TIME).tolist()


def sine(amplitude: float, frequency: float) -> FloatArray:
    """Return a sine over the time of the drive."""
    wave: FloatArray = amplitude * np.sin(2.0 * np.pi * frequency * TIME)
    return wave


def driven(offset: FloatArray | float = 0.0, **columns: FloatArray) -> DriveQuality:
    """Return the measures of a drive along a straight road, with other columns than usual."""
    offsets = np.broadcast_to(offset, len(TIME)).tolist()
    usual = drive(STRAIGHT, PLACES, offsets, SPEED, period=PERIOD)
    trajectory = replace(usual.trajectory, **columns) if columns else usual.trajectory
    return drive_quality(STRAIGHT, Drive(trajectory))


def test_a_sine_of_the_offset_gives_its_amplitude_frequency_and_distances() -> None:
    values = driven(sine(0.4, 0.5)).values
    assert values["rms_offset"] == pytest.approx(0.4 / np.sqrt(2.0), rel=0.01)
    assert values["largest_offset"] == pytest.approx(0.4, rel=0.01)
    assert values["sway_amplitude"] == pytest.approx(0.4, rel=0.02)
    assert values["sway_frequency"] == pytest.approx(0.5, abs=0.01)
    car = Drive(Trajectory.empty()).car
    inside = 0.5 * STRAIGHT.lane_width - 0.5 * car.width
    assert values["edge_distance"] == pytest.approx(inside - 0.4, abs=0.002)
    assert values["crossing"] == 0.0
    assert driven(sine(inside + 0.05, 0.5)).values["crossing"] == 100.0


def test_a_sine_of_the_steering_gives_its_rate_and_its_reversals() -> None:
    angle = np.radians(sine(2.0, 0.4))
    values = driven(steering=angle).values
    rate = 2.0 * 2.0 * np.pi * 0.4 / np.sqrt(2.0)  # [°/s]
    assert values["rms_steering_rate"] == pytest.approx(rate, rel=0.01)
    assert values["steering_reversals"] == pytest.approx(2.0 * 0.4 * 60.0, rel=0.03)
    small = np.radians(sine(0.09, 0.4))  # 0.18 degrees from side to side
    assert driven(steering=small).values["steering_reversals"] == 0.0


def test_a_sine_of_the_yaw_rate_gives_the_mean_lateral_jerk_of_half_a_second() -> None:
    frequency, window = 0.3, 0.5
    values = driven(yaw_rate=sine(0.1, frequency)).values
    # The mean of a cosine over a window.
    jerk = SPEED * 0.1 * 2.0 * np.sin(np.pi * frequency * window) / window
    assert values["rms_lateral_jerk"] == pytest.approx(jerk / np.sqrt(2.0), rel=0.02)


def test_steady_braking_has_its_deceleration_and_no_jerk() -> None:
    values = driven(speed=SPEED - 0.3 * TIME).values
    assert values["largest_deceleration"] == pytest.approx(0.3)
    assert values["rms_longitudinal_jerk"] == pytest.approx(0.0, abs=1e-9)
    assert values["mean_speed"] == pytest.approx(3.6 * (SPEED - 0.15 * TIME[-1]))
    wave = driven(speed=SPEED + sine(1.0, 0.1)).values
    pace = 2.0 * np.pi * 0.1
    assert wave["largest_deceleration"] == pytest.approx(pace, rel=0.02)
    assert wave["rms_longitudinal_jerk"] == pytest.approx(pace**2 / np.sqrt(2.0), rel=0.05)


def test_a_quiet_drive_has_no_sway() -> None:
    values = driven(0.2).values
    assert values["sway_amplitude"] == 0.0
    assert "sway_frequency" not in values
    assert values["rms_offset"] == pytest.approx(0.2, rel=0.01)
    tiny = driven(sine(0.005, 0.5)).values
    assert tiny["sway_amplitude"] == 0.0
    assert "sway_frequency" not in tiny


def test_measures_are_declared_with_unit_definition_and_what_is_better() -> None:
    for name, measure in QUALITY.items():
        assert measure.name == name
        assert measure.definition.endswith(".")
        assert measure.least > 0.0
        assert all("{}" in phrase for phrase in measure.phrases)


# Sway


@pytest.mark.parametrize("frequency", [0.123, 0.15, 0.7, 1.9])
def test_the_dominant_oscillation_stands_out_of_drift_and_noise(frequency: float) -> None:
    rng = np.random.default_rng(0)
    signal = sine(0.3, frequency) + 0.02 * TIME + 0.05 * rng.normal(size=len(TIME))
    sway = dominant_sway(TIME, signal)
    assert sway is not None
    assert sway.frequency == pytest.approx(frequency, abs=0.01)
    assert sway.amplitude == pytest.approx(0.3, rel=0.05)


def test_times_need_not_be_even() -> None:
    rng = np.random.default_rng(1)
    time = np.sort(TIME + rng.uniform(-0.02, 0.02, len(TIME)))
    sway = dominant_sway(time, 0.3 * np.sin(2.0 * np.pi * 0.5 * time))
    assert sway is not None
    assert sway.frequency == pytest.approx(0.5, abs=0.01)
    assert sway.amplitude == pytest.approx(0.3, rel=0.03)


@pytest.mark.parametrize(
    "signal",
    [
        np.zeros(len(TIME)),
        0.1 * TIME,
        np.random.default_rng(2).normal(size=len(TIME)),
        sine(0.3, 0.03),  # slower than a sway, and fewer than three periods
        sine(0.3, 5.0),
        (TIME > 20.0).astype(float),
    ],
    ids=["still", "drift", "noise", "slow", "fast", "step"],
)
def test_other_signals_have_no_sway(signal: FloatArray) -> None:
    assert dominant_sway(TIME, signal) is None


def test_a_drive_of_a_few_records_has_no_sway() -> None:
    for n in range(8):
        assert dominant_sway(TIME[:n], np.arange(float(n))) is None


# Reversals


@pytest.mark.parametrize(
    ("values", "count"),
    [
        ([], 0),
        ([1.0], 0),
        ([0.0, 1.0, 2.0], 0),
        ([0.0, 1.0, 0.0], 1),
        ([0.0, -1.0, 0.0, -1.0], 2),
        ([0.0, 1.0, 0.6, 1.4, 0.95], 0),  # no way back of half
        ([0.0, 1.0, 0.7, 0.4], 1),  # in two steps
        ([0.0, 0.3, -0.3, 0.3, -0.3], 2),  # the first way is shorter than the gap
    ],
)
def test_reversals_count_ways_back_of_the_gap(values: list[float], count: int) -> None:
    assert reversals(np.array(values), 0.5) == count


# Bins


def test_bins_split_a_drive_by_radius_and_speed() -> None:
    curvature = np.concatenate([np.zeros(60), np.full(61, 1.0 / 150.0)])
    road = Road(curvature, 10.0)
    places = np.arange(5.0, 1190.0, 1.0)
    offsets = np.where(places < 590.0, 0.1, -0.5)
    bends = drive(road, places.tolist(), offsets.tolist(), 15.0, period=1.0 / 15.0)
    quality = drive_quality(road, bends)
    radius = quality.bins["radius"]
    straight, bend = len(RADII), 2
    assert radius[straight]["rms_offset"] == pytest.approx(0.1, abs=0.01)
    assert radius[bend]["largest_offset"] == pytest.approx(0.5, abs=0.02)
    assert bin_ends("radius", bend) == (100.0, 200.0)
    assert bin_ends("radius", straight) == (RADII[-1], np.inf)
    (number,) = quality.bins["speed"]
    assert bin_ends("speed", number) == (50.0, 60.0)
    whole = quality.bins["speed"][number]
    assert whole == {name: quality.values[name] for name in whole}
    assert "sway_amplitude" not in whole
