"""Validity of roads by the competition's rules, against a slow reference."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytest
import reference_validity as reference
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.errors import RoadError
from frenetic.road.overlap import is_overlapping
from frenetic.road.validity import (
    Verdict,
    _to_millimetre,
    check_validity,
    interpolate,
    min_radius,
    overlaps_itself,
)

if TYPE_CHECKING:
    from agreements import Agreements

FloatArray = npt.NDArray[np.float64]

LIMIT_RADIUS = 47 / 3.280839895  # [m]


# --- families of roads ----------------------------------------------------------------------------


def drawn(curvatures: npt.ArrayLike, step: float, spacing: float) -> FloatArray:
    """Return points every `spacing` m of a road of these curvatures, centred in the map."""
    kappa = np.asarray(curvatures, dtype=np.float64)
    ds = 0.1
    s = np.arange(0.0, (len(kappa) - 1) * step + ds / 2, ds)
    fine = np.interp(s, np.arange(len(kappa)) * step, kappa)
    heading = np.pi / 2 + np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) * ds / 2)])
    middle = (heading[1:] + heading[:-1]) / 2
    moves = ds * np.column_stack([np.cos(middle), np.sin(middle)])
    line = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    line = line[:: round(spacing / ds)]
    return centred(line)


def centred(line: FloatArray, map_size: float = 200.0) -> FloatArray:
    return np.asarray(line - (line.min(axis=0) + line.max(axis=0)) / 2 + map_size / 2)


def turned(line: FloatArray, angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(line @ np.array([[c, s], [-s, c]]))


def random_curvatures(rng: np.random.Generator, n: int, bound: float, jump: float) -> list[float]:
    values, last = [], 0.0
    for _ in range(n):
        last = rng.uniform(max(-bound, last - jump), min(bound, last + jump))
        values.append(last)
    return values


def searched(rng: np.random.Generator) -> FloatArray:
    """Return a road as of a random search: often valid, sometimes outside or crossing itself."""
    n = int(rng.integers(5, 26))
    return drawn(random_curvatures(rng, n, 0.07, 0.05), 10.0, float(rng.choice([1.0, 2.0, 2.0])))


def coarse(rng: np.random.Generator) -> FloatArray:
    """Return a random road with points 10 m apart, so that the spline differs from the road."""
    return drawn(random_curvatures(rng, int(rng.integers(3, 22)), 0.06, 0.05), 10.0, 10.0)


def gentle(rng: np.random.Generator) -> FloatArray:
    return drawn(random_curvatures(rng, int(rng.integers(8, 20)), 0.03, 0.02), 10.0, 2.0)


def sharp(rng: np.random.Generator) -> FloatArray:
    """Return an arc between two straights, with a radius close to the limit."""
    radius = LIMIT_RADIUS + rng.choice([3.0, 0.3, 0.03]) * rng.uniform(-1, 1)
    arc = int(rng.integers(3, 8))
    kappa = [0.0, 0.0, *[rng.choice([-1, 1]) / radius] * arc, 0.0, 0.0]
    return centred(turned(drawn(kappa, 5.0, float(rng.choice([1.0, 2.0]))), rng.uniform(0, 7)))


def at_the_border(rng: np.random.Generator) -> FloatArray:
    """Return a road whose edge comes within 1 mm of the map's border."""
    line = drawn(random_curvatures(rng, int(rng.integers(4, 12)), 0.03, 0.03), 10.0, 2.0)
    if rng.random() < 0.2:
        line = np.array([[0.0, 0.0], [0.0, rng.uniform(25, 80)]]) + 100  # edges exactly parallel
    nodes = reference.interpolated(line)
    left, right = reference.edges(nodes)
    extent = np.array(left + right)
    axis = int(rng.integers(2))
    miss = rng.choice([0.0, *rng.uniform(-0.001, 0.001, 4)])
    if rng.random() < 0.5:
        line[:, axis] += miss - extent[:, axis].min()
    else:
        line[:, axis] += 200.0 + miss - extent[:, axis].max()
    return line


def few_points(rng: np.random.Generator) -> FloatArray:
    return rng.uniform(20, 180, (int(rng.integers(0, 8)), 2))


