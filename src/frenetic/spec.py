"""The spec of a run: what its user says, by the same names everywhere.

A `Spec` is the entries of ``campaign.toml``. The options of `frenetic run` have their names, a
campaign's database and a failing road's file keep them, and Python takes them::

    spec = Spec.of({"driver": "planner,aggression=1.2", "with": {"delay": 0.1}, "seed": 1})
    spec = Spec.of(Spec.read("campaign.toml"), {"simulations": 50})

What a user leaves out stays out. What follows is a property: `Spec.terms`, `Spec.rules`,
`Spec.budget`. `Spec.make_strategy`, `Spec.make_driver` and `Spec.make_simulator` make its parts.

Every command's help reads this module, so slow imports are inside functions.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, Self

import tomli_w
from msgspec import (
    Meta,
    Struct,
    ValidationError,
    convert,
    defstruct,
    field,
    structs,
    to_builtins,
)

from frenetic import trust
from frenetic._support.bounds import (
    Count,
    Index,
    NotNegative,
    Positive,
    Text,
    check,
    converted,
    is_number,
    require_count,
)
from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_json, read_toml
from frenetic._support.scalars import take_numpy_scalars
from frenetic._support.words import (
    counted,
    format_duration,
    parse_duration,
    part_word,
    read_part,
    shortened,
)
from frenetic.criteria import Profile
from frenetic.description import PARTS
from frenetic.errors import FreneticError
from frenetic.quantities import SEED, SPEED, quantities, quantity
from frenetic.registry import SIMULATORS, Made, hint

# Imports inside functions below are too slow for help.

if TYPE_CHECKING:
    from frenetic.domain import Domain
    from frenetic.drive import Rules
    from frenetic.drivers import Driver
    from frenetic.road.classes import RoadClass
    from frenetic.search import Strategy
    from frenetic.simulators.capabilities import Usual
    from frenetic.simulators.simulator import Simulator
    from frenetic.terms import Terms

DRIVEN: Final = "driven"
"""Entry of a road's file that says how the road was driven, see `Spec.driving`."""
FILE: Final = "campaign.toml"
"""Name of the file in a campaign's folder with the entries of its spec."""
COMPETITION: Final = "competition"
"""Name of the roads that keep the competition's rules alone, in place of a road class."""
USUAL: Final = {"strategy": "frenetic", "driver": "planner", "simulator": "embedded"}
"""Parts of a spec that names none."""
MAX_WORKERS: Final = 1024
"""Most roads that one computer drives at once; a cluster has as many seats as it has."""


class Part(NamedTuple):
    """The name of a strategy, driver or simulator, and its options."""

    name: str
    """A registered name, ``package.module:Class`` or ``file.py:Class``."""
    options: Mapping[str, Any]

    def __str__(self) -> str:
        return part_word(self.name, self.options)


def _followed_by(earlier: str, later: str) -> str:
    """The text of another part with its own options, or of an earlier one with options added."""
    name, options = read_part(earlier)
    later_name, later_options = read_part(later)
    if later_name is not None and name not in (None, later_name):
        return later
    return part_word(later_name or name, {**options, **later_options})


@dataclass(frozen=True)
class Budget:
    """The budget of a campaign. Only drives cost simulations; INVALID roads are free.

    Raises:
        ValueError: nothing is limited, or a limit is not positive.
    """

    simulations: int | None = None
    """Number of drives."""
    time: float | None = None
    """Wall time, in s."""
    failures: int | None = None
    """Number of FAIL outcomes wanted."""

    def __post_init__(self) -> None:
        if self.simulations is None and self.time is None and self.failures is None:
            raise ValueError(
                "the budget limits nothing: simulations, time or failures has to be given"
            )
        for name in ("simulations", "failures"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, require_count(name, value))
        if self.time is not None and not (is_number(self.time) and self.time > 0.0):
            raise ValueError(f"time is {self.time}: a positive number of seconds is needed")
        take_numpy_scalars(self)

    def __str__(self) -> str:
        """Return the limits with their units, such as "60 simulations, 17.2 s of time"."""
        texts = []
        if self.simulations is not None:
            texts.append(counted(self.simulations, "simulation"))
        if self.time is not None:
            is_short = self.time < 60.0
            text = f"{self.time:.3g} s" if is_short else format_duration(self.time)
            texts.append(f"{text} of time")
        if self.failures is not None:
            texts.append(counted(self.failures, "failure"))
        return ", ".join(texts)

    def spent(self, simulations: int, seconds: float, failures: int) -> float:
        """Spent share of the budget, 0..1: that of the nearest limit."""
        shares = [0.0]
        if self.simulations is not None:
            shares.append(simulations / self.simulations)
        if self.time is not None:
            shares.append(seconds / self.time)
        if self.failures is not None:
            shares.append(failures / self.failures)
        return min(max(shares), 1.0)


