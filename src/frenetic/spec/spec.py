"""The spec of a run: read from files, merged from several sources, and made into parts.

Some entries say how roads are driven, whichever roads they are: driver, simulator, conditions,
rules and time limit. These are the `DRIVING_ENTRIES`. `Spec.driving_spec` keeps only these and,
unless the roads are given, which roads may exist: their class, map and lanes. The file of a failing
road records how the road was driven: a driving spec, as the file's entry ``driven``.

Every command's help reads this module, so slow imports are inside functions or for types only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from msgspec import UNSET, Struct, UnsetType, field, structs

from frenetic._support.bounds import Positive
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_json
from frenetic.errors import FreneticError
from frenetic.parts.construction import Construction
from frenetic.parts.named_code import REGISTRIES
from frenetic.parts.registry import STRATEGIES
from frenetic.spec.budget import Budget
from frenetic.spec.files import DRIVEN, converted_entries, read_entries, write_entries
from frenetic.spec.merging import merged
from frenetic.spec.parts import simulator_defaults
from frenetic.spec.run_code import RunCode
from frenetic.spec.run_settings import TERMS_ENTRIES
from frenetic.spec.values import roads_entry

if TYPE_CHECKING:
    from frenetic.drivers import Driver
    from frenetic.oracle.drive import Rules
    from frenetic.search import Strategy
    from frenetic.simulators.simulator import Simulator
    from frenetic.spec.terms import Terms

SPEC_FILE: Final = "campaign.toml"
"""Name of the file in a campaign's folder with the entries of its spec."""
DRIVING_ENTRIES: Final = (
    "driver",
    "simulator",
    "conditions",
    "speed_limit",
    "oob_tolerance",
    "criteria",
    "wall_limit",
)
"""Attributes of a spec that say how roads are driven, whichever roads they are."""


class _DrivenFile(Struct):
    """The entries of a road's file that say how its road was driven."""

    driven: Any = field(name=DRIVEN)
    """Entries of a `Spec.driving_spec`, which `Spec.of_driven` checks."""
    lane_width: Positive | UnsetType = UNSET
    """Width of each lane, in m; UNSET for the competition's width."""


