"""What a camera on the car sees: the road, the land beside it and the sky, in compiled code.

The world is flat. A frame costs a rotation of the camera's samples (`projection.py`) and a look-up
of the nearest piece of road for each (`drawn_road.py`). Edges are smooth, because a line's share of
a pixel's footprint on the ground is calculated, not sampled.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.camera import Camera, Scene
from frenetic.plugins.vision.drawn_road import (
    LENGTH_BEFORE,
    SHOULDER_WIDTH,
    Spot,
    lay_drawn_road,
    locate,
)
from frenetic.plugins.vision.projection import (
    CLEAR,
    DOWN_X,
    DOWN_Y,
    FOOTPRINT,
    RIGHT_X,
    RIGHT_Y,
    SKY_COLUMNS,
    X,
    Y,
    projection_of,
)
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
    scenery_of,
)
from frenetic.road import Road

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.drivers.camera import Image

    _Samples: TypeAlias = npt.NDArray[np.float32]
    """Samples of a projection, (lines, width, 8)."""
    _Texels: TypeAlias = npt.NDArray[np.float32]
    """Texture, (256, 256)."""
    _Road: TypeAlias = tuple[FloatArray, float, npt.NDArray[np.int64], npt.NDArray[np.int64]]
    """Values of a `DrawnRoad`."""
    _Scenery: TypeAlias = tuple[FloatArray, FloatArray, _Texels, _Texels, Image]
    """Values of a `Scenery`."""

# Steps of the drawing are inlined: calls with records of numbers would take half of its time.

# Ours, in the range of European rural roads.
MARKING_WIDTH: Final = 0.15
"""Width of a line, in m."""
EDGE_DISTANCE: Final = 0.2
"""Distance of an edge line's middle from the edge of the road, in m."""
DASH: Final = 4.0
"""Length of a dash of the centre line, in m."""
DASH_PERIOD: Final = 12.0
"""Distance from one dash to the next, in m."""

_GRAIN_TEXEL = 1.0 / 16.0  # [m], a texel of gravel and grain; ours
_PATCH_TEXEL = 0.5  # [m], a texel of patches; ours
_STRIDE = 4  # samples from a knot, which is located on the road, to the next; ours
_LAND_ONLY, _BETWEEN, _EACH = range(3)  # how samples between two knots are located


class _CarPose(NamedTuple):
    """Where the car is."""

    x: float
    y: float
    cosine: float
    """Cosine of the heading."""
    sine: float
    """Sine of the heading."""
    sky_columns: float
    """Columns of the panorama by which the heading turns the sky; positive."""


class _Lanes(NamedTuple):
    """Distances of edges from the centre line, in m, and the wear of the markings."""

    width: float
    """Edge of the road."""
    verge: float
    """Edge of the gravel."""
    line_inside: float
    """Inner edge of the edge line."""
    line_outside: float
    """Outer edge of the edge line."""
    wear: float
    """Share of the markings' paint that is gone."""


class _Texture(NamedTuple):
    """Values of the textures at a point, from -1 to 1."""

    fine: float
    coarse: float


class _Shares(NamedTuple):
    """Shares of a footprint."""

    verge: float
    """Share on the road with its gravel."""
    road: float
    """Share on the asphalt."""
    paint: float
    """Share on the markings."""


class _Footprint(NamedTuple):
    """What a sample covers on the ground, in the car's frame, in m."""

    size: float
    right_x: float
    right_y: float
    down_x: float
    down_y: float


class _Colour(NamedTuple):
    """Red, green and blue, from 0 to 255."""

    red: float
    green: float
    blue: float


class _Knot(NamedTuple):
    """A sample that is located on the road."""

    is_ground: bool
    x: float
    y: float
    spot: Spot


@njit(error_model="numpy")
def _car_at(place: tuple[float, float, float]) -> _CarPose:
    """Return the car at a place (m, m, rad)."""
    x, y, heading = place
    # Positive, so that cutting off a fraction rounds down.
    turns = heading / (2.0 * math.pi)
    sky_columns = (turns - math.floor(turns) + 1.0) * SKY_COLUMNS
    return _CarPose(x, y, math.cos(heading), math.sin(heading), sky_columns)


@njit(error_model="numpy")
def _lanes_of(width: float, wear: float) -> _Lanes:
    """Return the edges of two lanes of this width."""
    line_outside = width - EDGE_DISTANCE + 0.5 * MARKING_WIDTH
    return _Lanes(width, width + SHOULDER_WIDTH, line_outside - MARKING_WIDTH, line_outside, wear)