def _about(text: str, metavar: str = "") -> Meta:
    """What an entry says, and the placeholder of its option's value on the command line."""
    return Meta(description=text, extra={"metavar": metavar})


class Spec(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True, dict=True
):
    """What a user says of a run; an entry that is None or empty is not said.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: there are no such roads, criteria or quantities.
    """

    strategy: Annotated[
        Text | None, _about("How to search ('frenetic list strategies'). [default: frenetic]")
    ] = None
    driver: Annotated[
        Text | None,
        _about(
            "Who drives: a name ('frenetic list drivers'), package.module:Class, file.py:Class or"
            " model.onnx. [default: as recorded, or planner]"
        ),
    ] = None
    simulator: Annotated[
        Text | None,
        _about(
            "What moves the car ('frenetic list simulators'). [default: as recorded, or embedded]"
        ),
    ] = None
    conditions: Annotated[
        dict[str, float],
        _about(
            "A condition: delay=0.1, friction=0.5; may be repeated ('frenetic list quantities').",
            "NAME=VALUE",
        ),
    ] = field(name="with", default_factory=dict)
    speed_limit: Positive | None = None
    """km/h, also where a road has a limit of its own."""
    oob_tolerance: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    """Share of the car's box that may be outside its lane."""
    criteria: Annotated[
        Text | dict[str, Any] | None,
        _about(
            "What fails beside leaving the lane, or FILE.toml ('frenetic list criteria'). With"
            " rules: competition,speed_limit=70,oob_tolerance=0.95, the default.",
            "PROFILE",
        ),
    ] = None
    wall_limit: Positive | None = None
    """s of wall time that a drive may take; a worker is replaced after 1.5 times that and 10 s."""
    roads: Annotated[
        Text | dict[str, Any] | None,
        _about(
            "Roads that may exist: rural-80, say, or FILE.toml ('frenetic list roads')."
            " [default: competition]",
            "CLASS",
        ),
    ] = None
    odd: Annotated[
        Text | dict[str, Any] | None, _about("Domain (TOML): roads, conditions to search.", "FILE")
    ] = None
    map_size: Annotated[Positive | None, _about("m, side of the map. [default: 200]", "FLOAT")] = (
        None
    )
    margin: NotNegative | None = None
    """m that a road's centre line keeps from the map's edge."""
    lane_width: Positive | None = None
    """m."""
    objective: Annotated[
        Text | None,
        _about(
            "What gets worse ('frenetic list objectives'), or file.py:function. [default: moobd, or"
            " criteria]",
            "NAME",
        ),
    ] = None
    simulations: Annotated[Count | None, _about("Stop after N drives. [default: 1000]", "N")] = None
    time: Annotated[
        Positive | str | None, _about("Stop after this time: 90s, 10m, 1h30m.", "TIME")
    ] = None
    """s once it is read."""
    failures: Annotated[Count | None, _about("Stop after N failures.", "N")] = None
    start_from: Annotated[
        tuple[Text, ...],
        _about(
            "Start from an earlier campaign: what failed there is driven first; may be repeated.",
            "CAMPAIGN",
        ),
    ] = field(name="from", default=())
    from_roads: Annotated[
        Text | None,
        _about(
            "Start from real roads, .xodr or .json, and keep to the class that they show.", "DIR"
        ),
    ] = None
    seed: Annotated[Index | None, _about("Repeats a search. [default: a new one]", "N")] = None
    lookahead: Count | None = None
    """Roads that are proposed ahead."""
    workers: Annotated[
        Count | str | None,
        _about(
            "Drive on N roads at once, or on a Dask cluster, tcp://10.0.0.1:8786. [default: the"
            " cores, or 1]",
            "N|ADDRESS",
        ),
    ] = None

    def __post_init__(self) -> None:
        said = converted(self.said, Spec)
        said |= {kind: part_word(*read_part(said[kind])) for kind in PARTS if kind in said}
        for name, amount in said.get("conditions", {}).items():
            if name != SEED and amount != quantity(name).nothing:
                quantity(name).require(amount)
        if "criteria" in said:
            said |= converted(_read_criteria(said["criteria"]), Spec)
        if "roads" in said:
            said["roads"] = _roads_entry(_read_class(said["roads"]))
        if "odd" in said:
            said["odd"] = _read_domain(said["odd"]).entries()
        if isinstance(self.time, str):
            said["time"] = parse_duration(self.time)
        if isinstance(self.workers, str):
            said["workers"] = read_workers(self.workers)
        elif self.workers is not None and self.workers > MAX_WORKERS:
            raise ValueError(f"workers is {self.workers}: at most {MAX_WORKERS} are allowed")
        for name, value in said.items():
            structs.force_setattr(self, name, value)

    # From and to entries

    @classmethod
    def of(cls, *sources: Spec | Mapping[str, Any]) -> Self:
        """The spec of several sources, of which later ones win.

        Options are added to those of an earlier part of the same name, and conditions to earlier
        ones; an amount without effect removes a condition. Roads bring their own speed limit, map
        and lanes, so those of earlier sources are left out, as is the wall limit of an earlier
        simulator that is another.

        Args:
            sources: specs, and entries by their names in a file.

        Raises:
            ValueError: an entry is unknown, of another kind or out of range; the message names it.
            FreneticError: there are no such roads, criteria or quantities.
        """
        spec = cls()
        for source in sources:
            spec = spec._followed_by(
                source if isinstance(source, Spec) else _converted(source, cls)
            )
        return spec

    def _followed_by(self, later: Spec) -> Self:
        """The same with the entries of a later source in place of its own."""
        values = {n: getattr(self, n) for n in self.__struct_fields__}
        given = later.said
        conditions = dict(self.conditions)
        if later._names_roads:
            values |= dict.fromkeys(("roads", "speed_limit", "map_size", "lane_width"))
        if later._names_roads or later.speed_limit is not None:
            conditions.pop(SPEED, None)
        if later.simulator is not None:
            simulator, _ = read_part(later.simulator)
            if simulator not in (None, self.part("simulator").name):
                values["wall_limit"] = None
        for kind in PARTS:
            if kind in given and values[kind] is not None:
                given[kind] = _followed_by(values[kind], given[kind])
        given["conditions"] = {
            name: amount
            for name, amount in (conditions | later.conditions).items()
            if name == SEED or amount != quantity(name).nothing
        }
        return structs.replace(self, **values | given)

    @property
    def _names_roads(self) -> bool:
        """Whether it says which roads may exist."""
        odd_roads = isinstance(self.odd, Mapping) and self.odd.get("roads") is not None
        return self.roads is not None or self.from_roads is not None or odd_roads

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """The spec in a file, such as a campaign's ``campaign.toml``.

        Raises:
            FreneticError: there is no such file, or it is wrong; the message names the place in it.
        """
        if (inside := Path(path) / FILE).is_file():
            raise FreneticError(f"{path} is a campaign's folder: its file is {inside}")
        spec: Self = read_entries(Path(path), cls, "a run")
        return spec

    @classmethod
    def read_driven(cls, path: Path | str) -> Self:
        """How a file says that roads are driven: that of a campaign's failing road, for example.

        Args:
            path: a JSON file with the entries of `driving` as its entry ``driven``; the map may
                have lanes of another width (``lane_width``, m). Other entries are not read.

        Raises:
            FreneticError: there is no such file, or it does not say it.
        """
        data = read_bounded(Path(path))
        file_type = defstruct("File", [(DRIVEN, Any), ("lane_width", Positive, 4.0)])
        try:
            file: Any = read_json(data, file_type)
        except ValueError as error:
            raise FreneticError(f"{path} does not say how roads are driven: {error}") from None
        spec = cls.of_driven(file.driven, source=path)
        return structs.replace(spec, lane_width=file.lane_width)

    @classmethod
    def of_driven(cls, entries: Any, *, source: object) -> Self:
        """The spec in a road file's entry ``driven``.

        Args:
            entries: as `driving` gives them.
            source: name of the file for messages.

        Raises:
            FreneticError: they are none.
        """
        try:
            if not isinstance(entries, Mapping):
                raise ValueError("names with values are needed")
            if missing := [name for name in ("driver", "simulator") if name not in entries]:
                raise ValueError(f"it has no {missing[0]}")
            return cls.of(entries)
        except (ValueError, FreneticError) as error:
            raise FreneticError(
                f"{source}: its entry {DRIVEN!r} does not say with what the road was driven:"
                f" {error}; remove the entry and name a driver"
            ) from None

    @property
    def said(self) -> dict[str, Any]:
        """Names of the attributes that it says -> their values."""
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        return {name: value for name, value in values.items() if value != _UNSAID.get(name)}

    def entries(self) -> dict[str, Any]:
        """What it says, by the names of the entries in a file."""
        entries: dict[str, Any] = to_builtins(self)
        return entries

    def write(self, folder: Path) -> None:
        """Write its file into the folder of its campaign.

        Raises:
            FreneticError: it cannot be written.
        """
        about = f"What ran in this folder; 'frenetic run {FILE}' does it again in another."
        write_entries(self.entries(), folder / FILE, about)

    def driving(self, *, has_roads: bool = False) -> Spec:
        """What it says of how roads are driven.

        Args:
            has_roads: whether the roads exist, with a map and a lane width of their own.
        """
        entries = _DRIVING if has_roads else (*_DRIVING, "roads", *_ROADS)
        said = {name: getattr(self, name) for name in entries}
        if not has_roads and self._names_roads:
            said["roads"] = _roads_entry(self.road_class)
        return Spec(**said)

    @classmethod
    def of_terms(cls, terms: Terms) -> Self:
        """The spec that says some terms."""
        said: dict[str, Any] = {name: getattr(terms, name) for name in _ROADS}
        said |= {"roads": _roads_entry(terms.road_class), "conditions": dict(terms.conditions)}
        return cls(**said, odd=None if terms.domain is None else terms.domain.entries())

    def in_conditions(self, conditions: Mapping[str, float]) -> Spec:
        """The same in further conditions."""
        return Spec.of(self, {"with": dict(conditions)})

    def without_driving(self, *, has_roads: bool = False) -> Spec:
        """The same without what `driving` gives."""
        entries = _DRIVING if has_roads else (*_DRIVING, "roads", *_ROADS)
        unsaid = Spec()
        return structs.replace(self, **{name: getattr(unsaid, name) for name in entries})

    def require_trusted(self, source: object, named: Collection[str] = (), **more: str) -> None:
        """Checks that what a file or campaign names may be made, see `frenetic.trust`.

        Args:
            source: the file or campaign.
            named: kinds of parts that the command names itself.
            more: ``remedy`` and ``started_in``, as for `frenetic.trust.require`.

        Raises:
            FreneticError: a part may not.
        """
        parts: dict[str, Any] = {kind: self.part(kind) for kind in PARTS if getattr(self, kind)}
        parts["objective"] = (self.named_objective, {})
        trust.require(parts, source, named, **more)

    # What follows from it

    def part(self, kind: str) -> Part:
        """The strategy, driver or simulator; the usual one if it names none."""
        name, options = read_part(getattr(self, kind) or USUAL[kind])
        return Part(name or USUAL[kind], options)

    @cached_property
    def road_class(self) -> RoadClass | None:
        """Class whose rules its roads keep; None for the competition's."""
        if self.roads is not None:
            return _read_class(self.roads)
        if self.domain is not None and self.domain.road_class is not None:
            return self.domain.road_class
        if self.from_roads is not None:
            from frenetic.road.stretches import shown_class  # numba takes its time

            return shown_class(self.from_roads)
        return None

    @cached_property
    def domain(self) -> Domain | None:
        """Domain whose roads and conditions are searched; None for the usual conditions."""
        return None if self.odd is None else _read_domain(self.odd)

    @cached_property
    def rules(self) -> Rules:
        """The rules of its drives, but for a speed limit among its conditions."""
        from frenetic.drive import Rules  # numba takes its time

        return self.rules_over(Rules())

    def rules_over(self, usual: Rules) -> Rules:
        """The rules, where others hold for what it does not say.

        Raises:
            FreneticError: a rule is out of range.
        """
        said: dict[str, Any] = {}
        if self.oob_tolerance is not None:
            said["oob_tolerance"] = self.oob_tolerance
        if self.criteria is not None:
            said["criteria"] = _profile(self.criteria)
        if self.speed_limit is not None:
            said |= {"speed_limit": self.speed_limit, "road_limits": "ignored"}
        elif self.road_class is not None:
            said |= {"speed_limit": self.road_class.speed_limit, "road_limits": "kept"}
        try:
            return replace(usual, **said)
        except ValueError as error:
            raise FreneticError(str(error)) from None

    @cached_property
    def terms(self) -> Terms:
        """What holds for every drive beside driver, simulator and rules.

        Raises:
            ValueError: the map is too small for its margin, say.
        """
        from frenetic.terms import Terms  # numba takes its time

        said = {name: value for name in _ROADS if (value := getattr(self, name)) is not None}
        said |= {"domain": self.domain, "conditions": self.conditions}
        return Terms.of_class(self.road_class, **said)

    @property
    def budget(self) -> Budget | None:
        """Its limits; None if it says none."""
        limits: dict[str, Any] = {name: getattr(self, name) for name in _LIMITS}
        return Budget(**limits) if any(limits.values()) else None

    @property
    def named_objective(self) -> str:
        """Name of what the strategy minimises: by default the MOOBD, or the margin to criteria."""
        usual = "moobd" if self.criteria is None or not _profile(self.criteria) else "criteria"
        return self.objective or usual

    @property
    def names(self) -> list[str]:
        """Names of its parts and of its objective."""
        return [*(self.part(kind).name for kind in PARTS), self.named_objective]

    @property
    def amounts(self) -> dict[str, float]:
        """Amounts of quantities that it says, as conditions or as options of the simulator."""
        rows = {row.attribute: row.name for row in quantities().values() if row.attribute}
        options = self.part("simulator").options
        return {rows[n]: amount for n, amount in options.items() if n in rows} | self.conditions

    # To parts

    def make_strategy(self) -> Strategy:
        """The strategy, with seed, map size and this spec if its class takes them.

        Raises:
            FreneticError: it cannot be made.
        """
        strategy: Strategy = self._make("strategy")
        domain = self.domain
        if domain is not None and domain.conditions and strategy.domain is None:
            raise FreneticError(
                f"the strategy {self.part('strategy').name} searches roads alone, not the"
                f" conditions of {domain.name}: choose frenetic or random"
            )
        return strategy

    def make_driver(self) -> Driver:
        """The driver.

        Raises:
            FreneticError: it cannot be made.
        """
        driver: Driver = self._make("driver")
        return driver

    def make_simulator(self, rules: Rules | None = None) -> Simulator:
        """The simulator, with rules and wall limit if its class takes them; not yet entered.

        Args:
            rules: by default those of the spec.

        Raises:
            FreneticError: it cannot be made.
        """
        simulator: Simulator = self._make("simulator", rules)
        return simulator

    def made(self, kind: str, rules: Rules | None = None) -> Made:
        """How the strategy, driver or simulator is made; raises if it cannot be loaded."""
        part = self.part(kind)
        return trust.REGISTRIES[kind].made(*part, self._available(kind, rules))

    def _make(self, kind: str, rules: Rules | None = None) -> Any:
        part = self.part(kind)
        made = trust.REGISTRIES[kind].make_from(*part, self._available(kind, rules))
        trust.remember(kind, *part)
        return made

    def _available(self, kind: str, rules: Rules | None) -> dict[str, Any]:
        """Options that a part gets if its class takes them."""
        if kind == "driver":
            return {}
        if kind == "simulator":
            limit = self.wall_limit or usual_of(self.part(kind).name).usual_wall_limit
            return {"rules": self.rules if rules is None else rules, "wall_limit": limit}
        terms = self.terms
        of_terms = {name: getattr(terms, name) for name in ("map_size", "road_class", "domain")}
        return {"seed": self.seed, **of_terms, "spec": self}