def short(rng: np.random.Generator) -> FloatArray:
    """Return a road of about 20 m, on a grid of millimetres or off it."""
    length = 20.0 + rng.choice([0.0, 0.001, 0.01, 1.0, 15.0]) * rng.uniform(-1, 1)
    n = int(rng.integers(2, 9))
    line = np.zeros((n, 2))
    line[:, 0] = np.linspace(0, length, n)
    if rng.random() < 0.5:
        line[:, 1] = rng.uniform(0, 2) * np.sin(line[:, 0] / length * 3)
        return centred(turned(line, rng.uniform(0, 7)))
    return np.round(line, 3) + np.round(rng.uniform(10, 150, 2), 1)


def repeated(rng: np.random.Generator) -> FloatArray:
    """Return a road with a point twice: at once (refused), later (a crossing), or nearly twice."""
    line = gentle(rng)[:: int(rng.integers(1, 6))]
    i = int(rng.integers(len(line)))
    j = int(rng.integers(len(line)))
    kind = rng.integers(4)
    if kind == 0:
        return np.insert(line, j, line[i], axis=0)
    noise = [0.0, 1e-9, 1e-4][kind - 1]
    return np.insert(line, i, line[i] + noise * rng.uniform(0.5, 1, 2), axis=0)


def hairpin(rng: np.random.Generator) -> FloatArray:
    """Return a hairpin whose legs are about 8 m apart."""
    gap = 8.0 + rng.choice([0.0, 0.002, 0.05, 1.0]) * rng.uniform(-1, 1)
    radius = rng.uniform(14.5, 18)
    # A loop wider than the gap, as in the letter omega.
    flare = math.acos((radius + gap / 2) / (2 * radius))
    # Circle of the loop at the origin, flares to the sides with the same radius.
    x_flare = gap / 2 + radius
    y_flare = -math.sqrt(4 * radius**2 - x_flare**2)
    t = np.linspace(0, flare, 14)
    side = np.column_stack([x_flare - radius * np.cos(t), y_flare + radius * np.sin(t)])
    start = math.atan2(side[-1, 1], side[-1, 0])
    loop = np.linspace(start, math.pi - start, 34)[1:-1]
    top = radius * np.column_stack([np.cos(loop), np.sin(loop)])
    leg = np.column_stack([np.full(12, gap / 2), np.linspace(y_flare - 30, y_flare - 2.5, 12)])
    mirror = np.array([-1.0, 1.0])
    line = np.concatenate([leg, side, top, side[::-1] * mirror, leg[::-1] * mirror])
    return centred(turned(line, rng.choice([0.0, rng.uniform(0, 7)])))


def grazing(rng: np.random.Generator) -> FloatArray:
    """Return a spiral whose turns are about 8 m apart, so that edges nearly touch."""
    gap = 8.0 + rng.choice([0.003, 0.05, 0.5]) * rng.uniform(-1, 1)
    angle = [0.0]
    end = rng.uniform(6.5, 9)
    while angle[-1] < end:
        angle.append(angle[-1] + 2.0 / (15 + gap * angle[-1] / (2 * math.pi)))
    t = np.array(angle)
    r = rng.uniform(15, 17) + gap * t / (2 * math.pi)
    line = np.column_stack([r * np.cos(t), r * np.sin(t)])
    return centred(turned(line, rng.uniform(0, 7)))[:: int(rng.choice([-1, 1]))]


def folded(rng: np.random.Generator) -> FloatArray:
    """Return a bend about as tight as half the width, where the inner edge may run backwards."""
    radius = 4.0 + rng.choice([0.05, 0.5, 3.0]) * rng.uniform(-1, 1)
    t = np.linspace(0, rng.uniform(0.3, 3.0), int(rng.integers(6, 20)))
    arc = radius * np.column_stack([np.cos(t), np.sin(t)])
    tangent = np.array([-math.sin(t[-1]), math.cos(t[-1])])
    out = arc[-1] + np.outer(np.arange(1.0, 20.0, 2.0), tangent)
    into = arc[0] - np.outer(np.arange(19.0, 0.0, -2.0), [0.0, 1.0])
    return centred(turned(np.concatenate([into, arc, out]), rng.uniform(0, 7)))