@njit(error_model="numpy")
def _share(low: float, high: float, at: float, width: float) -> float:
    """Return the share of a footprint ``width`` wide around ``at`` between two bounds."""
    inside = min(high, at + 0.5 * width) - max(low, at - 0.5 * width)
    return max(inside, 0.0) / width


@njit(error_model="numpy")
def _dashes(s: float) -> float:
    """Return the length of dashes from 0 to ``s``; the first begins at 0."""
    periods = math.floor(s / DASH_PERIOD)
    return periods * DASH + min(s - periods * DASH_PERIOD, DASH)


@njit(error_model="numpy")
def _paint_left(wear: float, texture: _Texture, size: float) -> float:
    """Return the share of a marking's paint that is left; it wears off in flakes and patches."""
    left = 1.0 - wear
    here = min(max(0.5 + 2.5 * (left - 0.5 - 0.35 * (texture.fine + texture.coarse)), 0.0), 1.0)
    sharp = min(8.0 * _GRAIN_TEXEL / size, 1.0)
    return sharp * here + (1.0 - sharp) * left


@njit(error_model="numpy", inline="always")
def _knot_at(
    samples: _Samples,
    line: int,
    u: int,
    car: _CarPose,
    rows: FloatArray,
    cells_per_metre: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
) -> _Knot:
    """Return a sample with its spot on the road."""
    x, y = float(samples[line, u, X]), float(samples[line, u, Y])
    if samples[line, u, CLEAR] < 0.0:
        return _Knot(False, x, y, Spot(0.0, 0.0, 0.0, 0.0, 0.0))
    world_x = car.x + car.cosine * x - car.sine * y
    world_y = car.y + car.sine * x + car.cosine * y
    return _Knot(True, x, y, locate(world_x, world_y, rows, cells_per_metre, keys, nearest))


@njit(error_model="numpy", inline="always")
def _mode_between(start: _Knot, end: _Knot) -> int:
    """Return how the samples between two knots are located.

    They are interpolated where both knots lie on the same piece of road; on an arc this errs by
    less than an eighth of the samples' spacing.
    """
    if not (start.is_ground or end.is_ground):
        return _LAND_ONLY
    if not (start.is_ground and end.is_ground):
        return _EACH
    apart = (end.x - start.x) ** 2 + (end.y - start.y) ** 2
    near, far = start.spot, end.spot
    if near.stretch == 0.0 and far.stretch == 0.0:
        return _LAND_ONLY if apart < 36.0 else _EACH
    if (
        near.stretch > 0.0
        and far.stretch > 0.0
        and near.cosine * far.cosine + near.sine * far.sine > 0.97
        and (far.along - near.along) ** 2 < 4.0 * apart
        and (far.left - near.left) ** 2 < 1.1 * apart
    ):
        return _BETWEEN
    return _EACH


@njit(error_model="numpy", inline="always")
def _texture_at(
    x: float,
    y: float,
    size: float,
    grain: _Texels,
    patches: _Texels,
) -> _Texture:
    """Return the textures at a point; they fade where a footprint holds many texels."""
    mask = TEXTURE_SIZE - 1
    fine = coarse = 0.0
    if size < 16.0 * _GRAIN_TEXEL:
        i, j = math.floor(x * (1.0 / _GRAIN_TEXEL)), math.floor(y * (1.0 / _GRAIN_TEXEL))
        fine = grain[i & mask, j & mask] * min(2.0 * _GRAIN_TEXEL / size, 1.0)
    if size < 32.0 * _PATCH_TEXEL:
        tx, ty = x * (1.0 / _PATCH_TEXEL), y * (1.0 / _PATCH_TEXEL)
        i, j = math.floor(tx), math.floor(ty)
        tx -= i
        ty -= j
        i0, j0, i1, j1 = i & mask, j & mask, (i + 1) & mask, (j + 1) & mask
        low = patches[i0, j0] + ty * (patches[i0, j1] - patches[i0, j0])
        high = patches[i1, j0] + ty * (patches[i1, j1] - patches[i1, j0])
        coarse = (low + tx * (high - low)) * min(8.0 * _PATCH_TEXEL / size, 1.0)
    return _Texture(fine, coarse)


