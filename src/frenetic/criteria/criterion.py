"""Criteria: what a drive is judged by beside leaving its lane, and profiles of them by name.

A profile is one of `criteria.toml`, an installed package's (entry point group `GROUP`), or one's
own in a TOML file::

    about = "what our passengers accept"
    lateral_acceleration = 2.5
    lateral_jerk = {limit = 4.0, window = 0.5, clause = "our handbook, 7.2"}

A name is that of a quantity, of `QUANTITIES` or of a package's: its entry point is a `Quantity`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from msgspec import Struct, ValidationError, convert

from frenetic._support.bounds import Finite, NotNegative, check
from frenetic._support.entry_points import imported, installed
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_toml
from frenetic._support.words import number_word
from frenetic.errors import FreneticError

GROUP: Final = "frenetic.criteria.criterion"
"""Entry point group of other packages' profiles and quantities."""
LANE: Final = "lane"
"""Criterion of leaving the lane: the share of the car's box outside it."""
DRIVER: Final = "driver"
"""Criterion of the driver's own faults, of which none is allowed."""
EDGE_DISTANCE: Final = "edge_distance"
COMPETITION: Final = "competition"
"""Name of the profile that judges by leaving the lane alone."""
_TEXTS: Final = ("about", "left_out")


@dataclass(frozen=True)
class Quantity:
    """Something of a drive that a criterion limits."""

    name: str
    unit: str
    about: str
    scale: float
    """Amount that counts as much as that of another quantity, when their margins are compared."""
    window: float = 0.0
    """Usual window in s, see `Criterion.window`."""
    is_least: bool = False
    """Whether values below the limit breach it, rather than those above."""
    has_sides: bool = False
    """Whether its sign is a side, left positive, and its amount is limited."""
    series: Callable[[Any, float], Any] | None = None
    """Its values, (n,), from a `frenetic.oracle.signals.Seen` and a window in s; None for ours."""

    @property
    def words(self) -> str:
        """Its name in words."""
        return self.name.replace("_", " ")

    def told(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:.2f} {self.unit}"


QUANTITIES: Final[Mapping[str, Quantity]] = MappingProxyType(
    {
        one.name: one
        for one in (
            Quantity(
                EDGE_DISTANCE,
                "m",
                "least distance of the car's outline from an edge of its lane, negative outside",
                1.0,
                is_least=True,
            ),
            Quantity(
                "lateral_acceleration",
                "m/s²",
                "of the centre of mass across the car, to either side",
                3.0,
                has_sides=True,
            ),
            Quantity(
                "lateral_jerk",
                "m/s³",
                "change of the lateral acceleration, to either side",
                5.0,
                0.5,
                has_sides=True,
            ),
            Quantity("yaw_rate", "°/s", "to either side", 20.0, has_sides=True),
            Quantity(
                "steering_rate",
                "°/s",
                "change of the front wheels' angle, to either side",
                20.0,
                has_sides=True,
            ),
            Quantity("sway", "m", "way across the lane within the window", 1.0, 10.0),
            Quantity("acceleration", "m/s²", "along the car, when it speeds up", 2.0),
            Quantity("deceleration", "m/s²", "along the car, when it slows down", 3.0),
            Quantity("longitudinal_jerk", "m/s³", "change of the acceleration", 5.0, 0.5),
            Quantity("speed_excess", "km/h", "speed above the speed limit", 10.0),
            Quantity("stop", "s", "time for which the car stands still once it has moved", 5.0),
            Quantity("duration", "s", "simulated time of the drive", 60.0),
        )
    }
)
"""Name -> quantity of ours."""


def quantity(name: str) -> Quantity:
    """The quantity of a name.

    Raises:
        ValueError: there is none.
    """
    if name in QUANTITIES:
        return QUANTITIES[name]
    for entry in installed(GROUP):
        if entry.name == name and isinstance(found := imported(entry.target), Quantity):
            return found
    raise ValueError(f"there is no quantity {name}: choose from {', '.join(QUANTITIES)}")


@dataclass(frozen=True)
class Criterion:
    """A limit of a quantity.

    Raises:
        ValueError: there is no such quantity, or a number is out of range.
    """

    quantity: str
    """Name of a quantity."""
    limit: Finite
    """In its unit; a value that is it keeps it."""
    window: NotNegative
    """Time in s over which a value is the mean, up to its record; 0 for single records. Of the
    sway, the time within which it happens."""
    clause: str = ""
    """Where the limit comes from."""

    def __post_init__(self) -> None:
        check(vars(self), Criterion)
        if quantity(self.quantity).has_sides and self.limit < 0.0:
            raise ValueError(f"limit is {self.limit:g}: at least 0 is needed, as sides count alike")

    def margin(self, value: float) -> float:
        """Distance of a value from the limit, in the quantity's unit; negative beyond it."""
        return value - self.limit if quantity(self.quantity).is_least else self.limit - value

    def told(self) -> str:
        """The limit in words, such as ``at most 3 m/s²``."""
        what = quantity(self.quantity)
        text = f"{'at least' if what.is_least else 'at most'} {self.limit:g} {what.unit}"
        if self.window:
            how = "within" if self.quantity == "sway" else "in the mean of"
            text += f" {how} {self.window:g} s"
        return text