def jagged(rng: np.random.Generator) -> FloatArray:
    """Return a gentle road with noise on its points."""
    line = gentle(rng)[:: int(rng.integers(1, 5))]
    return np.asarray(line + rng.normal(0, rng.choice([0.01, 0.1, 1.0]), line.shape))


def loops(rng: np.random.Generator) -> FloatArray:
    """Return a loop through a few uneven points: nodes are metres apart, and the ends may cross."""
    t = np.sort(rng.uniform(0, 2 * np.pi * rng.uniform(0.8, 1.4), int(rng.integers(4, 9))))
    radius = rng.uniform(15, 60) * rng.uniform(0.5, 1.2, (len(t), 1))
    return np.asarray(100 + radius * np.column_stack([np.cos(t), np.sin(t)]))


def on_a_grid(rng: np.random.Generator) -> FloatArray:
    """Return points with integer coordinates, with many exact touches and collinear points."""
    steps = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [1, -1]])
    n = int(rng.integers(2, 9))
    size = int(rng.choice([4, 8, 12, 20]))
    chosen = steps[rng.integers(0, len(steps), n)]
    return np.cumsum(chosen, axis=0) * float(size) + 100.0


Family = Callable[[np.random.Generator], FloatArray]

# Number of roads of each family, and the least number of each message: it shows that a family still
# makes the roads of its name.
FAMILIES: list[tuple[Family, int, dict[str, int]]] = [
    (searched, 2500, {"": 2000, reference.SELF_INTERSECTING: 100, reference.TOO_SHARP: 1}),
    (coarse, 1000, {"": 900, reference.TOO_SHORT: 10}),
    (gentle, 800, {"": 750}),
    (sharp, 900, {"": 200, reference.TOO_SHARP: 500}),
    (at_the_border, 800, {"": 300, reference.OUTSIDE: 300}),
    (few_points, 500, {"": 60, reference.TOO_FEW: 90, reference.OUTSIDE: 20}),
    (short, 600, {"": 250, reference.TOO_SHORT: 200}),
    (repeated, 500, {reference.REPEATED: 100, reference.SELF_INTERSECTING: 250}),
    (hairpin, 500, {"": 60, reference.SELF_INTERSECTING: 300}),
    (grazing, 400, {"": 80, reference.SELF_INTERSECTING: 200}),
    (folded, 400, {reference.TOO_SHARP: 120, reference.SELF_INTERSECTING: 150}),
    (jagged, 400, {"": 150, reference.TOO_SHARP: 30, reference.SELF_INTERSECTING: 60}),
    (loops, 800, {"": 20, reference.SELF_INTERSECTING: 300}),
    (on_a_grid, 400, {"": 10, reference.TOO_SHORT: 50, reference.SELF_INTERSECTING: 200}),
]


# --- agreement with the reference --------------------------------------------------------------


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("family", "count", "least_counts"), FAMILIES, ids=[f[0].__name__ for f in FAMILIES]
)
def test_verdicts_agree_with_the_reference(
    agreements: Agreements, family: Family, count: int, least_counts: dict[str, int]
) -> None:
    rng = np.random.default_rng(20210517)
    judged = []
    for _ in range(count):
        points = family(rng)
        verdict = check_validity(points)
        assert verdict.valid == (verdict.message == "")
        judged.append((points, verdict.message))
    parts = [part for points, message in judged for part in (points.tobytes(), message)]
    judge = Path(reference.__file__).read_bytes()
    with agreements.upon(family.__name__, judge, *parts) as is_agreed:
        if not is_agreed:
            for points, message in judged:
                assert message == reference.verdict_message(points), points.tolist()
    counts = Counter(message for _, message in judged)
    assert not {m: (counts[m], n) for m, n in least_counts.items() if counts[m] < n}


