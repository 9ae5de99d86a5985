"""Segments of drives around a departure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sample_drives import departure, drive

from frenetic.analysis import segment_of, segments_of
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.simulators import Drive, Trajectory
from frenetic.testing import DummyDriver, DummySimulator

STRAIGHT = Road(np.zeros(11))  # 100 m, northwards from the origin


def test_segment_is_30_m_before_to_30_m_after_the_departure() -> None:
    places = np.arange(0.0, 71.0, 10.0).tolist()
    departing_drive = drive(STRAIGHT, places, [0.0] * 5 + [0.2, 1.0, 4.0])
    segment = segment_of(STRAIGHT, departing_drive, departure(7.0, 70.0, 2.0, 70.0))
    assert (segment.start, segment.place, segment.end) == (40.0, 70.0, 100.0)
    assert segment.side == "left"
    assert segment.lateral_offset == pytest.approx([0.0, 0.2, 1.0, 4.0])


def test_a_segment_without_departure_lies_at_the_largest_offset() -> None:
    places = np.arange(0.0, 91.0, 10.0).tolist()
    lane_drive = drive(STRAIGHT, places, [0.0, 0.1, 0.0, 0.0, 0.3, -1.5, 0.0, 0.0, 0.0, 0.0])
    segment = segment_of(STRAIGHT, lane_drive, None)
    assert (segment.start, segment.place, segment.end) == (20.0, 50.0, 80.0)
    assert segment.side is None
    assert len(segment.speed) == 7  # the records at 20, 30 .. 80 m


def test_segment_ends_with_the_road() -> None:
    departing_drive = drive(STRAIGHT, [0.0, 5.0, 10.0], [0.0, 1.0, 4.0])
    segment = segment_of(STRAIGHT, departing_drive, departure(2.0, 10.0, 2.0, 10.0))
    assert (segment.start, segment.end, segment.length) == (0.0, 40.0, 40.0)
    late = segment_of(STRAIGHT, drive(STRAIGHT, [85.0, 88.0, 91.0], [0.0, 0.0, 3.5]), None)
    assert (late.start, late.end) == (61.0, 100.0)


def test_an_earlier_passage_is_not_in_the_segment() -> None:
    """A car may pass a stretch, turn and come back: the segment is its last passage."""
    places = [0.0, 25.0, 45.0, 25.0, 0.0, 25.0, 45.0]
    turning_drive = drive(STRAIGHT, places, [0.0] * 6 + [1.0])
    segment = segment_of(STRAIGHT, turning_drive, None)
    assert segment.first == 5


def test_a_drive_without_records_has_no_segment() -> None:
    with pytest.raises(ValueError, match="without records"):
        segment_of(STRAIGHT, Drive(Trajectory.empty()), None)


def test_each_driven_test_of_a_campaign_has_a_segment(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=2, max_redraws=0),
        simulator=DummySimulator(lambda road: 4.0 if abs(road.curvatures).max() > 0.06 else 0.5),
        driver=DummyDriver(),
        budget=Budget(simulations=30),
        folder=tmp_path,
    ).run()
    with CampaignStore.open(tmp_path) as store:
        assert store.counts().by_outcome[Outcome.INVALID] > 0
        segments = list(segments_of(store))
        failed = list(segments_of(store, Outcome.FAIL))
    assert len(segments) == 30
    assert 0 < len(failed) < 30
    for record, segment in failed:
        assert record.departure is not None
        assert segment.place == record.departure.distance
        assert segment.side == record.departure.side == "left"
        assert abs(segment.lateral_offset[-1]) > 2.0