_UNSAID: Final[Mapping[str, Any]] = {"conditions": {}, "start_from": ()}
"""Values of entries that are not said, if they are not None."""
_DRIVING: Final = (
    *("driver", "simulator", "conditions", "speed_limit", "oob_tolerance", "criteria"),
    "wall_limit",
)
"""Entries that say how roads are driven."""
_ROADS: Final = ("map_size", "margin", "lane_width")
"""Entries that say where roads lie, and how wide they are."""
_LIMITS: Final = ("simulations", "time", "failures")
"""Entries that are limits of the budget."""


# Entries


def _converted(entries: Mapping[str, Any], kind: type[Any]) -> Any:
    """Entries as a struct of this kind.

    Raises:
        ValueError: one is unknown, missing, of another kind or out of range; the message names it.
    """
    known = [item.encode_name for item in structs.fields(kind)]
    if unknown := [name for name in entries if name not in known]:
        raise ValueError(f"there is no entry {unknown[0]!r}{hint(unknown[0], known)}")
    check(entries, kind)
    try:
        return convert(dict(entries), kind)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def read_entries(path: Path, kind: type[Any], about: str, *usual: Mapping[str, Any]) -> Any:
    """The entries of a file in TOML as a struct.

    Args:
        path: of the file.
        kind: of struct.
        about: what it says, for messages.
        usual: entries that hold where the file says nothing.

    Raises:
        FreneticError: there is no such file, or it is wrong; the message names the place in it.
    """
    data = read_bounded(path)
    try:
        entries = read_toml(data)
        for others in usual:
            entries = {**others, **entries}
        return _converted(entries, kind)
    except ValueError as error:
        raise FreneticError(f"{path} does not say {about}: {error}") from None
    except FreneticError as error:
        raise FreneticError(f"{path}: {error}") from None


