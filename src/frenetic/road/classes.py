"""Road classes: the rules by which roads are built for a design speed.

A class comes from `classes.toml` by its name, or from a user's TOML file. A rule that the file
leaves out follows from the design speed V in km/h:

================== ==================================================================
``min_radius``     V² / (127 (e + f)), e the largest superelevation, f the side
                   friction factor for V (AASHTO Green Book, minimum radius)
``min_clothoid``   the largest of three, with R the least radius: sqrt(v³ / C), v in
                   m/s, C = 1.2 m/s³ (AASHTO, spirals: lateral jerk);
                   sqrt(R w e / g), w the lane's width, g the relative gradient of
                   its edge for V (AASHTO, superelevation runoff); R / 3 (RAL, RAA)
``min_arc``        the way of 2 s: V / 1.8 (RAL, RAA)
``min_straight``   between bends to the same side: 6 V (RAS-L 1995); below 60 km/h
                   the way of 2 s
``min_crest``      100 S² / 658, S = 0.278 V 2.5 s + 0.039 V² / 3.4 m/s² the stopping
                   sight distance (AASHTO, crest vertical curves)
``min_sag``        100 V² / 395 (AASHTO, sag vertical curves: comfort)
``widening``       D² / 2 for each lane, with D = 10 m from a long vehicle's rear axle to
                   its front (RAS-L 1995); 0 where that widens no lane by 0.25 m
================== ==================================================================

Straights are level, and bends lean in proportion to their curvature up to ``max_superelevation`` at
the least radius (AASHTO's method 1), so they lean along the clothoids. Lanes widen in proportion to
the curvature, too.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from importlib.resources import files
from itertools import pairwise
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
from frenetic.road.conforming import NO_CHANGE, conform
from frenetic.road.steady_parts import indices_of, knots, steady_parts
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
_LONG_VEHICLE: Final = 50.0
"""Half the square of the 10 m from a long vehicle's rear axle to its front, in m²."""
_LEAST_WIDENING: Final = 0.25  # [m] a smaller widening is left out (RAS-L 1995)
_ROUNDING: Final = 1e-9
"""Share, 1/m, or number of steps by which a rounded value may miss a limit; ours."""
_LENGTH_ROUNDING: Final = 1e-6
"""Length in m, or share of a bend of the grade, by which a value may miss a limit; ours."""

_Speed: TypeAlias = Annotated[float, Meta(ge=20.0, le=250.0)]
_Slope: TypeAlias = Annotated[float, Meta(ge=0.0, le=0.2)]


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
    """Widening of a lane in a bend, times the bend's radius, in m²."""
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
    """Rule -> its source."""

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
            options: values in place of the class's own.

        Raises:
            FreneticError: no class has this name, the file cannot be read, or a value is unknown
                or out of range.
        """
        entries: Mapping[str, Any]
        changed = options or {}
        if name.endswith(".toml"):
            entries, class_name = _read(Path(name)), Path(name).stem
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
        values = {
            "speed_limit": speed,
            "lane_width": 3.5,
            "length": 2000.0,
            "max_superelevation": 0.06,
            "max_grade": 0.06,
            "widening": 0.0,
            "step": float(max(round(speed / 5.0), 5)),
            **entries,
        }
        slope, width = float(values["max_superelevation"]), float(values["lane_width"])
        friction, gradient = friction_at(speed), float(np.interp(speed, SPEEDS, _GRADIENT))
        radius = float(values.get("min_radius", speed**2 / (127.0 * (slope + friction))))
        square = max(
            (speed / 3.6) ** 3 / _JERK,
            100.0 * radius * width * slope / gradient,
            (radius / 3.0) ** 2,
        )
        sight = 0.278 * speed * 2.5 + 0.039 * speed**2 / 3.4
        if _LONG_VEHICLE / radius >= _LEAST_WIDENING:
            values = {**values, "widening": entries.get("widening", _LONG_VEHICLE)}
        derived = {
            "min_radius": radius,
            "min_clothoid": math.sqrt(square),
            "min_arc": speed / 1.8,
            "min_straight": 6.0 * speed if speed >= 60.0 else speed / 1.8,
            "min_crest": 100.0 * sight**2 / 658.0,
            "min_sag": 100.0 * speed**2 / 395.0,
        }
        for name, value in derived.items():
            # Rounded up to whole metres, so that the rule holds.
            values.setdefault(name, float(math.ceil(value - 1e-6)))
        values.setdefault("map_size", 100.0 * math.ceil(float(values["length"]) / 100.0 + 1.0))
        formulas = dict.fromkeys(derived, f"AASHTO Green Book, for {speed:g} km/h") | {
            "min_arc": "RAL, RAA: the way of 2 s",
            "min_straight": "RAS-L 1995: 6 V" if speed >= 60.0 else "the way of 2 s",
            "widening": "RAS-L 1995: D² / 2, D = 10 m; none below 0.25 m",
        }
        sources = {name: text for name, text in formulas.items() if name not in entries}
        sources |= entries.get("sources", {})
        return cls(**values | {"sources": sources})

    def as_json(self) -> dict[str, Any]:
        """Return the values, as `from_entries` takes them."""
        return asdict(self)

    def as_text(self) -> str:
        """Return name and design speed in words."""
        return f"{self.name}, {self.design_speed:g} km/h"

    @property
    def plain(self) -> str:
        """Text of the class with flat roads of one width, such as ``rural-80,max_grade=0``.

        Empty if the roads of this class are flat and have one width.
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
        """Return the limits for `conform`, (4,), for values that are ``step`` m apart.

        Largest curvature in 1/m, its largest change from value to value, and the least numbers of
        values of an arc and of a straight between two bends to the same side.
        """
        return np.array(
            [
                self.max_curvature,
                step / self.min_clothoid**2,
                math.ceil(self.min_arc / step - _ROUNDING),
                math.ceil(self.min_straight / step - _ROUNDING),
            ]
        )

    def conformed(self, curvatures: FloatArray, step: float) -> FloatArray:
        """Return curvatures, (N,) 1/m, that meet the rules, as near to other ones as possible.

        Curvatures that meet the rules stay as they are.
        """
        values = np.array(curvatures, dtype=np.float64)
        conform(values, self.limits(step), np.empty_like(values))
        return values

    def profiles(self, curvatures: FloatArray, step: float) -> dict[str, Any]:
        """Return superelevation and widening, (k, 2), of a road with (N,) curvatures in 1/m."""
        # To the inside of the bend: a left bend, of positive curvature, rises to the right.
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
        """Return grades, (N,), that meet the rules and follow other ones as far as possible."""
        conformed = np.clip(grades, -self.max_grade, self.max_grade)
        down, up = step / self.min_crest, step / self.min_sag
        for i in range(1, len(conformed)):
            conformed[i] = min(max(conformed[i], conformed[i - 1] - down), conformed[i - 1] + up)
        return conformed

    # Judging

    def breach(self, road: Road) -> str:
        """Return the first rule that a road breaches, in words; empty if it meets all."""
        return next(_find_breaches(self, road), "")

    def verdict(self, road: Road) -> Verdict:
        """Return whether a road meets the rules, with the first breach as message."""
        text = self.breach(road)
        return Verdict(not text, text)


