"""Real roads: stretches from which a search can start, and the road class of given stretches.

The road class of stretches has the limits that the stretches just meet: the sharpest bend gives the
least radius, the steepest slope the largest grade, and so on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError
from frenetic.road import geometry, profile
from frenetic.road.class_formulas import SPEEDS, friction_at
from frenetic.road.classes import RoadClass
from frenetic.road.folders import find_roads
from frenetic.road.road import Road
from frenetic.road.steady_parts import knots

_MIN_COMMON_STEP, _MAX_COMMON_STEP = 2.0, 25.0
"""Shortest and longest step that stretches take over from their roads, in m; our choice."""
_DEFAULT_STEP: Final = 10.0  # [m] step of other stretches: the step of a search
_MIN_LENGTH: Final = 50.0
"""Length of the shortest stretch, in m; our choice."""
_MAX_LENGTH: Final = 3000.0
"""Length of the longest stretch, in m; our choice."""
_STEPS_ROUNDING: Final = 1e-9
"""Number of steps or parts by which a computed number may exceed a whole number; our choice."""
_SOURCE: Final = "shown by the given roads"
"""Source of the rules of a class that follow from real roads."""


def shown_class(folder: Path | str) -> RoadClass:
    """Return the class of the roads in a folder, see `class_of_stretches`, with the folder's name.

    Raises:
        FreneticError: no road is at least 50 m long with radii of at least twice the lane's width.
    """
    roads = find_roads([folder]).roads
    stretches = stretches_of(roads, step_of(roads))
    if not stretches:
        raise FreneticError(
            f"no road in {folder} is {_MIN_LENGTH:g} m long, with bends as wide as two lanes"
        )
    return class_of_stretches(stretches, Path(folder).resolve().name)


def step_of(roads: Mapping[str, Road]) -> float:
    """Return the step for stretches of these roads, in m: the roads' common step, or else 10."""
    first_step, *other_steps = {road.step for road in roads.values()}
    if not other_steps and _MIN_COMMON_STEP <= first_step <= _MAX_COMMON_STEP:
        return first_step
    return _DEFAULT_STEP


