"""What the pixels of a camera look at: places on flat ground, or directions of the sky.

It never changes for a camera, so it is calculated once: where the rays through a pixel meet the
ground in the car's frame, and how large the pixel's footprint is there.
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
"""Columns of the panorama of the sky, all around counter-clockwise from +x."""
SKY_ROWS: Final = 128
"""Rows of the panorama; row i is (i / rows)^2 of the way from the horizon to the zenith."""

# Columns of a sample. Ground: place, footprint to the right and downwards (m), the footprint's
# size, what the haze leaves of its colour. Sky: column and row of the panorama, and a negative last
# value.
X, Y, RIGHT_X, RIGHT_Y, DOWN_X, DOWN_Y, FOOTPRINT, CLEAR = range(8)

# Ours, chosen by eye.
_GROUND_END = 4000.0  # [m], where the ground ends in the haze
_HAZE_LENGTH = 900.0  # [m], in which the haze takes 63 % of a colour
_MOST_LINES = 4  # of samples in one row of pixels
_LONGEST_FOOTPRINT = 2.0  # [m], longer ones may hold more than one piece of a bend


@dataclass(frozen=True, eq=False)
class Projection:
    """Samples of a camera's image, in lines: a row of the image has one line or several."""

    first_lines: npt.NDArray[np.int64]
    """First line of each row, (height + 1,)."""
    samples: npt.NDArray[np.float32]
    """Samples with the columns above, (lines, width, 8)."""


@lru_cache(maxsize=8)
def projection_of(camera: Camera) -> Projection:
    """Return the samples of a camera; rows that look far along the ground have several lines."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    single = _footprints(camera, rows, columns, 1.0)
    # At the horizon, ground and sky meet.
    length = np.hypot(single[..., DOWN_X], single[..., DOWN_Y]).max(axis=1)
    above_horizon = np.abs(camera.rays_through(rows, columns)[..., 2]).min(axis=1)
    number = np.clip(np.ceil(length / _LONGEST_FOOTPRINT), 1, _MOST_LINES)
    number[(above_horizon < 2.0 / camera.focal_length) & (number == 1)] = 2
    first_lines = np.concatenate([[0], np.cumsum(number)]).astype(np.int64)
    row = np.repeat(np.arange(camera.height), number.astype(np.int64))
    part = (np.arange(first_lines[-1]) - first_lines[row] + 0.5) / number[row] - 0.5
    lines = np.broadcast_to((row + part)[:, None], (len(row), camera.width))
    samples = _footprints(
        camera, lines, np.broadcast_to(columns[0], lines.shape), 1.0 / number[row][:, None]
    )
    return Projection(first_lines, samples.astype(np.float32))


def _footprints(
    camera: Camera, rows: FloatArray, columns: FloatArray, height: FloatArray | float
) -> FloatArray:
    """Return samples at these places of the image, ``height`` rows high."""
    samples = np.zeros((*rows.shape, 8))
    rays = camera.rays_through(rows, columns)
    samples[..., X] = np.arctan2(rays[..., 1], rays[..., 0]) * (SKY_COLUMNS / (2.0 * math.pi))
    up = np.arcsin(np.clip(rays[..., 2], 0.0, 1.0)) / (0.5 * math.pi)
    samples[..., Y] = np.minimum(np.sqrt(up) * SKY_ROWS, SKY_ROWS - 1.0)
    samples[..., CLEAR] = -1.0

    def on_ground(rays: FloatArray) -> FloatArray:
        down = np.maximum(-rays[..., 2:], camera.up / (2.0 * _GROUND_END))
        return rays[..., :2] * (camera.up / down)

    place = on_ground(rays)
    half = 0.5 * np.asarray(height)
    right = on_ground(camera.rays_through(rows, columns + 0.5)) - on_ground(
        camera.rays_through(rows, columns - 0.5)
    )
    down = on_ground(camera.rays_through(rows + half, columns)) - on_ground(
        camera.rays_through(rows - half, columns)
    )
    size = np.maximum(np.hypot(right[..., 0], right[..., 1]), np.hypot(down[..., 0], down[..., 1]))
    clear = np.exp(-np.hypot(place[..., 0], place[..., 1]) / _HAZE_LENGTH)
    place += np.array([camera.forward, camera.left])
    ground = np.concatenate([place, right, down, size[..., None], clear[..., None]], axis=-1)
    is_ground = rays[..., 2] < -camera.up / _GROUND_END
    samples[is_ground] = ground[is_ground]
    return samples
