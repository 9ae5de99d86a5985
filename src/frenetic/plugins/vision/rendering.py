"""What a camera on the car sees: the road, the land beside it and the sky, in compiled code.

The world is flat. A frame costs a rotation of the camera's samples (`projection.py`), a look-up
of the nearest piece of road for each (`drawn_road.py`) and a mixture of colours
(`ground_colour.py`). Edges are smooth, because a line's share of a pixel's footprint on the ground
is calculated, not sampled.
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
    locate,
    make_drawn_road,
)
from frenetic.plugins.vision.ground_colour import (
    GRAIN_TEXEL,
    Palette,
    Shares,
    Texture,
    ground_colour,
    palette_of,
    texture_at,
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
from frenetic.plugins.vision.scenery import scenery_of
from frenetic.road import Road

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.drivers.camera import Image
    from frenetic.plugins.vision.ground_colour import Texels

    _Samples: TypeAlias = npt.NDArray[np.float32]
    """Samples of a projection, (lines, width, 8)."""
    _Road: TypeAlias = tuple[FloatArray, float, npt.NDArray[np.int64], npt.NDArray[np.int64]]
    """Values of a `DrawnRoad`."""
    _Scenery: TypeAlias = tuple[FloatArray, FloatArray, Texels, Texels, Image]
    """Values of a `Scenery`."""

# Steps of the drawing are inlined and take no arrays, see `ground_colour.py`.

# Ours, in the range of European rural roads.
MARKING_WIDTH: Final = 0.15
"""Width of a line, in m."""
EDGE_DISTANCE: Final = 0.2
"""Distance of an edge line's middle from the edge of the road, in m."""
DASH: Final = 4.0
"""Length of a dash of the centre line, in m."""
DASH_PERIOD: Final = 12.0
"""Distance from one dash to the next, in m."""

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


class _Footprint(NamedTuple):
    """What a sample covers on the ground, in the car's frame, in m."""

    size: float
    right_x: float
    right_y: float
    down_x: float
    down_y: float


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
def _paint_left(wear: float, texture: Texture, size: float) -> float:
    """Return the share of a marking's paint that is left; it wears off in flakes and patches."""
    left = 1.0 - wear
    here = min(max(0.5 + 2.5 * (left - 0.5 - 0.35 * (texture.fine + texture.coarse)), 0.0), 1.0)
    sharp = min(8.0 * GRAIN_TEXEL / size, 1.0)
    return sharp * here + (1.0 - sharp) * left


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
def _shares_of(
    footprint: _Footprint, spot: Spot, car: _CarPose, lanes: _Lanes, texture: Texture
) -> Shares:
    """Return the shares of a footprint on the verge, the road and its markings."""
    size = footprint.size
    side = abs(spot.left)
    reach = 0.71 * size  # of a footprint to any side, at most
    if spot.stretch == 0.0 or side - reach > lanes.verge:
        return Shares(0.0, 0.0, 0.0)
    if side + reach < lanes.line_inside and side - reach > 0.5 * MARKING_WIDTH:
        return Shares(1.0, 1.0, 0.0)
    ahead = car.cosine * spot.cosine + car.sine * spot.sine
    turn = car.cosine * spot.sine - car.sine * spot.cosine
    ax, ay = footprint.right_x, footprint.right_y
    bx, by = footprint.down_x, footprint.down_y
    p, q = ay * ahead - ax * turn, by * ahead - bx * turn
    across = math.sqrt(p * p + q * q) + 1e-6
    verge = _share(-lanes.verge, lanes.verge, side, across)
    if verge <= 0.0:
        return Shares(verge, 0.0, 0.0)
    road = _share(-lanes.width, lanes.width, side, across)
    if road <= 0.0:
        return Shares(verge, road, 0.0)
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
    return Shares(verge, road, paint)


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
def _on_map(car: _CarPose, x: float, y: float) -> tuple[float, float]:
    """Return a point of the car's frame on the map, in m."""
    return car.x + car.cosine * x - car.sine * y, car.y + car.sine * x + car.cosine * y


