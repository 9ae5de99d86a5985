"""Colours and textures of the world that a camera sees."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.plugins.vision.projection import SKY_COLUMNS, SKY_ROWS

if TYPE_CHECKING:
    import numpy.typing as npt

TEXTURE_SIZE: Final = 256
"""Texels along a texture."""

LAND, PATCH, GRAVEL, ASPHALT, PAINT, HILLS = range(6)
"""Rows of the table of colours."""
LAND_GRAIN, GRAVEL_GRAIN, ASPHALT_GRAIN, PAINT_GRAIN, ASPHALT_PATCHES = range(5)
"""Places in the list of contrasts."""


class Scenery(NamedTuple):
    """Colours and textures of a scene."""

    colours: FloatArray
    """Colours of land, of patches on it, gravel, asphalt, paint and hills, (6, 3) from 0 to 255."""
    contrasts: FloatArray
    """Contrast of the grain of land, gravel, asphalt and paint, and of the asphalt's patches."""
    fine: npt.NDArray[np.float32]
    """Texture of the grain, (256, 256) from -1 to 1."""
    coarse: npt.NDArray[np.float32]
    """Texture of the patches, (256, 256) from -1 to 1."""
    sky: npt.NDArray[np.uint8]
    """Panorama, (rows, columns, 3)."""


@lru_cache(maxsize=16)
def scenery_of(seed: int) -> Scenery:
    """Return the scenery of a seed: ordinary colours for 0, else colours from wide ranges."""
    rng = np.random.default_rng(seed)
    fine = _noise(rng, (TEXTURE_SIZE, 128))
    coarse = _noise(rng, (64, 32, 16))
    # land, patches on it
    grass, dry, soil, sand, snow = (
        ((88, 112, 58), (118, 128, 74)),
        ((150, 142, 88), (126, 124, 76)),
        ((112, 92, 70), (136, 112, 86)),
        ((196, 176, 134), (180, 158, 116)),
        ((214, 218, 224), (190, 194, 198)),
    )
    asphalt, tint, gravel = 93.0, 1.5, 132.0
    paint, sun, sun_up, clouds = 234.0, 0.7, 0.6, 0.0
    land = grass
    contrasts = np.array([16.0, 22.0, 9.0, 6.0, 7.0])
    if seed:
        land = (grass, grass, dry, soil, sand, snow)[rng.integers(6)]
        asphalt, tint = rng.uniform(50.0, 135.0), rng.uniform(-6.0, 6.0)
        gravel = rng.uniform(90.0, 165.0)
        paint = rng.uniform(max(190.0, asphalt + 80.0), 250.0)
        sun, sun_up = rng.uniform(-math.pi, math.pi), rng.uniform(0.1, 1.2)
        clouds = rng.uniform(0.0, 1.0)
        contrasts = contrasts * rng.uniform(0.5, 2.0, 5)
    colours = np.array(
        [
            *land,
            (gravel + 10.0, gravel + 2.0, gravel - 14.0),
            (asphalt - tint, asphalt, asphalt + 2.0 * tint),
            (paint + 2.0, paint + 2.0, paint - 4.0),
            (92.0, 112.0, 108.0),
        ],
        dtype=np.float64,
    )
    sky = _panorama(coarse, colours[HILLS], sun, sun_up, clouds)
    return Scenery(colours, contrasts, fine, coarse, sky)


def _noise(rng: np.random.Generator, grids: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Return smooth noise that repeats itself, (256, 256) from -1 to 1: a sum of random grids."""
    total = np.zeros((TEXTURE_SIZE, TEXTURE_SIZE))
    for k, points in enumerate(grids):
        lattice = rng.uniform(-1.0, 1.0, (points, points))
        at = np.arange(TEXTURE_SIZE) * (points / TEXTURE_SIZE)
        low = at.astype(np.int64)
        t = at - low
        t = t * t * (3.0 - 2.0 * t)
        high = (low + 1) % points
        rows = lattice[low] * (1.0 - t)[:, None] + lattice[high] * t[:, None]
        total += (rows[:, low] * (1.0 - t) + rows[:, high] * t) * 0.5 ** (len(grids) - 1 - k)
    noise: npt.NDArray[np.float32] = (total / np.abs(total).max()).astype(np.float32)
    return noise


def _panorama(
    noise: npt.NDArray[np.float32], hills: FloatArray, sun: float, sun_up: float, clouds: float
) -> npt.NDArray[np.uint8]:
    """Return the sky all around, with a sun, clouds and a chain of hills, (rows, columns, 3).

    Args:
        noise: shape of hills and clouds.
        hills: colour of the hills.
        sun: direction of the sun, in rad counter-clockwise from +x.
        sun_up: elevation of the sun, in rad.
        clouds: share of the sky that is grey, 0..1.
    """
    up = (((np.arange(SKY_ROWS) + 0.5) / SKY_ROWS) ** 2 * (0.5 * math.pi))[:, None]
    around = (np.arange(SKY_COLUMNS) + 0.5) * (2.0 * math.pi / SKY_COLUMNS)
    blue, pale, grey = np.array([[96, 148, 214], [196, 212, 226], [186, 190, 194]], dtype=float)
    height = (1.0 - 1.0 / (1.0 + 3.0 * up))[..., None]
    sky = pale + height * (blue - pale) + np.zeros((SKY_ROWS, SKY_COLUMNS, 3))
    repeated = np.tile(noise, (1, SKY_COLUMNS // TEXTURE_SIZE))
    cover = np.clip(0.5 + 2.0 * (repeated[:SKY_ROWS] + 2.0 * clouds - 1.2), 0.0, 1.0)[..., None]
    sky += cover * (grey - sky)
    cosine = np.cos(up) * math.cos(sun_up) * np.cos(around - sun) + np.sin(up) * math.sin(sun_up)
    near = np.maximum(cosine, 0.0)
    glow = (0.25 * near**8 + 0.75 * near**300)[..., None] * (1.0 - 0.8 * cover)
    sky += glow * (np.array([255.0, 250.0, 235.0]) - sky)
    skyline = np.interp(around, np.linspace(0.0, 2.0 * math.pi, 65), [*noise[7, :64], noise[7, 0]])
    is_hill = up < 0.025 + 0.022 * skyline
    sky = np.where(is_hill[..., None], hills, sky)
    panorama: npt.NDArray[np.uint8] = np.rint(np.clip(sky, 0.0, 255.0)).astype(np.uint8)
    return panorama
