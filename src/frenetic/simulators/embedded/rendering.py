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

# Layers of a picture, each drawn over the one before.
SKY, LAND, SHOULDER, ASPHALT, MARKINGS, TEXTURE = 0, 1, 2, 3, 4, 5
LAYERS: Final = ("sky", "land", "shoulder", "asphalt", "markings", "texture")
"""Layers of a picture in the order in which they are drawn, see `Renderer`."""

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
_MOST_SAMPLES = 4  # of a pixel, one above the other
_EMPTY = -(2**62)


# What a camera's pixels look at

# Columns of a sample's geometry. Ground: place, footprint to the right and downwards (m), 1 - haze,
# distance. Sky: direction, elevation, -1.
_X, _Y, _AX, _AY, _BX, _BY, _CLEAR, _DISTANCE = range(8)


@dataclass(frozen=True, eq=False)
class _Projection:
    """Samples of a camera's image."""

    first: npt.NDArray[np.int64]
    """First sample of each pixel, (height * width + 1,)."""
    samples: FloatArray
    """(n, 8), see above."""


@lru_cache(maxsize=8)
def _projection(camera: Camera) -> _Projection:
    """The samples of a camera; pixels that look far along the ground have several."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    single = _footprints(camera, rows.astype(float), columns.astype(float), 1.0)
    length = np.hypot(single[:, _BX], single[:, _BY])
    # A footprint of more than 2 m may hold more than one piece of a bend.
    is_near_horizon = np.abs(camera.rays_through(rows, columns)[..., 2]) < 2.0 / camera.focal_length
    number = np.where(single[:, _CLEAR] < 0.0, 1, np.ceil(length / 2.0))
    number = np.where(is_near_horizon, _MOST_SAMPLES, np.clip(number, 1, _MOST_SAMPLES))
    number = number.astype(np.int64)
    first = np.concatenate([[0], np.cumsum(number)])
    pixel = np.repeat(np.arange(len(number)), number)
    of_pixel = number[pixel]
    part = (np.arange(first[-1]) - first[pixel] + 0.5) / of_pixel - 0.5
    samples = _footprints(camera, rows[pixel] + part, columns[pixel].astype(float), 1.0 / of_pixel)
    return _Projection(first, samples)


def _footprints(
    camera: Camera, rows: FloatArray, columns: FloatArray, height: FloatArray | float
) -> FloatArray:
    """Geometry of samples at these places, ``height`` rows high."""
    out = np.zeros((len(rows), 8))
    rays = camera.rays_through(rows, columns)
    is_ground = rays[:, 2] < -camera.up / _FAR
    sky = ~is_ground
    flat = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-9)
    out[sky, _X], out[sky, _Y] = (rays[:, 0] / flat)[sky], (rays[:, 1] / flat)[sky]
    out[sky, _AX] = np.maximum(np.arcsin(np.clip(rays[:, 2], -1.0, 1.0)), 0.0)[sky]
    out[sky, _CLEAR] = -1.0

    def on_ground(rays: FloatArray) -> FloatArray:
        down = np.maximum(-rays[:, 2], camera.up / (2.0 * _FAR))
        return rays[:, :2] * (camera.up / down)[:, None]

    place = on_ground(rays)
    half = 0.5 * np.broadcast_to(height, rows.shape)
    across = on_ground(camera.rays_through(rows, columns + 0.5)) - on_ground(
        camera.rays_through(rows, columns - 0.5)
    )
    along = on_ground(camera.rays_through(rows + half, columns)) - on_ground(
        camera.rays_through(rows - half, columns)
    )
    distance = np.hypot(place[:, 0], place[:, 1])
    ground = np.column_stack(
        [
            place[:, 0] + camera.forward,
            place[:, 1] + camera.left,
            across,
            along,
            np.exp(-distance / _HAZE),
            distance,
        ]
    )
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


@njit()
def _slot(keys: npt.NDArray[np.int64], key: int) -> int:
    """Slot of a key in a hash table: where it is, or where it would be entered."""
    mask = len(keys) - 1
    slot = ((key * 0x9E3779B97F4A7C1) >> 20) & mask
    while keys[slot] != _EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit()
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


@dataclass(frozen=True, eq=False)
class _Paint:
    """Colours and textures of a scene."""

    colours: FloatArray
    """(8, 3) from 0 to 255: zenith, horizon, land, land in patches, hills, gravel, asphalt,
    paint."""
    numbers: FloatArray
    """Cosine and sine of the sun's direction, its elevation in rad, its strength; how much grain
    and patches the asphalt has, and the land."""
    fine: npt.NDArray[np.float32]
    """Grain, (256, 256) from -1 to 1."""
    coarse: npt.NDArray[np.float32]
    """Patches, likewise."""


@lru_cache(maxsize=16)
def _paint(seed: int) -> _Paint:
    rng = np.random.default_rng(seed)
    fine = _noise(rng, (_SIZE, 128))
    coarse = _noise(rng, (64, 32, 16))
    colours = np.array(
        [
            [96, 148, 214],
            [196, 212, 226],
            [88, 112, 58],
            [118, 128, 74],
            [92, 112, 108],
            [142, 134, 118],
            [92, 93, 96],
            [236, 236, 230],
        ],
        dtype=np.float64,
    )
    numbers = np.array([math.cos(0.7), math.sin(0.7), 0.6, 1.0, 9.0, 7.0, 16.0])
    return _Paint(colours, numbers, fine, coarse)


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


# Drawing


@njit()
def _share(low: float, high: float, at: float, width: float) -> float:
    """Share of a footprint ``width`` wide around ``at`` that lies between two bounds."""
    inside = min(high, at + 0.5 * width) - max(low, at - 0.5 * width)
    return max(inside, 0.0) / width


@njit()
def _dashes(s: float) -> float:
    """Length of dashes from 0 to ``s``; the first begins at 0."""
    periods = math.floor(s / DASH_PERIOD)
    return periods * DASH + min(s - periods * DASH_PERIOD, DASH)


@njit(error_model="numpy")
def _draw(
    first: npt.NDArray[np.int64],
    samples: FloatArray,
    place: FloatArray,
    rows: FloatArray,
    before: int,
    lane_width: float,
    cell: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
    colours: FloatArray,
    numbers: FloatArray,
    fine: npt.NDArray[np.float32],
    coarse: npt.NDArray[np.float32],
    wear: float,
    layers: int,
    image: npt.NDArray[np.uint8],
) -> None:
    """Writes the picture from a car at ``place`` (x, y, heading) into ``image``, (pixels, 3)."""
    x, y = place[0], place[1]
    c, n = math.cos(place[2]), math.sin(place[2])
    sun_x, sun_y, sun_up, sun_power = numbers[0], numbers[1], numbers[2], numbers[3]
    sun_c, sun_s = math.cos(sun_up), math.sin(sun_up)
    grain, patches, land_patches = numbers[4], numbers[5], numbers[6]
    verge = lane_width + SHOULDER_WIDTH
    edge = lane_width - EDGE_DISTANCE
    last_row = len(rows) - 1
    cell_key, row = _EMPTY, -1
    for pixel in range(len(first) - 1):
        red = green = blue = 0.0
        for k in range(first[pixel], first[pixel + 1]):
            fx, fy = samples[k, _X], samples[k, _Y]
            wx, wy = c * fx - n * fy, n * fx + c * fy
            clear = samples[k, _CLEAR]
            if clear < 0.0:
                elevation = samples[k, _AX]
                t = 1.0 - 1.0 / (1.0 + 3.0 * elevation)
                r = colours[1, 0] + t * (colours[0, 0] - colours[1, 0])
                g = colours[1, 1] + t * (colours[0, 1] - colours[1, 1])
                b = colours[1, 2] + t * (colours[0, 2] - colours[1, 2])
                towards = wx * sun_x + wy * sun_y
                if towards > 0.0:
                    # Cosine of the angle to the sun, for small elevations.
                    cosine = towards * sun_c * math.sqrt(max(1.0 - elevation * elevation, 0.0))
                    cosine += elevation * sun_s
                    if cosine > 0.0:
                        glow = cosine * cosine
                        glow *= glow
                        glow *= glow
                        glow = sun_power * (0.25 * glow + 0.75 * glow**8)
                        r += glow * (255.0 - r)
                        g += glow * (250.0 - g)
                        b += glow * (235.0 - b)
                # A chain of hills.
                turn = 0.5 * _SIZE * (1.0 + math.atan2(wy, wx) / math.pi)
                j = int(turn)
                u = turn - j
                height = (1.0 - u) * coarse[7, j % _SIZE] + u * coarse[7, (j + 1) % _SIZE]
                if elevation < 0.025 + 0.022 * height:
                    r, g, b = colours[4, 0], colours[4, 1], colours[4, 2]
            else:
                wx += x
                wy += y
                ax, ay = samples[k, _AX], samples[k, _AY]
                bx, by = samples[k, _BX], samples[k, _BY]
                size = max(math.hypot(ax, ay), math.hypot(bx, by))
                # Texture, which fades where a pixel holds many texels.
                rough = smooth = 0.0
                if layers >= TEXTURE:
                    if size < 32.0 * _FINE:
                        i, j = math.floor(wx / _FINE), math.floor(wy / _FINE)
                        rough = fine[i & (_SIZE - 1), j & (_SIZE - 1)] * min(
                            2.0 * _FINE / size, 1.0
                        )
                    if size < 64.0 * _COARSE:
                        tx, ty = wx / _COARSE, wy / _COARSE
                        i, j = math.floor(tx), math.floor(ty)
                        tx -= i
                        ty -= j
                        i0, j0 = i & (_SIZE - 1), j & (_SIZE - 1)
                        i1, j1 = (i + 1) & (_SIZE - 1), (j + 1) & (_SIZE - 1)
                        smooth = (1.0 - tx) * (
                            (1.0 - ty) * coarse[i0, j0] + ty * coarse[i0, j1]
                        ) + tx * ((1.0 - ty) * coarse[i1, j0] + ty * coarse[i1, j1])
                        smooth *= min(8.0 * _COARSE / size, 1.0)
                mix = min(max(0.5 + 0.8 * smooth, 0.0), 1.0)
                r = colours[2, 0] + mix * (colours[3, 0] - colours[2, 0]) + land_patches * rough
                g = colours[2, 1] + mix * (colours[3, 1] - colours[2, 1]) + land_patches * rough
                b = colours[2, 2] + mix * (colours[3, 2] - colours[2, 2]) + land_patches * rough
                if layers >= SHOULDER:
                    ix, iy = math.floor(wx / cell), math.floor(wy / cell)
                    key = _key(ix, iy)
                    if key != cell_key:
                        cell_key = key
                        slot = _slot(keys, key)
                        row = nearest[slot] if keys[slot] == key else -1
                    if row >= 0:
                        i = row
                        dx, dy = wx - rows[i, _RX], wy - rows[i, _RY]
                        along = dx * rows[i, _RC] + dy * rows[i, _RN]
                        step = math.floor(along / _SPACING + 0.5)
                        if step != 0:
                            i = min(max(i + step, 0), last_row)
                            dx, dy = wx - rows[i, _RX], wy - rows[i, _RY]
                            along = dx * rows[i, _RC] + dy * rows[i, _RN]
                        left = dy * rows[i, _RC] - dx * rows[i, _RN]
                        kappa = rows[i, _RKAPPA]
                        stretch = max(1.0 - kappa * left, 0.2)
                        if abs(along) < 4.0 * _SPACING:
                            d = left - 0.5 * kappa * along * along / stretch
                            # Footprint across and along the road.
                            rc = rows[i, _RC] - kappa * along * rows[i, _RN]
                            rn = rows[i, _RN] + kappa * along * rows[i, _RC]
                            ux, uy = c * ax - n * ay, n * ax + c * ay
                            vx, vy = c * bx - n * by, n * bx + c * by
                            p, q = uy * rc - ux * rn, vy * rc - vx * rn
                            across = math.sqrt(p * p + q * q) + 1e-6
                            side = abs(d)
                            share = _share(-verge, verge, side, across)
                            if share > 0.0:
                                r += share * (colours[5, 0] + 22.0 * rough - r)
                                g += share * (colours[5, 1] + 22.0 * rough - g)
                                b += share * (colours[5, 2] + 20.0 * rough - b)
                            share = _share(-lane_width, lane_width, side, across)
                            if layers >= ASPHALT and share > 0.0:
                                shade = grain * rough + patches * smooth
                                r += share * (colours[6, 0] + shade - r)
                                g += share * (colours[6, 1] + shade - g)
                                b += share * (colours[6, 2] + shade - b)
                            if layers >= MARKINGS and share > 0.0:
                                line = _share(
                                    edge - 0.5 * MARKING_WIDTH,
                                    edge + 0.5 * MARKING_WIDTH,
                                    side,
                                    across,
                                )
                                centre = _share(
                                    -0.5 * MARKING_WIDTH, 0.5 * MARKING_WIDTH, d, across
                                )
                                if centre > 0.0:
                                    p, q = ux * rc + uy * rn, vx * rc + vy * rn
                                    length = (math.sqrt(p * p + q * q) + 1e-6) / stretch
                                    s = (i - before) * _SPACING + along / stretch
                                    line += (
                                        centre
                                        * (_dashes(s + 0.5 * length) - _dashes(s - 0.5 * length))
                                        / length
                                    )
                                if line > 0.0:
                                    if wear > 0.0:
                                        line *= _paint_left(wear, rough, smooth, size)
                                    r += line * (colours[7, 0] + 6.0 * rough - r)
                                    g += line * (colours[7, 1] + 6.0 * rough - g)
                                    b += line * (colours[7, 2] + 6.0 * rough - b)
                haze = 1.0 - clear
                r += haze * (colours[4, 0] - r)
                g += haze * (colours[4, 1] - g)
                b += haze * (colours[4, 2] - b)
            red += r
            green += g
            blue += b
        share = 1.0 / (first[pixel + 1] - first[pixel])
        image[pixel, 0] = int(min(max(red * share + 0.5, 0.0), 255.0))
        image[pixel, 1] = int(min(max(green * share + 0.5, 0.0), 255.0))
        image[pixel, 2] = int(min(max(blue * share + 0.5, 0.0), 255.0))


@njit()
def _paint_left(wear: float, rough: float, smooth: float, size: float) -> float:
    """Share of a marking's paint that is left here; it wears off in flakes and in patches."""
    left = 1.0 - wear
    here = min(max(0.5 + 2.5 * (left - 0.5 - 0.35 * (rough + smooth)), 0.0), 1.0)
    sharp = min(8.0 * _FINE / size, 1.0)
    return sharp * here + (1.0 - sharp) * left


class Renderer:
    """Draws what a camera on a car sees along one road.

    Args:
        road: the road; it goes on straight beyond its ends, 80 m at its end.
        camera: the camera.
        scene: appearance of the world.
        layer: the last of `LAYERS` that is drawn; all by default.
    """

    def __init__(
        self, road: Road, camera: Camera, scene: Scene | None = None, *, layer: str = LAYERS[-1]
    ) -> None:
        self.camera = camera
        self._scene = scene or Scene()
        self._layers = LAYERS.index(layer)
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
        """The picture from a car at this place (m, m, rad), (height, width, 3); read-only."""
        projection, paint = _projection(self.camera), _paint(self._scene.seed)
        image = np.empty(self.camera.shape, dtype=np.uint8)
        _draw(
            projection.first,
            projection.samples,
            np.array([x, y, heading], dtype=np.float64),
            self._rows,
            self._before,
            self._lane_width,
            self._cell,
            self._keys,
            self._nearest,
            paint.colours,
            paint.numbers,
            paint.fine,
            paint.coarse,
            self._scene.wear,
            self._layers,
            image.reshape(-1, 3),
        )
        image.setflags(write=False)
        return image
