"""Road classes: the rules by which roads are built for a design speed.

A class comes from `classes.toml` by its name, or from a user's TOML file. A rule that the file
leaves out is computed from the design speed, see `frenetic.road.class_formulas`.

Straights do not lean. Bends lean in proportion to their curvature, up to ``max_superelevation`` at
the least radius (AASHTO's method 1), so the slope changes along the clothoids. Lanes widen in
proportion to the curvature, too.
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
from frenetic._support.option_text import read_part
from frenetic._support.outside_text import read_toml
from frenetic.criteria.criterion import COMPETITION
from frenetic.errors import FreneticError
from frenetic.road import profile
from frenetic.road.class_formulas import completed
from frenetic.road.conforming import NO_CHANGE, conform
from frenetic.road.steady_parts import indices_of, knots, steady_parts
from frenetic.road.validity import Verdict

if TYPE_CHECKING:
    from frenetic.road.road import Road

GRAVITY: Final = 9.81
"""Acceleration of gravity, in m/s²: the standard 9.80665, rounded."""
_STEPS_ROUNDING: Final = 1e-9
"""Number of steps by which a computed number of steps may exceed a whole number; our choice."""
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
        return cls(**completed(entries))

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
        return next(_find_breaches(self, road), "")

    def verdict(self, road: Road) -> Verdict:
        """Return the verdict on a road by the rules, with the first breach as its message."""
        text = self.breach(road)
        return Verdict(not text, text)


# Breaches


def _find_breaches(rules: RoadClass, road: Road) -> Iterator[str]:
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
