"""The `Spec` of a run, see `frenetic.spec`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Self, Unpack

from msgspec import defstruct, structs

from frenetic._support.bounds import Positive
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_json
from frenetic._support.words import part_word, read_part
from frenetic.conditions.condition import SEED, SPEED, amounts_in, condition_named
from frenetic.errors import FreneticError
from frenetic.parts.construction import Construction
from frenetic.parts.named_code import REGISTRIES, Parts, named_code
from frenetic.parts.signatures import sign
from frenetic.parts.trust import CodeClaim, TrustOptions, require_trusted
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
from frenetic.spec.run_entries import RunEntries, Signed
from frenetic.spec.values import read_class, read_domain, read_profile, roads_entry

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


class Spec(RunEntries, frozen=True, kw_only=True):
    """The spec of a run: the entries that its user sets, and what follows from them.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: no roads, criteria or conditions have this name.
    """

    # From and to entries

    @classmethod
    def of(cls, *sources: Spec | Mapping[str, Any]) -> Self:
        """Return the spec of several sources, of which later ones win.

        Options are added to the options of an earlier part of the same name, and conditions to
        earlier conditions; an amount without effect removes a condition, and so does an option of a
        later simulator that sets it. Roads bring their own speed limit, map and lanes, so earlier
        ones are left out. Another simulator drops the wall limit. A merged spec is not signed.

        Args:
            sources: specs, and entries by their names in a file.

        Raises:
            ValueError: an entry is unknown, of another kind or out of range; the message names it.
            FreneticError: no roads, criteria or conditions have this name.
        """
        spec = cls()
        for source in sources:
            spec = spec._followed_by(
                source if isinstance(source, Spec) else converted_entries(source, cls)
            )
        return spec

    def _followed_by(self, later: Spec) -> Self:
        """Return the spec with the entries of a later source in place of its own."""
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        later_values = later.user_values
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
            if kind in later_values and values[kind] is not None:
                later_values[kind] = followed_by(values[kind], later_values[kind])
        later_values[SIGNED] = None
        later_values["conditions"] = {
            name: amount
            for name, amount in (conditions | later.conditions).items()
            if name == SEED or amount != condition_named(name).nothing
        }
        return structs.replace(self, **values | later_values)

    @property
    def _names_roads(self) -> bool:
        """Whether it sets the roads that may exist."""
        odd_roads = isinstance(self.odd, Mapping) and self.odd.get("roads") is not None
        return self.roads is not None or self.from_roads is not None or odd_roads

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """Return the spec in a file, such as a campaign's ``campaign.toml``.

        Raises:
            FreneticError: the file does not exist, or an entry is wrong; the message names it.
        """
        if (inside := Path(path) / FILE).is_file():
            raise FreneticError(f"{path} is a campaign's folder: its file is {inside}")
        spec: Self = read_entries(Path(path), cls, "a run")
        return spec

    @classmethod
    def read_driven(cls, path: Path | str) -> Self:
        """Return the spec with which a road's file says that the road was driven.

        Args:
            path: a JSON file with the entries of a `driving_spec` as its entry ``driven``; the map
                may have lanes of another width (``lane_width``, m). Other entries are not read.

        Raises:
            FreneticError: the file does not exist, or lacks a usable entry ``driven``.
        """
        from frenetic.road import LANE_WIDTH  # too slow for help

        data = read_bounded(Path(path))
        file_type = defstruct("File", [(DRIVEN, Any), ("lane_width", Positive, LANE_WIDTH)])
        try:
            file: Any = read_json(data, file_type)
        except ValueError as error:
            raise FreneticError(f"{path} does not say how roads are driven: {error}") from None
        spec = cls.of_driven(file.driven, source=path)
        return structs.replace(spec, lane_width=file.lane_width)

    @classmethod
    def of_driven(cls, entries: Any, *, source: object) -> Self:
        """Return the spec in a road file's entry ``driven``.

        Args:
            entries: of a `driving_spec`.
            source: name of the file for messages.

        Raises:
            FreneticError: the entries lack driver or simulator, or an entry is wrong.
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

    def write(self, folder: Path) -> None:
        """Write the file of the spec into the folder of its campaign.

        Raises:
            FreneticError: the file cannot be written.
        """
        about = f"What ran in this folder; 'frenetic run {FILE}' does it again in another."
        write_entries(self.entries(), folder / FILE, about)

    def driving_spec(self, *, has_roads: bool = False) -> Spec:
        """Return the entries about how roads are driven.

        Args:
            has_roads: whether the roads exist, with a map and a lane width of their own.
        """
        entries = DRIVING if has_roads else (*DRIVING, "roads", *_TERMS)
        values = {name: getattr(self, name) for name in entries}
        if not has_roads and self._names_roads:
            values["roads"] = roads_entry(self.road_class)
        return Spec(**values)

    @classmethod
    def of_terms(cls, terms: Terms) -> Self:
        """Return the spec of terms."""
        values: dict[str, Any] = {name: getattr(terms, name) for name in _TERMS}
        values |= {"roads": roads_entry(terms.road_class), "conditions": dict(terms.conditions)}
        return cls(**values, odd=None if terms.domain is None else terms.domain.entries())

    def in_conditions(self, conditions: Mapping[str, float]) -> Spec:
        """Return the spec with further conditions, which name no code, so it stays signed."""
        return structs.replace(Spec.of(self, {"with": dict(conditions)}), signed=self.signed)

    def without_driving(self, *, has_roads: bool = False) -> Spec:
        """Return the spec without the entries of its `driving_spec`."""
        entries = DRIVING if has_roads else (*DRIVING, "roads", *_TERMS)
        empty = Spec()
        return structs.replace(self, **{name: getattr(empty, name) for name in entries})

    def with_budget(self, budget: Budget) -> Self:
        """Return the spec with the limits of a budget."""
        return structs.replace(self, **asdict(budget))

    # Code of the parts

    @property
    def parts(self) -> dict[str, Part]:
        """Kind -> part, of the parts that the user names, and of the objective.

        A scheduler is a part, too: Dask lets it send objects, whose loading runs code.
        """
        parts = {kind: self.part(kind) for kind in PARTS if getattr(self, kind)}
        if isinstance(self.workers, str):
            parts["workers"] = Part(self.workers, {})
        return parts | {"objective": Part(self.named_objective, {})}

    def signed_in(
        self,
        folder: Path | str | None,
        sources: object = None,
        others: Parts = MappingProxyType({}),
    ) -> Self:
        """Return the spec with its user's signature of the named code.

        It is unsigned if it names no code, or if the user's key cannot be written, see
        `frenetic.parts.signatures`.

        Args:
            folder: folder from which the code is loaded; None for the current folder.
            sources: name of a file -> its text, stored beside the spec.
            others: other parts that are named beside the spec, such as a bench's entrants.
        """
        place = Path(folder or "").absolute()
        signature = sign(named_code({**self.parts, **others}), place, sources)
        signed = Signed(str(place), signature) if signature else None
        return structs.replace(self, signed=signed)

    def require_trusted(
        self,
        source: Path | str,
        *,
        others: Parts = MappingProxyType({}),
        sources: object = None,
        **options: Unpack[TrustOptions],
    ) -> Path:
        """Return the folder from which the named code may be loaded, see `frenetic.parts.trust`.

        Args:
            source: the file or campaign that holds this spec.
            others: other parts that the source names, such as a bench's entrants.
            sources: sources that the source stores, as for `frenetic.parts.signatures.sign`.
            options: other options of `frenetic.parts.trust.require_trusted`.

        Raises:
            FreneticError: the user has not trusted it.
        """
        signed = self.signed or Signed("", "")
        parts = {**self.parts, **others}
        claim = CodeClaim(parts, signed.signature, signed.folder, sources)
        return require_trusted(source, claim, **options)

    def with_files_in(self, folders: Mapping[str, Path]) -> Self:
        """Return the spec with absolute paths of the files of some parts.

        Args:
            folders: kind of a part -> folder from which its relative paths go.

        Raises:
            FreneticError: a part is a module, which has no path.
        """
        values: dict[str, str] = {}
        for kind, folder in folders.items():
            name, options = REGISTRIES[kind].absolute(*self.parts[kind], folder)
            values[kind] = part_word(name, options) if kind in PARTS else name
        return structs.replace(self, **values)

    def with_roads_from(self, folder: Path) -> Self:
        """Return the spec with absolute paths of the campaigns and roads from which it starts.

        Args:
            folder: folder from which relative paths go.
        """
        roads = None if self.from_roads is None else str(folder / self.from_roads)
        starts = tuple(str(folder / start) for start in self.start_from)
        return structs.replace(self, from_roads=roads, start_from=starts)

    # What follows from the entries

    def part(self, kind: str) -> Part:
        """Return the strategy, driver or simulator; the usual one if the user names none."""
        name, options = read_part(getattr(self, kind) or USUAL[kind])
        return Part(name or USUAL[kind], options)

    @cached_property
    def road_class(self) -> RoadClass | None:
        """Class whose rules the roads keep; None for the competition's roads."""
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
        """Rules of the drives, apart from a speed limit among the conditions."""
        from frenetic.oracle.drive import Rules  # numba takes its time

        return self.rules_over(Rules())

    def rules_over(self, simulator_rules: Rules) -> Rules:
        """Return a simulator's rules with the rules that the user sets.

        Raises:
            FreneticError: a rule is out of range.
        """
        values: dict[str, Any] = {}
        if self.oob_tolerance is not None:
            values["oob_tolerance"] = self.oob_tolerance
        if self.criteria is not None:
            values["criteria"] = read_profile(self.criteria)
        if self.speed_limit is not None:
            values |= {"speed_limit": self.speed_limit, "road_limits": "ignored"}
        elif self.road_class is not None:
            values |= {"speed_limit": self.road_class.speed_limit, "road_limits": "kept"}
        try:
            return replace(simulator_rules, **values)
        except ValueError as error:
            raise FreneticError(str(error)) from None

    @cached_property
    def terms(self) -> Terms:
        """Map, lanes, roads and conditions of every drive.

        Raises:
            ValueError: an entry does not suit another, such as the margin a small map.
        """
        from frenetic.spec.terms import Terms  # numba takes its time

        values = {name: value for name in _TERMS if (value := getattr(self, name)) is not None}
        values |= {"domain": self.domain, "conditions": self.conditions}
        return Terms.of_class(self.road_class, **values)

    @property
    def budget(self) -> Budget | None:
        """Limits of the run; None without limits."""
        limits: dict[str, Any] = {name: getattr(self, name) for name in _LIMITS}
        return Budget(**limits) if any(limits.values()) else None

    @property
    def named_objective(self) -> str:
        """Name of the objective: by default the MOOBD, or with criteria the margin to them."""
        has_criteria = self.criteria is not None and bool(read_profile(self.criteria))
        return self.objective or ("criteria" if has_criteria else "moobd")

    @property
    def amounts(self) -> dict[str, float]:
        """Amounts of the conditions that the user sets, also as options of the simulator."""
        return amounts_in(self.part("simulator").options) | self.conditions

    # To parts

    def make_strategy(self) -> Strategy:
        """Make the strategy; its class may take seed, map size, road class, domain and this spec.

        Raises:
            FreneticError: the strategy cannot be made.
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
        """Make the driver.

        Raises:
            FreneticError: the driver cannot be made.
        """
        driver: Driver = self._make("driver")
        return driver

    def make_simulator(self, rules: Rules | None = None) -> Simulator:
        """Make the simulator, with rules and wall limit if its class takes them; do not start it.

        Args:
            rules: rules of the drives; by default the rules of the spec.

        Raises:
            FreneticError: the simulator cannot be made.
        """
        simulator: Simulator = self._make("simulator", rules)
        return simulator

    def construction(self, kind: str, rules: Rules | None = None) -> Construction:
        """Return the call that makes the strategy, driver or simulator.

        Raises:
            FreneticError: the part cannot be loaded.
        """
        part = self.part(kind)
        return REGISTRIES[kind].construction(*part, self._available(kind, rules))

    def _make(self, kind: str, rules: Rules | None = None) -> Any:
        part = self.part(kind)
        return REGISTRIES[kind].make_from(*part, self._available(kind, rules))

    def _available(self, kind: str, rules: Rules | None) -> dict[str, Any]:
        """Return the options that a part gets if its class takes them."""
        if kind == "driver":
            return {}
        if kind == "simulator":
            limit = self.wall_limit or usual_of(self.part(kind).name).usual_wall_limit
            return {"rules": self.rules if rules is None else rules, "wall_limit": limit}
        terms = self.terms
        of_terms = {name: getattr(terms, name) for name in ("map_size", "road_class", "domain")}
        return {"seed": self.seed, **of_terms, "spec": self}


DRIVING: Final = (
    *("driver", "simulator", "conditions", "speed_limit", "oob_tolerance", "criteria"),
    "wall_limit",
)
"""Entries about how roads are driven."""
_TERMS: Final = ("map_size", "map_margin", "lane_width")
"""Entries that `Terms` has by the same names; they do not count for roads that exist."""
_LIMITS: Final = ("simulations", "time", "failures")
"""Entries that are limits of the budget."""
