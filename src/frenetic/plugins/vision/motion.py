"""How the picture of the flat ground moves while the car drives, and the blur that this makes."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.camera import Camera

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image

_BLUR_SAMPLES: Final = 7
"""Number of pixels whose mean is a blurred pixel; our choice."""
_SKY_DISTANCE: Final = 1e4
"""Distance of what is seen in the sky, in m: far enough not to move while the car drives."""


@lru_cache(maxsize=8)
def ground_distances(camera: Camera) -> FloatArray:
    """Return the distance to the flat ground along each pixel's ray, (height, width) in m.

    It is infinite for pixels in the sky.
    """
    rays = camera.rays_through(*np.mgrid[0 : camera.height, 0 : camera.width])
    with np.errstate(divide="ignore"):
        distances: FloatArray = np.where(rays[..., 2] < 0.0, camera.up / -rays[..., 2], np.inf)
    return distances


def picture_motion(camera: Camera, speed: float, yaw_rate: float) -> FloatArray:
    """Return how far what each pixel sees moves in a second, (height, width, 2).

    Args:
        camera: the camera.
        speed: speed of the car, in m/s.
        yaw_rate: yaw rate of the car, in rad/s, positive to the left.

    Returns:
        Columns to the right and rows downwards, for each pixel.
    """
    driving, turning = _unit_motions(camera)
    motion: FloatArray = speed * driving + yaw_rate * turning
    return motion


@lru_cache(maxsize=8)
def _unit_motions(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return how far what each pixel sees moves, (height, width, 2): columns and rows.

    The first array is for a metre straight ahead, the second for turning a radian to the left about
    the centre of mass.
    """
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    rays = camera.rays_through(rows, columns)
    distances = np.minimum(ground_distances(camera), _SKY_DISTANCE)
    points = rays * distances[..., None] + (camera.forward, camera.left, 0.0)
    # Change of the ray from a pixel's left edge to its right one, and from its upper to its lower.
    across = camera.rays_through(rows, columns + 0.5) - camera.rays_through(rows, columns - 0.5)
    down = camera.rays_through(rows + 0.5, columns) - camera.rays_through(rows - 0.5, columns)

    def pixels_moved(velocity: FloatArray) -> FloatArray:
        """Return columns and rows per unit for points with this velocity in the car's frame."""
        turned = velocity / distances[..., None]
        turned = turned - (turned * rays).sum(-1, keepdims=True) * rays
        # Least squares: the columns c and rows r for which c across + r down is nearest to turned.
        aa, bb, ab = (across**2).sum(-1), (down**2).sum(-1), (across * down).sum(-1)
        at, bt = (across * turned).sum(-1), (down * turned).sum(-1)
        determinant = aa * bb - ab * ab
        return np.stack(
            [(bb * at - ab * bt) / determinant, (aa * bt - ab * at) / determinant], axis=-1
        )

    driving = pixels_moved(np.broadcast_to([-1.0, 0.0, 0.0], points.shape))
    upwards = np.zeros_like(points[..., 0])
    turning = pixels_moved(np.stack([points[..., 1], -points[..., 0], upwards], axis=-1))
    return driving, turning


@njit()
def smear(image: Image, ways: FloatArray, out: Image) -> None:
    """Write a picture blurred by motion.

    Args:
        image: the sharp picture.
        ways: columns and rows that what a pixel sees moved until now, (height, width, 2): the
            pixel becomes the mean along this way.
        out: picture that receives the result.
    """
    height, width = image.shape[0], image.shape[1]
    for v in range(height):
        for u in range(width):
            red = green = blue = 0
            for k in range(_BLUR_SAMPLES):
                back = k / (_BLUR_SAMPLES - 1)
                i = min(max(int(v - back * ways[v, u, 1] + 0.5), 0), height - 1)
                j = min(max(int(u - back * ways[v, u, 0] + 0.5), 0), width - 1)
                red += image[i, j, 0]
                green += image[i, j, 1]
                blue += image[i, j, 2]
            # With half of the divisor added, the division rounds to the nearest number.
            out[v, u, 0] = (red + _BLUR_SAMPLES // 2) // _BLUR_SAMPLES
            out[v, u, 1] = (green + _BLUR_SAMPLES // 2) // _BLUR_SAMPLES
            out[v, u, 2] = (blue + _BLUR_SAMPLES // 2) // _BLUR_SAMPLES
