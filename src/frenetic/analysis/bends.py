"""The bends of a road."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.oracle import Side

GENTLE: Final = 0.005
"""Curvature below which a road counts as straight, in 1/m: a radius of 200 m."""
LEAST_TURN: Final = math.radians(10.0)
"""Least turn of a bend, in rad."""


@dataclass(frozen=True)
class Bend:
    """A stretch that turns one way, `LEAST_TURN` or more, with a curvature of at least `GENTLE`."""

    start: float
    """m."""
    end: float
    """m."""
    turn: float
    """Turn in rad, positive to the left."""
    sharpest: float
    """Largest curvature without its sign, in 1/m."""

    @property
    def side(self) -> Side:
        """Direction of the turn."""
        return "left" if self.turn > 0.0 else "right"


def find_bends(distances: FloatArray, curvatures: FloatArray) -> tuple[Bend, ...]:
    """The bends of a line, in order.

    Args:
        distances: (n,) m, increasing.
        curvatures: (n,) 1/m at these distances, linear in between.
    """
    s, kappa = _cut(distances, curvatures, (-GENTLE, GENTLE))
    middle = 0.5 * (kappa[1:] + kappa[:-1])
    turns = middle * np.diff(s)
    way = np.where(np.abs(middle) >= GENTLE, np.sign(middle), 0.0)
    # First and one past the last piece of each stretch that turns one way.
    edges = np.flatnonzero(np.diff(way, prepend=np.nan, append=np.nan))
    found = []
    for first, last in pairwise(edges):
        turn = float(turns[first:last].sum())
        # A rounding error must not decide on a bend of exactly this size.
        if way[first] and abs(turn) >= LEAST_TURN - 1e-9:
            sharpest = float(np.abs(kappa[first : last + 1]).max())
            found.append(Bend(float(s[first]), float(s[last]), turn, sharpest))
    return tuple(found)


def heading_range(distances: FloatArray, curvatures: FloatArray) -> tuple[float, float]:
    """Least and largest heading in rad of a line as for `find_bends`; its first is 0."""
    s, kappa = _cut(distances, curvatures, (0.0,))
    headings = np.concatenate([[0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * np.diff(s))])
    return float(headings.min()), float(headings.max())


def _cut(
    distances: FloatArray, curvatures: FloatArray, levels: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Distances and curvatures with a sample more wherever the curvature crosses a level."""
    s, kappa = distances, curvatures
    for level in levels:
        i = np.flatnonzero((kappa[:-1] - level) * (kappa[1:] - level) < 0.0)
        share = (level - kappa[i]) / (kappa[i + 1] - kappa[i])
        s = np.insert(s, i + 1, s[i] + share * (s[i + 1] - s[i]))
        kappa = np.insert(kappa, i + 1, level)
    return s, kappa