@dataclass(frozen=True)
class Profile:
    """Criteria that drives have to keep, beside staying in the lane.

    Raises:
        ValueError: it has a quantity twice.
    """

    name: str
    criteria: tuple[Criterion, ...] = ()
    about: str = ""
    """What it is after, in a sentence."""
    left_out: str = ""
    """What the text that it is after asks for, too, and nothing here judges."""
    driven_time: NotNegative = 0.0
    """Simulated time, in s, that the drives of a campaign need together."""

    def __post_init__(self) -> None:
        check(vars(self), Profile)
        names = [one.quantity for one in self.criteria]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"{min(twice)} has two limits: one is needed")

    def __bool__(self) -> bool:
        """Whether it judges by more than leaving the lane."""
        return bool(self.criteria)

    @classmethod
    def of(cls, name: str, options: Mapping[str, Any] = MappingProxyType({})) -> Profile:
        """The profile of a name, or of a TOML file.

        Args:
            name: one of `profiles`, or the path of a file that ends in .toml.
            options: limits in place of the profile's own, or beside them.

        Raises:
            FreneticError: there is no such profile or file, or a limit is wrong.
        """
        if name.endswith(".toml"):
            path = Path(name)
            try:
                entries = read_toml(read_bounded(path))
                found = cls.made(path.stem, entries)
            except (ValueError, TypeError) as error:
                raise FreneticError(f"{name} says no criteria: {error}") from None
        elif name in (known := profiles()):
            found = known[name]
        else:
            raise FreneticError(
                f"there are no criteria {name!r}: choose {', '.join(known)}, or a TOML file"
            )
        try:
            return found.with_limits(options)
        except ValueError as error:
            raise FreneticError(f"criteria {name}: {error}") from None

    @classmethod
    def made(cls, name: str, given: Mapping[str, Any]) -> Self:
        """The profile of a file's entries.

        Raises:
            ValueError: an entry is wrong.
        """
        texts = {key: given[key] for key in (*_TEXTS, "driven_time") if key in given}
        rows = [_criterion(key, value) for key, value in given.items() if key not in texts]
        return cls(name, tuple(rows), **texts)

    def with_limits(self, limits: Mapping[str, Any]) -> Profile:
        """The same with limits of one's own.

        Raises:
            ValueError: one is wrong.
        """
        if not limits:
            return self
        rows = {one.quantity: one for one in self.criteria}
        for key, value in limits.items():
            window = rows[key].window if key in rows else None
            rows[key] = _criterion(key, {"limit": value, "window": window, "clause": "as given"})
        return replace(self, criteria=tuple(rows.values()))

    def in_words(self) -> str:
        """Its name and limits."""
        limits = [f"{quantity(one.quantity).words} {one.told()}" for one in self.criteria]
        return f"{self.name}: {', '.join(limits)}" if limits else self.name

    def as_json(self) -> dict[str, Any]:
        """Its fields, for JSON."""
        return asdict(self) | {"criteria": list(map(asdict, self.criteria))}

    def entries(self) -> dict[str, Any]:
        """What a file says of it, as `made` takes it."""
        texts = {key: text for key in _TEXTS if (text := getattr(self, key))}
        if self.driven_time:
            texts["driven_time"] = self.driven_time
        return texts | {
            one.quantity: {"limit": one.limit, "window": one.window, "clause": one.clause}
            for one in self.criteria
        }

    def entry(self) -> str | dict[str, Any]:
        """Its name, with limits that differ, if that says all; or else its entries."""
        known = profiles().get(self.name)
        if known is None:
            return self.whole_entry()
        theirs = {one.quantity: one for one in known.criteria}
        changed = {
            one.quantity: one.limit for one in self.criteria if theirs.get(one.quantity) != one
        }
        if known.with_limits(changed) != self:
            return self.whole_entry()
        limits = (f"{name}={number_word(limit)}" for name, limit in changed.items())
        return ",".join([self.name, *limits])

    def whole_entry(self) -> dict[str, Any]:
        """Its entries, whatever its name stands for elsewhere."""
        return {"name": self.name, **self.entries()}


JUDGED_BY_LANE: Final = Profile(COMPETITION, about="leaving the lane, as the competition judges")
"""The profile that is usual."""


class _Entry(Struct, forbid_unknown_fields=True):
    """What a file says of a criterion."""

    limit: float
    window: float | None = None
    clause: str = ""


def _criterion(name: str, given: Any) -> Criterion:
    """The criterion of a file's entry: a limit, or its fields."""
    try:
        entry = convert(given if isinstance(given, Mapping) else {"limit": given}, _Entry)
        window = quantity(name).window if entry.window is None else entry.window
        return Criterion(name, entry.limit, window, entry.clause)
    except ValidationError as error:
        raise ValueError(f"{name}: {error}") from None
    except ValueError as error:
        raise ValueError(str(error).replace("limit", name, 1)) from None


@cache
def _ours() -> Mapping[str, Profile]:
    text = files("frenetic.criteria").joinpath("criteria.toml").read_text(encoding="utf-8")
    made = (Profile.made(name, given) for name, given in tomllib.loads(text).items())
    return {COMPETITION: JUDGED_BY_LANE} | {one.name: one for one in made}


def profiles() -> Mapping[str, Profile]:
    """Name -> profile: ours, and those of installed packages."""
    theirs = {}
    for entry in installed(GROUP):
        if isinstance(found := imported(entry.target), Profile):
            theirs[entry.name] = replace(found, name=entry.name)
    return theirs | dict(_ours())
