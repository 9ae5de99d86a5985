"""A view of the world from above, and labels that hide nothing in it."""

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
    """A rectangle in the turned plane, in m."""

    low: FloatArray  # (2,) its lower left corner
    high: FloatArray  # (2,) its upper right corner

    @property
    def size(self) -> FloatArray:
        """(2,) width and height."""
        return self.high - self.low

    @property
    def flatness(self) -> float:
        """Height over width."""
        width, height = self.size
        return float(height / width)

    def holding(self, ends: FloatArray) -> Box:
        """Return the box around this box and a second box's lower left and upper right corners."""
        return Box(np.minimum(self.low, ends[0]), np.maximum(self.high, ends[1]))


@dataclass(frozen=True)
class View:
    """Axes that show the world from above, turned, in m."""

    axes: Axes
    turn: float  # rad counter-clockwise
    scale: float  # points per metre when it is drawn
    centre: FloatArray  # (2,) m, turned, in the middle
    half: FloatArray  # (2,) m from the middle to the edges

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
        """Return the (n, 2) places in the axes of (n, 2) places on the map, in m."""
        return turned(points, self.turn)

    def points(self, places: FloatArray) -> FloatArray:
        """Return the (..., 2) places in points from the view's middle."""
        offsets: FloatArray = (places - self.centre) * self.scale
        return offsets

    def places(self, points: FloatArray) -> FloatArray:
        """Return the places of (..., 2) offsets in points from the view's middle."""
        places: FloatArray = self.centre + points / self.scale
        return places

    def shows(self, place: FloatArray) -> bool:
        """Return whether a place, (2,) in the axes, is in sight."""
        return bool((np.abs(place - self.centre) < self.half).all())

    def mark(self, place: FloatArray, marker: str, **style: Any) -> None:
        """Draw a marker at a place, (2,) in the axes."""
        self.axes.plot(*place, linestyle="none", marker=marker, **style)

    def add(self, artists: Collection) -> None:
        """Draw artists without a change of the axes' limits."""
        self.axes.add_collection(artists, autolim=False)


def size_of(axes: Axes) -> FloatArray:
    """Return width and height of axes, (2,) in points."""
    box, dpi = axes.bbox, axes.figure.dpi
    return np.array([box.width, box.height]) * POINT / dpi


_REACHES: Final = np.array([11.0, 18.0, 28.0, 42.0, 60.0, 84.0])
"""Tried distances of a label from its place, in points, ours."""
_DIRECTIONS: Final = np.column_stack(
    [trig(np.arange(16) * (math.pi / 8.0)) for trig in (np.cos, np.sin)]
)
"""Tried directions of a label from its place, (16, 2) unit vectors."""


@dataclass
class Labels:
    """Labels in a view that neither hide anything nor touch each other.

    Internal positions are in points from the middle of the view.
    """

    view: View
    obstacles: FloatArray  # (n, 2) points of drawn things that labels must not hide
    size: float = 9.0
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def put(self, place: FloatArray, text: str, colour: str) -> None:
        """Write ``text`` beside a place, (2,) in the axes, with a leader if need be."""
        place = self.view.points(place)
        half = np.array([0.31 * self.size * len(text) + 2.0, 0.68 * self.size])
        # From the label's edge to the place it is the reach.
        to_edge = np.min(half / np.maximum(np.abs(_DIRECTIONS), 1e-9), axis=1)
        away = (_REACHES[:, None] + to_edge - 4.0)[:, :, None]
        centres = (place + away * _DIRECTIONS).reshape(-1, 2)
        reaches = np.repeat(_REACHES, len(_DIRECTIONS))
        i = int(np.argmin(self._costs(centres, half) + 0.25 * reaches))
        best, chosen = centres[i], reaches[i]
        low, high = best - half, best + half
        self.taken.append((*low, *high))
        if chosen > 15.0:
            near = np.clip(place, low + 1.0, high - 1.0)
            away = (near - place) / max(float(np.hypot(*(near - place))), 1e-9)
            leader = self.view.places(np.array([place + 6.0 * away, near]))
            self.view.axes.plot(*leader.T, color=colour, lw=0.7, alpha=0.7, zorder=8)
        x, y = self.view.places(best)
        self.view.axes.text(
            x, y, text, size=self.size, color=colour,
            ha="center", va="center", weight="bold", zorder=9,
        )  # fmt: skip

    def _costs(self, centres: FloatArray, half: FloatArray) -> FloatArray:
        """Return the costs of labels at (n, 2) ``centres``: hidden things, touched labels, cuts."""
        low, high = (centres - half - 2.0)[:, None], (centres + half + 2.0)[:, None]
        frame = self.view.half * self.view.scale
        outside = np.maximum(high - frame, 0.0) + np.maximum(-frame - low, 0.0)
        covered = np.ones((len(low), len(self.obstacles)), dtype=bool)
        for axis in (0, 1):  # one after the other, in a tenth of the time
            places = np.ascontiguousarray(self.obstacles[:, axis])
            covered &= (places > low[:, :, axis]) & (places < high[:, :, axis])
        hidden = covered.sum(axis=1)
        taken = np.array(self.taken).reshape(-1, 4)
        touching = ((low < taken[:, 2:]) & (taken[:, :2] < high)).all(axis=2).sum(axis=1)
        costs: FloatArray = 100.0 * outside.sum(axis=(1, 2)) + 20.0 * hidden + 500.0 * touching
        return costs

    def keep_clear(self, place: FloatArray, half: float) -> None:
        """Let no label touch the square of 2 ``half`` points around a place, (2,) in the axes."""
        centre = self.view.points(place)
        self.taken.append((*(centre - half), *(centre + half)))
