"""Breaches: the rules of a road class that a road does not meet, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic.road import profile
from frenetic.road.conforming import NO_CHANGE
from frenetic.road.steady_parts import indices_of, knots, steady_parts

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass
    from frenetic.road.road import Road

_SHARE_ROUNDING: Final = 1e-9
"""Share of a limit by which a rounded value may exceed the limit; our choice."""
_SLOPE_ROUNDING: Final = 1e-9
"""Slope in m/m by which a rounded slope may exceed its limit, even a limit of 0; our choice."""
_FRICTION_ROUNDING: Final = 1e-6
"""Side friction by which a computed friction may exceed its limit; our choice."""
_LENGTH_ROUNDING: Final = 1e-6
"""Length in m by which a rounded length may fall short of its limit; our choice."""
_CREST_ROUNDING: Final = 1e-6
"""Share of its limit by which the bend of a crest or a sag may exceed the limit; our choice."""


def find_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield each breach of the rules by a road, in words."""
    yield from _curvature_breaches(rules, road)
    yield from _length_breaches(rules, road)
    yield from _superelevation_breaches(rules, road)
    yield from _grade_breaches(rules, road)
    yield from _width_breaches(rules, road)


def _breach_text(rules: RoadClass, rule: str, fact: str, needed: str) -> str:
    """Return a breach in words, such as "A radius of 50 m at 20 m: rural-80 needs at least 240 m".

    Args:
        rules: the class.
        rule: name of the rule, whose source is added.
        fact: the fact about the road.
        needed: the value that the rule needs.
    """
    source = rules.sources.get(rule, "")
    return f"{fact}: {rules.name} needs {needed}" + (f" ({source})" if source else "")


def _curvature_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield bends and clothoids that are too sharp, in words."""
    values, step = road.curvatures, road.step
    for i in indices_of(np.abs(values) > rules.max_curvature * (1.0 + _SHARE_ROUNDING)):
        fact = f"A radius of {1.0 / abs(values[i]):.0f} m at {i * step:.0f} m"
        yield _breach_text(rules, "min_radius", fact, f"at least {rules.min_radius:g} m")
    changes = np.abs(np.diff(values)) / step
    for i in indices_of(changes > (1.0 + _SHARE_ROUNDING) / rules.min_clothoid**2):
        fact = f"A clothoid with A of {1.0 / math.sqrt(changes[i]):.0f} m at {i * step:.0f} m"
        yield _breach_text(rules, "min_clothoid", fact, f"at least {rules.min_clothoid:g} m")


def _length_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield arcs, and straights between bends to the same side, that are too short."""
    step = road.step
    for part in steady_parts(road.curvatures):
        length, start = (part.last - part.first) * step, part.first * step
        if abs(part.curvature) > NO_CHANGE:
            least, rule, fact = rules.min_arc, "min_arc", f"An arc of {length:.0f} m"
        elif part.before * part.after > 0.0:
            least, rule = rules.min_straight, "min_straight"
            fact = f"A straight of {length:.0f} m between bends to the same side"
        else:
            continue
        if length < least - _LENGTH_ROUNDING:
            yield _breach_text(rules, rule, f"{fact} at {start:.0f} m", f"at least {least:g} m")


def _superelevation_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield slopes across the road that are too steep, and bends that lean too little."""
    stations, curvatures = knots(road, road.superelevation)
    slopes = profile.value_at(road.superelevation, stations)
    steepest = rules.max_superelevation
    for i in indices_of(np.abs(slopes) > steepest * (1.0 + _SHARE_ROUNDING) + _SLOPE_ROUNDING):
        fact = f"A superelevation of {100.0 * abs(slopes[i]):.1f} % at {stations[i]:.0f} m"
        needed = f"at most {100.0 * steepest:g} %"
        yield _breach_text(rules, "max_superelevation", fact, needed)
    # Side friction that a car needs at the design speed: V²/(127 R) less what the slope carries,
    # whose sign is opposite to the curvature's. Most is needed at the least radius.
    demand = rules.design_speed**2 / 127.0 * curvatures + slopes
    most = rules.design_speed**2 / 127.0 * rules.max_curvature - rules.max_superelevation
    for i in indices_of(np.abs(demand) > max(most, 0.0) + _FRICTION_ROUNDING):
        radius = 1.0 / max(abs(float(curvatures[i])), 1e-9)
        fact = (
            f"A side friction of {abs(demand[i]):.2f} at {stations[i]:.0f} m, in a radius of"
            f" {radius:.0f} m with {100.0 * abs(slopes[i]):.1f} % of superelevation"
        )
        yield _breach_text(rules, "min_radius", fact, f"at most {max(most, 0.0):.2f}")


def _grade_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield slopes along the road that are too steep, and crests and sags too sharp."""
    pairs = profile.cut(road.grade, 0.0, road.length)
    for i in indices_of(
        np.abs(pairs[:, 1]) > rules.max_grade * (1.0 + _SHARE_ROUNDING) + _SLOPE_ROUNDING
    ):
        fact = f"A grade of {100.0 * pairs[i, 1]:.1f} % at {pairs[i, 0]:.0f} m"
        yield _breach_text(rules, "max_grade", fact, f"at most {100.0 * rules.max_grade:g} %")
    for (start, before), (end, after) in pairwise(pairs):
        bend = (after - before) / (end - start)
        word, rule = ("crest", "min_crest") if bend < 0.0 else ("sag", "min_sag")
        least = getattr(rules, rule)
        if abs(bend) * least > 1.0 + _CREST_ROUNDING:
            fact = f"A {word} of {1.0 / abs(bend):.0f} m radius at {start:.0f} m"
            yield _breach_text(rules, rule, fact, f"at least {least:g} m")


def _width_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
    """Yield lanes that are too narrow, on straights or in bends."""
    if road.lane_width < rules.lane_width * (1.0 - _SHARE_ROUNDING):
        fact = f"The lanes are {road.lane_width:g} m wide"
        yield _breach_text(rules, "lane_width", fact, f"at least {rules.lane_width:g} m")
    stations, curvatures = knots(road, road.widening)
    widths = road.lane_width + profile.value_at(road.widening, stations)
    needed = rules.lane_width + rules.widening * np.abs(curvatures)
    for i in indices_of(widths < needed * (1.0 - _SHARE_ROUNDING)):
        fact = f"A lane of {widths[i]:.2f} m in a radius of {1.0 / abs(curvatures[i]):.0f} m"
        fact += f" at {stations[i]:.0f} m"
        yield _breach_text(rules, "widening", fact, f"at least {needed[i]:.2f} m")
