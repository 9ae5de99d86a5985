"""Criteria: limits on a drive beside staying in its lane, and named sets of criteria.

A criteria set (called a profile on the command line and in the docs) comes from `criteria.toml`,
from an installed package (entry point group `GROUP`), or from a user's TOML file::

    about = "what our passengers accept"
    lateral_acceleration = 2.5
    lateral_jerk = {limit = 4.0, window = 0.5, clause = "our handbook, 7.2"}

Each limit has the name of a signal, which is a value measured at each record of a drive: one of
`SIGNALS`, or a `Signal` that is an entry point of an installed package.
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
from frenetic._support.option_text import number_word
from frenetic._support.outside_text import read_toml
from frenetic.errors import FreneticError

GROUP: Final = "frenetic.criteria"
"""Entry point group of other packages' criteria sets and signals."""
LANE: Final = "lane"
"""Criterion of leaving the lane: the share of the car's box outside it."""
DRIVER: Final = "driver"
"""Criterion of the driver's own faults: every fault breaches it."""
EDGE_DISTANCE: Final = "edge_distance"
"""Name of the signal that is the distance between the car's outline and its lane's edges."""
LATERAL_OFFSET: Final = "lateral_offset"
"""Name of the signal that is the distance of the car's centre from the middle of its lane."""
LATERAL_JERK: Final = "lateral_jerk"
"""Name of the signal that is the change of the lateral acceleration."""
COMPETITION: Final = "competition"
"""Name of the criteria set that is empty: only leaving the lane counts."""
_TEXT_ENTRIES: Final = ("about", "left_out")
"""Entries of a criteria set's file that are texts, not limits."""


@dataclass(frozen=True)
class Signal:
    """A measured value of a drive that a criterion can limit."""

    name: str
    unit: str
    about: str
    """Description of the value, continuing the name."""
    scale: float
    """Amount, in the signal's unit, by which margins are divided to compare signals."""
    window: float = 0.0
    """Default window in s, see `Criterion.window`."""
    is_least: bool = False
    """Whether the limit is a least value: values below it breach it, rather than values above."""
    has_sides: bool = False
    """Whether the value's sign is a side of the car, left positive; then the limit holds for the
    absolute value."""
    series: Callable[[Any, float], Any] | None = None
    """Function that computes the values, (n,), from a `frenetic.oracle.signals.LocatedDrive` and a
    window in s; None for built-in signals."""

    @property
    def words(self) -> str:
        """Name of the signal with spaces."""
        return self.name.replace("_", " ")

    def text(self, value: float) -> str:
        """Return a value with the signal's unit."""
        return f"{value:.2f} {self.unit}"


SIGNALS: Final[Mapping[str, Signal]] = MappingProxyType(
    {
        signal.name: signal
        for signal in (
            Signal(
                EDGE_DISTANCE,
                "m",
                "least distance of the car's outline from an edge of its lane, negative outside",
                scale=1.0,
                is_least=True,
            ),
            Signal(
                LATERAL_OFFSET,
                "m",
                "of the centre of mass from the middle of its lane, to either side",
                scale=1.0,
                has_sides=True,
            ),
            Signal(
                "lateral_acceleration",
                "m/s²",
                "of the centre of mass across the car, to either side",
                scale=3.0,
                has_sides=True,
            ),
            Signal(
                LATERAL_JERK,
                "m/s³",
                "change of the lateral acceleration, to either side",
                scale=5.0,
                window=0.5,
                has_sides=True,
            ),
            Signal("yaw_rate", "°/s", "to either side", scale=20.0, has_sides=True),
            Signal(
                "steering_rate",
                "°/s",
                "change of the front wheels' angle, to either side",
                scale=20.0,
                has_sides=True,
            ),
            Signal("sway", "m", "way across the lane within the window", scale=1.0, window=10.0),
            Signal("acceleration", "m/s²", "along the car, when it speeds up", scale=2.0),
            Signal("deceleration", "m/s²", "along the car, when it slows down", scale=3.0),
            Signal(
                "longitudinal_jerk", "m/s³", "change of the acceleration", scale=5.0, window=0.5
            ),
            Signal("speed_excess", "km/h", "speed above the speed limit", scale=10.0),
            Signal("stop", "s", "time for which the car stands still once it has moved", scale=5.0),
            Signal("duration", "s", "simulated time of the drive", scale=60.0),
        )
    }
)
"""Built-in signals: name -> signal."""


