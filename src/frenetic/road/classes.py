"""Road classes: the rules by which roads are built for a design speed.

A class comes from `classes.toml` by its name, or from a user's TOML file. A rule that the file
leaves out is computed from the design speed V in km/h:

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

Straights do not lean. Bends lean in proportion to their curvature, up to ``max_superelevation`` at
the least radius (AASHTO's method 1), so the slope changes along the clothoids. Lanes widen in
proportion to the curvature, too.

Sources: AASHTO Green Book is the American guideline; RAS-L, RAL and RAA are German ones.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, check, converted
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_toml
from frenetic._support.words import read_part
from frenetic.criteria.criterion import COMPETITION
from frenetic.errors import FreneticError
from frenetic.road import profile
from frenetic.road.class_breaches import find_breaches
from frenetic.road.conforming import conform
from frenetic.road.validity import Verdict

if TYPE_CHECKING:
    from frenetic.road.road import Road

GRAVITY: Final = 9.81
"""Acceleration of gravity, in m/s²: the standard 9.80665, rounded."""
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
_STEPS_ROUNDING: Final = 1e-9
"""Number of steps by which a computed number of steps may exceed a whole number; our choice."""
_METRES_ROUNDING: Final = 1e-6
"""Length by which a computed rule may exceed whole metres, in m; our choice."""

_Speed: TypeAlias = Annotated[float, Meta(ge=20.0, le=250.0)]  # km/h
_Slope: TypeAlias = Annotated[float, Meta(ge=0.0, le=0.2)]  # m/m


@dataclass(frozen=True, kw_only=True)
class RoadClass:
    """Rules for roads of a design speed.

    Raises:
        ValueError: a value is out of range.
    """

    name: str
    about: str = ""
    """Description of the roads, in a sentence."""
    design_speed: _Speed
    """Design speed, in km/h."""
    speed_limit: Positive
    """Speed limit, in km/h."""
    lane_width: Positive
    """Width of a lane outside bends, in m."""
    widening: NotNegative
    """Product of a lane's widening in a bend and the bend's radius, in m²."""
    length: Positive
    """Usual length of a road that a search proposes, in m."""
    map_size: Positive
    """Side of the map for such roads, in m."""
    step: Positive
    """Distance between two curvature values of such roads, in m."""
    max_superelevation: _Slope
    """Steepest slope across the road, m/m."""
    min_radius: Positive
    """Least radius of a bend, in m."""
    min_clothoid: Positive
    """Least parameter A of a clothoid, in m: its curvature changes by 1/A² each m."""
    min_arc: NotNegative
    """Least length of a bend's arc between its clothoids, in m."""
    min_straight: NotNegative
    """Least length of a straight between two bends to the same side, in m."""
    max_grade: _Slope
    """Steepest slope along the road, m/m."""
    min_crest: Positive
    """Least radius of a crest, in m: the grade falls by 1/radius each m."""
    min_sag: Positive
    """Least radius of a sag, in m."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """Name of a rule -> source of its value, such as a guideline."""

    def __post_init__(self) -> None:
        # Whole numbers become floats: records of a class are equal, however a number was written.
        for name, value in converted(vars(self), RoadClass).items():
            object.__setattr__(self, name, value)
        if self.min_radius < 1.5 * self.lane_width:
            raise ValueError(
                f"min_radius is {self.min_radius:g}: more than one and a half of the lane_width of"
                f" {self.lane_width:g} m is needed"
            )

    @classmethod
    def of(cls, name: str, options: Mapping[str, Any] | None = None) -> Self:
        """Return the class with this name, or the class of a TOML file.

        Args:
            name: one of `classes`, or the path of a file that ends in .toml.
            options: values that replace values of the class; they lose their sources.

        Raises:
            FreneticError: no class has this name, the file cannot be read, or a value is unknown
                or out of range.
        """
        entries: Mapping[str, Any]
        changed = options or {}
        if name.endswith(".toml"):
            entries, class_name = _read_entries(Path(name)), Path(name).stem
        else:
            class_name = name
            if name not in classes():
                raise FreneticError(
                    f"there is no road class {name!r}: choose competition,"
                    f" {', '.join(classes())}, or a TOML file"
                )
            entries = classes()[name]
        try:
            rules = cls.from_entries({"name": class_name, **entries, **changed})
            sources = {rule: text for rule, text in rules.sources.items() if rule not in changed}
            return replace(rules, sources=sources)
        except ValueError as error:
            raise FreneticError(f"road class {name}: {error}") from None

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Return the class with these values; missing values follow from the design speed.

        Args:
            entries: values by name.

        Raises:
            ValueError: a name is unknown, a value is out of range, or the design speed is missing.
        """
        known = [item.name for item in fields(cls)]
        if unknown := entries.keys() - known:
            raise ValueError(f"there is no {min(unknown)}; there is {', '.join(known[2:-1])}")
        if "design_speed" not in entries:
            raise ValueError("design_speed is missing: km/h are needed")
        check(entries, RoadClass)
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
        computed = _computed_rules(speed, values)
        is_widened = _LONG_VEHICLE_WIDENING / computed["min_radius"] >= _LEAST_WIDENING
        if "widening" not in entries and is_widened:
            values["widening"] = _LONG_VEHICLE_WIDENING
        for name, value in computed.items():
            # Rounded up to whole metres, so that the rule holds.
            values.setdefault(name, float(math.ceil(value - _METRES_ROUNDING)))
        values.setdefault("map_size", 100.0 * math.ceil(float(values["length"]) / 100.0 + 1.0))
        formulas = dict.fromkeys(computed, f"AASHTO Green Book, for {speed:g} km/h") | {
            "min_arc": "RAL, RAA: the way of 2 s",
            "min_straight": "RAS-L 1995: 6 V" if speed >= 60.0 else "the way of 2 s",
            "widening": "RAS-L 1995: D² / 2, D = 10 m; none below 0.25 m",
        }
        sources = {name: text for name, text in formulas.items() if name not in entries}
        sources |= entries.get("sources", {})
        return cls(**values | {"sources": sources})

    def as_json(self) -> dict[str, Any]:
        """Return the values, for JSON; `from_entries` returns the same class from them."""
        return asdict(self)

    def as_text(self) -> str:
        """Return name and design speed in words."""
        return f"{self.name}, {self.design_speed:g} km/h"

    @property
    def plain(self) -> str:
        """Text by which a user chooses this class with flat roads of constant width.

        Example: ``rural-80,max_grade=0``. Empty if the roads of this class are such roads.
        """
        rules = ("max_superelevation", "max_grade", "widening")
        zeros = [f"{name}=0" for name in rules if getattr(self, name)]
        name = self.name if self.name in classes() else "CLASS"
        return ",".join([name, *zeros]) if zeros else ""

    # Curvature

    @property
    def max_curvature(self) -> float:
        """Largest curvature, in 1/m."""
        return 1.0 / self.min_radius

    def limits(self, step: float) -> FloatArray:
        """Return the limits for `conform`, (4,), for curvatures that are ``step`` m apart.

        The limits are: the largest curvature in 1/m; the largest change from a curvature to the
        next, in 1/m; the least number of steps in an arc; and the least number of steps in a
        straight between two bends to the same side.
        """
        return np.array(
            [
                self.max_curvature,
                step / self.min_clothoid**2,
                math.ceil(self.min_arc / step - _STEPS_ROUNDING),
                math.ceil(self.min_straight / step - _STEPS_ROUNDING),
            ]
        )

    def conformed(self, curvatures: FloatArray, step: float) -> FloatArray:
        """Return curvatures, (N,) 1/m, that meet the rules and follow the passed curvatures.

        Curvatures that meet the rules come back unchanged; see `conform`.
        """
        values = np.array(curvatures, dtype=np.float64)
        conform(values, self.limits(step), np.empty_like(values))
        return values

    def profiles(self, curvatures: FloatArray, step: float) -> dict[str, Any]:
        """Return the superelevation and widening of a road in this class.

        Args:
            curvatures: the road's curvatures, (N,) in 1/m.
            step: distance between two curvatures, in m.

        Returns:
            Name of a profile -> the profile, (k, 2), see `Road`; without profiles that are 0.
        """
        # A road leans to the inside of a bend. In a left bend, whose curvature is positive, its
        # right edge is higher, and that is a negative superelevation.
        leaning = -self.max_superelevation * self.min_radius * curvatures
        columns = {"superelevation": leaning, "widening": self.widening * np.abs(curvatures)}
        stations = np.arange(len(curvatures)) * step
        return {
            name: profile.thinned(np.column_stack([stations, values]))
            for name, values in columns.items()
            if values.any()
        }

    # Grade

    def conformed_grades(self, grades: FloatArray, step: float) -> FloatArray:
        """Return grades, (N,), that meet the rules and follow the passed grades.

        From the first grade on, each is as near to the passed one as the grade before allows.
        """
        conformed = np.clip(grades, -self.max_grade, self.max_grade)
        down, up = step / self.min_crest, step / self.min_sag
        for i in range(1, len(conformed)):
            conformed[i] = min(max(conformed[i], conformed[i - 1] - down), conformed[i - 1] + up)
        return conformed

    # Judging

    def breach(self, road: Road) -> str:
        """Return the first rule that a road breaches, in words; empty if it meets all."""
        return next(find_breaches(self, road), "")

    def verdict(self, road: Road) -> Verdict:
        """Return the verdict on a road by the rules, with the first breach as its message."""
        text = self.breach(road)
        return Verdict(not text, text)


