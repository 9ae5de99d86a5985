"""A driver's camera: where it sits, and what ray of light each of its pixels gathers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from frenetic._support.arrays import FloatArray

if TYPE_CHECKING:
    from typing import TypeAlias

    import numpy.typing as npt

Image: TypeAlias = "npt.NDArray[np.uint8]"
"""Picture of a camera: (height, width, 3) RGB, the first row on top."""


class Renderer(Protocol):
    """Draws what a camera sees along a road.

    A package offers one by an entry point in the group `RENDERERS`: a function of the road, the
    `Camera` and the `Scene`.
    """

    def draw(self, x: float, y: float, heading: float) -> Image:
        """The picture with the car's centre of mass at a place in m, and its heading in rad."""


RENDERERS: Final = "frenetic.renderers"
MOST_PIXELS: Final = 1 << 20
"""Pixels of the largest image."""


@dataclass(frozen=True)
class Camera:
    """A camera that is fixed to the car.

    A pixel in column u and row v, counted from 0 at the top left, looks through the point
    x = (u + 1/2 - width/2) / f, y = (v + 1/2 - height/2) / f of the image plane, which is 1 in
    front of the lens: x to the right, y down. f = width/2 / tan(field_of_view/2), in pixels.

    Raises:
        ValueError: a value is out of range.
    """

    width: int = 160
    """Pixels in a row."""
    height: int = 80
    """Rows."""
    field_of_view: float = 100.0
    """Horizontal field of view without distortion, in degrees."""
    forward: float = 0.8
    """Distance in front of the centre of mass, in m."""
    left: float = 0.0
    """Distance to the left of the centre of mass, in m."""
    up: float = 1.4
    """Height above the ground, in m."""
    pitch: float = 10.0
    """Angle by which it looks down, in degrees."""
    distortion: float = 0.0
    """Radial distortion k of the lens: a point at distance r from the middle of the undistorted
    image plane appears at r (1 + k r^2). Negative is a barrel, positive a pincushion."""

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value: Any = getattr(self, name)
            is_whole = name in ("width", "height")
            is_number = isinstance(value, Integral if is_whole else Real)
            if not is_number or isinstance(value, bool) or not low <= value <= high:
                what = "a whole number of pixels" if is_whole else _UNITS.get(name, "a number")
                raise ValueError(
                    f"the camera's {name} is {repr(value)[:40]}: {what} from {low:g} to {high:g}"
                    " is needed"
                )
            object.__setattr__(self, name, int(value) if is_whole else float(value))
        if self.width * self.height > MOST_PIXELS:
            raise ValueError(
                f"the camera has {self.width} x {self.height} pixels: at most {MOST_PIXELS} are"
                " allowed"
            )
        if self.distortion < 0.0:
            # r (1 + k r^2) grows up to here; beyond, no ray reaches the pixel.
            reach = 2.0 / (3.0 * math.sqrt(-3.0 * self.distortion))
            corner = math.hypot(self.width, self.height) / (2.0 * self.focal_length)
            if corner >= reach:
                least = -4.0 / (27.0 * corner * corner)
                raise ValueError(
                    f"the camera's distortion is {self.distortion:g}: with this field of view its"
                    f" corners see something only above {least:.3g}"
                )

    @property
    def focal_length(self) -> float:
        """Focal length f, in pixels."""
        return 0.5 * self.width / math.tan(math.radians(0.5 * self.field_of_view))

    @property
    def vertical_field_of_view(self) -> float:
        """Vertical field of view without distortion, in degrees."""
        return math.degrees(2.0 * math.atan(0.5 * self.height / self.focal_length))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of its images."""
        return self.height, self.width, 3

    def rays_through(self, rows: npt.ArrayLike, columns: npt.ArrayLike) -> FloatArray:
        """Directions in which points of the image look, (..., 3) of length 1 in the car's frame.

        x ahead, y to the left, z up.

        Args:
            rows, columns: (...) row and column; a whole number is the middle of a pixel.
        """
        x = (np.asarray(columns, dtype=np.float64) + 0.5 - 0.5 * self.width) / self.focal_length
        y = (np.asarray(rows, dtype=np.float64) + 0.5 - 0.5 * self.height) / self.focal_length
        scale = self._undistorted(np.hypot(x, y))
        x, y = x * scale, y * scale
        c, s = math.cos(math.radians(self.pitch)), math.sin(math.radians(self.pitch))
        rays = np.stack([c - y * s, -x, -(s + y * c)], axis=-1)
        unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit

    def _undistorted(self, radius: FloatArray) -> FloatArray:
        """Factor that takes points at this distance from the middle to where a pinhole has them."""
        if self.distortion == 0.0:
            return np.ones_like(radius)
        r = radius.copy()
        for _ in range(30):  # Newton's method, from the convex side after the first step
            slope = np.maximum(1.0 + 3.0 * self.distortion * r * r, 1e-3)
            r -= (r * (1.0 + self.distortion * r * r) - radius) / slope
        factor: FloatArray = np.where(radius > 0.0, r / np.maximum(radius, 1e-12), 1.0)
        return factor


_RANGES: Final = {
    "width": (2, 4096),
    "height": (2, 4096),
    "field_of_view": (5.0, 160.0),
    "forward": (-10.0, 10.0),
    "left": (-10.0, 10.0),
    "up": (0.1, 20.0),
    "pitch": (-60.0, 90.0),
    "distortion": (-1.0, 1.0),
}
_UNITS: Final = {
    "field_of_view": "an angle in degrees",
    "pitch": "an angle in degrees",
    "forward": "a distance in m",
    "left": "a distance in m",
    "up": "a height in m",
}


@dataclass(frozen=True)
class Scene:
    """Appearance of the world that is drawn for a camera.

    Raises:
        ValueError: a value is out of range.
    """

    seed: int = 0
    """Seed of the surfaces, the sky and the sun; 0 is an ordinary day on grey asphalt."""
    wear: float = 0.0
    """Share of the paint of the markings that is gone, 0..1."""

    def __post_init__(self) -> None:
        if self.seed != int(self.seed) or not 0 <= self.seed < 2**31:
            raise ValueError(f"the scene's seed is {self.seed}: a whole number from 0 is needed")
        if not 0.0 <= self.wear <= 1.0:
            raise ValueError(f"the wear of the markings is {self.wear}: 0 to 1 is needed")
