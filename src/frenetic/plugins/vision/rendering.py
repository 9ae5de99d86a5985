"""Draw what a camera on the car sees: the road, the land beside it and the sky, in compiled code.

The world is flat. To draw a picture, the camera's samples (`projection.py`) are put on the map
where the car is, the nearest piece of road is looked up (`drawn_road.py`), and the colours of land,
gravel, asphalt and paint are mixed (`ground_colour.py`). Edges are smooth, because the share of a
sample's footprint that lies on a marking is calculated.
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
    """`Projection.samples`, (lines, width, 8)."""
    _Road: TypeAlias = tuple[FloatArray, float, npt.NDArray[np.int64], npt.NDArray[np.int64]]
    """Values of a `DrawnRoad`."""
    _Scenery: TypeAlias = tuple[FloatArray, FloatArray, Texels, Texels, Image]
    """Values of a `Scenery`."""

# `ground_colour.py` says why most kernels are inlined and take no arrays.

# The markings are our choice, in the range of European rural roads.
MARKING_WIDTH: Final = 0.15
"""Width of the edge lines and of the centre line, in m."""
EDGE_DISTANCE: Final = 0.2
"""Distance of an edge line's middle from the edge of the road, in m."""
DASH: Final = 4.0
"""Length of a dash of the centre line, in m."""
DASH_PERIOD: Final = 12.0
"""Distance from the start of a dash to the start of the next, in m."""

# Only every fourth sample of a line, a *knot*, is always located on the road.
_STRIDE = 4  # samples from a knot to the next; our choice
_OFF_ROAD, _ON_ROAD, _UNKNOWN = range(3)
"""Where the samples between two knots are: all off the road; all on the road, where they are
interpolated between the knots; unknown, so each is located."""


class _CarPose(NamedTuple):
    """Position and heading of the car on the map."""

    x: float
    """Coordinate of the centre of mass, in m."""
    y: float
    """Coordinate of the centre of mass, in m."""
    cosine: float
    """Cosine of the heading."""
    sine: float
    """Sine of the heading."""
    sky_columns: float
    """Number of columns by which the heading shifts the panorama; positive."""


class _Lanes(NamedTuple):
    """Distances of edges from the centre line, on both sides, and the wear of the markings."""

    width: float
    """Distance of the road's edge, which is the width of a lane, in m."""
    verge: float
    """Distance of the gravel's outer edge, in m."""
    line_inside: float
    """Distance of the edge line's inner edge, in m."""
    line_outside: float
    """Distance of the edge line's outer edge, in m."""
    wear: float
    """Share of the markings' paint that is gone."""


class _Footprint(NamedTuple):
    """Parallelogram that a sample covers on the ground, in the car's frame."""

    size: float
    """Length of the longer side, in m."""
    right_x: float
    """The side to the right in the picture: m ahead."""
    right_y: float
    """The side to the right in the picture: m to the left."""
    down_x: float
    """The side downwards in the picture: m ahead."""
    down_y: float
    """The side downwards in the picture: m to the left."""


class _Knot(NamedTuple):
    """A sample that is always located on the road."""

    is_ground: bool
    """Whether the sample shows ground rather than sky."""
    x: float
    """Point of the ground: m ahead of the car."""
    y: float
    """Point of the ground: m to the left of the car."""
    spot: Spot
    """Position relative to the road."""


@njit(error_model="numpy")
def _car_at(pose: tuple[float, float, float]) -> _CarPose:
    """Return the car with a pose: x and y in m, heading in rad."""
    x, y, heading = pose
    # The number of columns is made positive, so that cutting off its fraction rounds down.
    turns = heading / (2.0 * math.pi)
    sky_columns = (turns - math.floor(turns) + 1.0) * SKY_COLUMNS
    return _CarPose(x, y, math.cos(heading), math.sin(heading), sky_columns)


@njit(error_model="numpy")
def _lanes_of(width: float, wear: float) -> _Lanes:
    """Return the edges of a road with two lanes.

    Args:
        width: m, width of a lane.
        wear: share of the markings' paint that is gone.
    """
    line_outside = width - EDGE_DISTANCE + 0.5 * MARKING_WIDTH
    return _Lanes(width, width + SHOULDER_WIDTH, line_outside - MARKING_WIDTH, line_outside, wear)


@njit(error_model="numpy")
def _share(low: float, high: float, at: float, width: float) -> float:
    """Return the share of a footprint between two edges that run along the road.

    Args:
        low, high: m, offsets of the edges from the centre line.
        at: m, offset of the footprint's middle from the centre line.
        width: m, width of the footprint across the road.
    """
    inside = min(high, at + 0.5 * width) - max(low, at - 0.5 * width)
    return max(inside, 0.0) / width


@njit(error_model="numpy")
def _dashes(s: float) -> float:
    """Return the length of all dashes from 0 to ``s`` m; the first dash begins at 0."""
    periods = math.floor(s / DASH_PERIOD)
    return periods * DASH + min(s - periods * DASH_PERIOD, DASH)


