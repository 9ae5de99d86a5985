"""The road that a camera sees, with a table that finds the piece of road nearest to a point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road import Road
from frenetic.road.geometry import frame_at

if TYPE_CHECKING:
    import numpy.typing as npt

SHOULDER_WIDTH: Final = 1.0
"""Width of the gravel beside the road, in m."""
LENGTH_BEYOND: Final = 80.0
"""Length of straight road that is drawn beyond the road's end, in m."""
LENGTH_BEFORE: Final = 20.0
"""Length of straight road that is drawn before the road's start, in m."""

_SPACING = 1.0  # [m] between two rows of the drawn road
_EMPTY = -(2**62)  # key of a slot that holds no cell

# Columns of the rows: place (m), cosine and sine of the heading, curvature (1/m).
_X, _Y, _COSINE, _SINE, _CURVATURE = range(5)


class DrawnRoad(NamedTuple):
    """A road in rows, and a hash table of the square cells near it."""

    rows: FloatArray
    """Place, heading and curvature every metre, (rows, 5)."""
    cells_per_metre: float
    """Inverse of the side of a cell."""
    keys: npt.NDArray[np.int64]
    """Cell of each slot, (slots,)."""
    nearest: npt.NDArray[np.int64]
    """Row nearest to the middle of each slot's cell, (slots,)."""


class Spot(NamedTuple):
    """Where a point lies on the drawn road."""

    left: float
    """Offset to the left of the centre line, in m."""
    along: float
    """Distance from the first row, in m."""
    cosine: float
    """Cosine of the road's heading."""
    sine: float
    """Sine of the road's heading."""
    stretch: float
    """Metres of the centre line per metre at this offset; 0 far from the road."""


def lay_drawn_road(road: Road) -> DrawnRoad:
    """Return a road as it is drawn, straight beyond its ends."""
    before = round(LENGTH_BEFORE / _SPACING)
    length = math.ceil(road.length / _SPACING)
    count = before + length + 1 + round(LENGTH_BEYOND / _SPACING)
    rows = _road_rows(road.table, road.sub_step, before, count)
    # A pixel's footprint may reach onto the road from beside it.
    reach = road.lane_width + SHOULDER_WIDTH + 1.0
    cell = max(2.0, 0.5 * road.lane_width)
    wide = reach + 3.0 * cell
    cells = (2.0 * wide * count * _SPACING + math.pi * wide * wide) / cell**2
    slots = 1 << math.ceil(math.log2(2.0 * cells))
    keys = np.full(slots, _EMPTY, dtype=np.int64)
    nearest = np.empty(slots, dtype=np.int64)
    _enter_rows(rows, before, before + length + 1, reach, cell, keys, nearest, np.empty(slots))
    return DrawnRoad(rows, 1.0 / cell, keys, nearest)


@njit()
def _road_rows(table: FloatArray, ds: float, before: int, count: int) -> FloatArray:
    """Return the rows of a road, the first ``before`` rows ahead of its start."""
    rows = np.empty((count, 5))
    for i in range(count):
        x, y, cosine, sine, curvature = frame_at(table, ds, (i - before) * _SPACING)
        rows[i, _X] = x
        rows[i, _Y] = y
        rows[i, _COSINE] = cosine
        rows[i, _SINE] = sine
        rows[i, _CURVATURE] = curvature
    return rows


@njit(error_model="numpy")
def _slot_of(keys: npt.NDArray[np.int64], key: int) -> int:
    """Return the slot of a key in a hash table: where it is, or where it would be entered."""
    mask = len(keys) - 1
    slot = ((key * 0x9E3779B97F4A7C1) >> 40) & mask
    while keys[slot] != _EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit(error_model="numpy")
def _key_of(ix: int, iy: int) -> int:
    """Return the key of a cell."""
    return ix * 67108864 + iy


@njit()
def _enter_rows(
    rows: FloatArray,
    start: int,
    end: int,
    reach: float,
    cell: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
    squares: FloatArray,
) -> None:
    """Enter for each cell near the road the row nearest to its middle.

    The rows from ``start`` up to ``end`` are the road itself. Those beyond its ends give way to it,
    where it comes by.
    """
    span = math.ceil(reach / cell)
    last = len(rows)
    for turn in range(2):
        for i in range(last):
            is_road = start <= i < end
            if is_road != (turn == 0):
                continue
            x, y = rows[i, _X], rows[i, _Y]
            cx, cy = math.floor(x / cell), math.floor(y / cell)
            for ix in range(cx - span, cx + span + 1):
                for iy in range(cy - span, cy + span + 1):
                    square = ((ix + 0.5) * cell - x) ** 2 + ((iy + 0.5) * cell - y) ** 2
                    if square > (reach + cell) ** 2:
                        continue
                    key = _key_of(ix, iy)
                    slot = _slot_of(keys, key)
                    if keys[slot] == key:
                        if square >= squares[slot]:
                            continue
                        other = nearest[slot]
                        if not is_road and start <= other < end:
                            # Only the road's own end meets what lies beyond it.
                            gap = start - other if i < start else other - end
                            if abs(gap) > 2.0 * reach / _SPACING:
                                continue
                    keys[slot] = key
                    nearest[slot] = i
                    squares[slot] = square


@njit(error_model="numpy")
def locate(
    x: float,
    y: float,
    rows: FloatArray,
    cells_per_metre: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
) -> Spot:
    """Return where a point of the ground lies on the road."""
    key = _key_of(math.floor(x * cells_per_metre), math.floor(y * cells_per_metre))
    slot = _slot_of(keys, key)
    if keys[slot] != key:
        return Spot(0.0, 0.0, 0.0, 0.0, 0.0)
    i = nearest[slot]
    dx, dy = x - rows[i, _X], y - rows[i, _Y]
    along = dx * rows[i, _COSINE] + dy * rows[i, _SINE]
    step = math.floor(along / _SPACING + 0.5)
    if step != 0:
        i = min(max(i + step, 0), len(rows) - 1)
        dx, dy = x - rows[i, _X], y - rows[i, _Y]
        along = dx * rows[i, _COSINE] + dy * rows[i, _SINE]
    if abs(along) > 4.0 * _SPACING:
        return Spot(0.0, 0.0, 0.0, 0.0, 0.0)
    left = dy * rows[i, _COSINE] - dx * rows[i, _SINE]
    curvature = rows[i, _CURVATURE]
    stretch = 1.0 / max(1.0 - curvature * left, 0.2)
    offset = left - 0.5 * curvature * along * along * stretch
    along *= stretch
    turned = curvature * along
    cosine = rows[i, _COSINE] - turned * rows[i, _SINE]
    sine = rows[i, _SINE] + turned * rows[i, _COSINE]
    return Spot(offset, i * _SPACING + along, cosine, sine, stretch)