def signal_named(name: str) -> Signal:
    """Return the signal with this name, built in or installed.

    Raises:
        ValueError: no signal has this name.
    """
    if name in SIGNALS:
        return SIGNALS[name]
    for entry in installed(GROUP):
        if entry.name == name and isinstance(target := imported(entry.target), Signal):
            return target
    raise ValueError(f"there is no signal {name}: choose from {', '.join(SIGNALS)}")


@dataclass(frozen=True)
class Criterion:
    """A limit of a signal.

    Raises:
        ValueError: no signal has this name, or a number is out of range.
    """

    signal: str
    """Name of the signal."""
    limit: Finite
    """Limit in the signal's unit; a value equal to the limit is allowed."""
    window: NotNegative
    """Time before each record over which values are averaged, in s; 0 judges single records. Of
    the signal ``sway``, the time within which the car sways."""
    clause: str = ""
    """Source of the limit, such as a clause of a standard."""

    def __post_init__(self) -> None:
        check(vars(self), Criterion)
        if signal_named(self.signal).has_sides and self.limit < 0.0:
            raise ValueError(
                f"limit is {self.limit:g}: at least 0 is needed, as it holds for both sides"
            )

    def margin(self, value: float) -> float:
        """Return the distance of a value from the limit, in its unit; negative beyond it."""
        return value - self.limit if signal_named(self.signal).is_least else self.limit - value

    def text(self) -> str:
        """Return the limit in words, such as ``at most 3 m/s²``."""
        signal = signal_named(self.signal)
        text = f"{'at least' if signal.is_least else 'at most'} {self.limit:g} {signal.unit}"
        if self.window:
            preposition = "within" if self.signal == "sway" else "in the mean of"
            text += f" {preposition} {self.window:g} s"
        return text