# Formulas


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


# Names


@cache
def classes() -> Mapping[str, Mapping[str, Any]]:
    """Return the entries of `classes.toml`: name of a class -> its values."""
    text = files("frenetic.road").joinpath("classes.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _read_entries(path: Path) -> Mapping[str, Any]:
    """Return the entries of a TOML file.

    Raises:
        FreneticError: the file cannot be read, or is no TOML file.
    """
    try:
        return read_toml(read_bounded(path))
    except ValueError as error:
        raise FreneticError(f"{path} is no TOML file: {error}") from None


def class_of(roads: object) -> RoadClass | None:
    """Return the class that a text such as ``rural-80,length=1500`` or a table of values names.

    Args:
        roads: the text, or a mapping of a class's values by name.

    Returns:
        The class; None for the competition's roads, which have no class.

    Raises:
        ValueError: the text names no class, or a value is unknown or out of range.
        FreneticError: no class has this name.
    """
    if isinstance(roads, Mapping):
        return RoadClass.from_entries({"name": "own", **roads})
    name, options = read_part(str(roads))
    if name is None:
        raise ValueError(f"{roads!r} names no road class, as in rural-80,length=1500")
    if name != COMPETITION:
        return RoadClass.of(name, options)
    if options:
        raise ValueError("the competition's roads have no options")
    return None
