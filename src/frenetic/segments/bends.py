"""Bends of a line, and places of a road in words, relative to the bends around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.oracle.verdict import Side
from frenetic.search.approach import AHEAD, BEHIND

GENTLE: Final = 0.005
"""Curvature below which a road counts as straight, in 1/m: a radius of 200 m (our choice)."""
LEAST_TURN: Final = math.radians(10.0)
"""Least turn of a bend, in rad (our choice)."""
AFTER_BEND: Final = 20.0
"""Distance after a bend up to which a place belongs to the bend, in m (our choice).

A car that a bend throws out of its lane has left it up to 13 m after the bend."""
BEFORE_BEND: Final = AHEAD
"""Distance before a bend from which on a place belongs to the bend, in m.

It is the length of road after the place by which failures are compared."""

_GENTLEST_SHARE: Final = 0.25
"""Least curvature of a bend on a road without sharp bends, as a share of the road's largest."""
_MENTIONED_STRAIGHT: Final = 15.0
"""Least length of a straight before a bend that is mentioned, in m (our choice)."""
_STRAIGHT: Final = 1e-4
"""Curvature below which every road counts as straight, in 1/m: a radius of 10 km (our choice)."""
_ROUNDING: Final = 1e-9
"""Turn that a rounding error can make, in rad."""


@dataclass(frozen=True)
class Bend:
    """Stretch of a line that turns to one side and is not too gentle, see `find_bends`."""

    start: float
    """Start, in m along the road."""
    end: float
    """End, in m along the road."""
    turn: float
    """Turn in rad, positive to the left."""
    sharpest: float
    """Largest curvature without its sign, in 1/m."""

    @property
    def side(self) -> Side:
        """Direction of the turn."""
        return "left" if self.turn > 0.0 else "right"


def find_bends(
    distances: FloatArray, curvatures: FloatArray, gentle: float = GENTLE
) -> tuple[Bend, ...]:
    """Return the bends of a line, in order.

    Args:
        distances: (n,) distances along the line in m, increasing.
        curvatures: (n,) curvatures in 1/m at these distances, linear in between.
        gentle: curvature in 1/m below which the line counts as straight. The least turn of a bend
            is `LEAST_TURN` times `gentle` / `GENTLE`.
    """
    s, kappa = _cut(distances, curvatures, (-gentle, gentle))
    means = [0.5 * (start + end) for start, end in pairwise(kappa)]
    sides = [math.copysign(1.0, mean) if abs(mean) >= gentle else 0.0 for mean in means]
    least_turn = LEAST_TURN * gentle / GENTLE
    bends, last = [], 0
    for side, pieces in groupby(sides):
        first, last = last, last + len(list(pieces))
        if side == 0.0:
            continue
        turn = 0.0
        for i in range(first, last):
            turn += means[i] * (s[i + 1] - s[i])
        # A rounding error must not decide on a bend of exactly the least turn.
        if abs(turn) >= least_turn - _ROUNDING:
            sharpest = max(map(abs, kappa[first : last + 1]))
            bends.append(Bend(s[first], s[last], turn, sharpest))
    return tuple(bends)


def heading_range(distances: FloatArray, curvatures: FloatArray) -> tuple[float, float]:
    """Return the least and the largest heading of a line in rad, from 0 at its start.

    Args:
        distances: (n,) distances along the line in m, increasing.
        curvatures: (n,) curvatures in 1/m at these distances, linear in between.
    """
    s, kappa = _cut(distances, curvatures, (0.0,))
    heading = least = most = 0.0
    for (start, end), (kappa_start, kappa_end) in zip(pairwise(s), pairwise(kappa), strict=True):
        heading += 0.5 * (kappa_end + kappa_start) * (end - start)
        least, most = min(least, heading), max(most, heading)
    return least, most