@dataclass(frozen=True)
class CriteriaSet:
    """Criteria that drives have to meet, beside staying in the lane.

    Raises:
        ValueError: two criteria limit the same signal.
    """

    name: str
    criteria: tuple[Criterion, ...] = ()
    about: str = ""
    """Standard that the criteria follow, or what they are for, in a sentence."""
    left_out: str = ""
    """Demands of the standard that no criterion judges."""
    driven_time: NotNegative = 0.0
    """Simulated time that all drives of a campaign together need for the standard, in s."""

    def __post_init__(self) -> None:
        check(vars(self), CriteriaSet)
        names = [criterion.signal for criterion in self.criteria]
        if repeated := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"{min(repeated)} has two limits: one is needed")

    def __bool__(self) -> bool:
        """Return whether there are criteria beside leaving the lane."""
        return bool(self.criteria)

    @classmethod
    def of(cls, name: str, options: Mapping[str, Any] = MappingProxyType({})) -> CriteriaSet:
        """Return the criteria set with this name, or the set in a TOML file.

        Args:
            name: a key of `criteria_sets`, or the path of a file that ends in .toml.
            options: name of a signal -> limit, see `with_limits`.

        Raises:
            FreneticError: no criteria set has this name, the file cannot be read, or a limit is out
                of range.
        """
        if name.endswith(".toml"):
            path = Path(name)
            try:
                entries = read_toml(read_bounded(path))
                criteria_set = cls.from_entries(path.stem, entries)
            except (ValueError, TypeError) as error:
                raise FreneticError(f"{name} holds no criteria: {error}") from None
        elif name in (known := criteria_sets()):
            criteria_set = known[name]
        else:
            raise FreneticError(
                f"there are no criteria {name!r}: choose {', '.join(known)}, or a TOML file"
            )
        try:
            return criteria_set.with_limits(options)
        except ValueError as error:
            raise FreneticError(f"criteria {name}: {error}") from None

    @classmethod
    def from_entries(cls, name: str, entries: Mapping[str, Any]) -> Self:
        """Return the criteria set of a file's entries.

        Args:
            name: name of the set.
            entries: the texts and ``driven_time``, and name of a signal -> limit or table.

        Raises:
            ValueError: a signal is unknown, or a limit is out of range.
        """
        fields = {key: entries[key] for key in (*_TEXT_ENTRIES, "driven_time") if key in entries}
        criteria = [_criterion(key, value) for key, value in entries.items() if key not in fields]
        return cls(name, tuple(criteria), **fields)

    def with_limits(self, limits: Mapping[str, Any]) -> CriteriaSet:
        """Return the criteria set with other limits.

        Args:
            limits: name of a signal -> its limit. The limit replaces the limit of the set's
                criterion, whose window stays, or is added as a new criterion.

        Raises:
            ValueError: a signal is unknown, or a limit is out of range.
        """
        if not limits:
            return self
        criteria = {criterion.signal: criterion for criterion in self.criteria}
        for key, value in limits.items():
            window = criteria[key].window if key in criteria else None
            entry = {"limit": value, "window": window, "clause": "as given"}
            criteria[key] = _criterion(key, entry)
        return replace(self, criteria=tuple(criteria.values()))

    def as_text(self) -> str:
        """Return the name and the limits in words."""
        limits = [
            f"{signal_named(criterion.signal).words} {criterion.text()}"
            for criterion in self.criteria
        ]
        return f"{self.name}: {', '.join(limits)}" if limits else self.name

    def as_json(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        return asdict(self) | {"criteria": list(map(asdict, self.criteria))}

    def entries(self) -> dict[str, Any]:
        """Return the entries of a file, as `from_entries` takes them."""
        entries = {key: text for key in _TEXT_ENTRIES if (text := getattr(self, key))}
        if self.driven_time:
            entries["driven_time"] = self.driven_time
        for criterion in self.criteria:
            fields = asdict(criterion)
            entries[fields.pop("signal")] = fields
        return entries

    def entry(self) -> str | dict[str, Any]:
        """Return the shortest value by which a spec stores this criteria set.

        That is a text, the set's name with changed limits, such as
        ``after-un-r79,lateral_jerk=4``; or a table of all entries, if the name and the limits do
        not suffice to restore the set.
        """
        known = criteria_sets().get(self.name)
        if known is None:
            return self.whole_entry()
        known_criteria = {criterion.signal: criterion for criterion in known.criteria}
        changed_limits = {
            criterion.signal: criterion.limit
            for criterion in self.criteria
            if known_criteria.get(criterion.signal) != criterion
        }
        if known.with_limits(changed_limits) != self:
            return self.whole_entry()
        limits = (f"{name}={number_word(limit)}" for name, limit in changed_limits.items())
        return ",".join([self.name, *limits])

    def whole_entry(self) -> dict[str, Any]:
        """Return name and entries, from which the set can be restored wherever they are read."""
        return {"name": self.name, **self.entries()}


JUDGED_BY_LANE: Final = CriteriaSet(
    COMPETITION, about="leaving the lane, as the competition judges"
)
"""Default criteria set: drives are judged by leaving the lane alone."""


class _CriterionEntry(Struct, forbid_unknown_fields=True):
    """Entry of a criteria set's file that is a table: the fields of a `Criterion`."""

    limit: float
    window: float | None = None
    """Window in s; None for the signal's default."""
    clause: str = ""


def _criterion(name: str, value: Any) -> Criterion:
    """Return the criterion of a file's entry.

    Args:
        name: name of the signal.
        value: the limit, or a table of the fields of a `_CriterionEntry`.

    Raises:
        ValueError: the signal is unknown, or the limit is out of range.
    """
    try:
        entry = convert(value if isinstance(value, Mapping) else {"limit": value}, _CriterionEntry)
        window = signal_named(name).window if entry.window is None else entry.window
        return Criterion(name, entry.limit, window, entry.clause)
    except ValidationError as error:
        raise ValueError(f"{name}: {error}") from None
    except ValueError as error:
        # The message says "limit is ..."; a user's file has the name of the signal instead.
        raise ValueError(str(error).replace("limit", name, 1)) from None


@cache
def _built_in_sets() -> Mapping[str, CriteriaSet]:
    """Return the default criteria set and the sets of `criteria.toml`, by name."""
    text = files("frenetic.criteria").joinpath("criteria.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    return {COMPETITION: JUDGED_BY_LANE} | {
        name: CriteriaSet.from_entries(name, entries) for name, entries in tables.items()
    }


def criteria_sets() -> Mapping[str, CriteriaSet]:
    """Return all criteria sets by name: installed packages come first, then the built-in sets.

    A built-in set cannot be replaced by an installed set of the same name.
    """
    installed_sets = {}
    for entry in installed(GROUP):
        if isinstance(target := imported(entry.target), CriteriaSet):
            installed_sets[entry.name] = replace(target, name=entry.name)
    return installed_sets | dict(_built_in_sets())