@njit(error_model="numpy", inline="always")
def _shares_of(
    footprint: _Footprint, spot: Spot, car: _CarPose, lanes: _Lanes, texture: _Texture
) -> _Shares:
    """Return the shares of a footprint on the verge, the road and its markings."""
    size = footprint.size
    side = abs(spot.left)
    reach = 0.71 * size  # of a footprint to any side, at most
    if spot.stretch == 0.0 or side - reach > lanes.verge:
        return _Shares(0.0, 0.0, 0.0)
    if side + reach < lanes.line_inside and side - reach > 0.5 * MARKING_WIDTH:
        return _Shares(1.0, 1.0, 0.0)
    ahead = car.cosine * spot.cosine + car.sine * spot.sine
    turn = car.cosine * spot.sine - car.sine * spot.cosine
    ax, ay = footprint.right_x, footprint.right_y
    bx, by = footprint.down_x, footprint.down_y
    p, q = ay * ahead - ax * turn, by * ahead - bx * turn
    across = math.sqrt(p * p + q * q) + 1e-6
    verge = _share(-lanes.verge, lanes.verge, side, across)
    if verge <= 0.0:
        return _Shares(verge, 0.0, 0.0)
    road = _share(-lanes.width, lanes.width, side, across)
    if road <= 0.0:
        return _Shares(verge, road, 0.0)
    paint = _share(lanes.line_inside, lanes.line_outside, side, across)
    centre = _share(-0.5 * MARKING_WIDTH, 0.5 * MARKING_WIDTH, spot.left, across)
    if centre > 0.0:
        p, q = ax * ahead + ay * turn, bx * ahead + by * turn
        length = (math.sqrt(p * p + q * q) + 1e-6) * spot.stretch
        at = spot.along - LENGTH_BEFORE
        dashes = _dashes(at + 0.5 * length) - _dashes(at - 0.5 * length)
        paint += centre * dashes / length
    if lanes.wear > 0.0 and paint > 0.0:
        paint *= _paint_left(lanes.wear, texture, size)
    return _Shares(verge, road, paint)


@njit(error_model="numpy", inline="always")
def _ground_colour(
    shares: _Shares, texture: _Texture, colours: FloatArray, contrasts: FloatArray
) -> _Colour:
    """Return the ground's colour without haze."""
    r = g = b = 0.0
    if shares.verge < 1.0:
        mix = min(max(0.5 + 0.8 * texture.coarse, 0.0), 1.0)
        grain = contrasts[LAND_GRAIN] * texture.fine
        r = colours[LAND, 0] + mix * (colours[PATCH, 0] - colours[LAND, 0]) + grain
        g = colours[LAND, 1] + mix * (colours[PATCH, 1] - colours[LAND, 1]) + grain
        b = colours[LAND, 2] + mix * (colours[PATCH, 2] - colours[LAND, 2]) + grain
    if shares.verge > 0.0:
        if shares.road < 1.0:
            grain = contrasts[GRAVEL_GRAIN] * texture.fine
            r += shares.verge * (colours[GRAVEL, 0] + grain - r)
            g += shares.verge * (colours[GRAVEL, 1] + grain - g)
            b += shares.verge * (colours[GRAVEL, 2] + grain - b)
        if shares.road > 0.0:
            shade = (
                contrasts[ASPHALT_GRAIN] * texture.fine
                + contrasts[ASPHALT_PATCHES] * texture.coarse
            )
            r += shares.road * (colours[ASPHALT, 0] + shade - r)
            g += shares.road * (colours[ASPHALT, 1] + shade - g)
            b += shares.road * (colours[ASPHALT, 2] + shade - b)
        if shares.paint > 0.0:
            grain = contrasts[PAINT_GRAIN] * texture.fine
            r += shares.paint * (colours[PAINT, 0] + grain - r)
            g += shares.paint * (colours[PAINT, 1] + grain - g)
            b += shares.paint * (colours[PAINT, 2] + grain - b)
    return _Colour(r, g, b)


@njit(error_model="numpy", inline="always")
def _footprint_of(samples: _Samples, line: int, u: int) -> _Footprint:
    """Return what a sample covers on the ground."""
    return _Footprint(
        samples[line, u, FOOTPRINT],
        samples[line, u, RIGHT_X],
        samples[line, u, RIGHT_Y],
        samples[line, u, DOWN_X],
        samples[line, u, DOWN_Y],
    )


@njit(error_model="numpy", inline="always")
def _spot_between(start: Spot, end: Spot, t: float) -> Spot:
    """Return the spot between two knots; the heading only turns footprints, so it is the end's."""
    return Spot(
        start.left + t * (end.left - start.left),
        start.along + t * (end.along - start.along),
        end.cosine,
        end.sine,
        end.stretch,
    )


