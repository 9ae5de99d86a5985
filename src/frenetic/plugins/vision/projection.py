"""What the pixels of a camera look at: points of flat ground, or directions of the sky.

In the car's frame this never changes for a camera, so it is calculated once. A pixel is the mean of
one to four *samples*, one above the other. A sample's *footprint* is the piece of ground that it
covers. A *line* has the samples of one height, one for each column of the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.camera import Camera

if TYPE_CHECKING:
    import numpy.typing as npt

SKY_COLUMNS: Final = 1024
"""Columns of the panorama of the sky, all around, counter-clockwise from +x; our choice."""
SKY_ROWS: Final = 128
"""Rows of the panorama; row i is (i / rows)^2 of the way from the horizon to the zenith."""

X, Y, RIGHT_X, RIGHT_Y, DOWN_X, DOWN_Y, FOOTPRINT, CLEAR = range(8)
"""Indices of a sample's values.

Of the ground: the point's x and y in the car's frame, the vectors across the footprint to the right
and downwards, the footprint's size, all in m, and the share of the colour that the haze leaves. Of
the sky: column and row of the panorama as ``X`` and ``Y``, and a negative ``CLEAR``."""

# Our choice, by eye.
_GROUND_END = 4000.0  # [m], distance at which the ground ends in the haze
_HAZE_LENGTH = 900.0  # [m], distance at which the haze has replaced 63 % of a colour
_MOST_LINES = 4  # largest number of lines for one row of pixels
_LONGEST_FOOTPRINT = 2.0  # [m]; a longer one may cover more than one piece of a bend


@dataclass(frozen=True, eq=False)
class Projection:
    """Samples of a camera's image, in lines: a row of the image has one to four lines."""

    first_lines: npt.NDArray[np.int64]
    """Index of the first line of each row, and at last the number of lines, (height + 1,)."""
    samples: npt.NDArray[np.float32]
    """Samples, whose values have the indices above, (lines, width, 8)."""


@lru_cache(maxsize=8)
def projection_of(camera: Camera) -> Projection:
    """Return the samples of a camera.

    A row of pixels with long footprints has several lines, a row near the horizon at least two.
    """
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    single = _samples_at(camera, rows, columns, 1.0)
    lengths = np.hypot(single[..., DOWN_X], single[..., DOWN_Y]).max(axis=1)
    line_counts = np.clip(np.ceil(lengths / _LONGEST_FOOTPRINT), 1, _MOST_LINES)
    # Pixels at the horizon show both ground and sky.
    horizon_distances = np.abs(camera.rays_through(rows, columns)[..., 2]).min(axis=1)
    line_counts[(horizon_distances < 2.0 / camera.focal_length) & (line_counts == 1)] = 2
    first_lines = np.concatenate([[0], np.cumsum(line_counts)]).astype(np.int64)
    row_of_line = np.repeat(np.arange(camera.height), line_counts.astype(np.int64))
    number_in_row = np.arange(first_lines[-1]) - first_lines[row_of_line]
    from_row_centre = (number_in_row + 0.5) / line_counts[row_of_line] - 0.5
    line_rows = np.broadcast_to(
        (row_of_line + from_row_centre)[:, None], (len(row_of_line), camera.width)
    )
    samples = _samples_at(
        camera,
        line_rows,
        np.broadcast_to(columns[0], line_rows.shape),
        1.0 / line_counts[row_of_line][:, None],
    )
    return Projection(first_lines, samples.astype(np.float32))


def _samples_at(
    camera: Camera, rows: FloatArray, columns: FloatArray, height: FloatArray | float
) -> FloatArray:
    """Return samples at points of the image, (lines, width, 8).

    Args:
        camera: the camera.
        rows, columns: (lines, width) the points; a whole number is the middle of a pixel.
        height: number of rows, or fraction of one, that a sample covers.
    """
    samples = np.zeros((*rows.shape, 8))
    rays = camera.rays_through(rows, columns)
    # All samples begin as sky; then samples of the ground are overwritten.
    samples[..., X] = np.arctan2(rays[..., 1], rays[..., 0]) * (SKY_COLUMNS / (2.0 * math.pi))
    up = np.arcsin(np.clip(rays[..., 2], 0.0, 1.0)) / (0.5 * math.pi)
    samples[..., Y] = np.minimum(np.sqrt(up) * SKY_ROWS, SKY_ROWS - 1.0)
    samples[..., CLEAR] = -1.0

    def on_ground(rays: FloatArray) -> FloatArray:
        """Return where rays meet the ground, in m from below the camera."""
        # Rays to the horizon or above it would never meet the ground: they are bent down.
        down = np.maximum(-rays[..., 2:], camera.up / (2.0 * _GROUND_END))
        return rays[..., :2] * (camera.up / down)

    points = on_ground(rays)
    half = 0.5 * np.asarray(height)
    right = on_ground(camera.rays_through(rows, columns + 0.5)) - on_ground(
        camera.rays_through(rows, columns - 0.5)
    )
    down = on_ground(camera.rays_through(rows + half, columns)) - on_ground(
        camera.rays_through(rows - half, columns)
    )
    size = np.maximum(np.hypot(right[..., 0], right[..., 1]), np.hypot(down[..., 0], down[..., 1]))
    clear = np.exp(-np.hypot(points[..., 0], points[..., 1]) / _HAZE_LENGTH)
    points += np.array([camera.forward, camera.left])
    ground = np.concatenate([points, right, down, size[..., None], clear[..., None]], axis=-1)
    is_ground = rays[..., 2] < -camera.up / _GROUND_END
    samples[is_ground] = ground[is_ground]
    return samples
