"""The spec of a run: one typed object, with one conversion each from and to its other forms.

A `Spec` comes from options (`Spec.replaced`), from a campaign's record (`Spec.from_json`), from a
file (`frenetic.run_file`, `Spec.read`) or from a campaign of objects (`Campaign.spec`). It makes
objects (`make_strategy`, `make_driver`, `make_simulator`, `Campaign.of`), the record (`to_json`)
and the words of files and command lines (`Spec.drive_entries`, `Part.words`).

Its layers are declared in `frenetic.quantities`. Every command's help reads this module, so slow
imports are inside functions.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from dataclasses import field as dataclass_field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, ValidationError, convert, defstruct, structs, to_builtins

from frenetic import trust
from frenetic._support.bounds import Count, NotNegative, Positive
from frenetic._support.files import read_bounded
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.outside_text import read_json
from frenetic._support.scalars import take_numpy_scalars
from frenetic._support.words import counted, format_duration, part_word
from frenetic.description import PARTS, describe, sources_of
from frenetic.drive_entries import COMPETITION, DriveEntries
from frenetic.errors import CampaignError, FreneticError
from frenetic.quantities import SEED, SPEED, quantities, quantity
from frenetic.recipe import Guest, Named, Recipe, Told
from frenetic.registry import SIMULATORS, STRATEGIES, Registry
from frenetic.versions import sources_named

# Imports inside functions below are too slow for help.

if TYPE_CHECKING:
    from frenetic.domain import Domain
    from frenetic.drive import CarBody, Rules
    from frenetic.drivers import Driver
    from frenetic.road.classes import RoadClass
    from frenetic.search import Strategy
    from frenetic.simulators.capabilities import Usual
    from frenetic.simulators.simulator import Simulator

DRIVEN: Final = "driven"
"""Entry of a road's file with its `drive_record`."""
MAX_WORKERS: Final = 1024
"""Most roads that one computer drives at once; a cluster has as many seats as it has."""


def require_count(name: str, value: float, least: int = 1) -> int:
    """An option that counts something.

    Raises:
        ValueError: it is no whole number of at least ``least``.
    """
    if not is_number(value) or value != int(value) or value < least:
        given: object = value
        text = given if isinstance(given, numbers.Real) else shown(given)
        raise ValueError(f"{name} is {text}: a whole number of at least {least} is needed")
    return int(value)


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


@dataclass(frozen=True)
class EarlierCampaign:
    """An earlier campaign that a search starts from."""

    folder: str
    """Its folder, as it was given."""
    simulations: int = 0
    """Its drives."""
    failures: int = 0
    """Its failures."""
    taken: int = 0
    """Tests that were taken from it."""
    left_out: int = 0
    """Roads that do not fit the map or the strategy's step."""

    def __str__(self) -> str:
        left_out = f", {self.left_out} left out that do not fit" if self.left_out else ""
        return (
            f"{self.folder} ({counted(self.simulations, 'simulation')},"
            f" {counted(self.failures, 'failure')}): {counted(self.taken, 'road')} taken{left_out}"
        )


