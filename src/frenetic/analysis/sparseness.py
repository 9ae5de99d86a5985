"""Differences between failing roads: edit distances, and measures made of them.

A line of points is compared as a word: each step from point to point is a letter, made of the
step's turn and length. The distance between two lines is Levenshtein's: the least cost of changing
one word into the other. Inserting or deleting a letter costs 1. Replacing a letter costs nothing if
both letters are nearly the same, and otherwise up to 1, growing with their difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

SAME_ANGLE: Final = 0.3
"""Difference below which two turns count as equal, in degrees (the competition's)."""
SAME_LENGTH: Final = 0.2
"""Difference below which two lengths count as equal, in m (the competition's)."""
UNLIKE: Final = 0.2
"""Edits per step above which two lines are unlike each other (our choice)."""
MOST_COMPARED: Final = 2000
"""Largest number of failures for the competition's sparseness (our choice).

Its time grows with the square of this number.
"""


def largest_distances(segments: Sequence[npt.ArrayLike]) -> FloatArray:
    """Return the largest edit distance of each failure to a *later* one, (n - 1,) in edits.

    The mean and the deviation of these distances are the sparseness that the competition's
    published code computes. No distance belongs to the last failure, and the order matters.

    Args:
        segments: (n, 2) points each, see `frenetic.analysis.competition_segment`, in the order of
            the tests.

    Raises:
        ValueError: a segment has fewer than two points.
    """
    largest: FloatArray = _largest_later(*_words(segments)) if segments else np.empty(0)
    return largest


def unlike_lines(lines: Sequence[npt.ArrayLike]) -> int:
    """Return the number of lines that are unlike each other.

    Lines are taken in turn. A line counts if its distance to each line that counted before is more
    than `UNLIKE` times the number of steps of the longer line of the two.

    Args:
        lines: (n, 2) points each, in equal steps.

    Raises:
        ValueError: a line has fewer than two points.
    """
    return int(_unlike(*_words(lines))) if lines else 0


def _words(
    segments: Sequence[npt.ArrayLike],
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Return turns in degrees and lengths in m of all steps, and the first step of each segment.

    The last of the (segments + 1) indices of steps is the end of the last segment.
    """
    angles, lengths, counts = [], [], [0]
    for segment in segments:
        points = np.asarray(segment, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise ValueError(f"a segment has shape {points.shape}: two or more points x, y needed")
        steps = np.diff(points, axis=0)
        headings = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))
        # Turns lie in -180..180, so that two of them differ by at most 360.
        angles.append((np.diff(headings, prepend=headings[0]) + 180.0) % 360.0 - 180.0)
        lengths.append(np.hypot(steps[:, 0], steps[:, 1]))
        counts.append(len(steps))
    return np.concatenate(angles), np.concatenate(lengths), np.cumsum(counts, dtype=np.int64)


@njit()
def _replacement(angles: FloatArray, lengths: FloatArray, p: int, q: int) -> float:
    """Return the cost 0..1 of replacing step p by step q."""
    angle = abs(angles[p] - angles[q])
    angle = min(angle, 360.0 - angle)
    length = abs(lengths[p] - lengths[q])
    if angle < SAME_ANGLE and length < SAME_LENGTH:
        return 0.0
    # The mean of angle / (1 + angle) and length / (1 + length), with one division.
    u, v = 1.0 + angle, 1.0 + length
    cost: float = 0.5 * (angle * v + length * u) / (u * v)
    return cost


@njit()
def _upper_bound(
    angles: FloatArray, lengths: FloatArray, i: int, i_end: int, j: int, j_end: int
) -> float:
    """Return the cost of replacing step by step, without a shift: never less than `_distance`."""
    both = min(i_end - i, j_end - j)
    cost = 0.0
    for p in range(both):
        cost += _replacement(angles, lengths, i + p, j + p)
    return cost + max(i_end - i, j_end - j) - both


@njit()
def _distance(
    angles: FloatArray, lengths: FloatArray, i: int, i_end: int, j: int, j_end: int
) -> float:
    """Return the edit distance between the steps i .. i_end - 1 and j .. j_end - 1."""
    m = j_end - j
    # row[q] is the cost of changing the first p letters of one word into the first q letters of the
    # other; p grows by 1 with each pass.
    row = np.arange(m + 1).astype(np.float64)
    for p in range(i, i_end):
        diagonal = row[0]
        row[0] += 1.0
        for q in range(m):
            cost = diagonal + _replacement(angles, lengths, p, j + q)
            diagonal = row[q + 1]
            row[q + 1] = min(cost, min(row[q], diagonal) + 1.0)
    distance: float = row[m]
    return distance


@njit()
def _largest_later(
    angles: FloatArray, lengths: FloatArray, starts: npt.NDArray[np.int64]
) -> FloatArray:
    """Return the largest distance of each segment to a later one, (k - 1,).

    The pairs with the largest upper bounds are compared first, until no other can be further apart:
    about a tenth of all pairs.
    """
    k = len(starts) - 1
    largest = np.zeros(k - 1)
    for i in range(k - 1):
        bounds = np.empty(k - 1 - i)
        for j in range(i + 1, k):
            bounds[j - i - 1] = _upper_bound(
                angles, lengths, starts[i], starts[i + 1], starts[j], starts[j + 1]
            )
        # Not sorted: numba's names for the parts of a sort are unique in one process only, so two
        # cached kernels that sort would call each other's.
        while bounds.max() > largest[i]:
            likeliest = int(bounds.argmax())
            bounds[likeliest] = 0.0
            j = i + 1 + likeliest
            edits = _distance(angles, lengths, starts[i], starts[i + 1], starts[j], starts[j + 1])
            largest[i] = max(largest[i], edits)
    return largest


@njit()
def _are_alike(
    angles: FloatArray, lengths: FloatArray, i: int, i_end: int, j: int, j_end: int
) -> bool:
    """Return whether two segments are not unlike each other, see `unlike_lines`."""
    most = UNLIKE * max(i_end - i, j_end - j)
    if abs((i_end - i) - (j_end - j)) > most:
        return False
    if _upper_bound(angles, lengths, i, i_end, j, j_end) <= most:
        return True
    return bool(_distance(angles, lengths, i, i_end, j, j_end) <= most)


@njit()
def _unlike(angles: FloatArray, lengths: FloatArray, starts: npt.NDArray[np.int64]) -> int:
    """Return the number of segments that are unlike each other, see `unlike_lines`."""
    counted = np.empty(len(starts) - 1, np.int64)
    n = 0
    for i in range(len(starts) - 1):
        is_new = True
        for j in counted[:n]:
            if _are_alike(angles, lengths, starts[i], starts[i + 1], starts[j], starts[j + 1]):
                is_new = False
                break
        if is_new:
            counted[n] = i
            n += 1
    return n