def stretches_of(roads: Mapping[str, Road], step: float) -> dict[str, Road]:
    """Return the stretches of roads by name, with one curvature every ``step`` m.

    Each curvature is the mean over one step of road around it, so bends turn as far as before.
    Roads of more than 3 km are cut into equal parts. Roads of less than 50 m are left out, and
    roads with a radius below twice the lane's width.

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
        parts = math.ceil(whole.length / _MAX_LENGTH - _STEPS_ROUNDING)
        if parts == 1:
            stretches[name] = whole
            continue
        ends = [round(k * last / parts) for k in range(parts + 1)]
        for number, (start, end) in enumerate(pairwise(ends), 1):
            stretches[f"{name}, part {number}"] = whole.piece(start, end)
    return stretches


def resampled(road: Road, step: float) -> Road | None:
    """Return a road with one curvature every ``step`` m; None if it is less than 50 m long.

    The returned road is up to a step shorter, since its length is a whole number of steps.
    """
    if road.length < _MIN_LENGTH:
        return None
    if road.step == step:
        return road
    stations = np.arange(int(road.length / step + _STEPS_ROUNDING) + 1) * step
    # The mean curvature between two edges is the change of heading over the distance.
    edges = np.concatenate([stations - 0.5 * step, [stations[-1] + 0.5 * step]])
    edges = np.clip(edges, 0.0, road.length)
    table_stations = np.arange(len(road.table)) * road.sub_step
    headings = np.interp(edges, table_stations, road.table[:, geometry.HEADING])
    curvatures = np.diff(headings) / np.diff(edges)
    return replace(road, curvatures=curvatures, step=step)


def fitting(road: Road, road_class: RoadClass) -> Road:
    """Return a road that meets the rules of a class and follows the passed road.

    A road that meets the rules comes back unchanged; its lane width does not count, as a search
    gives its roads the lane width of the class.
    """
    if not road_class.breach(replace(road, lane_width=road_class.lane_width)):
        return road
    curvatures = road_class.conformed(road.curvatures, road.step)
    stations = np.arange(len(curvatures)) * road.step
    grades = road_class.conformed_grades(profile.value_at(road.grade, stations), road.step)
    return replace(
        road,
        curvatures=curvatures,
        grade=profile.thinned(np.column_stack([stations, grades])),
        **road_class.profiles(curvatures, road.step),
    )


def class_of_stretches(stretches: Mapping[str, Road], name: str) -> RoadClass:
    """Return the class whose limits are the extremes of these stretches.

    The design speed is the largest of AASHTO's, which are 10 km/h apart, for which AASHTO's least
    radius is not above the stretches' least radius. Arcs and straights may have any length.

    Args:
        stretches: stretches by name, of the same step, from `stretches_of`.
        name: name of the class.
    """
    roads = list(stretches.values())
    grades = [profile.cut(road.grade, 0.0, road.length) for road in roads]
    steepest = max(float(np.abs(grade[:, 1]).max(initial=0.0)) for grade in grades)
    speed, superelevation, sharpest = _bend_limits(roads)
    grade_changes = np.concatenate(
        [[0.0], *(np.diff(grade[:, 1]) / np.diff(grade[:, 0]) for grade in grades)]
    )
    curvature_change = max(
        float(np.abs(np.diff(road.curvatures)).max()) / road.step for road in roads
    )
    # Name of a rule -> 1 / its limit; 0 where the stretches set no limit.
    reciprocals = {
        "min_radius": sharpest,
        "min_clothoid": curvature_change**0.5,
        "min_crest": float((-grade_changes).max()),
        "min_sag": float(grade_changes.max()),
    }
    limits = {
        rule: _rounded_down(1.0 / value) for rule, value in reciprocals.items() if value > 0.0
    }
    lengths = sorted(road.length for road in roads)
    return RoadClass.from_entries(
        {
            "name": name,
            "about": "As real roads are.",
            "design_speed": speed,
            "lane_width": min(road.lane_width for road in roads),
            "length": lengths[len(lengths) // 2],
            "map_size": 100.0 * math.ceil(lengths[-1] / 100.0 + 1.0),
            "step": roads[0].step,
            "max_superelevation": superelevation,
            "max_grade": _rounded_up(steepest),
            "widening": 0.0,
            "min_arc": 0.0,
            "min_straight": 0.0,
            "sources": dict.fromkeys([*limits, "max_superelevation", "max_grade"], _SOURCE),
            **limits,
        }
    )


def _bend_limits(roads: Sequence[Road]) -> tuple[float, float, float]:
    """Return the design speed, largest superelevation and largest curvature of roads.

    In km/h, m/m and 1/m. The curvature allows for bends that lean less than in proportion to their
    curvature, and so need more side friction.
    """
    bends = [_curvatures_and_slopes(road) for road in roads]
    curvature = max(float(np.abs(curvatures).max()) for curvatures, _ in bends)
    superelevation = _rounded_up(max(float(np.abs(slopes).max()) for _, slopes in bends))
    speeds = [
        speed
        for speed in SPEEDS
        if speed**2 / 127.0 * curvature <= superelevation + friction_at(speed)
    ]
    speed = float(max(speeds, default=SPEEDS[0]))
    # Side friction by V² / (127 R), as for the least radius in `class_formulas`.
    square = speed**2 / 127.0
    friction = max(
        float(np.abs(square * curvatures + slopes).max()) for curvatures, slopes in bends
    )
    return speed, superelevation, max(curvature, (friction + superelevation) / square)


def _curvatures_and_slopes(road: Road) -> tuple[FloatArray, FloatArray]:
    """Return curvatures in 1/m and slopes across the road where either of them bends."""
    stations, curvatures = knots(road, road.superelevation)
    return curvatures, profile.value_at(road.superelevation, stations)


def _rounded_up(slope: float) -> float:
    """Return a slope rounded up to 0.01 %, so that the road with this slope is allowed."""
    return math.ceil(1e4 * slope - 1e-6) / 1e4


def _rounded_down(length: float) -> float:
    """Return a limit in m rounded down to 0.1 m, so that the road with this value is allowed."""
    return math.floor(10.0 * length + 1e-6) / 10.0
