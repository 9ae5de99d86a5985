"""Numbers of failures that are unlike each other: closed cases."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.analysis.linkage import link
from frenetic.analysis.unlike import UnlikeFailures


def at_places(*places: float) -> UnlikeFailures:
    """Return the numbers for failures on a line."""
    return UnlikeFailures.of(np.array(places).reshape(-1, 1))


@pytest.mark.parametrize("radius", [0.0, 0.5, 2.9, 3.0, 100.0])
def test_of_three_failures_two_are_equal_at_every_radius(radius: float) -> None:
    assert at_places(5.0, 2.0, 5.0).unlike_at(radius) == (2 if radius < 3.0 else 1)


def test_the_curve_falls_from_all_failures_to_a_single_one() -> None:
    # 0 and 1 join at 1, both with 3 at the root of (9 + 4) / 2, all with 7 at (49 + 36 + 16) / 3.
    unlike = at_places(0.0, 1.0, 3.0, 7.0)
    assert unlike.joins == pytest.approx([1.0, 6.5**0.5, (101.0 / 3.0) ** 0.5])
    radii = np.array([0.0, 0.9, 1.0, 2.5, 2.6, 5.8, 5.9])
    assert unlike.unlike_over(radii).tolist() == [4, 4, 3, 3, 2, 2, 1]


def test_no_failure_and_a_single_failure() -> None:
    assert UnlikeFailures.of(np.array([])).unlike_at(1.0) == 0
    assert at_places(3.0).unlike_at(0.0) == at_places(3.0, 3.0, 3.0).unlike_at(9.0) == 1


def test_the_numbers_are_those_of_clusters_at_a_threshold() -> None:
    vectors = np.random.default_rng(5).normal(size=(60, 4))
    vectors = np.concatenate([vectors, vectors[::3]])
    unlike = UnlikeFailures.of(vectors)
    for radius in (0.1, 0.8, 1.5, 2.5, 4.0):
        labels = link(vectors, np.arange(len(vectors), dtype=np.float64), radius)
        assert unlike.unlike_at(radius) == len(np.unique(labels))
