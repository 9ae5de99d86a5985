"""Formulas of road classes: rules that follow from the design speed V in km/h.

================== ==================================================================
``min_radius``     V² / (127 (e + f)), e the largest superelevation, f the side
                   friction factor for V (AASHTO Green Book, minimum radius)
``min_clothoid``   the largest of three, with R the least radius: sqrt(v³ / C), v in
                   m/s, C = 1.2 m/s³ (AASHTO, spirals: lateral jerk);
                   sqrt(R w e / g), w the lane's width, g the relative gradient of
                   its edge for V (AASHTO, superelevation runoff); R / 3 (RAL, RAA)
``min_arc``        the distance driven in 2 s: V / 1.8 (RAL, RAA)
``min_straight``   between bends to the same side: 6 V (RAS-L 1995); below 60 km/h
                   the distance driven in 2 s
``min_crest``      100 S² / 658, S = 0.278 V 2.5 s + 0.039 V² / 3.4 m/s² the stopping
                   sight distance (AASHTO, crest vertical curves)
``min_sag``        100 V² / 395 (AASHTO, sag vertical curves: comfort)
``widening``       D² / 2 for each lane, with D = 10 m from a long vehicle's rear axle to
                   its front (RAS-L 1995); 0 if no lane would be widened by 0.25 m
================== ==================================================================

Sources: the AASHTO Green Book is the American guideline; RAS-L, RAL and RAA are German guidelines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

SPEEDS: Final = (20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130)
"""Design speeds of AASHTO's tables, in km/h."""
_FRICTION: Final = (0.35, 0.28, 0.23, 0.19, 0.17, 0.15, 0.14, 0.13, 0.12, 0.11, 0.09, 0.08)
"""Side friction factors for these design speeds (AASHTO)."""
_GRADIENT: Final = (0.80, 0.75, 0.70, 0.65, 0.60, 0.55, 0.50, 0.47, 0.44, 0.41, 0.38, 0.35)
"""Largest slopes of a lane's edge against its centre line for these speeds, in % (AASHTO)."""
_JERK: Final = 1.2  # [m/s³] lateral jerk in a clothoid (AASHTO, spirals)
_LONG_VEHICLE_WIDENING: Final = 50.0
"""Widening times radius for a long vehicle, in m²: half the square of the 10 m from its rear axle
to its front (RAS-L 1995)."""
_LEAST_WIDENING: Final = 0.25  # [m] a smaller widening is left out (RAS-L 1995)
_METRES_ROUNDING: Final = 1e-6
"""Length by which a computed rule may exceed whole metres, in m; our choice."""


def completed(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a class with these values; missing values follow from the design speed.

    The returned ``sources`` name the formulas of computed rules.

    Args:
        entries: values by name, with a ``design_speed`` in km/h.
    """
    speed = float(entries["design_speed"])
    values: dict[str, Any] = {
        # Defaults, our choice: the step is a fifth of the speed in km/h, and at least 5 m.
        "speed_limit": speed,
        "lane_width": 3.5,
        "length": 2000.0,
        "max_superelevation": 0.06,
        "max_grade": 0.06,
        "widening": 0.0,
        "step": float(max(round(speed / 5.0), 5)),
        **entries,
    }
    rules = _computed_rules(speed, values)
    is_widened = _LONG_VEHICLE_WIDENING / rules["min_radius"] >= _LEAST_WIDENING
    if "widening" not in entries and is_widened:
        values["widening"] = _LONG_VEHICLE_WIDENING
    for name, value in rules.items():
        # Rounded up to whole metres, so that the rule holds.
        values.setdefault(name, float(math.ceil(value - _METRES_ROUNDING)))
    values.setdefault("map_size", 100.0 * math.ceil(float(values["length"]) / 100.0 + 1.0))
    formulas = dict.fromkeys(rules, f"AASHTO Green Book, for {speed:g} km/h") | {
        "min_arc": "RAL, RAA: the way of 2 s",
        "min_straight": "RAS-L 1995: 6 V" if speed >= 60.0 else "the way of 2 s",
        "widening": "RAS-L 1995: D² / 2, D = 10 m; none below 0.25 m",
    }
    sources = {name: text for name, text in formulas.items() if name not in entries}
    return values | {"sources": sources | entries.get("sources", {})}


def _computed_rules(speed: float, values: Mapping[str, Any]) -> dict[str, float]:
    """Return the rules that have a formula in the module's table, in m, before rounding.

    Args:
        speed: design speed, in km/h.
        values: values of the class: lane width, largest superelevation, and maybe a least radius,
            which then stays.
    """
    slope, lane_width = float(values["max_superelevation"]), float(values["lane_width"])
    gradient = float(np.interp(speed, SPEEDS, _GRADIENT))
    radius = float(values.get("min_radius", speed**2 / (127.0 * (slope + friction_at(speed)))))
    clothoid_square = max(
        (speed / 3.6) ** 3 / _JERK,
        100.0 * radius * lane_width * slope / gradient,
        (radius / 3.0) ** 2,
    )
    sight_distance = 0.278 * speed * 2.5 + 0.039 * speed**2 / 3.4
    return {
        "min_radius": radius,
        "min_clothoid": math.sqrt(clothoid_square),
        "min_arc": speed / 1.8,
        "min_straight": 6.0 * speed if speed >= 60.0 else speed / 1.8,
        "min_crest": 100.0 * sight_distance**2 / 658.0,
        "min_sag": 100.0 * speed**2 / 395.0,
    }


def friction_at(speed: float) -> float:
    """Return the side friction factor for a design speed in km/h."""
    return float(np.interp(speed, SPEEDS, _FRICTION))