@dataclass(frozen=True)
class Part:
    """A strategy, driver or simulator: its name and options, and the object's description."""

    name: str | None = None
    """A registered name, ``package.module:Class`` or ``file.py:Class``; None for an object that
    came from Python."""
    options: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Options given with the name."""
    made: Mapping[str, JSONValue] = dataclass_field(default_factory=dict)
    """The description of the object by `describe`; empty before it is made."""

    def replaced(self, name: str | None, options: Mapping[str, Any]) -> Part:
        """Another part with its own options, or else this one with added options."""
        if name not in (None, self.name):
            return Part(name, options)
        return Part(self.name, {**self.options, **options}) if options else self

    @property
    def word(self) -> str:
        """Its name and options as on a command line, such as ``planner,aggression=1.2``."""
        assert self.name is not None
        return part_word(self.name, self.options)

    def words(self, kind: str) -> list[str]:
        """The options of a command line that choose it."""
        return [f"--{kind}", self.word]


def _usual_rules() -> Rules:
    from frenetic.drive import Rules  # numba takes its time

    return Rules()


@dataclass(frozen=True, kw_only=True)
class Spec:
    """The spec of a run."""

    strategy: Part = Part()
    """The strategy; without a name where there is none, as for `frenetic drive`."""
    driver: Part = Part("planner")
    """The system under test, described with its layers."""
    layers: Mapping[str, float] = dataclass_field(default_factory=dict)
    """Name of a quantity of the driver -> its amount, if it has one."""
    simulator: Part = Part("embedded")
    rules: Rules = dataclass_field(default_factory=_usual_rules)
    wall_limit: float | None = None
    """Limit of a drive's wall time, in s; None for the simulator's default."""
    map_size: float = 200.0
    """Side of the square map in m."""
    margin: float = 10.0
    """Distance that a road's centre line keeps from the map's edge in m."""
    lane_width: float = 4.0
    """m."""
    road_class: RoadClass | None = None
    """Class whose rules the roads keep; None for the competition's."""
    domain: Domain | None = None
    """Domain whose roads and conditions are searched; None for the usual conditions."""
    seed: Any = None
    """Seed of the strategy; a user's own strategy may take any JSON but objects."""
    lookahead: int | None = None
    """Number of outstanding candidates; None for the campaign's default."""
    objective: str = "moobd"
    """Name of what the strategy minimises, see `frenetic.campaign.objective`."""
    start_from: tuple[EarlierCampaign, ...] = ()
    """Earlier campaigns that the search starts from."""
    from_roads: str | None = None
    """Folder of real roads that it starts from."""
    budget: Budget | None = None
    """Budget, None without a search."""
    workers: int = 1
    cluster: str | None = None
    """Address of a Dask scheduler."""
    car: CarBody | None = None
    """Car of the simulator, None before it is made."""
    versions: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Package -> its version in the run."""
    behaviours: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Those of `describe_terms`; each part has its own in its description."""

    # From options

    def replaced(self, given: Mapping[str, Any]) -> Spec:
        """The same spec with replacements from a command line.

        Another part comes with its own given options, since the recorded ones belong to the old
        one; without another, given options are added to the recorded ones. Layers and rules stay
        unless they are given; an amount without effect removes a layer.

        Args:
            given: name -> value of an option: of a part such as ``driver``, of its options
                (``driver_options``, a mapping or pairs), of the ``layers`` (likewise: amounts of
                any quantities), ``road_class``, rules and map size. None or empty values are not
                given.

        Raises:
            FreneticError: a rule is out of range, or another simulator cannot be loaded.
        """
        asked = {k: v for k, v in given.items() if v is not None and v != ()}
        asked = {**_limit_rules(asked), **_class_rules(asked), **asked}
        asked = _placed(asked, self.simulator.options if not asked.get("simulator") else {})
        strategy, driver, simulator = (
            getattr(self, kind).replaced(asked.get(kind), dict(asked.get(f"{kind}_options", ())))
            for kind in PARTS
        )
        layers = _with_effect({**self.layers, **dict(asked.get("layers", ()))})
        if layers != self.layers:
            driver = replace(driver, made={})
        # The limit of another simulator does not hold for this one.
        limit = asked.get("wall_limit")
        if limit is None and simulator.name == self.simulator.name:
            limit = self.wall_limit
        return replace(
            self,
            strategy=strategy,
            driver=driver,
            layers=layers,
            simulator=simulator,
            rules=_with_rules(self.rules, asked),
            wall_limit=limit,
            map_size=asked.get("map_size", self.map_size),
            **_of_class(asked),
        )

    @property
    def conditions(self) -> dict[str, float]:
        """Amounts that it says: of layers over the driver, and options of the simulator."""
        rows = {row.attribute: row.name for row in quantities().values() if row.attribute}
        options = self.simulator.options.items()
        return {rows[name]: amount for name, amount in options if name in rows} | {**self.layers}

    # From and to JSON

    @classmethod
    def from_json(cls, config: Mapping[str, Any], *, source: object) -> Spec:
        """The spec of a campaign's record.

        Args:
            config: as `to_json` makes it; other entries are ignored.
            source: name of its place for messages.

        Raises:
            CampaignError: the record is damaged; the message names the place in it.
        """
        try:
            record, given = _read_record(config)
        except ValueError as error:
            raise CampaignError(
                f"{source} is damaged: it does not say with what it was driven: {error}; restore it"
                " from a copy"
            ) from None
        named = cls() if given else cls(driver=Part(), simulator=Part())
        named = named.replaced(given)
        parts = {kind: replace(getattr(named, kind), made=config[kind]) for kind in PARTS}
        values = {name: value for name, value in structs.asdict(record).items() if name != "run"}
        return replace(named, **values | parts)

    @classmethod
    def from_drive_record(cls, record: Any, *, source: object) -> Spec:
        """The spec with which the road in a file was driven.

        Args:
            record: as `drive_record` makes it.
            source: name of the file for messages.

        Raises:
            FreneticError: it is none.
        """
        try:
            return cls().replaced(_convert(record, _Driven).given())
        except (ValueError, FreneticError) as error:
            raise FreneticError(
                f"{source}: its entry {DRIVEN!r} does not say with what the road was driven:"
                f" {error}; remove the entry and name a driver"
            ) from None

    @classmethod
    def read(cls, path: Path | str) -> Spec:
        """How a file says that roads are driven: that of a campaign's failing road, for example.

        Args:
            path: a JSON file with a `drive_record` as its entry ``driven``; the map may have lanes
                of another width (``lane_width``, m). Other entries are not read.

        Raises:
            FreneticError: there is no such file, or it does not say it.
        """
        path = Path(path)
        data = read_bounded(path)
        try:
            file_type = defstruct("File", [("driven", Any), ("lane_width", Positive, 4.0)])
            record: Any = read_json(data, file_type)
        except ValueError as error:
            raise FreneticError(f"{path} does not say how roads are driven: {error}") from None
        return replace(
            cls.from_drive_record(record.driven, source=path), lane_width=record.lane_width
        )

    def driven_as(
        self, other: Spec, given: Mapping[str, Any], *, source: object, has_roads: bool
    ) -> Spec:
        """The same spec, driven as another one, with the options of a command line on top.

        Args:
            other: as `read` gives it.
            given: as for `replaced`. The other's driver, given once more, keeps its options.
            source: the other's file.
            has_roads: whether the roads exist, with a map and a lane width of their own.

        Raises:
            FreneticError: an option is out of range, or the file names code that is not loaded
                unasked (`frenetic.trust`).
        """
        named = [kind for kind in ("driver", "simulator") if given.get(kind)]
        other.require_trusted(source, ("strategy", "objective", *named))
        asked = dict(given)
        if asked.get("driver") == other.driver.name:
            asked["driver"] = None
        spec = self
        if not has_roads:
            terms = ("map_size", "lane_width", "road_class")
            spec = replace(self, **{name: getattr(other, name) for name in terms})
        spec = replace(spec, layers={}, driver=replace(spec.driver, made={}))
        if (entries := other.drive_entries()) is not None:
            driven = _convert(entries, DriveEntries).given()
            rules = {
                name: getattr(other.rules, name)
                for name in ("criteria", "speed_limit", "road_limits", "scaled_from")
            }
            spec = spec.replaced({**driven, **rules})
        return spec.replaced(asked)

    def to_json(self) -> dict[str, JSONValue]:
        """The campaign's record in its database."""
        names = [item.name for item in fields(self) if item.name not in ("layers", "wall_limit")]
        values = {name: getattr(self, name) for name in names} | {"rules": self.rules.as_json()}
        record = {
            name: value.made if isinstance(value, Part) else to_builtins(value, enc_hook=plain)
            for name, value in values.items()
        }
        if (entries := self.drive_entries()) is None:
            return record
        return {**record, "run": self.strategy_entry() | entries}

    def drive_entries(self) -> dict[str, Any] | None:
        """Parts, conditions and rules as `DriveEntries`; None if the parts have no names."""
        driver, simulator, rules = self.driver, self.simulator, self.rules
        if driver.name is None or simulator.name is None:
            return None
        is_scaled = rules.road_limits == "scaled"
        criteria = {"criteria": rules.criteria.whole_entry()} if rules.criteria else {}
        return {
            "driver": driver.word,
            "simulator": simulator.word,
            "with": {**self.layers, **({SPEED: rules.speed_limit} if is_scaled else {})},
            "speed_limit": None if is_scaled or self._has_usual_limit else rules.speed_limit,
            "oob_tolerance": rules.oob_tolerance,
            **criteria,
            "wall_limit": self.wall_limit,
        }

    @property
    def _has_usual_limit(self) -> bool:
        """Whether no speed limit was given: it is that of the class, or the usual one."""
        usual = _usual_rules() if self.road_class is None else self.road_class
        return self.rules.road_limits == "kept" and self.rules.speed_limit == usual.speed_limit

    def strategy_entry(self) -> dict[str, str]:
        """Its strategy, likewise; empty without a name."""
        return {} if self.strategy.name is None else {"strategy": self.strategy.word}

    # To objects

    def with_limit(self) -> Spec:
        """The same with the usual wall limit of its simulator if it has none."""
        if self.wall_limit is not None or self.simulator.name is None:
            return self
        return replace(self, wall_limit=usual_of(self.simulator.name).usual_wall_limit)

    def require_trusted(self, source: object, named: Collection[str] = (), **more: str) -> None:
        """Checks that what a file or campaign names may be made, see `frenetic.trust`.

        Args:
            source: the file or campaign.
            named: kinds of parts that the command names itself.
            more: ``remedy`` and ``started_in``, as for `frenetic.trust.require`.

        Raises:
            FreneticError: a part may not.
        """
        parts = {kind: getattr(self, kind) for kind in PARTS}
        recorded = {kind: (part.name, part.options) for kind, part in parts.items() if part.name}
        trust.require({**recorded, "objective": (self.objective, {})}, source, named, **more)

    def edited(self, sources: object) -> list[str]:
        """Names of users' own files that are not as a campaign keeps them; nothing is imported."""
        known = sources if isinstance(sources, Mapping) else {}
        found: dict[str, str] = {}
        for name in (*(getattr(self, kind).name for kind in PARTS), self.objective):
            with suppress(OSError, ValueError, RuntimeError):
                found |= sources_named(name or "")
        return [name for name, text in sorted(found.items()) if known.get(name, text) != text]

    def make_strategy(self) -> Strategy:
        """The strategy, with seed, map size and this spec if its class takes them.

        Raises:
            FreneticError: it cannot be made.
        """
        available = {
            "seed": self.seed,
            "map_size": self.map_size,
            "road_class": self.road_class,
            "domain": self.domain,
            "spec": self,
        }
        strategy: Strategy = _made(STRATEGIES, self.strategy, available)
        if self.domain is not None and self.domain.conditions and strategy.domain is None:
            raise FreneticError(
                f"the strategy {self.strategy.name} searches roads alone, not the conditions of"
                f" {self.domain.name}: choose frenetic or random"
            )
        return strategy

    def make_driver(self) -> Driver:
        """The driver under its layers, see `driver_of`.

        Raises:
            FreneticError: it cannot be made.
        """
        assert self.driver.name is not None
        driver = driver_of(self.driver.name, self.driver.options, self.layers, self._preloads())
        trust.remember("driver", self.driver.name, self.driver.options)
        return driver

    def _preloads(self) -> tuple[str, ...]:
        """Modules that processes for the simulator have from the start."""
        from frenetic.simulators.capabilities import usual  # numba takes its time

        assert self.simulator.name is not None
        if SIMULATORS.is_own(self.simulator.name):
            return ()
        return usual(SIMULATORS.load(self.simulator.name)).preloads

    def make_simulator(self) -> Simulator:
        """The simulator, with rules and wall limit if its class takes them; not yet entered.

        One of the user's own is a `NamedSimulator`, as a driver is by `driver_of`.

        Raises:
            FreneticError: it cannot be made.
        """
        available = {"rules": self.rules, "wall_limit": self.with_limit().wall_limit}
        simulator: Simulator = _made(SIMULATORS, self.simulator, available)
        return simulator

    def make_parts(self, *, isolate: bool) -> tuple[Driver, Simulator]:
        """Driver and simulator.

        Args:
            isolate: whether the simulator gets a process of its own, unless only compiled code of
                ours drives, see `frenetic.simulators.isolated`. A script that isolates needs
                ``if __name__ == "__main__":``.

        Raises:
            FreneticError: one of them cannot be made.
        """
        from frenetic.simulators.isolated import isolated  # numba takes its time

        driver, simulator = self.make_driver(), self.make_simulator()
        return driver, isolated(simulator, driver) if isolate else simulator


