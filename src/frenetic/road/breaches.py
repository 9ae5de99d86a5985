"""Breaches: the rules of a road class that a road does not meet, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import profile
from frenetic.road.conforming import NO_CHANGE

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.road.classes import RoadClass
    from frenetic.road.road import Road

_ROUNDING: Final = 1e-9
"""Share, or 1/m, by which a value may miss a limit, since values are rounded; ours."""
_LENGTH_ROUNDING: Final = 1e-6
"""Length in m, or share of a bend of the grade, by which a value may miss a limit; ours."""


def find_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield each breach of the rules by a road, in words."""
    yield from _breaches_of_curvature(rules, road)
    yield from _breaches_of_length(rules, road)
    yield from _breaches_across(rules, road)
    yield from _breaches_of_grade(rules, road)
    yield from _breaches_of_width(rules, road)


def _text(rules: RoadClass, rule: str, fact: str, needed: str) -> str:
    """Return a breach in words: the fact about the road, and what the rule needs."""
    source = rules.sources.get(rule, "")
    return f"{fact}: {rules.name} needs {needed}" + (f" ({source})" if source else "")


def _breaches_of_curvature(rules: RoadClass, road: Road) -> Iterator[str]:
    values, step = road.curvatures, road.step
    for i in _indices(np.abs(values) > rules.max_curvature * (1.0 + _ROUNDING)):
        fact = f"A radius of {1.0 / abs(values[i]):.0f} m at {i * step:.0f} m"
        yield _text(rules, "min_radius", fact, f"at least {rules.min_radius:g} m")
    changes = np.abs(np.diff(values)) / step
    for i in _indices(changes > (1.0 + _ROUNDING) / rules.min_clothoid**2):
        fact = f"A clothoid with A of {1.0 / math.sqrt(changes[i]):.0f} m at {i * step:.0f} m"
        yield _text(rules, "min_clothoid", fact, f"at least {rules.min_clothoid:g} m")


def _breaches_of_length(rules: RoadClass, road: Road) -> Iterator[str]:
    step = road.step
    for part in _steady_parts(road.curvatures):
        length, start = (part.last - part.first) * step, part.first * step
        if abs(part.curvature) > NO_CHANGE:
            least, rule, fact = rules.min_arc, "min_arc", f"An arc of {length:.0f} m"
        elif part.before * part.after > 0.0:
            least, rule = rules.min_straight, "min_straight"
            fact = f"A straight of {length:.0f} m between bends to the same side"
        else:
            continue
        if length < least - _LENGTH_ROUNDING:
            yield _text(rules, rule, f"{fact} at {start:.0f} m", f"at least {least:g} m")


def _breaches_across(rules: RoadClass, road: Road) -> Iterator[str]:
    stations, curvatures = knots(road, road.superelevation)
    slopes = profile.value_at(road.superelevation, stations)
    steepest = rules.max_superelevation
    for i in _indices(np.abs(slopes) > steepest * (1.0 + _ROUNDING) + _ROUNDING):
        fact = f"A superelevation of {100.0 * abs(slopes[i]):.1f} % at {stations[i]:.0f} m"
        needed = f"at most {100.0 * steepest:g} %"
        yield _text(rules, "max_superelevation", fact, needed)
    # Side friction that a car needs at the design speed, by V²/(127 R).
    demand = rules.design_speed**2 / 127.0 * curvatures + slopes
    most = rules.design_speed**2 / 127.0 * rules.max_curvature - rules.max_superelevation
    for i in _indices(np.abs(demand) > max(most, 0.0) + 1e-6):
        radius = 1.0 / max(abs(float(curvatures[i])), 1e-9)
        fact = (
            f"A side friction of {abs(demand[i]):.2f} at {stations[i]:.0f} m, in a radius of"
            f" {radius:.0f} m with {100.0 * abs(slopes[i]):.1f} % of superelevation"
        )
        yield _text(rules, "min_radius", fact, f"at most {max(most, 0.0):.2f}")


def _breaches_of_grade(rules: RoadClass, road: Road) -> Iterator[str]:
    pairs = profile.cut(road.grade, 0.0, road.length)
    for i in _indices(np.abs(pairs[:, 1]) > rules.max_grade * (1.0 + _ROUNDING) + _ROUNDING):
        fact = f"A grade of {100.0 * pairs[i, 1]:.1f} % at {pairs[i, 0]:.0f} m"
        yield _text(rules, "max_grade", fact, f"at most {100.0 * rules.max_grade:g} %")
    for (start, before), (end, after) in pairwise(pairs):
        bend = (after - before) / (end - start)
        word, rule = ("crest", "min_crest") if bend < 0.0 else ("sag", "min_sag")
        least = getattr(rules, rule)
        if abs(bend) * least > 1.0 + _LENGTH_ROUNDING:
            fact = f"A {word} of {1.0 / abs(bend):.0f} m radius at {start:.0f} m"
            yield _text(rules, rule, fact, f"at least {least:g} m")


def _breaches_of_width(rules: RoadClass, road: Road) -> Iterator[str]:
    if road.lane_width < rules.lane_width * (1.0 - _ROUNDING):
        fact = f"The lanes are {road.lane_width:g} m wide"
        yield _text(rules, "lane_width", fact, f"at least {rules.lane_width:g} m")
    stations, curvatures = knots(road, road.widening)
    widths = road.lane_width + profile.value_at(road.widening, stations)
    needed = rules.lane_width + rules.widening * np.abs(curvatures)
    for i in _indices(widths < needed * (1.0 - _ROUNDING)):
        fact = f"A lane of {widths[i]:.2f} m in a radius of {1.0 / abs(curvatures[i]):.0f} m"
        fact += f" at {stations[i]:.0f} m"
        yield _text(rules, "widening", fact, f"at least {needed[i]:.2f} m")


def _indices(is_breach: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices of true values."""
    return np.flatnonzero(is_breach).tolist()


def knots(road: Road, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return stations in m where the curvature or a profile bends, and the curvatures there."""
    samples = np.arange(len(road.curvatures)) * road.step
    stations = np.unique(np.concatenate([samples, pairs[:, 0]]))
    stations = stations[(stations >= 0.0) & (stations <= road.length + _ROUNDING)]
    return stations, road.curvature_at(stations)


class _SteadyPart(NamedTuple):
    """Samples of one curvature between two clothoids, or the sample at which clothoids meet."""

    first: int
    """Index of the first sample."""
    last: int
    """Index of the last sample."""
    curvature: float
    """Curvature of the part, in 1/m."""
    before: float
    """Curvature at the start of the clothoid that leads to the part, in 1/m."""
    after: float
    """Curvature at the end of the clothoid that leads away, in 1/m."""


def _steady_parts(values: FloatArray) -> list[_SteadyPart]:
    """Return a road's steady parts, without those at its ends, which may belong to longer ones."""
    changes = np.diff(values)
    signs = np.where(np.abs(changes) > NO_CHANGE, np.sign(changes), 0.0)
    borders = [0, *_indices(np.diff(signs, prepend=signs[0]) != 0.0), len(signs)]
    spans: list[tuple[int, int]] = []
    for first, last in pairwise(borders):
        if signs[first] == 0.0:
            spans.append((first, last))
        elif not spans or spans[-1][1] != first:
            spans.append((first, first))
    if spans[-1][1] != len(signs):
        spans.append((len(signs), len(signs)))
    curvatures = [float(values[first]) for first, _ in spans]
    return [
        _SteadyPart(*spans[k], curvatures[k], curvatures[k - 1], curvatures[k + 1])
        for k in range(1, len(spans) - 1)
    ]