@njit(error_model="numpy")
def _locate_line(
    samples: _Samples,
    line: int,
    car: _CarPose,
    rows: FloatArray,
    cells_per_metre: float,
    keys: npt.NDArray[np.int64],
    nearest: npt.NDArray[np.int64],
    spots: FloatArray,
) -> None:
    """Write where the samples of a line lie on the road into ``spots``, (width, 5).

    Every fourth sample is a knot, which is located; most samples between two knots are not.
    """
    nowhere = Spot(0.0, 0.0, 0.0, 0.0, 0.0)
    last = samples.shape[1] - 1
    u, end = 0, _Knot(False, samples[line, 0, X], samples[line, 0, Y], nowhere)
    for k in range(0, last + _STRIDE, _STRIDE):
        first, start = u, end
        u = min(k, last)
        x, y = samples[line, u, X], samples[line, u, Y]
        is_ground = samples[line, u, CLEAR] >= 0.0
        spot = nowhere
        if is_ground:
            map_x, map_y = _on_map(car, x, y)
            spot = locate(map_x, map_y, rows, cells_per_metre, keys, nearest)
        _keep_spot(spots, u, spot)
        end = _Knot(is_ground, x, y, spot)
        mode = _mode_between(start, end)
        for between in range(first + 1, u):
            spot = nowhere
            if mode == _BETWEEN:
                spot = _spot_between(start.spot, end.spot, (1.0 / (u - first)) * (between - first))
            elif mode == _EACH and samples[line, between, CLEAR] >= 0.0:
                x, y = samples[line, between, X], samples[line, between, Y]
                map_x, map_y = _on_map(car, x, y)
                spot = locate(map_x, map_y, rows, cells_per_metre, keys, nearest)
            _keep_spot(spots, between, spot)


@njit(error_model="numpy", inline="always")
def _keep_spot(spots: FloatArray, u: int, spot: Spot) -> None:
    """Write a spot into a row of ``spots``."""
    spots[u, 0] = spot.left
    spots[u, 1] = spot.along
    spots[u, 2] = spot.cosine
    spots[u, 3] = spot.sine
    spots[u, 4] = spot.stretch


@njit(error_model="numpy")
def _add_line(
    samples: _Samples,
    line: int,
    spots: FloatArray,
    car: _CarPose,
    lanes: _Lanes,
    palette: Palette,
    grain: Texels,
    patches: Texels,
    sky: Image,
    sums: FloatArray,
) -> None:
    """Add the colours of a line of samples to ``sums``, (width, 3)."""
    hills = palette.hills
    for u in range(samples.shape[1]):
        fx, fy, clear = samples[line, u, X], samples[line, u, Y], samples[line, u, CLEAR]
        if clear < 0.0:
            j = int(fx + car.sky_columns) & (SKY_COLUMNS - 1)
            i = int(fy)
            for k in range(3):
                sums[u, k] += sky[i, j, k]
            continue
        x, y = _on_map(car, fx, fy)
        spot = Spot(spots[u, 0], spots[u, 1], spots[u, 2], spots[u, 3], spots[u, 4])
        footprint = _footprint_of(samples, line, u)
        texture = texture_at(x, y, footprint.size, grain, patches)
        shares = _shares_of(footprint, spot, car, lanes, texture)
        colour = ground_colour(shares, texture, palette)
        sums[u, 0] += hills.red + clear * (colour.red - hills.red)
        sums[u, 1] += hills.green + clear * (colour.green - hills.green)
        sums[u, 2] += hills.blue + clear * (colour.blue - hills.blue)


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
    rows, cells_per_metre, keys, nearest = road
    colours, contrasts, grain, patches, sky = scenery
    palette = palette_of(colours, contrasts)
    width = image.shape[1]
    spots = np.empty((width, 5))
    sums = np.empty((width, 3))
    for v in range(image.shape[0]):
        sums[:] = 0.0
        for line in range(first_lines[v], first_lines[v + 1]):
            _locate_line(samples, line, car, rows, cells_per_metre, keys, nearest, spots)
            _add_line(samples, line, spots, car, lanes, palette, grain, patches, sky, sums)
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
        rows, cells_per_metre, keys, nearest = make_drawn_road(road)
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
