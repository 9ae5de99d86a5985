"""What a camera on the car sees: the road, the land beside it and the sky, in compiled code.

The world is flat. What never changes for a camera is calculated once (`_Projection`): where the
rays through a pixel meet the ground in the car's frame. A frame then costs a rotation and a look-up
of the nearest piece of road for each. Edges are smooth, because a line's share of a pixel's
footprint on the ground is calculated, not sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.camera import Camera, Scene
from frenetic.road import Road
from frenetic.road.geometry import frame_at

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.drivers.camera import Image

MARKING_WIDTH: Final = 0.15
"""Width of a line, in m."""
EDGE_DISTANCE: Final = 0.2
"""Distance of an edge line's middle from the edge of the road, in m."""
DASH: Final = 4.0
"""Length of a dash of the centre line, in m."""
DASH_PERIOD: Final = 12.0
"""Distance from one dash to the next, in m."""
SHOULDER_WIDTH: Final = 1.0
"""Width of the gravel beside the road, in m."""
BEYOND: Final = 80.0
"""Length of straight road that is drawn beyond the road's end, in m."""
BEFORE: Final = 20.0
"""Length of straight road that is drawn before its start, in m."""

_SPACING = 1.0  # m between two rows of the drawn road
_SIZE = 256  # texels along a texture
_FINE = 1.0 / 16.0  # m, a texel of gravel and grain
_COARSE = 0.5  # m, a texel of patches
_FAR = 4000.0  # m, where the ground ends in the haze
_HAZE = 900.0  # m in which the haze takes 63 % of a colour
_STRIDE = 4  # samples of a line from one that is looked up to the next
_LAND_ONLY, _BETWEEN, _EACH = range(3)  # how the samples of such a stretch are located
_MOST_SAMPLES = 4  # of a pixel, one above the other
_SKY_COLUMNS = 1024  # of the panorama, all around counter-clockwise from +x
_SKY_ROWS = 128  # of the panorama; row i is (i / rows)^2 of the way from the horizon to the zenith
_EMPTY = -(2**62)


# What a camera's pixels look at

# Columns of a sample's geometry. Ground: place, footprint to the right and downwards (m), its size,
# what the haze leaves of its colour. Sky: column and row of the panorama, and a negative last one.
_X, _Y, _AX, _AY, _BX, _BY, _FOOTPRINT, _CLEAR = range(8)


@dataclass(frozen=True, eq=False)
class _Projection:
    """Samples of a camera's image, in lines: a row of the image has one line or several."""

    first: npt.NDArray[np.int64]
    """First line of each row, (height + 1,)."""
    samples: npt.NDArray[np.float32]
    """(lines, width, 8), see above."""