def write_entries(entries: Mapping[str, Any], path: Path, about: str) -> None:
    """Write a file in TOML, but for entries that say nothing, under a line about it.

    Raises:
        FreneticError: it cannot be written.
    """
    said = {name: value for name, value in entries.items() if value not in (None, {}, [])}
    text = f"# {about}\n{tomli_w.dumps(said)}"
    write_file(path, text, remedy="make room, or let it be written")


def _read_class(roads: str | Mapping[str, Any]) -> RoadClass | None:
    from frenetic.road.classes import class_of  # numba takes its time

    return class_of(roads)


def _roads_entry(road_class: RoadClass | None) -> str | dict[str, Any]:
    """The entry for a road class: its name if that says all."""
    from frenetic.road.classes import RoadClass, classes  # numba takes its time

    if road_class is None:
        return COMPETITION
    name = road_class.name
    is_known = name in classes() and RoadClass.of(name) == road_class
    return name if is_known else road_class.as_json()


def _read_domain(odd: str | Mapping[str, Any]) -> Domain:
    from frenetic.domain import Domain  # numba takes its time

    if isinstance(odd, str):
        return Domain.of(odd)
    return Domain.made(str(odd.get("name", "own")), odd)


def _profile(criteria: str | Mapping[str, Any]) -> Profile:
    """The criteria of an entry that `_read_criteria` gave."""
    if isinstance(criteria, str):
        name, options = read_part(criteria)
        return Profile.of(name or COMPETITION, options)
    entries = {key: value for key, value in criteria.items() if key != "name"}
    return Profile.made(str(criteria.get("name", "own")), entries)


