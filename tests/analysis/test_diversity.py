from __future__ import annotations

import numpy as np

from frenetic.analysis import most_different, segment_profile
from frenetic.road import Road


def test_worst_comes_first_then_whatever_differs_most() -> None:
    left, slightly_left, right = np.full(31, 0.05), np.full(31, 0.045), np.full(31, -0.05)
    chosen = most_different([slightly_left, left, right], [3.0, 2.0, 1.0], 2)
    assert chosen == [0, 2]


def test_no_failure_is_chosen_twice_even_if_all_are_alike() -> None:
    profiles = [np.zeros(31)] * 5
    assert sorted(most_different(profiles, [1.0, 2.0, 3.0, 4.0, 5.0], 4)) == [1, 2, 3, 4]
    assert len(most_different(profiles, [0.0] * 5, 99)) == 5
    assert most_different([], [], 3) == []


def test_alike_failures_go_to_the_more_severe() -> None:
    base, far = np.zeros(31), np.full(31, 0.05)
    chosen = most_different([base, far, far.copy()], [9.0, 1.0, 2.0], 2)
    assert chosen == [0, 2]


def test_profile_is_the_curvature_around_the_place() -> None:
    road = Road(np.array([0.0, 0.0, 0.04, 0.0, 0.0, 0.0, 0.0]))
    profile = segment_profile(road, 20.0)
    assert len(profile) == 31
    assert profile[15] == 0.04
    assert profile[10] == road.curvature_at(10.0)
    assert profile[0] == 0.0  # before the road's start
