"""The diameter of a set of roads."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.analysis import diameter
from frenetic.analysis.diameter import set_diameter


def roads(number: int, seed: int = 1) -> list[FloatArray]:
    """Return the curvatures of different roads."""
    return list(np.random.default_rng(seed).uniform(-0.07, 0.07, size=(number, 25)))


def by_hand(words: Sequence[bytes]) -> float:
    """Return the normalised compression distance of words by its formula."""

    def compressed(*parts: bytes) -> int:
        return len(zlib.compress(b"".join(parts), 9))

    without = [compressed(*(word for word in words if word is not left_out)) for left_out in words]
    return (compressed(*words) - min(compressed(word) for word in words)) / max(without)


def test_the_diameter_is_the_compression_distance_of_rounded_curvatures() -> None:
    different = roads(6)
    words = [np.rint(1000.0 * road).astype(np.int8).tobytes() for road in different]
    assert set_diameter(different) == by_hand(words)
    assert set_diameter(road + 0.0001 for road in np.round(different, 3)) == by_hand(words)


def test_copies_have_a_small_diameter_and_different_roads_a_large_one() -> None:
    small, large = set_diameter(roads(1) * 20), set_diameter(roads(20))
    assert small is not None
    assert large is not None
    assert small < 0.5 < 0.9 < large


def test_fewer_than_two_roads_have_no_diameter() -> None:
    assert set_diameter([]) is None
    assert set_diameter(roads(1)) is None


def test_of_many_roads_some_count_and_of_a_tight_bend_its_largest_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many = roads(9)
    monkeypatch.setattr(diameter, "MOST_COMPRESSED", 5)
    assert set_diameter(many) == set_diameter(many[::2])
    tight = [np.full(20, 0.127), np.full(20, -0.127)]
    assert set_diameter(tight) == set_diameter([np.full(20, 0.2), np.full(20, -9.0)])
