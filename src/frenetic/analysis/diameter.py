"""Test-set diameter: how much the roads of a set hold that their neighbours do not.

It is the normalised compression distance of a multiset, by the first formula of R. Feldt,
S. Poulding, D. Clark and S. Yoo, "Test set diameter: quantifying the diversity of sets of test
cases", ICST 2016: (C(X) - min C(x)) / max C(X without x), where C is the compressed length of the
members of X one after the other. The compressor is zlib's at level 9 (ours), whose window of 32 kB
holds all roads of a set.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, evenly

MOST_COMPRESSED: Final = 100
"""Largest number of roads in a set (our choice), since the diameter grows with the number; of more
roads, so many are taken evenly."""
_CURVATURE_STEP: Final = 0.001  # [1/m] to which curvatures are rounded
_LARGEST_STEPS: Final = 127  # of curvature in a byte: a radius of 8 m
_LEVEL: Final = 9


def set_diameter(roads: Iterable[FloatArray]) -> float | None:
    """Return the diameter of a set of roads, mostly 0..1; None for fewer than two roads.

    Args:
        roads: curvatures of each road, in 1/m.
    """
    words = [_word(curvatures) for curvatures in roads]
    words = [words[i] for i in evenly(len(words), MOST_COMPRESSED)]
    if len(words) < 2:
        return None
    shortest = min(map(_compressed_length, [[word] for word in words]))
    longest = max(_compressed_length(words[:i] + words[i + 1 :]) for i in range(len(words)))
    return (_compressed_length(words) - shortest) / longest


def _word(curvatures: FloatArray) -> bytes:
    """Return a road's curvatures, rounded, with a byte for each."""
    steps = np.rint(curvatures / _CURVATURE_STEP)
    return np.clip(steps, -_LARGEST_STEPS, _LARGEST_STEPS).astype(np.int8).tobytes()


def _compressed_length(words: list[bytes]) -> int:
    """Return the compressed length of words one after the other, in bytes."""
    return len(zlib.compress(b"".join(words), _LEVEL))