class Spec(RunCode, frozen=True, kw_only=True):
    """The spec of a run: the entries that its user sets, and what follows from them.

    An entry is an attribute, which is None or empty if the user does not set it::

        spec = Spec.of({"driver": "planner,aggression=1.2", "with": {"delay": 0.1}})
        spec.conditions  # {"delay": 0.1}: the entry "with"; `with` is a word of Python
        spec.map_size  # None: not set
        spec.terms.map_size  # 200.0: the default
        spec.part("driver")  # Part("planner", {"aggression": 1.2})
        spec.make_driver()  # a Planner

    The base classes, each in its own module:

    - `RunEntries` declares the entries, such as ``driver``, ``roads``, ``seed`` and ``failures``.
      Its entry ``signed`` is the user's signature of the code that the spec names, see `Signed`.
    - `RunSettings` adds what follows from the entries, with defaults: `part` (name and options of
      the strategy, driver or simulator), `rules`, `budget`, `domain` and `terms`, which are map,
      lanes, roads and conditions.
    - `RunCode` adds `parts`, which is the code that a spec names, and `signed_in`, which signs it.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: no roads, criteria or conditions have this name.
    """

    # From and to entries

    @classmethod
    def of(cls, *sources: Spec | Mapping[str, Any]) -> Self:
        """Return the spec of several sources, of which later ones win.

        Options are added to the options of an earlier part of the same name, and conditions to
        earlier conditions; an amount without effect removes a condition. `frenetic.spec.merging`
        lists all rules.

        Args:
            sources: specs, and entries by their names in a file.

        Raises:
            ValueError: an entry is unknown, of another kind or out of range; the message names it.
            FreneticError: no roads, criteria or conditions have this name.
        """
        spec = cls()
        for source in sources:
            later = source if isinstance(source, Spec) else converted_entries(source, cls)
            spec = merged(spec, later)
        return spec

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """Return the spec in a file, such as a campaign's ``campaign.toml``.

        Raises:
            FreneticError: the file does not exist, or an entry is wrong; the message names it.
        """
        if (spec_file := Path(path) / SPEC_FILE).is_file():
            raise FreneticError(f"{path} is a campaign's folder: its file is {spec_file}")
        return read_entries(Path(path), cls, "a run")

    @classmethod
    def read_driven(cls, path: Path | str) -> Self:
        """Return the spec of driver, simulator, conditions and rules recorded in a road's file.

        Args:
            path: a JSON file with the entries of a `driving_spec` as its entry ``driven``. Its
                entry ``lane_width``, in m, by default the competition's, is the spec's lane width.
                Other entries are not read.

        Raises:
            FreneticError: the file does not exist, or lacks a usable entry ``driven``.
        """
        from frenetic.road import LANE_WIDTH  # imports numba, which is slow

        data = read_bounded(Path(path))
        try:
            file = read_json(data, _DrivenFile)
        except ValueError as error:
            raise FreneticError(f"{path} does not say how roads are driven: {error}") from None
        spec = cls.of_driven(file.driven, source=path)
        lane_width = LANE_WIDTH if isinstance(file.lane_width, UnsetType) else file.lane_width
        return structs.replace(spec, lane_width=lane_width)

    @classmethod
    def of_driven(cls, entries: object, *, source: object) -> Self:
        """Return the spec of the entry ``driven`` of a road's file.

        Args:
            entries: entries of a `driving_spec`, as read from the file.
            source: name of the file for messages.

        Raises:
            FreneticError: the entries lack driver or simulator, or an entry is wrong.
        """
        try:
            if not isinstance(entries, Mapping):
                raise ValueError("names with values are needed")
            if missing := [name for name in ("driver", "simulator") if name not in entries]:
                raise ValueError(f"it has no {missing[0]}")
            spec = converted_entries(entries, cls)
            # `of` removes conditions without effect. It also removes the signature, which still
            # holds, because conditions name no code.
            return structs.replace(cls.of(spec), signed=spec.signed)
        except (ValueError, FreneticError) as error:
            raise FreneticError(
                f"{source}: its entry {DRIVEN!r} does not say with what the road was driven:"
                f" {error}; remove the entry and name a driver"
            ) from None

    def write(self, folder: Path) -> None:
        """Write the spec as `SPEC_FILE` into the folder of its campaign.

        Raises:
            FreneticError: the file cannot be written.
        """
        about = f"What ran in this folder; 'frenetic run {SPEC_FILE}' does it again in another."
        write_entries(self.entries(), folder / SPEC_FILE, about)

    # Specs with some of the entries, or with others

    @classmethod
    def of_terms(cls, terms: Terms) -> Self:
        """Return the spec whose `terms` are the given ones."""
        values: dict[str, Any] = {name: getattr(terms, name) for name in TERMS_ENTRIES}
        values |= {"roads": roads_entry(terms.road_class), "conditions": dict(terms.conditions)}
        return cls(**values, odd=None if terms.domain is None else terms.domain.entries())

    def driving_spec(self, *, roads_are_given: bool = False) -> Spec:
        """Return a spec with only the entries about how and, unless given, which roads are driven.

        Args:
            roads_are_given: True if the roads are read from a campaign or a file, which also holds
                their map and lane width. False if the entries have to say which roads may exist, on
                which map and with which lane width: to make new roads, or to record a drive.
        """
        values = {name: getattr(self, name) for name in _entries_of_driving_spec(roads_are_given)}
        if not roads_are_given and self.names_roads:
            values["roads"] = roads_entry(self.road_class)
        return Spec(**values)

    def without_driving(self, *, roads_are_given: bool = False) -> Spec:
        """Return the spec without the entries of its `driving_spec`.

        Args:
            roads_are_given: as for `driving_spec`; False removes the entries about roads, too.
        """
        empty = Spec()
        values = {name: getattr(empty, name) for name in _entries_of_driving_spec(roads_are_given)}
        return structs.replace(self, **values)

    def in_conditions(self, conditions: Mapping[str, float]) -> Spec:
        """Return the spec with further conditions; its signature is kept, see `Signed`."""
        if not conditions and not self.conditions:
            return self
        # In files the attribute `conditions` is named "with", like the option --with.
        spec = Spec.of(self, {"with": dict(conditions)})
        # `of` removes the signature, which still holds, because conditions name no code.
        return structs.replace(spec, signed=self.signed)

    def with_budget(self, budget: Budget) -> Self:
        """Return the spec with the limits of a budget."""
        return structs.replace(self, **asdict(budget))

    # To parts

    def make_strategy(
        self, *, driver: Driver | None = None, simulator: Simulator | None = None
    ) -> Strategy:
        """Make the strategy.

        Its class may take the options ``seed``, ``map_size``, ``road_class``, ``domain``, ``spec``
        (this spec), ``driver`` and ``simulator``.

        Args:
            driver: driver of the campaign, which the strategy may look at. It must not drive with
                it, which would disturb the campaign. None if somebody else drives.
            simulator: simulator of the campaign, which the strategy may look at, too.

        Raises:
            FreneticError: the strategy cannot be made.
        """
        offered = self._offered_options("strategy", None)
        offered |= {"driver": driver, "simulator": simulator}
        strategy: Strategy = STRATEGIES.make_from(*self.part("strategy"), offered)
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
        driver: Driver = self._make_part("driver")
        return driver

    def make_simulator(self, rules: Rules | None = None) -> Simulator:
        """Make the simulator, with rules and wall limit if its class takes them; do not start it.

        Args:
            rules: rules of the drives; by default the rules of the spec.

        Raises:
            FreneticError: the simulator cannot be made.
        """
        simulator: Simulator = self._make_part("simulator", rules)
        return simulator

    def construction(self, kind: str, rules: Rules | None = None) -> Construction:
        """Return the call by which a ``make_`` method makes its part, without making the part.

        Args:
            kind: ``strategy``, ``driver`` or ``simulator``.
            rules: rules of a simulator's drives; by default the rules of the spec.

        Raises:
            FreneticError: the part cannot be loaded.
        """
        offered = self._offered_options(kind, rules)
        return REGISTRIES[kind].construction(*self.part(kind), offered)

    def _make_part(self, kind: str, rules: Rules | None = None) -> Any:
        """Make the part whose call `construction` returns."""
        offered = self._offered_options(kind, rules)
        return REGISTRIES[kind].make_from(*self.part(kind), offered)

    def _offered_options(self, kind: str, rules: Rules | None) -> dict[str, Any]:
        """Return the options that follow from other entries; a class gets those that it takes."""
        if kind == "driver":
            return {}
        if kind == "simulator":
            defaults = simulator_defaults(self.part(kind).name)
            return {
                "rules": self.rules if rules is None else rules,
                "wall_limit": self.wall_limit or defaults.usual_wall_limit,
            }
        terms = self.terms
        return {
            "seed": self.seed,
            "map_size": terms.map_size,
            "road_class": terms.road_class,
            "domain": terms.domain,
            "spec": self,
            "driver": None,
            "simulator": None,
        }


def _entries_of_driving_spec(roads_are_given: bool) -> tuple[str, ...]:
    """Return the names of a driving spec's attributes, see `Spec.driving_spec`."""
    road_entries = ("roads", *TERMS_ENTRIES)
    return DRIVING_ENTRIES if roads_are_given else (*DRIVING_ENTRIES, *road_entries)