def earlier_of(config: Mapping[str, Any]) -> tuple[EarlierCampaign, ...]:
    """The earlier campaigns in a campaign's record.

    Raises:
        CampaignError: they cannot be read.
    """
    try:
        return convert(config.get("start_from", []), tuple[EarlierCampaign, ...])
    except ValidationError as error:
        raise CampaignError(f"the campaign is damaged: what it starts from: {error}") from None


def drive_record(
    config: Mapping[str, Any], conditions: Mapping[str, float] = MappingProxyType({})
) -> dict[str, JSONValue] | None:
    """What a road's file keeps of a campaign's record, to drive the road again in its conditions.

    None if the campaign was started from Python, so that its parts have no names.
    """
    run = config.get("run")
    if not isinstance(run, Mapping):
        return None
    record = {name: value for name, value in run.items() if name != "strategy"}
    record |= {"with": {**run.get("with", {}), **conditions}, "map_size": config.get("map_size")}
    roads = config.get("road_class")
    return record if roads is None else {**record, "roads": roads}


def usual_of(simulator: str) -> Usual:
    """What the class of the simulator of that name declares before one is made."""
    if SIMULATORS.is_own(simulator):
        from frenetic.simulators.capabilities import Usual as Answer  # numba takes its time

        declared: Usual = Recipe("simulator", simulator).ask(_usual_of_guest, answer=Answer)
        return declared
    return _usual_of_class(SIMULATORS.load(simulator))