@lru_cache(maxsize=8)
def _projection(camera: Camera) -> _Projection:
    """The samples of a camera; rows that look far along the ground have several lines."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    single = _footprints(camera, rows, columns, 1.0)
    # Footprints of more than 2 m may hold more than one piece of a bend; at the horizon, ground
    # and sky meet.
    length = np.hypot(single[..., _BX], single[..., _BY]).max(axis=1)
    at_horizon = np.abs(camera.rays_through(rows, columns)[..., 2]).min(axis=1)
    number = np.clip(np.ceil(length / 2.0), 1, _MOST_SAMPLES)
    number[(at_horizon < 2.0 / camera.focal_length) & (number == 1)] = 2
    first = np.concatenate([[0], np.cumsum(number)]).astype(np.int64)
    row = np.repeat(np.arange(camera.height), number.astype(np.int64))
    part = (np.arange(first[-1]) - first[row] + 0.5) / number[row] - 0.5
    lines = np.broadcast_to((row + part)[:, None], (len(row), camera.width))
    samples = _footprints(
        camera, lines, np.broadcast_to(columns[0], lines.shape), 1.0 / number[row][:, None]
    )
    return _Projection(first, samples.astype(np.float32))


def _footprints(
    camera: Camera, rows: FloatArray, columns: FloatArray, height: FloatArray | float
) -> FloatArray:
    """Geometry of samples at these places, ``height`` rows high."""
    out = np.zeros((*rows.shape, 8))
    rays = camera.rays_through(rows, columns)
    out[..., _X] = np.arctan2(rays[..., 1], rays[..., 0]) * (_SKY_COLUMNS / (2.0 * math.pi))
    up = np.arcsin(np.clip(rays[..., 2], 0.0, 1.0)) / (0.5 * math.pi)
    out[..., _Y] = np.minimum(np.sqrt(up) * _SKY_ROWS, _SKY_ROWS - 1.0)
    out[..., _CLEAR] = -1.0

    def on_ground(rays: FloatArray) -> FloatArray:
        down = np.maximum(-rays[..., 2:], camera.up / (2.0 * _FAR))
        return rays[..., :2] * (camera.up / down)

    place = on_ground(rays)
    half = 0.5 * np.asarray(height)
    across = on_ground(camera.rays_through(rows, columns + 0.5)) - on_ground(
        camera.rays_through(rows, columns - 0.5)
    )
    along = on_ground(camera.rays_through(rows + half, columns)) - on_ground(
        camera.rays_through(rows - half, columns)
    )
    size = np.maximum(
        np.hypot(across[..., 0], across[..., 1]), np.hypot(along[..., 0], along[..., 1])
    )
    clear = np.exp(-np.hypot(place[..., 0], place[..., 1]) / _HAZE)
    place += np.array([camera.forward, camera.left])
    ground = np.concatenate([place, across, along, size[..., None], clear[..., None]], axis=-1)
    is_ground = rays[..., 2] < -camera.up / _FAR
    out[is_ground] = ground[is_ground]
    return out


# The road that is drawn

_RX, _RY, _RC, _RN, _RKAPPA = range(5)


@njit()
def _road_rows(table: FloatArray, ds: float, before: int, rows: int) -> FloatArray:
    """(rows, 5) x, y, cosine and sine of the heading, curvature, every `_SPACING`."""
    out = np.empty((rows, 5))
    for i in range(rows):
        x, y, c, n, kappa = frame_at(table, ds, (i - before) * _SPACING)
        out[i, _RX] = x
        out[i, _RY] = y
        out[i, _RC] = c
        out[i, _RN] = n
        out[i, _RKAPPA] = kappa
    return out


@njit(error_model="numpy")
def _slot(keys: npt.NDArray[np.int64], key: int) -> int:
    """Slot of a key in a hash table: where it is, or where it would be entered."""
    mask = len(keys) - 1
    slot = ((key * 0x9E3779B97F4A7C1) >> 40) & mask
    while keys[slot] != _EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit(error_model="numpy")
def _key(ix: int, iy: int) -> int:
    return ix * 67108864 + iy


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
    """Enters for each cell near the road the row nearest to its middle.

    The rows from ``start`` up to ``end`` are the road itself. Those beyond its ends give way to it,
    where it comes by.
    """
    span = math.ceil(reach / cell)
    last = len(rows)
    for turn in range(2):
        for i in range(last):
            is_own = start <= i < end
            if is_own != (turn == 0):
                continue
            x, y = rows[i, _RX], rows[i, _RY]
            cx, cy = math.floor(x / cell), math.floor(y / cell)
            for ix in range(cx - span, cx + span + 1):
                for iy in range(cy - span, cy + span + 1):
                    square = ((ix + 0.5) * cell - x) ** 2 + ((iy + 0.5) * cell - y) ** 2
                    if square > (reach + cell) ** 2:
                        continue
                    key = _key(ix, iy)
                    slot = _slot(keys, key)
                    if keys[slot] == key:
                        if square >= squares[slot]:
                            continue
                        other = nearest[slot]
                        if not is_own and start <= other < end:
                            # Only the road's own end meets what lies beyond it.
                            gap = start - other if i < start else other - end
                            if abs(gap) > 2.0 * reach / _SPACING:
                                continue
                    keys[slot] = key
                    nearest[slot] = i
                    squares[slot] = square


# Colours

_LAND, _PATCH, _GRAVEL, _TAR, _PAINT, _HILLS = range(6)


@dataclass(frozen=True, eq=False)
class _Paint:
    """Colours and textures of a scene."""

    colours: FloatArray
    """Colours of land, of patches on it, gravel, asphalt, paint and hills, (6, 3) from 0 to 255."""
    contrasts: FloatArray
    """Contrast of the grain of land, gravel, asphalt and paint, and of the asphalt's patches."""
    fine: npt.NDArray[np.float32]
    """Grain, (256, 256) from -1 to 1."""
    coarse: npt.NDArray[np.float32]
    """Patches, likewise."""
    sky: npt.NDArray[np.uint8]
    """Panorama, (rows, columns, 3)."""


