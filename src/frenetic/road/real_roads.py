"""Real roads: stretches from which a search can start, and the road class that they show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError
from frenetic.road import profile
from frenetic.road.classes import SPEEDS, RoadClass, friction_at
from frenetic.road.files import find_roads
from frenetic.road.road import Road
from frenetic.road.steady_parts import knots

_STEPS: Final = (2.0, 25.0)
"""Shortest and longest step of roads whose stretches have the same step, in m; ours."""
_USUAL_STEP: Final = 10.0  # [m] step of other stretches; the step of a search
_SHORTEST: Final = 50.0
"""Length of the shortest stretch, in m; ours."""
_LONGEST: Final = 3000.0
"""Length of the longest stretch, in m; ours."""
_SHOWN: Final = "shown by the given roads"
"""Source of the rules of a class that real roads show."""


def shown_class(folder: Path | str) -> RoadClass:
    """Return the class that the roads in a folder show, see `class_of`, with the folder's name.

    Raises:
        FreneticError: no road is long enough, with bends as wide as two lanes.
    """
    roads = find_roads([folder]).roads
    stretches = stretches_of(roads, step_of(roads))
    if not stretches:
        raise FreneticError(f"no road in {folder} is 50 m long, with bends as wide as two lanes")
    return class_of(stretches, Path(folder).resolve().name)


def step_of(roads: Mapping[str, Road]) -> float:
    """Return the step for stretches of these roads, in m: their common step, or else 10."""
    steps = {road.step for road in roads.values()}
    step = steps.pop()
    return step if not steps and _STEPS[0] <= step <= _STEPS[1] else _USUAL_STEP


def stretches_of(roads: Mapping[str, Road], step: float) -> dict[str, Road]:
    """Return the stretches of roads by name, with one curvature every ``step`` m.

    A curvature is the mean over the step around it, so bends turn as far as before. A road of more
    than 3 km is cut into equal parts. Roads of less than 50 m are left out, and roads with bends
    that no class allows, of a radius of less than twice the lane.

    Args:
        roads: the roads by name.
        step: distance between two curvatures, in m.
    """
    stretches: dict[str, Road] = {}
    for name, road in roads.items():
        whole = resampled(road, step)
        if whole is None or np.abs(whole.curvatures).max() * 2.0 * road.lane_width > 1.0:
            continue
        last = len(whole.curvatures) - 1
        count = math.ceil(whole.length / _LONGEST - 1e-9)
        ends = [round(k * last / count) for k in range(count + 1)]
        if count == 1:
            stretches[name] = whole
            continue
        for k in range(count):
            stretches[f"{name}, part {k + 1}"] = whole.piece(ends[k], ends[k + 1])
    return stretches


def resampled(road: Road, step: float) -> Road | None:
    """Return a road with one curvature every ``step`` m; None if it is less than 50 m long.

    The returned road is up to a step shorter, since its length is a whole number of steps.
    """
    if road.length < _SHORTEST:
        return None
    if road.step == step:
        return road
    places = np.arange(int(road.length / step + 1e-9) + 1) * step
    edges = np.concatenate([places - 0.5 * step, [places[-1] + 0.5 * step]])
    edges = np.clip(edges, 0.0, road.length)
    along = np.arange(len(road.table)) * road.sub_step
    headings = np.interp(edges, along, road.table[:, 2])
    curvatures = np.diff(headings) / np.diff(edges)
    return replace(road, curvatures=curvatures, step=step)


def fitting(road: Road, road_class: RoadClass) -> Road:
    """Return a stretch that meets the rules of a class, as near to another one as possible.

    A stretch that meets the rules stays as it is.
    """
    if not road_class.breach(replace(road, lane_width=road_class.lane_width)):
        return road
    curvatures = road_class.conformed(road.curvatures, road.step)
    places = np.arange(len(curvatures)) * road.step
    grades = road_class.conformed_grades(profile.value_at(road.grade, places), road.step)
    return replace(
        road,
        curvatures=curvatures,
        grade=profile.thinned(np.column_stack([places, grades])),
        **road_class.profiles(curvatures, road.step),
    )


def class_of(stretches: Mapping[str, Road], name: str) -> RoadClass:
    """Return the class that stretches show: its limits are the extremes of the stretches.

    The design speed is the largest, in steps of 10 km/h, for which AASHTO's least radius is not
    above the stretches' least radius. Arcs and straights may have any length.

    Args:
        stretches: stretches by name, of the same step, from `stretches_of`.
        name: name of the class.
    """
    roads = list(stretches.values())
    bends = [_bends(road) for road in roads]
    curvature, lean = (max(float(np.abs(pair[k]).max()) for pair in bends) for k in (0, 1))
    lean = _above(lean)
    speed = float(
        max(
            (v for v in SPEEDS if v**2 / 127.0 * curvature <= lean + friction_at(v)),
            default=SPEEDS[0],
        )
    )
    # Bends that lean less than in proportion to their curvature ask for more side friction.
    square = speed**2 / 127.0
    friction = max(float(np.abs(square * k + e).max()) for k, e in bends)
    grades = [profile.cut(road.grade, 0.0, road.length) for road in roads]
    turns = np.concatenate([[0.0], *(np.diff(g[:, 1]) / np.diff(g[:, 0]) for g in grades)])
    change = max(float(np.abs(np.diff(road.curvatures)).max()) / road.step for road in roads)
    rules = {
        "min_radius": max(curvature, (friction + lean) / square),
        "min_clothoid": change**0.5,
        "min_crest": float((-turns).max()),
        "min_sag": float(turns.max()),
    }
    limits = {rule: _below(1.0 / value) for rule, value in rules.items() if value > 0.0}
    lengths = sorted(road.length for road in roads)
    steepest = max(float(np.abs(g[:, 1]).max(initial=0.0)) for g in grades)
    return RoadClass.from_entries(
        {
            "name": name,
            "about": "As real roads are.",
            "design_speed": speed,
            "lane_width": min(road.lane_width for road in roads),
            "length": lengths[len(lengths) // 2],
            "map_size": 100.0 * math.ceil(lengths[-1] / 100.0 + 1.0),
            "step": roads[0].step,
            "max_superelevation": lean,
            "max_grade": _above(steepest),
            "widening": 0.0,
            "min_arc": 0.0,
            "min_straight": 0.0,
            "sources": dict.fromkeys([*limits, "max_superelevation", "max_grade"], _SHOWN),
            **limits,
        }
    )


def _bends(road: Road) -> tuple[FloatArray, FloatArray]:
    """Return curvatures in 1/m and superelevations wherever one of them bends."""
    stations, curvatures = knots(road, road.superelevation)
    return curvatures, profile.value_at(road.superelevation, stations)


def _above(value: float) -> float:
    """Return a slope rounded up to 0.01 %, so that the road that shows it meets it."""
    return math.ceil(1e4 * value - 1e-6) / 1e4


def _below(value: float) -> float:
    """Return a limit in m rounded down to 0.1 m, so that the road that shows it meets it."""
    return math.floor(10.0 * value + 1e-6) / 10.0
