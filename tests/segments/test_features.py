"""Features of failing segments."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_drives import departing, drive

from frenetic.analysis import FEATURES, Segment, features_of, segment_of
from frenetic.road import Road

STRAIGHT = Road(np.zeros(11))

ROADS = st.lists(st.floats(-0.07, 0.07), min_size=8, max_size=25)


def whole(road: Road) -> Segment:
    return segment_of(road, drive(road, [0.0, 5.0]), None).whole()


def test_features_of_a_drive_worked_out_by_hand() -> None:
    # The largest offset is at 50 m, so the segment goes from 20 m to 80 m: records 2 to 8.
    hand_drive = drive(
        STRAIGHT,
        places=np.arange(0.0, 91.0, 10.0).tolist(),
        offsets=[0.0, 0.0, 0.0, 0.2, 0.4, -1.1, 0.0, 0.0, -0.2, 0.0],
        speeds=[0.0, 5.0, 10.0, 10.0, 12.0, 12.0, 12.0, 14.0, 14.0, 99.0],
        steering=[9.0, 9.0, 0.1, -0.1, 0.1, -0.1, 0.1, -0.1, 0.0, 9.0],
    )
    features = features_of(segment_of(STRAIGHT, hand_drive, None))
    assert list(features) == list(FEATURES)
    assert features == pytest.approx(
        {
            "length": 60.0,
            "max_curvature": 0.0,
            "direction_coverage": 0.1,  # one of ten directions
            "bends": 0,
            "mean_speed": 84.0 / 7.0,  # 12
            "std_speed": math.sqrt((4 + 4 + 0 + 0 + 0 + 4 + 4) / 7.0),
            "std_steering": math.sqrt(6 * 0.01 / 7.0),  # about a mean of 0
            "mean_offset": (0.2 + 0.4 - 1.1 - 0.2) / 7.0,
            "extreme_offset": -1.1,
            "lateral_acceleration": 0.0,
            "lateral_jerk": 0.0,
        }
    )


@pytest.mark.parametrize(
    ("degrees", "bins"),
    [
        ((0.0,), 1),
        ((17.9,), 1),  # the first bin reaches 18 degrees to either side
        ((18.1,), 2),
        ((80.0,), 3),  # up to 18, 54 and 90
        ((-80.0,), 3),
        ((40.0, -80.0), 3),  # -40 .. 40: the middle bin and its two neighbours
        ((170.0,), 6),
        ((340.0,), 10),
        ((700.0,), 10),
    ],
)
def test_direction_coverage_counts_36_degree_bins(degrees: tuple[float, ...], bins: int) -> None:
    # Arcs of 100 m; the metre between two arcs turns by a tenth of a degree.
    values = np.repeat([math.radians(angle) / 100.0 for angle in degrees], 101)
    road = Road(values, step=1.0)
    assert features_of(whole(road))["direction_coverage"] == pytest.approx(bins / 10)


@pytest.mark.parametrize(
    ("name", "values", "bins"),
    [
        ("max_curvature", (0.0, 0.0069, 0.0071, 0.0699, 0.07, 1.0), (0, 0, 1, 9, 9, 9)),  # 0.007
        ("extreme_offset", (-9.0, -4.5, -0.1, 0.0, 0.1, 9.0), (0, 0, 4, 5, 5, 9)),  # of 1 m each
        ("direction_coverage", [number / 10 for number in range(1, 11)], range(10)),
        ("bends", range(12), (*range(10), 9, 9)),
    ],
)
def test_values_beyond_the_bins_fall_into_the_last_bin(
    name: str, values: list[float], bins: list[int]
) -> None:
    assert [FEATURES[name].bin(value) for value in values] == list(bins)


@settings(max_examples=50)
@given(ROADS)
def test_features_stay_within_their_bounds_and_mirroring_flips_offsets(values: list[float]) -> None:
    left = dict(features_of(departing(Road(values), 50.0, "left")))
    right = dict(features_of(departing(Road(-np.array(values)), 50.0, "right")))
    assert 0.1 <= left["direction_coverage"] <= 1.0
    assert 0.0 <= left["max_curvature"] <= max(map(abs, values))
    assert left["extreme_offset"] > 2.0
    mirrored = {name: -left[name] for name in ("mean_offset", "extreme_offset")}
    assert right == pytest.approx({**left, **mirrored}, abs=1e-6)