@pytest.mark.parametrize("noise", [1, 2, 3])
def test_chains_of_quads_on_a_grid_agree_with_shapely(noise: int) -> None:
    # Random quads on a coarse grid touch and overlap exactly, in every way.
    rng = np.random.default_rng(noise)
    counts: Counter[bool] = Counter()
    while sum(counts.values()) < 1500:
        n = int(rng.integers(3, 7))
        along = np.cumsum(rng.integers(1, 4, n))
        left = np.column_stack([along, np.full(n, 2)]) + rng.integers(-noise, noise + 1, (n, 2))
        right = np.column_stack([along, np.full(n, -2)]) + rng.integers(-noise, noise + 1, (n, 2))
        pairs = [(left[1:], left[:-1]), (right[1:], right[:-1]), (left, right)]
        if any((a == b).all(axis=1).any() for a, b in pairs):
            continue  # a triangle: shapely and our code differ, and no road has a triangle
        expected = reference.overlaps_itself(
            [(x, y) for x, y in left.tolist()], [(x, y) for x, y in right.tolist()]
        )
        assert is_overlapping(left.astype(float), right.astype(float)) == expected, (left, right)
        counts[expected] += 1
    assert min(counts.values()) > 50, counts


# --- the rules, one by one ---------------------------------------------------------------------


def line(length: float, n: int = 2, start: tuple[float, float] = (50.0, 50.0)) -> FloatArray:
    return np.column_stack([start[0] + np.linspace(0, length, n), np.full(n, start[1])])


def arc(radius: float, angle: float = 1.5) -> FloatArray:
    t = np.linspace(0, angle, max(4, int(radius * angle)))
    return 100 + radius * np.column_stack([np.cos(t), np.sin(t)])


CROSSING = np.array([[60.0, 60.0], [120.0, 120.0], [120.0, 60.0], [60.0, 120.0]])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (line(100), ""),
        (line(100, 3), ""),
        (arc(20.0), ""),
        ([], reference.TOO_FEW),
        ([[-50, 50]], reference.TOO_FEW),
        (line(100, 500), ""),
        (np.full((501, 2), -1.0), reference.TOO_MANY),
        (line(100, 1_000_000), reference.TOO_MANY),
        ([[-50, 50], [-50, 50]], reference.REPEATED),
        ([[50, 50], [90, 50], [90, 50], [130, 50]], reference.REPEATED),
        (line(160, start=(50, 50)), reference.OUTSIDE),
        (line(100, start=(50, 4.0)), reference.OUTSIDE),
        (line(100, start=(50, 4.001)), ""),
        (line(100, start=(50, 196.0)), reference.OUTSIDE),
        (line(100, start=(50, 195.999)), ""),
        (line(140, start=(60, 100)), reference.OUTSIDE),
        (line(139.999, start=(60, 100)), ""),
        (line(1e300), reference.OUTSIDE),
        (CROSSING - 70, reference.OUTSIDE),
        (CROSSING, reference.SELF_INTERSECTING),
        ([[50, 50], [130, 50], [50, 50], [130, 51]], reference.SELF_INTERSECTING),
        (line(0.005), reference.SELF_INTERSECTING),  # nodes coincide once rounded
        (arc(3.0), reference.SELF_INTERSECTING),  # and too short, and too sharp
        (line(20.0), reference.TOO_SHORT),
        (line(20.001), ""),
        (arc(10.0), reference.TOO_SHORT),  # and too sharp
        (arc(14.0), reference.TOO_SHARP),
        (arc(14.7), ""),
    ],
)
def test_the_verdict_names_the_first_broken_rule(points: npt.ArrayLike, message: str) -> None:
    assert check_validity(points) == Verdict(message == "", message)


def test_a_larger_map_has_room_for_longer_roads() -> None:
    assert check_validity(line(300), map_size=400.0)
    assert check_validity(line(50, start=(20, 20)), map_size=75.0)
    assert check_validity(line(50, start=(20, 20)), map_size=70.0).message == reference.OUTSIDE
    for map_size in (0.0, math.nan, math.inf):
        with pytest.raises(RoadError, match="map_size"):
            check_validity(line(100), map_size)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, 0.0], [math.nan, 1.0]], "road point 1 is"),
        ([[1.0, 2.0, 3.0]], r"\(1, 3\)"),
        ([["1", "2"], ["3", "4"]], "numbers"),
        ("road", r"shape \(\)"),
        ([[True, False], [False, True]], "bool"),
        ([[None, 2.0], [3.0, 4.0]], "object"),
        ([[1.0, 2.0], [3.0]], "pairs"),
    ],
)
def test_points_that_are_no_numbers_are_refused(points: Any, message: str) -> None:
    for judge in (check_validity, interpolate, min_radius):
        with pytest.raises(RoadError, match=message) as caught:
            judge(points)
        assert "\n" not in str(caught.value)


