"""The road that a camera sees, with a table that finds the piece of road nearest to a point.

The road is a list of rows, one every metre. A grid of square cells covers the ground near it, and a
hash table holds the nearest row for each cell. `locate` looks up the row of a point's cell and
corrects it with the row's heading and curvature.
"""

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

# The lengths and widths are our choice.
SHOULDER_WIDTH: Final = 1.0
"""Width of the gravel beside the road, in m."""
LENGTH_BEYOND: Final = 80.0
"""Length of straight road that is drawn beyond the road's end, in m."""
LENGTH_BEFORE: Final = 20.0
"""Length of straight road that is drawn before the road's start, in m."""

_SPACING = 1.0  # [m], along the road from one row to the next
_LEAST_CELL_SIDE = 2.0  # [m]
_FOOTPRINT_REACH = 1.0  # [m], from a pixel's centre beside the road to the edge of its footprint

_EMPTY = -(2**62)  # key of a slot without a cell
_HASH_FACTOR = 0x9E3779B97F4A7C1  # 2^60 divided by the golden ratio spreads neighbouring keys
_COLUMN_KEYS = 67108864  # 2^26, difference of the keys of two neighbouring columns of cells

# Columns of the rows: x and y (m), cosine and sine of the heading, curvature (1/m).
_X, _Y, _COSINE, _SINE, _CURVATURE = range(5)


class DrawnRoad(NamedTuple):
    """A road in rows, and a hash table of the square cells near it."""

    rows: FloatArray
    """Position, heading and curvature every metre, (rows, 5)."""
    cells_per_metre: float
    """Inverse of the side of a cell, in 1/m."""
    keys: npt.NDArray[np.int64]
    """Key of the cell in each slot of the hash table, (slots,)."""
    nearest: npt.NDArray[np.int64]
    """Index of the row nearest to the middle of the cell in each slot, (slots,)."""


class Spot(NamedTuple):
    """Position of a point relative to the drawn road."""

    left: float
    """Offset to the left of the centre line, in m."""
    along: float
    """Distance along the centre line from the first row, in m."""
    cosine: float
    """Cosine of the road's heading."""
    sine: float
    """Sine of the road's heading."""
    stretch: float
    """Metres along the centre line for each metre at this offset; 0 for a point far from the road,
    where the other values mean nothing."""


def make_drawn_road(road: Road) -> DrawnRoad:
    """Return a road as it is drawn, straight beyond its ends."""
    before = round(LENGTH_BEFORE / _SPACING)
    length = math.ceil(road.length / _SPACING)
    count = before + length + 1 + round(LENGTH_BEYOND / _SPACING)
    rows = _road_rows(road.table, road.sub_step, before, count)
    reach = road.lane_width + SHOULDER_WIDTH + _FOOTPRINT_REACH
    cell_side = max(_LEAST_CELL_SIDE, 0.5 * road.lane_width)
    # An upper bound of the number of cells: a straight band around the road with round ends.
    half_width = reach + 3.0 * cell_side
    area = 2.0 * half_width * count * _SPACING + math.pi * half_width * half_width
    cells = area / cell_side**2
    # The hash table stays at most half full, and its size is a power of two.
    slots = 1 << math.ceil(math.log2(2.0 * cells))
    keys = np.full(slots, _EMPTY, dtype=np.int64)
    nearest = np.empty(slots, dtype=np.int64)
    squares = np.empty(slots)
    _enter_rows(rows, before, before + length + 1, reach, cell_side, keys, nearest, squares)
    return DrawnRoad(rows, 1.0 / cell_side, keys, nearest)


@njit()
def _road_rows(table: FloatArray, ds: float, before: int, count: int) -> FloatArray:
    """Return the rows of a road.

    Args:
        table, ds: the road's table and sub-step, see `frenetic.road.geometry`.
        before: number of rows before the road's start.
        count: number of rows.
    """
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
    """Return the slot that holds a key, or the empty slot in which the key would be entered."""
    mask = len(keys) - 1
    slot = ((key * _HASH_FACTOR) >> 40) & mask
    while keys[slot] != _EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit(error_model="numpy")
def _key_of(ix: int, iy: int) -> int:
    """Return the key of the cell with these whole coordinates in the grid."""
    return ix * _COLUMN_KEYS + iy


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
    """Enter the nearest row of each cell near the road into the hash table.

    The road itself is entered first. The straight rows beyond its ends, which would otherwise be
    drawn over the road where it comes back to them, take a cell from it only at its ends.

    Args:
        rows: rows of the drawn road.
        start, end: the rows from ``start`` up to ``end`` are the road itself.
        reach: m from the centre line up to which cells are entered.
        cell: m, side of a cell.
        keys, nearest: the hash table, see `DrawnRoad`; written to.
        squares: (slots,) room for the squared distances of the nearest rows, in m^2.
    """
    span = math.ceil(reach / cell)
    for turn in range(2):  # first the road, then the rows beyond its ends
        for i in range(len(rows)):
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
                            # The road's end may lose a cell to the rows beyond it, not the rest.
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
    """Return the position of a point of the ground relative to the road.

    The road near a row is a parabola with the row's heading and curvature.

    Args:
        x, y: m, the point on the map.
        rows, cells_per_metre, keys, nearest: see `DrawnRoad`.
    """
    key = _key_of(math.floor(x * cells_per_metre), math.floor(y * cells_per_metre))
    slot = _slot_of(keys, key)
    if keys[slot] != key:  # the cell is far from the road
        return Spot(0.0, 0.0, 0.0, 0.0, 0.0)
    i = nearest[slot]
    dx, dy = x - rows[i, _X], y - rows[i, _Y]
    along = dx * rows[i, _COSINE] + dy * rows[i, _SINE]
    step = math.floor(along / _SPACING + 0.5)
    if step != 0:  # another row is nearer to the point than the one nearest to the cell's middle
        i = min(max(i + step, 0), len(rows) - 1)
        dx, dy = x - rows[i, _X], y - rows[i, _Y]
        along = dx * rows[i, _COSINE] + dy * rows[i, _SINE]
    if abs(along) > 4.0 * _SPACING:  # the point lies beyond an end of the drawn road
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