def _usual_of_guest(guest: Guest) -> Usual:
    return _usual_of_class(guest.factory)


def _usual_of_class(factory: Callable[..., Any]) -> Usual:
    from frenetic.simulators.capabilities import usual  # numba takes its time

    return usual(factory)


def drive_options() -> list[str]:
    """Names of the options that say how roads are driven, as `Spec.replaced` takes them."""
    parts = ("driver", "driver_options", "simulator", "simulator_options")
    rules = ("speed_limit", "oob_tolerance", "criteria")
    return [*parts, "layers", "wall_limit", "road_class", "map_size", *rules]


def _of_class(given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a spec that follow from a ``road_class`` among given options."""
    road_class = given.get("road_class")
    own = {} if (domain := given.get("domain")) is None else {"domain": domain}
    if road_class is None:
        return own
    if road_class == COMPETITION:
        return {"road_class": None, **own}
    return {"road_class": road_class, "lane_width": road_class.lane_width, **own}


def _limit_rules(options: Mapping[str, Any]) -> dict[str, Any]:
    """The rule of roads' own speed limits by options: a limit among these holds everywhere."""
    if "speed_limit" in options:
        return {"road_limits": "ignored"}
    return {"road_limits": "kept"} if "road_class" in options else {}


def _class_rules(given: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers that follow from it unless they are given, too."""
    road_class = given.get("road_class")
    if road_class in (None, COMPETITION):
        return {}
    return {name: getattr(road_class, name) for name in ("speed_limit", "map_size")}


def _placed(
    given: Mapping[str, Any], recorded: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Given options with each condition where it belongs: rules, simulator, or over the driver.

    Args:
        given: as for `Spec.replaced`.
        recorded: options that the simulator has; without effect elsewhere, none is added.

    Raises:
        UnknownNameError: there is no such quantity.
    """
    layers: dict[str, float] = {}
    options = dict(given.get("simulator_options") or ())
    placed = dict(given)
    for name, amount in dict(given.get("layers") or ()).items():
        row = None if name == SEED else quantity(name)
        if row is None or row.layer:
            layers[name] = amount
        elif row.attribute == "rules":
            placed[SPEED] = amount
        elif amount != row.nothing or row.attribute in {*options, *recorded}:
            options[row.attribute] = amount
    if "layers" in given:
        placed["layers"] = layers
    return placed | ({"simulator_options": options} if options else {})


def _with_effect(layers: Mapping[str, float]) -> dict[str, float]:
    """The layers that have an effect.

    Raises:
        UnknownNameError: there is no such quantity.
    """
    return {
        name: amount
        for name, amount in layers.items()
        if name == SEED or amount != quantity(name).nothing
    }


def _with_rules(rules: Rules, given: Mapping[str, Any]) -> Rules:
    """The rules, replaced by given ones."""
    known = {item.name for item in fields(rules)}
    try:
        rules = replace(rules, **{k: v for k, v in given.items() if k in known and v is not None})
        return rules.with_speed(given[SPEED]) if SPEED in given else rules
    except ValueError as error:
        raise FreneticError(str(error)) from None


def driver_of(
    name: str,
    options: Mapping[str, Any],
    layers: Mapping[str, float],
    preloads: Sequence[str] = (),
) -> Driver:
    """The driver of a name under layers, see `frenetic.drivers.loading.under`.

    One of the user's own is a `NamedDriver`: a process that drives makes it, this one does not.

    Args:
        name: of the driver.
        options: passed to its class.
        layers: name -> amount.
        preloads: modules that processes for the simulator have from the start.

    Raises:
        FreneticError: it cannot be made, or a layer's amount is out of range.
    """
    from frenetic.drivers.loading import under  # numpy takes its time
    from frenetic.drivers.named import NamedDriver  # likewise

    return under(layers, _part_of(Recipe("driver", name, options), NamedDriver, preloads))


def _part_of(recipe: Recipe, kind: type[Named], preloads: Sequence[str] = ()) -> Any:
    """The part of a recipe; one of this kind if it is the user's own."""
    if not recipe.registry.is_own(recipe.name):
        return recipe.make()
    from frenetic.simulators.embedded import compile_kernels  # numba takes its time

    answer = Told[kind.attributes_type]  # type: ignore[name-defined]
    facts = recipe.ask(_told, kind, answer=answer, preloads=preloads, meanwhile=compile_kernels)
    return kind(recipe, facts)


def _told(guest: Guest, kind: type[Named]) -> Told[Any]:
    part = guest.part
    return Told(describe(part), sources_of(part), kind.attributes_of(part))


def _made(registry: Registry, part: Part, available: Mapping[str, object]) -> Any:
    assert part.name is not None
    for name in part.options:
        if name in available:
            raise FreneticError(
                f"the option {name} of the {registry.kind} is not allowed: it follows from the"
                " options of the command"
            )
    if registry is SIMULATORS:
        from frenetic.simulators.named import NamedSimulator  # numba takes its time

        made = _part_of(Recipe("simulator", part.name, part.options, available), NamedSimulator)
    else:
        made = registry.make_from(part.name, part.options, available)
    trust.remember(registry.kind, part.name, part.options)
    return made


# Decoding


def shown(value: object) -> str:
    """The repr of a value, shortened."""
    try:
        text = repr(value)
    except RecursionError:
        return f"a {type(value).__name__} that is nested too deep"
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_number(value: object) -> bool:
    """Whether it is a finite number, of numpy too."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:  # a whole number may be too large for a float
        return False


class _Described(Struct, forbid_unknown_fields=True, rename={"kind": "class"}):
    """A part in the form of `describe`."""

    kind: str
    options: dict[str, Any] = {}
    version: str = ""
    camera: dict[str, Any] | None = None
    driver: _Described | None = None
    margin: float | None = None


class _Driven(DriveEntries, kw_only=True):
    """With what a road was driven."""

    driver: str
    simulator: str


class _Run(_Driven, kw_only=True):
    """What a record says by name."""

    strategy: str | None = None


def _record_type() -> Any:
    """The type of a campaign's record, which may have other entries, too."""
    from frenetic.domain import Domain  # likewise
    from frenetic.drive import CarBody, Rules  # numba takes its time
    from frenetic.road.classes import RoadClass  # likewise

    entries: list[Any] = [
        ("seed", int | float | str | bool | None),
        ("strategy", _Described),
        ("simulator", _Described),
        ("driver", _Described),
        ("rules", Rules),
        ("car", CarBody),
        ("budget", Budget),
        ("map_size", Positive),
        ("margin", NotNegative),
        ("lane_width", Positive),
        ("road_class", RoadClass | None, None),
        ("domain", Domain | None, None),
        ("workers", Count, 1),
        ("cluster", str | None, None),
        ("lookahead", Count | None, None),
        ("objective", str, "moobd"),
        ("start_from", tuple[EarlierCampaign, ...], ()),
        ("from_roads", str | None, None),
        ("versions", dict[str, str]),
        ("behaviours", dict[str, str], {}),
        ("run", _Run | None, None),
    ]
    return defstruct("Record", entries, kw_only=True)


def _convert(value: Any, kind: Any) -> Any:
    """A value from JSON as an object of a type.

    Raises:
        ValueError: it is none; the message names the place.
    """
    try:
        return convert(value, kind)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def _read_record(config: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A campaign's record, whose rules and car have to be whole, and the options of its parts.

    Raises:
        ValueError: it is none; the message names the place.
    """
    record = _convert(dict(config), _record_type())
    for name in ("rules", "car"):
        if other := config[name].keys() ^ asdict(getattr(record, name)).keys():
            raise ValueError(f"Missing or unknown {', '.join(sorted(other))} - at `$.{name}`")
    return record, {} if record.run is None else record.run.given()


def fault_of(config: Mapping[str, Any]) -> str:
    """What keeps a campaign's record from being read, in a line; empty if nothing does."""
    try:
        _read_record(config)
    except ValueError as error:
        return str(error)
    return ""


def decode_budget(value: Any) -> Budget:
    """The budget of a JSON object.

    Raises:
        ValueError: it is none.
    """
    budget: Budget = _convert(value, Budget)
    return budget