@njit(error_model="numpy")
def _paint_left(wear: float, texture: Texture, size: float) -> float:
    """Return the share of the paint that is left in a footprint of a marking.

    Paint wears off in flakes and patches where the textures have large values. In a footprint that
    covers many texels, the share is the mean.

    Args:
        wear: share of all paint that is gone.
        texture: values of the textures in the footprint.
        size: m, size of the footprint.
    """
    left = 1.0 - wear
    here = min(max(0.5 + 2.5 * (left - 0.5 - 0.35 * (texture.grain + texture.patches)), 0.0), 1.0)
    sharp = min(8.0 * GRAIN_TEXEL / size, 1.0)
    return sharp * here + (1.0 - sharp) * left


@njit(error_model="numpy", inline="always")
def _region_between(start: _Knot, end: _Knot) -> int:
    """Return `_OFF_ROAD`, `_ON_ROAD` or `_UNKNOWN` for the samples between two knots.

    They are interpolated if both knots lie on the same piece of road; on an arc this errs by less
    than an eighth of the samples' spacing.
    """
    if not (start.is_ground or end.is_ground):
        return _OFF_ROAD
    if not (start.is_ground and end.is_ground):
        return _UNKNOWN
    square = (end.x - start.x) ** 2 + (end.y - start.y) ** 2
    near, far = start.spot, end.spot
    if near.stretch == 0.0 and far.stretch == 0.0:
        # No road fits between two knots off the road that are less than 6 m apart.
        return _OFF_ROAD if square < 36.0 else _UNKNOWN
    # The same piece: both on the road, with headings less than 14 degrees apart, and not farther
    # apart along and across the road than on the ground, give or take a bend.
    if (
        near.stretch > 0.0
        and far.stretch > 0.0
        and near.cosine * far.cosine + near.sine * far.sine > 0.97
        and (far.along - near.along) ** 2 < 4.0 * square
        and (far.left - near.left) ** 2 < 1.1 * square
    ):
        return _ON_ROAD
    return _UNKNOWN


@njit(error_model="numpy", inline="always")
def _shares_of(
    footprint: _Footprint, spot: Spot, car: _CarPose, lanes: _Lanes, texture: Texture
) -> Shares:
    """Return the shares of a footprint on the verge, the road and its markings.

    Args:
        footprint: the footprint, around the spot.
        spot: position of the footprint's middle relative to the road.
        car: position and heading of the car.
        lanes: edges of the road.
        texture: values of the textures in the footprint, for worn markings.
    """
    size = footprint.size
    side = abs(spot.left)
    reach = 0.71 * size  # largest distance from the middle: half the diagonal of a square
    if spot.stretch == 0.0 or side - reach > lanes.verge:
        return Shares(0.0, 0.0, 0.0)
    if side + reach < lanes.line_inside and side - reach > 0.5 * MARKING_WIDTH:
        return Shares(1.0, 1.0, 0.0)
    # Cosine and sine of the road's heading in the car's frame.
    ahead = car.cosine * spot.cosine + car.sine * spot.sine
    turn = car.cosine * spot.sine - car.sine * spot.cosine
    ax, ay = footprint.right_x, footprint.right_y
    bx, by = footprint.down_x, footprint.down_y
    # Extents of the footprint's two sides across the road; further down, along the road.
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
        s = spot.along - LENGTH_BEFORE
        dashes = _dashes(s + 0.5 * length) - _dashes(s - 0.5 * length)
        paint += centre * dashes / length
    if lanes.wear > 0.0 and paint > 0.0:
        paint *= _paint_left(lanes.wear, texture, size)
    return Shares(verge, road, paint)


@njit(error_model="numpy", inline="always")
def _footprint_of(samples: _Samples, line: int, u: int) -> _Footprint:
    """Return the footprint of the sample in column ``u`` of a line."""
    return _Footprint(
        samples[line, u, FOOTPRINT],
        samples[line, u, RIGHT_X],
        samples[line, u, RIGHT_Y],
        samples[line, u, DOWN_X],
        samples[line, u, DOWN_Y],
    )


@njit(error_model="numpy", inline="always")
def _spot_between(start: Spot, end: Spot, t: float) -> Spot:
    """Return the spot at the share ``t`` of the way between two knots.

    Heading and stretch, which only turn and stretch footprints, are those at the end.
    """
    return Spot(
        start.left + t * (end.left - start.left),
        start.along + t * (end.along - start.along),
        end.cosine,
        end.sine,
        end.stretch,
    )


