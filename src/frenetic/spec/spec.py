"""The `Spec` of a run, see `frenetic.spec`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Self

from msgspec import (
    Meta,
    Struct,
    defstruct,
    field,
    structs,
    to_builtins,
)

from frenetic._support.bounds import (
    Count,
    Index,
    NotNegative,
    Positive,
    Text,
    converted,
)
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_json
from frenetic._support.words import (
    parse_duration,
    part_word,
    read_part,
)
from frenetic.conditions.condition import SEED, SPEED, amounts_in, quantity, require_allowed
from frenetic.errors import FreneticError
from frenetic.parts import trust
from frenetic.parts.registry import Made
from frenetic.spec.budget import Budget
from frenetic.spec.files import (
    DRIVEN,
    SIGNED,
    converted_entries,
    read_entries,
    write_entries,
)
from frenetic.spec.part_record import PARTS
from frenetic.spec.parts import USUAL, Part, followed_by, usual_of
from frenetic.spec.values import (
    MAX_WORKERS,
    criteria_entries,
    read_class,
    read_domain,
    read_profile,
    read_workers,
    roads_entry,
)

# Imports inside functions below are too slow for help.

if TYPE_CHECKING:
    from frenetic.conditions.domain import Domain
    from frenetic.drivers import Driver
    from frenetic.oracle.drive import Rules
    from frenetic.road.classes import RoadClass
    from frenetic.search import Strategy
    from frenetic.simulators.simulator import Simulator
    from frenetic.spec.terms import Terms

FILE: Final = "campaign.toml"
"""Name of the file in a campaign's folder with the entries of its spec."""


def _about(text: str, metavar: str = "") -> Meta:
    """What an entry says, and the placeholder of its option's value on the command line."""
    return Meta(description=text, extra={"metavar": metavar})