def _read_criteria(criteria: str | Mapping[str, Any]) -> dict[str, Any]:
    """The entries that a text such as ``after-iso-11270,lateral_jerk=4,speed_limit=60`` says.

    A text that says rules alone gives no criteria.
    """
    rules: dict[str, Any] = {}
    if isinstance(criteria, str):
        name, options = read_part(criteria)
    else:
        name, options = str(criteria.get("name", "own")), dict(criteria)
    for rule in ("speed_limit", "oob_tolerance"):
        if rule in options:
            rules[rule] = options.pop(rule)
    if isinstance(criteria, str) and name is None and not options:
        return {**rules, "criteria": None}
    profile = _profile(part_word(name, options) if isinstance(criteria, str) else options)
    return {**rules, "criteria": profile.entry()}


def read_workers(text: str) -> int | str:
    """A number of workers, or the address of a Dask scheduler.

    Raises:
        ValueError: it is neither.
    """
    if re.fullmatch("-?[0-9]+", text):
        if len(text) <= 9 and 1 <= int(text) <= MAX_WORKERS:
            return int(text)
        raise ValueError(f"{shortened(text, 60)} workers are given: 1 to {MAX_WORKERS} are allowed")
    if ":" not in text:
        raise ValueError(
            f"{text!r} is neither a number nor the address of a Dask scheduler, such as"
            " tcp://10.0.0.1:8786"
        )
    return text


# Parts


def usual_of(simulator: str) -> Usual:
    """What the class of the simulator of that name declares before one is made."""
    from frenetic.simulators.capabilities import usual  # numba takes its time

    return usual(SIMULATORS.load(simulator))