def test_points_that_cannot_be_interpolated_are_refused() -> None:
    for points, message in (
        ([[1.0, 2.0]], "at least 2 points"),
        ([[1.0, 2.0], [1.0, 2.0]], "are the same"),
        ([[0.0, 0.0], [2e6, 0.0]], "at most 1000000 m"),
    ):
        with pytest.raises(RoadError, match=message):
            interpolate(points)


@pytest.mark.parametrize("convert", [lambda p: p.tolist(), np.asfortranarray, np.int64, np.float32])
def test_any_array_of_points_is_accepted_and_not_changed(
    convert: Callable[[FloatArray], Any],
) -> None:
    points = np.array([[30.0, 30.0], [70.0, 35.0], [110.0, 60.0], [130.0, 100.0]])
    points.setflags(write=False)
    assert check_validity(convert(points))
    np.testing.assert_array_equal(interpolate(convert(points)), interpolate(points))


# --- interpolation and radius ------------------------------------------------------------------


@pytest.mark.parametrize("family", [searched, coarse, few_points, jagged])
def test_interpolation_equals_scipy(family: Family) -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        points = family(rng)
        if len(points) >= 2:
            np.testing.assert_array_equal(interpolate(points), reference.interpolated(points))


def test_a_tiny_last_step_does_not_change_the_last_node() -> None:
    t = np.linspace(0, 87.5 / 30, 12)
    points = 100 + 30 * np.column_stack([np.cos(t), np.sin(t)])
    points = np.concatenate([points, points[-1:] + np.array([-1e-9, 1e-10])])
    nodes = interpolate(points)
    assert len(nodes) == 87 + 2
    np.testing.assert_allclose(nodes, reference.interpolated(points), rtol=0, atol=0.0011)


@given(st.floats(-1e6, 1e6) | st.integers(-(10**7), 10**7).map(lambda i: i / 2000))
@settings(max_examples=300)
def test_rounding_to_millimetres_agrees_with_round(value: float) -> None:
    assert _to_millimetre(value) == round(value, 3)


def test_the_radius_of_circles_and_straights_is_exact() -> None:
    for radius in (5.0, LIMIT_RADIUS, 1000.0):
        assert min_radius(arc(radius)) == pytest.approx(radius, rel=1e-9)
    for straight in (line(100, 101), arc(10.0)[:5], np.empty((0, 2))):
        assert min_radius(straight) == math.inf


# --- properties --------------------------------------------------------------------------------

inner = st.integers(10, 190)


@given(st.lists(st.tuples(inner, inner), min_size=2, max_size=9))
@settings(max_examples=100)
def test_quarter_turns_and_mirrors_keep_the_verdict(
    pairs: list[tuple[int, int]],
) -> None:
    points = np.array(pairs, dtype=np.float64)
    verdict = check_validity(points)
    assert check_validity(np.column_stack([200 - points[:, 1], points[:, 0]])) == verdict
    assert check_validity(points[:, ::-1]) == verdict


@given(st.lists(st.tuples(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308)), max_size=12))
@settings(max_examples=50)
def test_every_list_of_finite_points_gets_a_verdict(points: list[tuple[float, float]]) -> None:
    verdict = check_validity(points)
    assert verdict.valid == (verdict.message == "")


def test_overlap_is_found_from_the_edges() -> None:
    left = [(-4.0, 0.0), (-4.0, 10.0), (-4.0, 20.0)]
    right = [(4.0, 0.0), (4.0, 10.0), (4.0, 20.0)]
    assert not overlaps_itself(left, right)
    assert overlaps_itself(left, [right[0], left[1], right[2]])  # no width in the middle
    assert overlaps_itself(left, right[::-1])
    for bad, message in (([], "at least 2 each"), (right[:2], "have 3 and 2"), ([0.0], "shape")):
        with pytest.raises(RoadError, match=message):
            overlaps_itself(left if bad else [], bad)
