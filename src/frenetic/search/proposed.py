"""Roads that a search has proposed."""

from __future__ import annotations

import hashlib

import numpy as np

from frenetic._support.arrays import FloatArray


class ProposedRoads:
    """The set of roads that a search has proposed, by fingerprints of their curvatures."""

    def __init__(self) -> None:
        self._fingerprints: set[bytes] = set()

    def __contains__(self, curvatures: FloatArray) -> bool:
        """Return whether a road of these curvatures, (n,) in 1/m, was proposed."""
        return fingerprint(curvatures) in self._fingerprints

    def add(self, curvatures: FloatArray) -> None:
        """Add the road of these curvatures, (n,) in 1/m."""
        self._fingerprints.add(fingerprint(curvatures))


def fingerprint(curvatures: FloatArray) -> bytes:
    """Return 16 bytes that are equal for roads of equal curvatures, and else differ."""
    # Adding 0 makes negative zeros positive.
    values = np.ascontiguousarray(curvatures, dtype="<f8") + 0.0
    return hashlib.blake2b(values.tobytes(), digest_size=16).digest()
