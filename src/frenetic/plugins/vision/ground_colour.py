"""Colour of the ground that a camera's sample covers, in compiled code.

`projection.py` says what a sample and its footprint are, `scenery.py` what textures are.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.plugins.vision.scenery import (
    ASPHALT,
    ASPHALT_GRAIN,
    ASPHALT_PATCHES,
    GRAVEL,
    GRAVEL_GRAIN,
    HILLS,
    LAND,
    LAND_GRAIN,
    PAINT,
    PAINT_GRAIN,
    PATCH,
    TEXTURE_SIZE,
)

if TYPE_CHECKING:
    import numpy.typing as npt

    Texels: TypeAlias = npt.NDArray[np.float32]
    """Texture, (256, 256) from -1 to 1."""

# The functions that run for each sample are inlined: calls that return records would take half of
# a picture's time. They take numbers, not arrays, because Numba counts references to arrays
# by slow atomic operations at each branch. Only `texture_at` takes arrays; nothing is counted there
# as long as each `if` has an `else`.

GRAIN_TEXEL: Final = 1.0 / 16.0
"""Side of a texel of the grain, in m; our choice."""
_PATCH_TEXEL = 0.5  # [m], side of a texel of the patches; our choice


class Texture(NamedTuple):
    """Values of the textures at a point, from -1 to 1."""

    grain: float
    """Value of the grain, small dots."""
    patches: float
    """Value of the patches, a few metres wide."""


class Shares(NamedTuple):
    """Shares of a footprint on the road's surfaces; each share includes the ones after it."""

    verge: float
    """Share on the road with the gravel beside it."""
    road: float
    """Share on the asphalt with its markings."""
    paint: float
    """Share on the markings."""


class Colour(NamedTuple):
    """Red, green and blue, from 0 to 255."""

    red: float
    green: float
    blue: float


class Palette(NamedTuple):
    """Colours of a scenery, and the contrasts of their textures."""

    land: Colour
    patch: Colour
    gravel: Colour
    asphalt: Colour
    paint: Colour
    hills: Colour
    land_grain: float
    gravel_grain: float
    asphalt_grain: float
    asphalt_patches: float
    paint_grain: float


@njit(error_model="numpy")
def _colour_of(colours: FloatArray, row: int) -> Colour:
    """Return the colour in a row of a scenery's colours, such as `LAND`."""
    return Colour(colours[row, 0], colours[row, 1], colours[row, 2])


@njit(error_model="numpy")
def palette_of(colours: FloatArray, contrasts: FloatArray) -> Palette:
    """Return the palette of a scenery, whose values kernels get without arrays."""
    return Palette(
        _colour_of(colours, LAND),
        _colour_of(colours, PATCH),
        _colour_of(colours, GRAVEL),
        _colour_of(colours, ASPHALT),
        _colour_of(colours, PAINT),
        _colour_of(colours, HILLS),
        contrasts[LAND_GRAIN],
        contrasts[GRAVEL_GRAIN],
        contrasts[ASPHALT_GRAIN],
        contrasts[ASPHALT_PATCHES],
        contrasts[PAINT_GRAIN],
    )


@njit(error_model="numpy", inline="always")
def texture_at(
    x: float,
    y: float,
    size: float,
    grain_texture: Texels,
    patch_texture: Texels,
) -> Texture:
    """Return the textures at a point; they fade where a footprint covers many texels.

    Args:
        x, y: m, the point on the map.
        size: m, size of the footprint.
        grain_texture, patch_texture: the textures; they repeat all over the map.
    """
    mask = TEXTURE_SIZE - 1
    if size < 16.0 * GRAIN_TEXEL:
        i, j = math.floor(x * (1.0 / GRAIN_TEXEL)), math.floor(y * (1.0 / GRAIN_TEXEL))
        grain = grain_texture[i & mask, j & mask] * min(2.0 * GRAIN_TEXEL / size, 1.0)
    else:
        grain = 0.0
    if size < 32.0 * _PATCH_TEXEL:
        tx, ty = x * (1.0 / _PATCH_TEXEL), y * (1.0 / _PATCH_TEXEL)
        i, j = math.floor(tx), math.floor(ty)
        tx -= i
        ty -= j
        i0, j0, i1, j1 = i & mask, j & mask, (i + 1) & mask, (j + 1) & mask
        low = patch_texture[i0, j0] + ty * (patch_texture[i0, j1] - patch_texture[i0, j0])
        high = patch_texture[i1, j0] + ty * (patch_texture[i1, j1] - patch_texture[i1, j0])
        patches = (low + tx * (high - low)) * min(8.0 * _PATCH_TEXEL / size, 1.0)
    else:
        patches = 0.0
    return Texture(grain, patches)


@njit(error_model="numpy", inline="always")
def _covered(ground: Colour, cover: Colour, share: float, shade: float) -> Colour:
    """Return the mean colour of ground of which a share is covered.

    Args:
        ground: colour of the ground.
        cover: colour of the cover.
        share: share of the ground that is covered, 0..1.
        shade: number that is added to the cover's colour.
    """
    return Colour(
        ground.red + share * (cover.red + shade - ground.red),
        ground.green + share * (cover.green + shade - ground.green),
        ground.blue + share * (cover.blue + shade - ground.blue),
    )


@njit(error_model="numpy", inline="always")
def ground_colour(shares: Shares, texture: Texture, palette: Palette) -> Colour:
    """Return the ground's colour without haze.

    Args:
        shares: shares of the footprint on the road's surfaces; the rest is land.
        texture: values of the textures in the footprint.
        palette: colours and contrasts.
    """
    colour = Colour(0.0, 0.0, 0.0)
    if shares.verge < 1.0:
        mix = min(max(0.5 + 0.8 * texture.patches, 0.0), 1.0)
        shade = palette.land_grain * texture.grain
        land = _covered(palette.land, palette.patch, mix, 0.0)
        colour = Colour(land.red + shade, land.green + shade, land.blue + shade)
    if shares.verge > 0.0:
        if shares.road < 1.0:
            shade = palette.gravel_grain * texture.grain
            colour = _covered(colour, palette.gravel, shares.verge, shade)
        if shares.road > 0.0:
            shade = (
                palette.asphalt_grain * texture.grain + palette.asphalt_patches * texture.patches
            )
            colour = _covered(colour, palette.asphalt, shares.road, shade)
        if shares.paint > 0.0:
            shade = palette.paint_grain * texture.grain
            colour = _covered(colour, palette.paint, shares.paint, shade)
    return colour