# Breaches


def _find_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
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
    for i in indices_of(np.abs(values) > rules.max_curvature * (1.0 + _ROUNDING)):
        fact = f"A radius of {1.0 / abs(values[i]):.0f} m at {i * step:.0f} m"
        yield _text(rules, "min_radius", fact, f"at least {rules.min_radius:g} m")
    changes = np.abs(np.diff(values)) / step
    for i in indices_of(changes > (1.0 + _ROUNDING) / rules.min_clothoid**2):
        fact = f"A clothoid with A of {1.0 / math.sqrt(changes[i]):.0f} m at {i * step:.0f} m"
        yield _text(rules, "min_clothoid", fact, f"at least {rules.min_clothoid:g} m")


def _breaches_of_length(rules: RoadClass, road: Road) -> Iterator[str]:
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
            yield _text(rules, rule, f"{fact} at {start:.0f} m", f"at least {least:g} m")


def _breaches_across(rules: RoadClass, road: Road) -> Iterator[str]:
    stations, curvatures = knots(road, road.superelevation)
    slopes = profile.value_at(road.superelevation, stations)
    steepest = rules.max_superelevation
    for i in indices_of(np.abs(slopes) > steepest * (1.0 + _ROUNDING) + _ROUNDING):
        fact = f"A superelevation of {100.0 * abs(slopes[i]):.1f} % at {stations[i]:.0f} m"
        needed = f"at most {100.0 * steepest:g} %"
        yield _text(rules, "max_superelevation", fact, needed)
    # Side friction that a car needs at the design speed, by V²/(127 R).
    demand = rules.design_speed**2 / 127.0 * curvatures + slopes
    most = rules.design_speed**2 / 127.0 * rules.max_curvature - rules.max_superelevation
    for i in indices_of(np.abs(demand) > max(most, 0.0) + 1e-6):
        radius = 1.0 / max(abs(float(curvatures[i])), 1e-9)
        fact = (
            f"A side friction of {abs(demand[i]):.2f} at {stations[i]:.0f} m, in a radius of"
            f" {radius:.0f} m with {100.0 * abs(slopes[i]):.1f} % of superelevation"
        )
        yield _text(rules, "min_radius", fact, f"at most {max(most, 0.0):.2f}")


def _breaches_of_grade(rules: RoadClass, road: Road) -> Iterator[str]:
    pairs = profile.cut(road.grade, 0.0, road.length)
    for i in indices_of(np.abs(pairs[:, 1]) > rules.max_grade * (1.0 + _ROUNDING) + _ROUNDING):
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
    for i in indices_of(widths < needed * (1.0 - _ROUNDING)):
        fact = f"A lane of {widths[i]:.2f} m in a radius of {1.0 / abs(curvatures[i]):.0f} m"
        fact += f" at {stations[i]:.0f} m"
        yield _text(rules, "widening", fact, f"at least {needed[i]:.2f} m")


# Names and formulas


def friction_at(speed: float) -> float:
    """Return the side friction factor for a design speed in km/h."""
    return float(np.interp(speed, SPEEDS, _FRICTION))


@cache
def classes() -> Mapping[str, Mapping[str, Any]]:
    """Return the entries of `classes.toml`: name of a class -> its values."""
    text = files("frenetic.road").joinpath("classes.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _read(path: Path) -> Mapping[str, Any]:
    """Return the entries of a TOML file.

    Raises:
        FreneticError: the file cannot be read, or is no TOML file.
    """
    try:
        return read_toml(read_bounded(path))
    except ValueError as error:
        raise FreneticError(f"{path} is no TOML file: {error}") from None


def class_of(roads: object) -> RoadClass | None:
    """Return the class of a text such as ``rural-80,length=1500``, or of a table of values.

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