@njit(error_model="numpy", inline="always")
def _add_line(
    samples: _Samples,
    line: int,
    car: _CarPose,
    road: _Road,
    lanes: _Lanes,
    scenery: _Scenery,
    sums: FloatArray,
) -> None:
    """Add the colours of a line of samples to ``sums``, (width, 3)."""
    # Arrays are taken out of their tuples once: each time costs an atomic count of references.
    rows, cells_per_metre, keys, nearest = road
    colours, contrasts, grain, patches, sky = scenery
    last = samples.shape[1] - 1
    first, high, mode, part = 0, 0, _LAND_ONLY, 0.0
    end = _knot_at(samples, line, 0, car, rows, cells_per_metre, keys, nearest)
    start = end
    for u in range(last + 1):
        spot = end.spot
        if u == high:
            if u < last:
                first, high, start = u, min(u + _STRIDE, last), end
                end = _knot_at(samples, line, high, car, rows, cells_per_metre, keys, nearest)
                part = 1.0 / (high - first)
                mode = _mode_between(start, end)
        elif mode == _BETWEEN:
            spot = _spot_between(start.spot, end.spot, part * (u - first))
        elif mode == _LAND_ONLY:
            spot = Spot(0.0, 0.0, 0.0, 0.0, 0.0)
        else:
            spot = _knot_at(samples, line, u, car, rows, cells_per_metre, keys, nearest).spot
        fx, fy, clear = samples[line, u, X], samples[line, u, Y], samples[line, u, CLEAR]
        if clear < 0.0:
            j = int(fx + car.sky_columns) & (SKY_COLUMNS - 1)
            i = int(fy)
            for k in range(3):
                sums[u, k] += sky[i, j, k]
            continue
        x = car.x + car.cosine * fx - car.sine * fy
        y = car.y + car.sine * fx + car.cosine * fy
        footprint = _footprint_of(samples, line, u)
        texture = _texture_at(x, y, footprint.size, grain, patches)
        shares = _shares_of(footprint, spot, car, lanes, texture)
        colour = _ground_colour(shares, texture, colours, contrasts)
        sums[u, 0] += colours[HILLS, 0] + clear * (colour.red - colours[HILLS, 0])
        sums[u, 1] += colours[HILLS, 1] + clear * (colour.green - colours[HILLS, 1])
        sums[u, 2] += colours[HILLS, 2] + clear * (colour.blue - colours[HILLS, 2])


@njit(error_model="numpy")
def _draw(
    first_lines: npt.NDArray[np.int64],
    samples: _Samples,
    place: tuple[float, float, float],
    road: _Road,
    lane_width: float,
    wear: float,
    scenery: _Scenery,
    image: Image,
) -> None:
    """Write the picture from a car at a place (m, m, rad) into ``image``, (height, width, 3)."""
    car = _car_at(place)
    lanes = _lanes_of(lane_width, wear)
    width = image.shape[1]
    sums = np.empty((width, 3))
    for v in range(image.shape[0]):
        sums[:] = 0.0
        for line in range(first_lines[v], first_lines[v + 1]):
            _add_line(samples, line, car, road, lanes, scenery, sums)
        share = 1.0 / (first_lines[v + 1] - first_lines[v])
        for u in range(width):
            for k in range(3):
                image[v, u, k] = int(min(max(sums[u, k] * share + 0.5, 0.0), 255.0))


class CameraRenderer:
    """Draws what a camera on a car sees along one road.

    Args:
        road: the road; it goes on straight beyond its ends, 80 m at its end.
        camera: the camera.
        scene: appearance of the world.
    """

    def __init__(self, road: Road, camera: Camera, scene: Scene | None = None) -> None:
        self.camera = camera
        scene = scene or Scene()
        self._wear = scene.wear
        colours, contrasts, fine, coarse, sky = scenery_of(scene.seed)
        self._scenery = (colours, contrasts, fine, coarse, sky)
        rows, cells_per_metre, keys, nearest = lay_drawn_road(road)
        self._road = (rows, cells_per_metre, keys, nearest)
        self._lane_width = road.lane_width

    def draw(self, x: float, y: float, heading: float) -> Image:
        """Return the picture from a car at this place (m, m, rad), (height, width, 3)."""
        projection = projection_of(self.camera)
        image = np.empty(self.camera.shape, dtype=np.uint8)
        # Numba takes plain tuples at once, named ones after a third of a millisecond.
        _draw(
            projection.first_lines,
            projection.samples,
            (float(x), float(y), float(heading)),
            self._road,
            self._lane_width,
            self._wear,
            self._scenery,
            image,
        )
        return image
