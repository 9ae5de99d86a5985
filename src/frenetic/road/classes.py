"""Road classes: the rules by which roads are built for a design speed, and roads that keep them.

A class is named (`classes.toml`), or one's own in a TOML file. What it leaves out follows from its
design speed V in km/h:

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
the least radius (AASHTO's method 1), so they lean along the clothoids. Lanes widen likewise.
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
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, Self, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, check, converted
from frenetic._support.compiled import njit
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_toml
from frenetic._support.words import read_part
from frenetic.criteria.criterion import COMPETITION
from frenetic.errors import FreneticError
from frenetic.road import profile
from frenetic.road.validity import Verdict

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.road.road import Road

GRAVITY: Final = 9.81  # m/s²
SPEEDS: Final = (20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130)
"""Design speeds of AASHTO's tables, in km/h."""
_FRICTION: Final = (0.35, 0.28, 0.23, 0.19, 0.17, 0.15, 0.14, 0.13, 0.12, 0.11, 0.09, 0.08)
"""Side friction factor for these design speeds (AASHTO)."""
_GRADIENT: Final = (0.80, 0.75, 0.70, 0.65, 0.60, 0.55, 0.50, 0.47, 0.44, 0.41, 0.38, 0.35)
"""Largest slope of a lane's edge against its centre line for them, in % (AASHTO)."""
_JERK: Final = 1.2  # m/s³
_LONG_VEHICLE: Final = 50.0
"""Half the square of the 10 m from a long vehicle's rear axle to its front, in m²."""
_LEAST_WIDENING: Final = 0.25  # m
_SAME: Final = 1e-9  # share and 1/m by which values may miss a limit
_NO_CHANGE: Final = 1e-12  # 1/m
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
    """What roads they are, in a sentence."""
    design_speed: _Speed
    """km/h."""
    speed_limit: Positive
    """km/h."""
    lane_width: Positive
    """m."""
    widening: NotNegative
    """What a lane is wider in a bend, times its radius, in m²."""
    length: Positive
    """Usual length of a road that a search proposes, in m."""
    map_size: Positive
    """Side of the map for such roads, in m."""
    step: Positive
    """Distance between two curvature values of such roads, in m."""
    max_superelevation: _Slope
    """Steepest slope across the road, m/m."""
    min_radius: Positive
    """m."""
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
    """Rule -> where it comes from."""

    def __post_init__(self) -> None:
        # A whole number is a float, too: records of a class are alike, however it was written.
        for name, value in converted(vars(self), RoadClass).items():
            object.__setattr__(self, name, value)
        if self.min_radius < 1.5 * self.lane_width:
            raise ValueError(
                f"min_radius is {self.min_radius:g}: more than one and a half of the lane_width of"
                f" {self.lane_width:g} m is needed"
            )

    @classmethod
    def of(cls, name: str, options: Mapping[str, Any] | None = None) -> Self:
        """The class of a name, or of a TOML file.

        Args:
            name: one of `classes`, or the path of a file that ends in .toml.
            options: values in place of the class's own.

        Raises:
            FreneticError: there is no such class or file, or a value is wrong.
        """
        given: Mapping[str, Any]
        changed = options or {}
        if name.endswith(".toml"):
            given, source = _read(Path(name)), Path(name).stem
        else:
            source = name
            if name not in classes():
                raise FreneticError(
                    f"there is no road class {name!r}: choose competition,"
                    f" {', '.join(classes())}, or a TOML file"
                )
            given = classes()[name]
        try:
            made = cls.made({"name": source, **given, **changed})
            kept = {name: text for name, text in made.sources.items() if name not in changed}
            return replace(made, sources=kept)
        except ValueError as error:
            raise FreneticError(f"road class {name}: {error}") from None

    @classmethod
    def made(cls, given: Mapping[str, Any]) -> Self:
        """The class of some values; those that are missing follow from the design speed.

        Args:
            given: values by name.

        Raises:
            ValueError: there is no such value, it is out of range, or the design speed is missing.
        """
        known = [item.name for item in fields(cls)]
        if unknown := given.keys() - known:
            raise ValueError(f"there is no {min(unknown)}; there is {', '.join(known[2:-1])}")
        if "design_speed" not in given:
            raise ValueError("design_speed is missing: km/h are needed")
        check(given, RoadClass)
        speed = float(given["design_speed"])
        values = {
            "speed_limit": speed,
            "lane_width": 3.5,
            "length": 2000.0,
            "max_superelevation": 0.06,
            "max_grade": 0.06,
            "widening": 0.0,
            "step": float(max(round(speed / 5.0), 5)),
            **given,
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
            values = {**values, "widening": given.get("widening", _LONG_VEHICLE)}
        derived = {
            "min_radius": radius,
            "min_clothoid": math.sqrt(square),
            "min_arc": speed / 1.8,
            "min_straight": 6.0 * speed if speed >= 60.0 else speed / 1.8,
            "min_crest": 100.0 * sight**2 / 658.0,
            "min_sag": 100.0 * speed**2 / 395.0,
        }
        for name, value in derived.items():
            # Rounded to whole metres on the side of the rule.
            values.setdefault(name, float(math.ceil(value - 1e-6)))
        values.setdefault("map_size", 100.0 * math.ceil(float(values["length"]) / 100.0 + 1.0))
        formulas = dict.fromkeys(derived, f"AASHTO Green Book, for {speed:g} km/h") | {
            "min_arc": "RAL, RAA: the way of 2 s",
            "min_straight": "RAS-L 1995: 6 V" if speed >= 60.0 else "the way of 2 s",
            "widening": "RAS-L 1995: D² / 2, D = 10 m; none below 0.25 m",
        }
        sources = {name: text for name, text in formulas.items() if name not in given}
        sources |= given.get("sources", {})
        return cls(**values | {"sources": sources})

    def as_json(self) -> dict[str, Any]:
        """Its values, which `made` takes."""
        return asdict(self)

    def in_words(self) -> str:
        """Its name and design speed."""
        return f"{self.name}, {self.design_speed:g} km/h"

    @property
    def plain(self) -> str:
        """The class with flat roads of one width, ``rural-80,max_grade=0``; empty if this is it."""
        rules = ("max_superelevation", "max_grade", "widening")
        zeros = [f"{name}=0" for name in rules if getattr(self, name)]
        name = self.name if self.name in classes() else "CLASS"
        return ",".join([name, *zeros]) if zeros else ""

    # Curvature

    @property
    def max_curvature(self) -> float:
        """1/m."""
        return 1.0 / self.min_radius

    def limits(self, step: float) -> FloatArray:
        """What `conform` keeps for values that are ``step`` m apart, (4,).

        Largest curvature in 1/m, its largest change from value to value, and the values that an arc
        and a straight between two bends to the same side take at least.
        """
        return np.array(
            [
                self.max_curvature,
                step / self.min_clothoid**2,
                math.ceil(self.min_arc / step - _SAME),
                math.ceil(self.min_straight / step - _SAME),
            ]
        )

    def conformed(self, curvatures: FloatArray, step: float) -> FloatArray:
        """Values, (N,) 1/m, that keep the rules and follow the given ones as far as these let them.

        Values that keep them stay as they are.
        """
        values = np.array(curvatures, dtype=np.float64)
        conform(values, self.limits(step), np.empty_like(values))
        return values

    def profiles(self, curvatures: FloatArray, step: float) -> dict[str, Any]:
        """Superelevation and widening, (k, 2), of a road of (N,) curvatures, 1/m, each step m."""
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
        """Grades, (N,), that keep the rules and follow the given ones as far as these let them."""
        kept = np.clip(grades, -self.max_grade, self.max_grade)
        down, up = step / self.min_crest, step / self.min_sag
        for i in range(1, len(kept)):
            kept[i] = min(max(kept[i], kept[i - 1] - down), kept[i - 1] + up)
        return kept

    # Judging

    def breach(self, road: Road) -> str:
        """The first rule that a road does not keep, in words; empty if it keeps all."""
        return next(self._breaches(road), "")

    def verdict(self, road: Road) -> Verdict:
        """Whether a road keeps the rules, and if not, the first that it does not keep."""
        text = self.breach(road)
        return Verdict(not text, text)

    def _told(self, rule: str, what: str, needed: str) -> str:
        source = self.sources.get(rule, "")
        return f"{what}: {self.name} needs {needed}" + (f" ({source})" if source else "")

    def _breaches(self, road: Road) -> Iterator[str]:
        values, step = road.curvatures, road.step
        for i in _places(np.abs(values) > self.max_curvature * (1.0 + _SAME)):
            what = f"A radius of {1.0 / abs(values[i]):.0f} m at {i * step:.0f} m"
            yield self._told("min_radius", what, f"at least {self.min_radius:g} m")
        changes = np.abs(np.diff(values)) / step
        for i in _places(changes > (1.0 + _SAME) / self.min_clothoid**2):
            what = f"A clothoid with A of {1.0 / math.sqrt(changes[i]):.0f} m at {i * step:.0f} m"
            yield self._told("min_clothoid", what, f"at least {self.min_clothoid:g} m")
        for stretch in _stretches(values):
            length, at = (stretch.last - stretch.first) * step, stretch.first * step
            if abs(stretch.value) > _NO_CHANGE:
                least, rule, what = self.min_arc, "min_arc", f"An arc of {length:.0f} m"
            elif stretch.before * stretch.after > 0.0:
                least, rule = self.min_straight, "min_straight"
                what = f"A straight of {length:.0f} m between bends to the same side"
            else:
                continue
            if length < least - 1e-6:
                yield self._told(rule, f"{what} at {at:.0f} m", f"at least {least:g} m")
        yield from self._breaches_across(road)
        pairs = profile.cut(road.grade, 0.0, road.length)
        for i in _places(np.abs(pairs[:, 1]) > self.max_grade * (1.0 + _SAME) + _SAME):
            what = f"A grade of {100.0 * pairs[i, 1]:.1f} % at {pairs[i, 0]:.0f} m"
            yield self._told("max_grade", what, f"at most {100.0 * self.max_grade:g} %")
        for (at, before), (end, after) in pairwise(pairs):
            bend = (after - before) / (end - at)
            word, rule = ("crest", "min_crest") if bend < 0.0 else ("sag", "min_sag")
            least = getattr(self, rule)
            if abs(bend) * least > 1.0 + 1e-6:
                what = f"A {word} of {1.0 / abs(bend):.0f} m radius at {at:.0f} m"
                yield self._told(rule, what, f"at least {least:g} m")
        if road.lane_width < self.lane_width * (1.0 - _SAME):
            what = f"The lanes are {road.lane_width:g} m wide"
            yield self._told("lane_width", what, f"at least {self.lane_width:g} m")
        stations, curvatures = knots(road, road.widening)
        widths = road.lane_width + profile.value_at(road.widening, stations)
        needed = self.lane_width + self.widening * np.abs(curvatures)
        for i in _places(widths < needed * (1.0 - _SAME)):
            what = f"A lane of {widths[i]:.2f} m in a radius of {1.0 / abs(curvatures[i]):.0f} m"
            what += f" at {stations[i]:.0f} m"
            yield self._told("widening", what, f"at least {needed[i]:.2f} m")

    def _breaches_across(self, road: Road) -> Iterator[str]:
        stations, curvatures = knots(road, road.superelevation)
        slopes = profile.value_at(road.superelevation, stations)
        for i in _places(np.abs(slopes) > self.max_superelevation * (1.0 + _SAME) + _SAME):
            what = f"A superelevation of {100.0 * abs(slopes[i]):.1f} % at {stations[i]:.0f} m"
            needed = f"at most {100.0 * self.max_superelevation:g} %"
            yield self._told("max_superelevation", what, needed)
        # What the side friction has to hold at the design speed, as V²/(127 R) says it.
        demand = self.design_speed**2 / 127.0 * curvatures + slopes
        most = self.design_speed**2 / 127.0 * self.max_curvature - self.max_superelevation
        for i in _places(np.abs(demand) > max(most, 0.0) + 1e-6):
            radius = 1.0 / max(abs(float(curvatures[i])), 1e-9)
            what = (
                f"A side friction of {abs(demand[i]):.2f} at {stations[i]:.0f} m, in a radius of"
                f" {radius:.0f} m with {100.0 * abs(slopes[i]):.1f} % of superelevation"
            )
            yield self._told("min_radius", what, f"at most {max(most, 0.0):.2f}")


def _places(broken: npt.NDArray[np.bool_]) -> list[int]:
    """Indices at which a rule is not kept."""
    return np.flatnonzero(broken).tolist()


def knots(road: Road, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stations where the curvature or a profile bends, in m, and the curvatures there."""
    samples = np.arange(len(road.curvatures)) * road.step
    stations = np.unique(np.concatenate([samples, pairs[:, 0]]))
    stations = stations[(stations >= 0.0) & (stations <= road.length + _SAME)]
    return stations, road.curvature_at(stations)


def friction_at(speed: float) -> float:
    """Side friction factor for a design speed in km/h."""
    return float(np.interp(speed, SPEEDS, _FRICTION))


class _Stretch(NamedTuple):
    """Values of one curvature between two clothoids, or the one at which clothoids meet."""

    first: int
    last: int
    value: float
    before: float
    """Curvature from which the clothoid before it comes."""
    after: float
    """Curvature to which the one behind it leads."""


def _stretches(values: FloatArray) -> list[_Stretch]:
    """The stretches of a road but for those at its ends, which may be parts of longer ones."""
    changes = np.diff(values)
    signs = np.where(np.abs(changes) > _NO_CHANGE, np.sign(changes), 0.0)
    runs = [0, *_places(np.diff(signs, prepend=signs[0]) != 0.0), len(signs)]
    ends: list[tuple[int, int]] = []
    for first, last in pairwise(runs):
        if signs[first] == 0.0:
            ends.append((first, last))
        elif not ends or ends[-1][1] != first:
            ends.append((first, first))
    if ends[-1][1] != len(signs):
        ends.append((len(signs), len(signs)))
    curvatures = [float(values[first]) for first, _ in ends]
    return [
        _Stretch(*ends[k], curvatures[k], curvatures[k - 1], curvatures[k + 1])
        for k in range(1, len(ends) - 1)
    ]


@njit()
def conform(values: FloatArray, limits: FloatArray, wished: FloatArray) -> None:
    """Make curvatures, (n,) 1/m, keep a class's rules, from the first value on, in place.

    Each value is a wish. From a curvature that has lasted long enough a clothoid leads to where the
    wishes turn or rest next, as they do if they are slow enough, or as fast as is allowed; then the
    curvature lasts. Wishes that keep the rules are kept.

    Args:
        values: (n,) 1/m.
        limits: (4,) see `RoadClass.limits`.
        wished: (n,) room.
    """
    bound, change, arc, straight = limits[0], limits[1], int(limits[2]), int(limits[3])
    n = len(values)
    for i in range(n):
        wished[i] = min(max(values[i], -bound), bound)
    values[0] = wished[0]
    i = 0
    free = 0  # index from which the present curvature may be left
    begun = 0  # index where the present straight began
    side = 0.0  # of the last bend; 0 before the first
    while i < n - 1:
        now = values[i]
        target = now
        turn = i + 1  # where the wishes turn or rest next
        if i >= free and abs(wished[i + 1] - now) > _NO_CHANGE:
            while turn + 1 < n:
                step = wished[turn + 1] - wished[turn]
                if abs(step) <= _NO_CHANGE:
                    break
                if turn > i + 1 and step * (wished[turn] - wished[turn - 1]) < 0.0:
                    break
                turn += 1
            target = wished[turn]
            if abs(target) <= _NO_CHANGE:
                target = 0.0
            if now == 0.0 and side * target > 0.0 and i - begun < straight:
                target = now
        if abs(target - now) <= _NO_CHANGE:
            i += 1
            values[i] = now
            continue
        needed = max(math.ceil(abs(target - now) / change - 1e-9), 1)
        is_kept = turn - i >= needed
        for k in range(i + 1, turn + 1):
            before = now if k == i + 1 else wished[k - 1]
            rise = (wished[k] - before) * (1.0 if target > now else -1.0)
            is_kept = is_kept and 0.0 < rise <= change * (1.0 + 1e-9)
        count = turn - i if is_kept else needed
        for k in range(1, count + 1):
            if i + k < n:
                values[i + k] = wished[i + k] if is_kept else now + (target - now) * k / count
        if now != 0.0:
            side = 1.0 if now > 0.0 else -1.0
        i += count
        if i < n:
            values[i] = target
        free = i
        begun = i
        if target != 0.0:
            side = 1.0 if target > 0.0 else -1.0
            free = i + arc


@cache
def classes() -> Mapping[str, Mapping[str, Any]]:
    """Name of a class -> what its file says of it."""
    text = files("frenetic.road").joinpath("classes.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _read(path: Path) -> Mapping[str, Any]:
    try:
        return read_toml(read_bounded(path))
    except ValueError as error:
        raise FreneticError(f"{path} is no TOML file: {error}") from None


def class_of(roads: object) -> RoadClass | None:
    """The class of a text such as ``rural-80,length=1500``, or of its values.

    Returns:
        None for the competition's roads, which have no class.

    Raises:
        ValueError: the text or the values are wrong.
        FreneticError: there is no such class.
    """
    if isinstance(roads, Mapping):
        return RoadClass.made({"name": "own", **roads})
    name, options = read_part(str(roads))
    if name is None:
        raise ValueError(f"{roads!r} names no road class, as in rural-80,length=1500")
    if name != COMPETITION:
        return RoadClass.of(name, options)
    if options:
        raise ValueError("the competition's roads have no options")
    return None
