"""An independent checker of road classes, written from the formulas and without Frenetic.

A road is its plain values: curvatures, step, and superelevation, grade and widening at stations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SIDE_FRICTION = {50: 0.19, 80: 0.14, 100: 0.12}
RULES: Mapping[str, Mapping[str, float]] = {
    # speed km/h, lane m, superelevation, arc m, grade, crest m, sag m; radius and clothoid in m
    # where a table gives them
    "urban-50": {"v": 50, "w": 3.25, "e": 0.04, "arc": 50 / 1.8, "grade": 0.08, "straight": 27},
    "rural-80": {
        "v": 80, "w": 3.5, "e": 0.07, "arc": 50, "grade": 0.065, "crest": 5000, "sag": 3000,
        "straight": 480,
    },
    "rural-100": {
        "v": 100, "w": 3.5, "e": 0.07, "arc": 60, "grade": 0.055, "crest": 6000, "sag": 3500,
        "straight": 600,
    },
    "motorway-130": {
        "v": 130, "w": 3.75, "e": 0.06, "arc": 130 / 1.8, "grade": 0.04, "crest": 13000,
        "sag": 8800, "straight": 780, "r": 900, "a": 300,
    },
}  # fmt: skip


def violations(
    name: str,
    curvatures: Array,
    step: float,
    lean: Array,
    grade: Array | None,
    wider: Array,
) -> list[str]:
    """Return the names of the rules of a class that a road does not keep."""
    rules = RULES[name]
    v, e = rules["v"], rules["e"]
    radius = rules.get("r") or v * v / (127.0 * (e + SIDE_FRICTION[int(v)]))
    sight = 0.278 * v * 2.5 + 0.039 * v * v / 3.4
    crest = rules.get("crest", 100.0 * sight * sight / 658.0)
    sag = rules.get("sag", 100.0 * v * v / 395.0)
    breached = []
    at = np.arange(len(curvatures)) * step
    dense = np.arange(0.0, at[-1], 1.0)
    kappa = np.interp(dense, at, curvatures)
    slope = np.interp(dense, *lean.T) if len(lean) else np.zeros_like(dense)
    if np.abs(kappa).max() * radius > 1.0 + 1e-9:
        breached.append("radius")
    rate = np.abs(np.diff(curvatures)) / step
    jerk = rate * (v / 3.6) ** 3
    if jerk.max() > 1.2 + 1e-9 or rate.max() * (rules.get("a", 0.0)) ** 2 > 1.0 + 1e-9:
        breached.append("clothoid")
    if np.abs(slope).max() > e + 1e-9:
        breached.append("superelevation")
    demand = np.abs(v * v * kappa / 127.0 + slope)
    friction = v * v / (127.0 * radius) - e
    if demand.max() > friction + 1e-9:
        breached.append("side friction")
    if (kappa * slope > 1e-12).any():
        breached.append("leans outwards")
    wide = np.interp(dense, *wider.T) if len(wider) else np.zeros_like(dense)
    # A vehicle of 10 m needs more width in bends; under 0.25 m in the sharpest bend is left out.
    if (needs := 10.0**2 / 2.0) / radius >= 0.25 and (wide < needs * np.abs(kappa) - 1e-9).any():
        breached.append("widening")
    # Runs of one curvature, apart from those that touch the road's ends.
    flat = np.abs(np.diff(curvatures)) < 1e-13
    runs, i = [], 0
    while i < len(curvatures):
        j = i
        while j < len(flat) and flat[j]:
            j += 1
        runs.append((i, j))
        i = j + 1
    turning = []
    for i, j in runs:
        if i == 0 or j == len(curvatures) - 1:
            continue
        before, after = curvatures[i] - curvatures[i - 1], curvatures[j + 1] - curvatures[j]
        if i == j and before * after > 0.0:
            continue  # a sample in the middle of a clothoid
        turning.append((i, j))
    for i, j in turning:
        length = (j - i) * step
        if abs(curvatures[i]) > 1e-12:
            if length < rules["arc"] - 1e-6:
                breached.append("arc")
        else:
            sides = [_next_side(curvatures[i - 1 :: -1]), _next_side(curvatures[j + 1 :])]
            if sides[0] == sides[1] and length < rules["straight"] - 1e-6:
                breached.append("straight")
    if grade is not None and len(grade):
        slopes = np.interp(dense, *grade.T)
        if np.abs(slopes).max() > rules["grade"] + 1e-9:
            breached.append("grade")
        change = np.diff(slopes)
        if (
            change.max(initial=0.0) * sag > 1.0 + 1e-6
            or -change.min(initial=0.0) * crest > 1 + 1e-6
        ):
            breached.append("vertical curve")
    return breached


def _next_side(values: Array) -> float:
    bent = values[np.abs(values) > 1e-12]
    return math.copysign(1.0, bent[0]) if len(bent) else 0.0
