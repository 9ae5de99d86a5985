"""A driver's camera: its position on the car, and the direction in which each pixel looks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, Protocol, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Share, check
from frenetic._support.scalars import take_numpy_scalars

if TYPE_CHECKING:
    import numpy.typing as npt

Image: TypeAlias = "npt.NDArray[np.uint8]"
"""Image of a camera: (height, width, 3), red, green and blue from 0 to 255, first row on top."""


class Renderer(Protocol):
    """A renderer, which draws what a camera sees along a road.

    A package offers a renderer by an entry point in the group `RENDERERS`: a function that takes
    the road, the `Camera` and the `Scene`, and returns the renderer.
    """

    def draw(self, x: float, y: float, heading: float) -> Image:
        """Return the image for a car with its centre of mass at x, y in m, and a heading in rad."""


RENDERERS: Final = "frenetic.renderers"
"""Entry point group of renderers."""
MOST_PIXELS: Final = 1 << 20
"""Number of pixels of the largest image; our choice."""
_NEWTON_STEPS: Final = 30
"""Number of Newton steps by which the distortion of a lens is inverted; our choice."""

_Pixels: TypeAlias = Annotated[int, Meta(ge=2, le=4096)]
_Offset: TypeAlias = Annotated[float, Meta(ge=-10.0, le=10.0)]
"""Distance from the centre of mass, in m."""


@dataclass(frozen=True)
class Camera:
    """A camera that is fixed to the car.

    A pixel in column u and row v, counted from 0 at the top left, looks through a point of the
    image plane, which is at distance 1 in front of the lens. The point is
    x = (u + 1/2 - width/2) / f to the right and y = (v + 1/2 - height/2) / f downwards, with the
    focal length f = width/2 / tan(field_of_view/2) in pixels.

    Raises:
        ValueError: a value is out of range.
    """

    width: _Pixels = 160
    """Number of pixels in a row."""
    height: _Pixels = 80
    """Number of rows."""
    field_of_view: Annotated[float, Meta(ge=5.0, le=160.0)] = 100.0
    """Horizontal field of view without distortion, in degrees."""
    forward: _Offset = 0.8
    """Distance in front of the centre of mass, in m."""
    left: _Offset = 0.0
    """Distance to the left of the centre of mass, in m."""
    up: Annotated[float, Meta(ge=0.1, le=20.0)] = 1.4
    """Height above the ground, in m."""
    pitch: Annotated[float, Meta(ge=-60.0, le=90.0)] = 10.0
    """Angle by which the camera looks down, in degrees."""
    distortion: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0
    """Radial distortion k of the lens: a point at distance r from the middle of the undistorted
    image plane appears at distance r (1 + k r^2). Negative values make a barrel, positive values a
    pincushion."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        try:
            check(vars(self), Camera)
        except ValueError as error:
            raise ValueError(f"the camera's {error}") from None
        if self.width * self.height > MOST_PIXELS:
            raise ValueError(
                f"the camera has {self.width} x {self.height} pixels: at most {MOST_PIXELS} are"
                " allowed"
            )
        if self.distortion < 0.0:
            # The largest value of r (1 + k r^2): no ray reaches a pixel farther from the middle.
            farthest = 2.0 / (3.0 * math.sqrt(-3.0 * self.distortion))
            corner = math.hypot(self.width, self.height) / (2.0 * self.focal_length)
            if corner >= farthest:
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
        """Shape of the camera's images: rows, columns and 3 colours."""
        return self.height, self.width, 3

    def rays_through(self, rows: npt.ArrayLike, columns: npt.ArrayLike) -> FloatArray:
        """Return the directions in which points of the image look, (..., 3), vectors of length 1.

        In the car's frame: x ahead, y to the left, z up.

        Args:
            rows, columns: rows and columns of the points, of any shape; a whole number is the
                middle of a pixel.
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
        """Return the factors by which distances from the middle grow without distortion.

        Args:
            radius: distances from the middle of the image plane with distortion.
        """
        if self.distortion == 0.0:
            return np.ones_like(radius)
        # Solve r (1 + k r^2) = radius for r by Newton's method.
        r = radius.copy()
        for _ in range(_NEWTON_STEPS):
            slope = np.maximum(1.0 + 3.0 * self.distortion * r * r, 1e-3)
            r -= (r * (1.0 + self.distortion * r * r) - radius) / slope
        factor: FloatArray = np.where(radius > 0.0, r / np.maximum(radius, 1e-12), 1.0)
        return factor


@dataclass(frozen=True)
class Scene:
    """Appearance of the world that is drawn for a camera.

    Raises:
        ValueError: a value is out of range.
    """

    seed: Annotated[int, Meta(ge=0, lt=2**31)] = 0
    """Seed of the surfaces, the sky and the sun; 0 is an ordinary day on grey asphalt."""
    wear: Share = 0.0
    """Share of the paint that has worn off the markings, 0 to 1."""

    def __post_init__(self) -> None:
        check(vars(self), Scene)