class Signed(Struct, frozen=True, forbid_unknown_fields=True):
    """The user's signature of the code that a file names, see `frenetic.parts.trust`."""

    folder: str
    """From which the code is loaded."""
    signature: str


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
    signed: Signed | None = None
    """Of a spec that is read from a file, or written into one."""

    def __post_init__(self) -> None:
        said = converted(self.said, Spec)
        said |= {kind: part_word(*read_part(said[kind])) for kind in PARTS if kind in said}
        require_allowed(said.get("conditions", {}))
        if "criteria" in said:
            entries = converted(criteria_entries(said["criteria"]), Spec)
            for rule in sorted(entries.keys() & said.keys() - {"criteria"}):
                if said[rule] != entries[rule]:
                    raise ValueError(
                        f"{rule} is {said[rule]:g}, and {entries[rule]:g} in the criteria: leave"
                        " out one of the two"
                    )
            said |= entries
        if "roads" in said:
            said["roads"] = roads_entry(read_class(said["roads"]))
        if "odd" in said:
            said["odd"] = read_domain(said["odd"]).entries()
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
        ones; an amount without effect removes a condition, and so does an option of a later
        simulator that sets it. Roads bring their own speed limit, map
        and lanes, so those of earlier sources are left out, as is the wall limit of an earlier
        simulator that is another. What is merged is not signed.

        Args:
            sources: specs, and entries by their names in a file.

        Raises:
            ValueError: an entry is unknown, of another kind or out of range; the message names it.
            FreneticError: there are no such roads, criteria or quantities.
        """
        spec = cls()
        for source in sources:
            spec = spec._followed_by(
                source if isinstance(source, Spec) else converted_entries(source, cls)
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
            simulator, options = read_part(later.simulator)
            for name in amounts_in(options):
                conditions.pop(name, None)
            if simulator not in (None, self.part("simulator").name):
                values["wall_limit"] = None
        for kind in PARTS:
            if kind in given and values[kind] is not None:
                given[kind] = followed_by(values[kind], given[kind])
        given[SIGNED] = None
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
            spec: Self = converted_entries(entries, cls)
            return structs.replace(cls.of(spec), signed=spec.signed)
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
        entries = _DRIVING if has_roads else (*_DRIVING, "roads", *_TERMS)
        said = {name: getattr(self, name) for name in entries}
        if not has_roads and self._names_roads:
            said["roads"] = roads_entry(self.road_class)
        return Spec(**said)

    @classmethod
    def of_terms(cls, terms: Terms) -> Self:
        """The spec that says some terms."""
        said: dict[str, Any] = {name: getattr(terms, name) for name in _TERMS}
        said |= {"roads": roads_entry(terms.road_class), "conditions": dict(terms.conditions)}
        return cls(**said, odd=None if terms.domain is None else terms.domain.entries())

    def in_conditions(self, conditions: Mapping[str, float]) -> Spec:
        """The same in further conditions, which name no code, so that it stays signed."""
        return structs.replace(Spec.of(self, {"with": dict(conditions)}), signed=self.signed)

    def without_driving(self, *, has_roads: bool = False) -> Spec:
        """The same without what `driving` gives."""
        entries = _DRIVING if has_roads else (*_DRIVING, "roads", *_TERMS)
        unsaid = Spec()
        return structs.replace(self, **{name: getattr(unsaid, name) for name in entries})

    # Code that it names

    @property
    def parts(self) -> dict[str, Part]:
        """Kind -> part of those that it names, and its objective.

        A scheduler is one, too: Dask lets it send objects, whose loading runs code.
        """
        parts = {kind: self.part(kind) for kind in PARTS if getattr(self, kind)}
        if isinstance(self.workers, str):
            parts["workers"] = Part(self.workers, {})
        return parts | {"objective": Part(self.named_objective, {})}

    @property
    def code(self) -> list[str]:
        """Kinds of its parts that name code, see `frenetic.parts.trust`."""
        return [*trust.named_code(self.parts)]

    def signed_in(
        self,
        folder: Path | str | None,
        sources: object = None,
        others: trust.Parts = MappingProxyType({}),
    ) -> Self:
        """The same with its user's signature of the code that it names, see `frenetic.parts.trust`.

        It is unsigned if it names none, or if the user's key cannot be written.

        Args:
            folder: from which the code is loaded; None for the current one.
            sources: name of a file -> its text, which are stored beside it.
            others: other parts that are named beside it, such as a bench's entrants.
        """
        place = Path(folder or "").absolute()
        signature = trust.sign(trust.named_code({**self.parts, **others}), place, sources)
        signed = Signed(str(place), signature) if signature else None
        return structs.replace(self, signed=signed)

    def require_trusted(
        self, source: Path | str, *, others: trust.Parts = MappingProxyType({}), **how: Any
    ) -> Path:
        """The folder from which the code may be loaded that it names, see `frenetic.parts.trust`.

        Args:
            source: the file or campaign that says this spec.
            others: other parts that it names, such as a bench's entrants.
            how: other arguments of `frenetic.parts.trust.require_trusted`.

        Raises:
            FreneticError: the user has not trusted it.
        """
        signed = self.signed or Signed("", "")
        return trust.require_trusted(
            source,
            {**self.parts, **others},
            signature=signed.signature,
            folder=signed.folder,
            **how,
        )

    def with_files_in(self, folders: Mapping[str, Path]) -> Self:
        """The same with absolute paths in place of the files of some parts.

        Args:
            folders: kind of such a part -> folder from which its files go.

        Raises:
            FreneticError: a part is a module, which has no path.
        """
        said: dict[str, str] = {}
        for kind, folder in folders.items():
            name, options = trust.REGISTRIES[kind].absolute(*self.parts[kind], folder)
            said[kind] = part_word(name, options) if kind in PARTS else name
        return structs.replace(self, **said)

    def with_roads_from(self, folder: Path) -> Self:
        """The same with absolute paths of the campaigns and roads that it starts from.

        Args:
            folder: from which their paths go.
        """
        roads = None if self.from_roads is None else str(folder / self.from_roads)
        starts = tuple(str(folder / start) for start in self.start_from)
        return structs.replace(self, from_roads=roads, start_from=starts)

    # What follows from it

    def part(self, kind: str) -> Part:
        """The strategy, driver or simulator; the usual one if it names none."""
        name, options = read_part(getattr(self, kind) or USUAL[kind])
        return Part(name or USUAL[kind], options)

    @cached_property
    def road_class(self) -> RoadClass | None:
        """Class whose rules its roads keep; None for the competition's."""
        if self.roads is not None:
            return read_class(self.roads)
        if self.domain is not None and self.domain.road_class is not None:
            return self.domain.road_class
        if self.from_roads is not None:
            from frenetic.road.real_roads import shown_class  # numba takes its time

            return shown_class(self.from_roads)
        return None

    @cached_property
    def domain(self) -> Domain | None:
        """Domain whose roads and conditions are searched; None for the usual conditions."""
        return None if self.odd is None else read_domain(self.odd)

    @cached_property
    def rules(self) -> Rules:
        """The rules of its drives, but for a speed limit among its conditions."""
        from frenetic.oracle.drive import Rules  # numba takes its time

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
            said["criteria"] = read_profile(self.criteria)
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
        from frenetic.spec.terms import Terms  # numba takes its time

        said = {name: value for name in _TERMS if (value := getattr(self, name)) is not None}
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
        usual = "moobd" if self.criteria is None or not read_profile(self.criteria) else "criteria"
        return self.objective or usual

    @property
    def names(self) -> list[str]:
        """Names of its parts and of its objective."""
        return [*(self.part(kind).name for kind in PARTS), self.named_objective]

    @property
    def amounts(self) -> dict[str, float]:
        """Amounts of quantities that it says, as conditions or as options of the simulator."""
        return amounts_in(self.part("simulator").options) | self.conditions

    # To parts

    def make_strategy(self) -> Strategy:
        """The strategy; its class may take seed, map size, road class, domain and this spec.

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
        return trust.REGISTRIES[kind].make_from(*part, self._available(kind, rules))

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
_TERMS: Final = ("map_size", "margin", "lane_width")
"""Entries that `Terms` has by the same names; of roads that exist, they do not count."""
_LIMITS: Final = ("simulations", "time", "failures")
"""Entries that are limits of the budget."""
