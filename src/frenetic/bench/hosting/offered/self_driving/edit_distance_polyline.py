"""Difference of two roads: the distance behind the competition's sparseness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError

_SAME_ANGLE: Final = 0.3  # degrees by which the turns of two equal steps differ less
_SAME_LENGTH: Final = 0.2  # m by which the lengths of two equal steps differ less


def iterative_levenshtein(s: Sequence[Sequence[float]], t: Sequence[Sequence[float]]) -> float:
    """Return the edits that turn one line into the other, step by step.

    Inserting or deleting a step costs 1; replacing one costs nothing if turn and length are nearly
    the same, otherwise up to 1.

    Args:
        s: points x, y in m, two or more.
        t: likewise.

    Raises:
        RoadError: A line has fewer than two points.

    """
    turns, lengths = _steps(s)
    other_turns, other_lengths = _steps(t)
    row = np.arange(len(other_turns) + 1.0)  # [q]: edits from the steps so far to the first q
    for p in range(len(turns)):
        turned = np.abs((turns[p] - other_turns + 180.0) % 360.0 - 180.0)
        longer = np.abs(lengths[p] - other_lengths)
        replacing = 0.5 * (turned / (1.0 + turned) + longer / (1.0 + longer))
        replacing[(turned < _SAME_ANGLE) & (longer < _SAME_LENGTH)] = 0.0
        kept = np.minimum(row[:-1] + replacing, row[1:] + 1.0).tolist()
        edits = [p + 1.0]
        for cost in kept:
            edits.append(min(cost, edits[-1] + 1.0))
        row = np.array(edits)
    return float(row[-1])


def _steps(line: Sequence[Sequence[float]]) -> tuple[FloatArray, FloatArray]:
    """Turn in degrees, of the first step 0, and length in m of every step."""
    if len(line) < 2:
        raise RoadError(f"a line needs at least 2 points, but there are {len(line)}")
    steps = np.diff(np.array([(point[0], point[1]) for point in line], dtype=np.float64), axis=0)
    headings = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))
    return np.diff(headings, prepend=headings[:1]), np.hypot(steps[:, 0], steps[:, 1])
