"""A view of the map from above in Matplotlib's axes, and labels that hide nothing in it.

The map is turned counter-clockwise by the view's angle. A *place in the axes* is a place on the
turned map, in m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection

from frenetic._support.arrays import FloatArray
from frenetic.report.orientation import turned
from frenetic.report.style import PANEL, POINT


@dataclass(frozen=True)
class Box:
    """A rectangle in the axes."""

    low: FloatArray
    """Lower left corner, (2,) in m."""
    high: FloatArray
    """Upper right corner, (2,) in m."""

    @property
    def size(self) -> FloatArray:
        """Width and height, (2,) in m."""
        return self.high - self.low

    @property
    def flatness(self) -> float:
        """Height divided by width."""
        width, height = self.size
        return float(height / width)

    def holding(self, corners: FloatArray) -> Box:
        """Return the box around this box and a second one.

        Args:
            corners: lower left and upper right corner of the second box, (2, 2) in m.
        """
        return Box(np.minimum(self.low, corners[0]), np.maximum(self.high, corners[1]))


@dataclass(frozen=True)
class View:
    """Axes that show the turned map from above."""

    axes: Axes
    turn: float
    """Angle by which the map is turned counter-clockwise, in rad."""
    scale: float
    """Points of the picture per metre."""
    centre: FloatArray
    """Place in the middle of the axes, (2,) in m."""
    half: FloatArray
    """Distances from the middle to the right and upper edge, (2,) in m."""

    @classmethod
    def showing(cls, axes: Axes, box: Box, turn: float) -> View:
        """Return a view of ``box`` that fills the axes."""
        size = size_of(axes)
        scale = float(min(size / box.size))
        half, centre = 0.5 * size / scale, 0.5 * (box.low + box.high)
        (left, bottom), (right, top) = centre - half, centre + half
        axes.set(xlim=(left, right), ylim=(bottom, top), facecolor=PANEL)
        return cls(axes, turn, scale, centre, half)

    def at(self, points: FloatArray) -> FloatArray:
        """Return places in the axes, (n, 2), of places on the map, (n, 2) in m."""
        return turned(points, self.turn)

    def points(self, places: FloatArray) -> FloatArray:
        """Return the offsets of places in the axes, (..., 2), from the middle, in points."""
        offsets: FloatArray = (places - self.centre) * self.scale
        return offsets

    def places(self, points: FloatArray) -> FloatArray:
        """Return the places in the axes at offsets, (..., 2) in points, from the middle."""
        places: FloatArray = self.centre + points / self.scale
        return places

    def shows(self, place: FloatArray) -> bool:
        """Return whether a place, (2,) in the axes, lies within them."""
        return bool((np.abs(place - self.centre) < self.half).all())

    def mark(self, place: FloatArray, marker: str, **style: Any) -> None:
        """Draw a marker at a place, (2,) in the axes."""
        self.axes.plot(*place, linestyle="none", marker=marker, **style)

    def add(self, artists: Collection) -> None:
        """Draw artists; the axes' limits stay."""
        self.axes.add_collection(artists, autolim=False)


def size_of(axes: Axes) -> FloatArray:
    """Return width and height of axes, (2,) in points."""
    box, dpi = axes.bbox, axes.figure.dpi
    return np.array([box.width, box.height]) * POINT / dpi


_REACHES: Final = np.array([11.0, 18.0, 28.0, 42.0, 60.0, 84.0])
"""Tried distances of a label's edge from its place, in points; our choice."""
_LEADER_REACH: Final = 15.0
"""Distance above which a line leads from the place to its label, in points; our choice."""
_DIRECTIONS: Final = np.column_stack(
    [trig(np.arange(16) * (math.pi / 8.0)) for trig in (np.cos, np.sin)]
)
"""Tried directions of a label from its place, (16, 2) unit vectors."""


@dataclass
class Labels:
    """Labels in a view that hide as little as possible and do not touch each other.

    Offsets are in points from the middle of the view.
    """

    view: View
    obstacles: FloatArray
    """Offsets of drawn things that labels must not hide, (n, 2)."""
    size: float = 9.0
    """Size of the letters, in points."""
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Rectangles that no label may touch: left, lower, right and upper edge."""

    def put(self, place: FloatArray, text: str, colour: str) -> None:
        """Write ``text`` beside a place, (2,) in the axes; a line leads to a label far away.

        Of all tried positions, the label takes the one of the least cost.
        """
        offset = self.view.points(place)
        half = np.array([0.31 * self.size * len(text) + 2.0, 0.68 * self.size])  # of the label
        # The reach is counted from the label's edge, a position is the label's centre.
        to_edge = np.min(half / np.maximum(np.abs(_DIRECTIONS), 1e-9), axis=1)
        distances = (_REACHES[:, None] + to_edge - 4.0)[:, :, None]
        centres = (offset + distances * _DIRECTIONS).reshape(-1, 2)
        reaches = np.repeat(_REACHES, len(_DIRECTIONS))
        cheapest = int(np.argmin(self._costs(centres, half) + 0.25 * reaches))
        centre = centres[cheapest]
        low, high = centre - half, centre + half
        self.taken.append((*low, *high))
        if reaches[cheapest] > _LEADER_REACH:
            end = np.clip(offset, low + 1.0, high - 1.0)
            direction = (end - offset) / max(float(np.hypot(*(end - offset))), 1e-9)
            leader = self.view.places(np.array([offset + 6.0 * direction, end]))
            self.view.axes.plot(*leader.T, color=colour, lw=0.7, alpha=0.7, zorder=8)
        x, y = self.view.places(centre)
        self.view.axes.text(
            x, y, text, size=self.size, color=colour,
            ha="center", va="center", weight="bold", zorder=9,
        )  # fmt: skip

    def _costs(self, centres: FloatArray, half: FloatArray) -> FloatArray:
        """Return the costs of a label at each of some centres, (n,).

        Costs are 100 for each point outside the view, 20 for each hidden obstacle and 500 for each
        touched rectangle; our choice.

        Args:
            centres: offsets of the label's centre, (n, 2).
            half: half of the label's width and height, (2,) in points.
        """
        low, high = (centres - half - 2.0)[:, None], (centres + half + 2.0)[:, None]
        frame = self.view.half * self.view.scale
        outside = np.maximum(high - frame, 0.0) + np.maximum(-frame - low, 0.0)
        covered = np.ones((len(low), len(self.obstacles)), dtype=bool)
        for axis in (0, 1):  # axis by axis, in a tenth of the time
            values = np.ascontiguousarray(self.obstacles[:, axis])
            covered &= (values > low[:, :, axis]) & (values < high[:, :, axis])
        hidden = covered.sum(axis=1)
        taken = np.array(self.taken).reshape(-1, 4)
        touching = ((low < taken[:, 2:]) & (taken[:, :2] < high)).all(axis=2).sum(axis=1)
        costs: FloatArray = 100.0 * outside.sum(axis=(1, 2)) + 20.0 * hidden + 500.0 * touching
        return costs

    def keep_clear(self, place: FloatArray, half: float) -> None:
        """Keep labels off a square of twice ``half`` points around a place, (2,) in the axes."""
        centre = self.view.points(place)
        self.taken.append((*(centre - half), *(centre + half)))