@njit(error_model="numpy", inline="always")
def _on_map(car: _CarPose, x: float, y: float) -> tuple[float, float]:
    """Return the coordinates on the map, in m, of a point in the car's frame."""
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
    """Locate the samples of a line on the road; write their spots.

    Args:
        samples: samples of the projection.
        line: index of the line.
        car: position and heading of the car.
        rows, cells_per_metre, keys, nearest: the road, see `DrawnRoad`.
        spots: (width, 5) values of a `Spot` for each sample; written to.
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
        _write_spot(spots, u, spot)
        end = _Knot(is_ground, x, y, spot)
        region = _region_between(start, end)
        for between in range(first + 1, u):
            spot = nowhere
            if region == _ON_ROAD:
                spot = _spot_between(start.spot, end.spot, (1.0 / (u - first)) * (between - first))
            elif region == _UNKNOWN and samples[line, between, CLEAR] >= 0.0:
                x, y = samples[line, between, X], samples[line, between, Y]
                map_x, map_y = _on_map(car, x, y)
                spot = locate(map_x, map_y, rows, cells_per_metre, keys, nearest)
            _write_spot(spots, between, spot)


@njit(error_model="numpy", inline="always")
def _write_spot(spots: FloatArray, u: int, spot: Spot) -> None:
    """Write a spot into row ``u`` of ``spots``."""
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
    grain_texture: Texels,
    patch_texture: Texels,
    sky: Image,
    sums: FloatArray,
) -> None:
    """Add the colours of a line of samples.

    Args:
        samples: samples of the projection.
        line: index of the line.
        spots: (width, 5) spots of the samples, see `_locate_line`.
        car: position and heading of the car.
        lanes: edges of the road.
        palette: colours of the ground and of the hills; distant ground takes their colour.
        grain_texture, patch_texture: the textures.
        sky: the panorama.
        sums: (width, 3) sums of colours, to which the colours are added.
    """
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
        texture = texture_at(x, y, footprint.size, grain_texture, patch_texture)
        shares = _shares_of(footprint, spot, car, lanes, texture)
        colour = ground_colour(shares, texture, palette)
        sums[u, 0] += hills.red + clear * (colour.red - hills.red)
        sums[u, 1] += hills.green + clear * (colour.green - hills.green)
        sums[u, 2] += hills.blue + clear * (colour.blue - hills.blue)


@njit(error_model="numpy")
def _draw(
    first_lines: npt.NDArray[np.int64],
    samples: _Samples,
    pose: tuple[float, float, float],
    road: _Road,
    lane_width: float,
    wear: float,
    scenery: _Scenery,
    image: Image,
) -> None:
    """Write the picture of a camera into ``image``, (height, width, 3).

    Args:
        first_lines, samples: values of the `Projection`.
        pose: x and y of the car in m, its heading in rad.
        road: values of the `DrawnRoad`.
        lane_width: m, width of a lane.
        wear: share of the markings' paint that is gone.
        scenery: values of the `Scenery`.
        image: the picture; written to.
    """
    car = _car_at(pose)
    lanes = _lanes_of(lane_width, wear)
    rows, cells_per_metre, keys, nearest = road
    colours, contrasts, grain_texture, patch_texture, sky = scenery
    palette = palette_of(colours, contrasts)
    width = image.shape[1]
    spots = np.empty((width, 5))
    sums = np.empty((width, 3))
    for v in range(image.shape[0]):
        sums[:] = 0.0
        for line in range(first_lines[v], first_lines[v + 1]):
            _locate_line(samples, line, car, rows, cells_per_metre, keys, nearest, spots)
            _add_line(
                samples, line, spots, car, lanes, palette, grain_texture, patch_texture, sky, sums
            )
        # A pixel is the mean of its samples, rounded.
        share = 1.0 / (first_lines[v + 1] - first_lines[v])
        for u in range(width):
            for k in range(3):
                image[v, u, k] = int(min(max(sums[u, k] * share + 0.5, 0.0), 255.0))


class CameraRenderer:
    """Draws what a camera on a car sees along one road.

    Args:
        road: the road; it is drawn straight before its start (20 m) and after its end (80 m).
        camera: the camera.
        scene: appearance of the world; None for the usual one.
    """

    def __init__(self, road: Road, camera: Camera, scene: Scene | None = None) -> None:
        self.camera = camera
        scene = scene or Scene()
        self._wear = scene.wear
        colours, contrasts, grain, patches, sky = scenery_of(scene.seed)
        self._scenery = (colours, contrasts, grain, patches, sky)
        rows, cells_per_metre, keys, nearest = make_drawn_road(road)
        self._road = (rows, cells_per_metre, keys, nearest)
        self._lane_width = road.lane_width

    def draw(self, x: float, y: float, heading: float) -> Image:
        """Return the picture with the car at this pose, (height, width, 3).

        Args:
            x, y: m, the car's centre of mass on the map.
            heading: rad, the car's heading, counter-clockwise from +x.
        """
        projection = projection_of(self.camera)
        image = np.empty(self.camera.shape, dtype=np.uint8)
        # The road and the scenery are plain tuples: Numba takes a third of a millisecond more for
        # named ones.
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