def _cut(
    distances: FloatArray, curvatures: FloatArray, levels: tuple[float, ...]
) -> tuple[list[float], list[float]]:
    """Return distances and curvatures with an extra sample wherever a level is crossed."""
    s, kappa = distances.tolist(), curvatures.tolist()  # few numbers: faster than arrays
    for level in levels:
        for i in range(len(s) - 2, -1, -1):
            before, after = kappa[i], kappa[i + 1]
            if (before - level) * (after - level) < 0.0:
                share = (level - before) / (after - before)
                s.insert(i + 1, s[i] + share * (s[i + 1] - s[i]))
                kappa.insert(i + 1, level)
    return s, kappa


def bends_of(curvatures: FloatArray, step: float) -> tuple[Bend, ...]:
    """Return the bends of a whole road, by which places on it are described.

    On a road without sharp bends, such as a motorway, gentler bends count, too: those with at least
    a quarter of the road's largest curvature.

    Args:
        curvatures: curvatures of the road, (n,) in 1/m.
        step: distance between two curvatures, in m.
    """
    gentle = max(min(GENTLE, _GENTLEST_SHARE * float(np.abs(curvatures).max())), _STRAIGHT)
    return find_bends(np.arange(len(curvatures), dtype=np.float64) * step, curvatures, gentle)


def bend_of_place(bends: Sequence[Bend], place: float) -> Bend | None:
    """Return the bend to which a place belongs; None for a place on a straight.

    The place belongs to the bend in which it lies, else to the last bend that ended at most
    `AFTER_BEND` before it, else to the next bend that starts at most `BEFORE_BEND` after it.

    Args:
        bends: bends of the road, in order.
        place: place, in m along the road.
    """
    around = [bend for bend in bends if bend.start <= place <= bend.end]
    passed = [bend for bend in reversed(bends) if 0.0 < place - bend.end <= AFTER_BEND]
    ahead = [bend for bend in bends if 0.0 < bend.start - place <= BEFORE_BEND]
    return next(iter([*around, *passed, *ahead]), None)


def place_text(curvatures: FloatArray, step: float, place: float) -> str:
    """Return a place of a road in words: ``10 m past a left-hand bend of 15 m radius``.

    Args:
        curvatures: curvatures of the whole road, (n,) in 1/m.
        step: distance between two curvatures, in m.
        place: place, in m along the road.
    """
    bends = bends_of(curvatures, step)
    bend = bend_of_place(bends, place)
    if bend is None:
        return "on a straight"
    if place > bend.end:
        part = f"{_gap(place - bend.end)} past"
    elif place < bend.start:
        part = f"{_gap(bend.start - place)} before"
    else:
        turned_share = _turn(curvatures, step, bend.start, place) / bend.turn
        part = "at the end of"
        if turned_share < 2 / 3:
            part = "entering" if turned_share < 1 / 3 else "in"
    text = f"{part} a {bend.side}-hand bend of {1.0 / bend.sharpest:.0f} m radius"
    previous = next((other for other in reversed(bends) if other.end <= bend.start), None)
    # What lies further back than failures are compared is not mentioned.
    straight_start = max(0.0 if previous is None else previous.end, place - BEHIND)
    if bend.start - straight_start >= _MENTIONED_STRAIGHT:
        return f"{text} after a straight"
    if previous is not None and previous.end > place - BEHIND:
        return f"{text} after a {previous.side}-hand bend"
    return text


def _gap(distance: float) -> str:
    """Return a distance from a bend in words."""
    return "just" if distance < 0.5 else f"{distance:.0f} m"


def _turn(curvatures: FloatArray, step: float, start: float, end: float) -> float:
    """Return the angle in rad by which a road turns between two places, positive to the left."""
    samples = np.arange(len(curvatures)) * step
    places = np.concatenate([[start], samples[(samples > start) & (samples < end)], [end]])
    kappa = np.interp(places, samples, curvatures)
    return float(np.sum(0.5 * (kappa[1:] + kappa[:-1]) * np.diff(places)))