@lru_cache(maxsize=16)
def _paint(seed: int) -> _Paint:
    """The colours of a scene: ordinary ones with seed 0, else drawn from wide ranges."""
    rng = np.random.default_rng(seed)
    fine = _noise(rng, (_SIZE, 128))
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
    sky = _panorama(coarse, colours[_HILLS], sun, sun_up, clouds)
    return _Paint(colours, contrasts, fine, coarse, sky)


def _noise(rng: np.random.Generator, grids: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Smooth noise that repeats itself, (256, 256) from -1 to 1: grids of random numbers."""
    total = np.zeros((_SIZE, _SIZE))
    for k, points in enumerate(grids):
        lattice = rng.uniform(-1.0, 1.0, (points, points))
        at = np.arange(_SIZE) * (points / _SIZE)
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
    """The sky all around, with a sun, clouds and a chain of hills, (rows, columns, 3).

    Args:
        noise: shape of hills and clouds.
        hills: their colour.
        sun: its direction, in rad counter-clockwise from +x.
        sun_up: its elevation, in rad.
        clouds: share of the sky that is grey, 0..1.
    """
    up = (((np.arange(_SKY_ROWS) + 0.5) / _SKY_ROWS) ** 2 * (0.5 * math.pi))[:, None]
    around = (np.arange(_SKY_COLUMNS) + 0.5) * (2.0 * math.pi / _SKY_COLUMNS)
    blue, pale, grey = np.array([[96, 148, 214], [196, 212, 226], [186, 190, 194]], dtype=float)
    height = (1.0 - 1.0 / (1.0 + 3.0 * up))[..., None]
    sky = pale + height * (blue - pale) + np.zeros((_SKY_ROWS, _SKY_COLUMNS, 3))
    repeated = np.tile(noise, (1, _SKY_COLUMNS // _SIZE))
    cover = np.clip(0.5 + 2.0 * (repeated[:_SKY_ROWS] + 2.0 * clouds - 1.2), 0.0, 1.0)[..., None]
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


# Drawing


@njit(error_model="numpy")
def _share(low: float, high: float, at: float, width: float) -> float:
    """Share of a footprint ``width`` wide around ``at`` that lies between two bounds."""
    inside = min(high, at + 0.5 * width) - max(low, at - 0.5 * width)
    return max(inside, 0.0) / width


@njit(error_model="numpy")
def _dashes(s: float) -> float:
    """Length of dashes from 0 to ``s``; the first begins at 0."""
    periods = math.floor(s / DASH_PERIOD)
    return periods * DASH + min(s - periods * DASH_PERIOD, DASH)


@njit(error_model="numpy")
def _paint_left(wear: float, rough: float, smooth: float, size: float) -> float:
    """Share of a marking's paint that is left here; it wears off in flakes and in patches."""
    left = 1.0 - wear
    here = min(max(0.5 + 2.5 * (left - 0.5 - 0.35 * (rough + smooth)), 0.0), 1.0)
    sharp = min(8.0 * _FINE / size, 1.0)
    return sharp * here + (1.0 - sharp) * left


@njit(error_model="numpy")
def _locate(
    wx: float,
    wy: float,
    rows: FloatArray,
    per_metre: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
) -> tuple[float, float, float, float, float]:
    """Place of a point on the road.

    Returns:
        Offset to the left of the centre line (m), distance from the first row (m), cosine and sine
        of the road's heading, metres of road per metre at this offset: 0 far from the road.
    """
    key = _key(math.floor(wx * per_metre), math.floor(wy * per_metre))
    slot = _slot(keys, key)
    if keys[slot] != key:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    i = nearest[slot]
    dx, dy = wx - rows[i, _RX], wy - rows[i, _RY]
    along = dx * rows[i, _RC] + dy * rows[i, _RN]
    step = math.floor(along / _SPACING + 0.5)
    if step != 0:
        i = min(max(i + step, 0), len(rows) - 1)
        dx, dy = wx - rows[i, _RX], wy - rows[i, _RY]
        along = dx * rows[i, _RC] + dy * rows[i, _RN]
    if abs(along) > 4.0 * _SPACING:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    left = dy * rows[i, _RC] - dx * rows[i, _RN]
    kappa = rows[i, _RKAPPA]
    unstretched = 1.0 / max(1.0 - kappa * left, 0.2)
    d = left - 0.5 * kappa * along * along * unstretched
    along *= unstretched
    turned = kappa * along
    cosine = rows[i, _RC] - turned * rows[i, _RN]
    sine = rows[i, _RN] + turned * rows[i, _RC]
    return d, i * _SPACING + along, cosine, sine, unstretched


@njit(error_model="numpy")
def _draw(
    first: npt.NDArray[np.int64],
    samples: npt.NDArray[np.float32],
    x: float,
    y: float,
    heading: float,
    rows: FloatArray,
    before: int,
    lane_width: float,
    cell: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
    colours: FloatArray,
    contrasts: FloatArray,
    fine: npt.NDArray[np.float32],
    coarse: npt.NDArray[np.float32],
    sky: npt.NDArray[np.uint8],
    wear: float,
    image: npt.NDArray[np.uint8],
) -> None:
    """Writes the picture from a car at x, y and heading into ``image``, (height, width, 3).

    One in `_STRIDE` samples of a line is located on the road. Those between two of them are
    interpolated if both lie on the same piece of road; on an arc this errs by less than an eighth
    of the samples' spacing.
    """
    c, n = math.cos(heading), math.sin(heading)
    # Positive, so that cutting off a fraction rounds down.
    turns = heading / (2.0 * math.pi)
    turned = (turns - math.floor(turns) + 1.0) * _SKY_COLUMNS
    verge = lane_width + SHOULDER_WIDTH
    outer = lane_width - EDGE_DISTANCE + 0.5 * MARKING_WIDTH
    inner = outer - MARKING_WIDTH
    mask = _SIZE - 1
    width = image.shape[1]
    per_metre = 1.0 / cell
    sums = np.empty((width, 3))
    for v in range(image.shape[0]):
        sums[:] = 0.0
        for line in range(first[v], first[v + 1]):
            # The first knot, as if it were the end of a stretch before.
            high, mode = 0, _LAND_ONLY
            d1 = s1 = c1 = n1 = per1 = x1 = y1 = 0.0
            is_ground = samples[line, 0, _CLEAR] >= 0.0
            if is_ground:
                x1, y1 = samples[line, 0, _X], samples[line, 0, _Y]
                d1, s1, c1, n1, per1 = _locate(
                    x + c * x1 - n * y1, y + n * x1 + c * y1, rows, per_metre, keys, nearest
                )
            d0, s0, part = d1, s1, 0.0
            low = 0
            for u in range(width):
                fx, fy = samples[line, u, _X], samples[line, u, _Y]
                clear = samples[line, u, _CLEAR]
                d, at, rc, rn, per = d1, s1, c1, n1, per1
                if u == high:
                    if u < width - 1:  # the next stretch
                        low, high = u, min(u + _STRIDE, width - 1)
                        was_ground, x0, y0, d0, s0 = is_ground, x1, y1, d1, s1
                        c0, n0, per0 = c1, n1, per1
                        is_ground = samples[line, high, _CLEAR] >= 0.0
                        x1, y1 = samples[line, high, _X], samples[line, high, _Y]
                        d1 = s1 = c1 = n1 = per1 = 0.0
                        if is_ground:
                            d1, s1, c1, n1, per1 = _locate(
                                x + c * x1 - n * y1,
                                y + n * x1 + c * y1,
                                rows,
                                per_metre,
                                keys,
                                nearest,
                            )
                        part = 1.0 / (high - low)
                        apart = (x1 - x0) ** 2 + (y1 - y0) ** 2
                        mode = _EACH
                        if not (is_ground or was_ground):
                            mode = _LAND_ONLY
                        elif is_ground and was_ground:
                            if per0 == 0.0 and per1 == 0.0:
                                mode = _LAND_ONLY if apart < 36.0 else _EACH
                            elif (
                                per0 > 0.0
                                and per1 > 0.0
                                and c0 * c1 + n0 * n1 > 0.97
                                and (s1 - s0) ** 2 < 4.0 * apart
                                and (d1 - d0) ** 2 < 1.1 * apart
                            ):
                                mode = _BETWEEN
                elif mode == _BETWEEN:
                    # The rest only turns the footprint.
                    t = part * (u - low)
                    d, at = d0 + t * (d1 - d0), s0 + t * (s1 - s0)
                elif mode == _LAND_ONLY:
                    per = 0.0
                elif clear >= 0.0:
                    d, at, rc, rn, per = _locate(
                        x + c * fx - n * fy, y + n * fx + c * fy, rows, per_metre, keys, nearest
                    )
                if clear < 0.0:
                    j = int(fx + turned) & (_SKY_COLUMNS - 1)
                    i = int(fy)
                    sums[u, 0] += sky[i, j, 0]
                    sums[u, 1] += sky[i, j, 1]
                    sums[u, 2] += sky[i, j, 2]
                    continue
                wx, wy = x + c * fx - n * fy, y + n * fx + c * fy
                # Texture, which fades where a pixel holds many texels.
                rough = smooth = 0.0
                size = samples[line, u, _FOOTPRINT]
                if size < 16.0 * _FINE:
                    i, j = math.floor(wx * (1.0 / _FINE)), math.floor(wy * (1.0 / _FINE))
                    rough = fine[i & mask, j & mask] * min(2.0 * _FINE / size, 1.0)
                if size < 32.0 * _COARSE:
                    tx, ty = wx * (1.0 / _COARSE), wy * (1.0 / _COARSE)
                    i, j = math.floor(tx), math.floor(ty)
                    tx -= i
                    ty -= j
                    i0, j0, i1, j1 = i & mask, j & mask, (i + 1) & mask, (j + 1) & mask
                    this = coarse[i0, j0] + ty * (coarse[i0, j1] - coarse[i0, j0])
                    that = coarse[i1, j0] + ty * (coarse[i1, j1] - coarse[i1, j0])
                    smooth = (this + tx * (that - this)) * min(8.0 * _COARSE / size, 1.0)
                on_verge = on_road = line_share = 0.0
                side = abs(d)
                reach = 0.71 * size  # of a footprint to any side, at most
                if per == 0.0 or side - reach > verge:
                    pass
                elif side + reach < inner and side - reach > 0.5 * MARKING_WIDTH:
                    on_verge = 1.0
                    on_road = 1.0
                else:
                    # Footprint across the road.
                    ahead, turn = c * rc + n * rn, c * rn - n * rc
                    ax, ay = samples[line, u, _AX], samples[line, u, _AY]
                    bx, by = samples[line, u, _BX], samples[line, u, _BY]
                    p, q = ay * ahead - ax * turn, by * ahead - bx * turn
                    across = math.sqrt(p * p + q * q) + 1e-6
                    on_verge = _share(-verge, verge, side, across)
                    if on_verge > 0.0:
                        on_road = _share(-lane_width, lane_width, side, across)
                    if on_road > 0.0:
                        line_share = _share(inner, outer, side, across)
                        centre = _share(-0.5 * MARKING_WIDTH, 0.5 * MARKING_WIDTH, d, across)
                        if centre > 0.0:
                            p, q = ax * ahead + ay * turn, bx * ahead + by * turn
                            length = (math.sqrt(p * p + q * q) + 1e-6) * per
                            at -= before * _SPACING
                            ends = _dashes(at + 0.5 * length) - _dashes(at - 0.5 * length)
                            line_share += centre * ends / length
                        if wear > 0.0 and line_share > 0.0:
                            line_share *= _paint_left(wear, rough, smooth, size)
                r = g = b = 0.0
                if on_verge < 1.0:
                    mix = min(max(0.5 + 0.8 * smooth, 0.0), 1.0)
                    grain = contrasts[0] * rough
                    r = colours[_LAND, 0] + mix * (colours[_PATCH, 0] - colours[_LAND, 0]) + grain
                    g = colours[_LAND, 1] + mix * (colours[_PATCH, 1] - colours[_LAND, 1]) + grain
                    b = colours[_LAND, 2] + mix * (colours[_PATCH, 2] - colours[_LAND, 2]) + grain
                if on_verge > 0.0:
                    if on_road < 1.0:
                        grain = contrasts[1] * rough
                        r += on_verge * (colours[_GRAVEL, 0] + grain - r)
                        g += on_verge * (colours[_GRAVEL, 1] + grain - g)
                        b += on_verge * (colours[_GRAVEL, 2] + grain - b)
                    if on_road > 0.0:
                        shade = contrasts[2] * rough + contrasts[4] * smooth
                        r += on_road * (colours[_TAR, 0] + shade - r)
                        g += on_road * (colours[_TAR, 1] + shade - g)
                        b += on_road * (colours[_TAR, 2] + shade - b)
                    if line_share > 0.0:
                        grain = contrasts[3] * rough
                        r += line_share * (colours[_PAINT, 0] + grain - r)
                        g += line_share * (colours[_PAINT, 1] + grain - g)
                        b += line_share * (colours[_PAINT, 2] + grain - b)
                sums[u, 0] += colours[_HILLS, 0] + clear * (r - colours[_HILLS, 0])
                sums[u, 1] += colours[_HILLS, 1] + clear * (g - colours[_HILLS, 1])
                sums[u, 2] += colours[_HILLS, 2] + clear * (b - colours[_HILLS, 2])
        share = 1.0 / (first[v + 1] - first[v])
        for u in range(width):
            for k in range(3):
                image[v, u, k] = int(min(max(sums[u, k] * share + 0.5, 0.0), 255.0))


class Renderer:
    """Draws what a camera on a car sees along one road.

    Args:
        road: the road; it goes on straight beyond its ends, 80 m at its end.
        camera: the camera.
        scene: appearance of the world.
    """

    def __init__(self, road: Road, camera: Camera, scene: Scene | None = None) -> None:
        self.camera = camera
        self._scene = scene or Scene()
        self._lane_width = road.lane_width
        self._before = round(BEFORE / _SPACING)
        own = math.ceil(road.length / _SPACING)
        count = self._before + own + 1 + round(BEYOND / _SPACING)
        self._rows = _road_rows(road.table, road.sub_step, self._before, count)
        # A pixel's footprint may reach onto the road from beside it.
        reach = road.lane_width + SHOULDER_WIDTH + 1.0
        self._cell = max(2.0, 0.5 * road.lane_width)
        wide = reach + 3.0 * self._cell
        cells = (2.0 * wide * count * _SPACING + math.pi * wide * wide) / self._cell**2
        slots = 1 << math.ceil(math.log2(2.0 * cells))
        self._keys = np.full(slots, _EMPTY, dtype=np.int64)
        self._nearest = np.empty(slots, dtype=np.int64)
        _enter_rows(
            self._rows,
            self._before,
            self._before + own + 1,
            reach,
            self._cell,
            self._keys,
            self._nearest,
            np.empty(slots),
        )

    def draw(self, x: float, y: float, heading: float) -> Image:
        """The picture from a car at this place (m, m, rad), (height, width, 3)."""
        projection, paint = _projection(self.camera), _paint(self._scene.seed)
        image = np.empty(self.camera.shape, dtype=np.uint8)
        _draw(
            projection.first,
            projection.samples,
            float(x),
            float(y),
            float(heading),
            self._rows,
            self._before,
            self._lane_width,
            self._cell,
            self._keys,
            self._nearest,
            paint.colours,
            paint.contrasts,
            paint.fine,
            paint.coarse,
            paint.sky,
            self._scene.wear,
            image,
        )
        return image
