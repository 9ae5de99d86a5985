"""Colours and textures of the world that a camera sees.

All numbers are our choice, by eye. A *texel* is an element of a texture, like a pixel of a picture.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.plugins.vision.projection import SKY_COLUMNS, SKY_ROWS

if TYPE_CHECKING:
    import numpy.typing as npt

TEXTURE_SIZE: Final = 256
"""Number of texels along each side of a texture, a power of two."""

LAND, PATCH, GRAVEL, ASPHALT, PAINT, HILLS = range(6)
"""Rows of `Scenery.colours`."""
LAND_GRAIN, GRAVEL_GRAIN, ASPHALT_GRAIN, PAINT_GRAIN, ASPHALT_PATCHES = range(5)
"""Indices of `Scenery.contrasts`."""

_GRAIN_GRIDS = (TEXTURE_SIZE, 128)  # points along the grids whose sum is the grain
_PATCH_GRIDS = (64, 32, 16)  # points along the grids whose sum are the patches
_USUAL_CONTRASTS = (16.0, 22.0, 9.0, 6.0, 7.0)
"""Contrasts of the scenery of seed 0."""

_LandColours: TypeAlias = tuple[tuple[int, int, int], tuple[int, int, int]]
"""Colour of the land, and of the patches on it."""
_GRASS: _LandColours = ((88, 112, 58), (118, 128, 74))
_DRY_GRASS: _LandColours = ((150, 142, 88), (126, 124, 76))
_SOIL: _LandColours = ((112, 92, 70), (136, 112, 86))
_SAND: _LandColours = ((196, 176, 134), (180, 158, 116))
_SNOW: _LandColours = ((214, 218, 224), (190, 194, 198))
_LANDS = (_GRASS, _GRASS, _DRY_GRASS, _SOIL, _SAND, _SNOW)  # equally likely; grass counts twice


class Scenery(NamedTuple):
    """Colours and textures of a scene."""

    colours: FloatArray
    """Colours with the rows `LAND` to `HILLS`, (6, 3) from 0 to 255."""
    contrasts: FloatArray
    """Largest changes of a colour by a texture, with the indices `LAND_GRAIN` to
    `ASPHALT_PATCHES`, (5,)."""
    grain: npt.NDArray[np.float32]
    """Texture of the grain, (256, 256) from -1 to 1."""
    patches: npt.NDArray[np.float32]
    """Texture of the patches, (256, 256) from -1 to 1."""
    sky: npt.NDArray[np.uint8]
    """Panorama of the sky, (`SKY_ROWS`, `SKY_COLUMNS`, 3)."""


@lru_cache(maxsize=16)
def scenery_of(seed: int) -> Scenery:
    """Return the scenery of a seed: ordinary colours for 0, else colours from wide ranges."""
    rng = np.random.default_rng(seed)
    grain = _noise(rng, _GRAIN_GRIDS)
    patches = _noise(rng, _PATCH_GRIDS)
    land, contrasts = _GRASS, np.array(_USUAL_CONTRASTS)
    asphalt, tint, gravel, paint = 93.0, 1.5, 132.0, 234.0  # brightness; tint makes asphalt bluish
    sun, sun_up, clouds = 0.7, 0.6, 0.0  # see _panorama
    if seed:
        land = _LANDS[rng.integers(len(_LANDS))]
        asphalt, tint = rng.uniform(50.0, 135.0), rng.uniform(-6.0, 6.0)
        gravel = rng.uniform(90.0, 165.0)
        # Paint stays much brighter than the asphalt.
        paint = rng.uniform(max(190.0, asphalt + 80.0), 250.0)
        sun, sun_up = rng.uniform(-math.pi, math.pi), rng.uniform(0.1, 1.2)
        clouds = rng.uniform(0.0, 1.0)
        contrasts = contrasts * rng.uniform(0.5, 2.0, len(contrasts))
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
    sky = _panorama(patches, colours[HILLS], sun, sun_up, clouds)
    return Scenery(colours, contrasts, grain, patches, sky)


def _noise(rng: np.random.Generator, grids: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Return smooth noise that repeats itself, (256, 256) from -1 to 1.

    It is a sum of grids of random values with smooth transitions. Each grid counts half as much as
    the next.

    Args:
        rng: generator of the values.
        grids: number of points along each grid.
    """
    total = np.zeros((TEXTURE_SIZE, TEXTURE_SIZE))
    for k, points in enumerate(grids):
        lattice = rng.uniform(-1.0, 1.0, (points, points))
        positions = np.arange(TEXTURE_SIZE) * (points / TEXTURE_SIZE)
        low = positions.astype(np.int64)
        t = positions - low
        t = t * t * (3.0 - 2.0 * t)  # level at both points
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
        hills: colour of the hills, (3,).
        sun: direction of the sun, in rad counter-clockwise from +x.
        sun_up: elevation of the sun, in rad.
        clouds: share of the sky that is grey, 0..1.
    """
    # Elevation of each row and direction of each column, in rad.
    up = (((np.arange(SKY_ROWS) + 0.5) / SKY_ROWS) ** 2 * (0.5 * math.pi))[:, None]
    around = (np.arange(SKY_COLUMNS) + 0.5) * (2.0 * math.pi / SKY_COLUMNS)
    blue, pale, grey = np.array([[96, 148, 214], [196, 212, 226], [186, 190, 194]], dtype=float)
    # From pale at the horizon to blue above.
    blueness = (1.0 - 1.0 / (1.0 + 3.0 * up))[..., None]
    sky = pale + blueness * (blue - pale) + np.zeros((SKY_ROWS, SKY_COLUMNS, 3))
    repeated = np.tile(noise, (1, SKY_COLUMNS // TEXTURE_SIZE))
    cover = np.clip(0.5 + 2.0 * (repeated[:SKY_ROWS] + 2.0 * clouds - 1.2), 0.0, 1.0)[..., None]
    sky += cover * (grey - sky)
    # Cosine of the angle to the sun: a high power of it is the disc, a low one the glow around it.
    cosine = np.cos(up) * math.cos(sun_up) * np.cos(around - sun) + np.sin(up) * math.sin(sun_up)
    near = np.maximum(cosine, 0.0)
    glow = (0.25 * near**8 + 0.75 * near**300)[..., None] * (1.0 - 0.8 * cover)
    sky += glow * (np.array([255.0, 250.0, 235.0]) - sky)
    skyline = np.interp(around, np.linspace(0.0, 2.0 * math.pi, 65), [*noise[7, :64], noise[7, 0]])
    is_hill = up < 0.025 + 0.022 * skyline
    sky = np.where(is_hill[..., None], hills, sky)
    panorama: npt.NDArray[np.uint8] = np.rint(np.clip(sky, 0.0, 255.0)).astype(np.uint8)
    return panorama
