"""The entries of a run: name, type, bounds and help of each.

Every command's help reads this module, so slow imports are inside functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final

from msgspec import Meta, Struct, field, structs, to_builtins

from frenetic._support.bounds import Count, Index, NotNegative, Positive, Text, converted
from frenetic._support.option_text import part_word, read_part
from frenetic._support.words import parse_duration
from frenetic.conditions.condition import require_allowed
from frenetic.spec.parts import PARTS
from frenetic.spec.values import (
    criteria_entries,
    read_class,
    read_domain,
    read_workers,
    require_worker_count,
    roads_entry,
)


def _about(text: str, metavar: str = "") -> Meta:
    """Return the declared help of an entry.

    Args:
        text: help of the entry's option.
        metavar: placeholder of the option's value, such as FILE; by default the entry's name.
    """
    return Meta(description=text, extra={"metavar": metavar})


class Signed(Struct, frozen=True, forbid_unknown_fields=True):
    """The user's signature of the code that a file names, see `frenetic.parts.signatures`."""

    folder: str
    """Folder from which the code is loaded."""
    signature: str
    """Text that only the user's key can make, for this code in this folder."""


class RunEntries(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True, dict=True
):
    """The entries of a run: what its user says.

    An entry that is None or empty is not set. An entry with `_about` can be an option of commands.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: no roads, criteria or conditions have this name.
    """

    strategy: Annotated[
        Text | None, _about("How to search ('frenetic list strategies'). [default: frenetic]")
    ] = None
    driver: Annotated[
        Text | None,
        _about(
            "Who drives: a name ('frenetic list drivers'), package.module:Class, file.py:Class,"
            " model.onnx or command:./program. [default: as recorded, or planner]"
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
            "A condition: delay=0.1, friction=0.5; may be repeated ('frenetic list conditions').",
            "NAME=VALUE",
        ),
    ] = field(name="with", default_factory=dict)
    speed_limit: Positive | None = None
    """Speed limit in km/h, also where a road has a limit of its own."""
    oob_tolerance: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    """Share of the car's box that may be outside its lane, 0..1."""
    criteria: Annotated[
        Text | dict[str, Any] | None,
        _about(
            "What fails beside leaving the lane, or FILE.toml ('frenetic list criteria'). With"
            " rules: competition,speed_limit=70,oob_tolerance=0.95, the default.",
            "PROFILE",
        ),
    ] = None
    wall_limit: Positive | None = None
    """Largest wall time of a drive, in s; its worker is replaced after 1.5 times this and 10 s."""
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
    map_margin: NotNegative | None = None
    """Distance of a road's centre line from the map's edge, in m."""
    lane_width: Positive | None = None
    """Width of each lane, in m."""
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
    """Wall time of the run: a text with a unit, or a number of s, as which a text is kept."""
    failures: Annotated[Count | None, _about("Stop after N failures.", "N")] = None
    kilometres: Annotated[
        Positive | None, _about("Stop after this length of driven road, in km.", "KM")
    ] = None
    simulated_time: Annotated[
        Positive | str | None, _about("Stop after this simulated time: 30m, 10h.", "TIME")
    ] = None
    """Simulated time of all drives: a text with a unit, or a number of s, as a text is kept."""
    start_from: Annotated[
        tuple[Text, ...],
        _about(
            "Start from an earlier campaign: what failed there is driven first; may be repeated.",
            "CAMPAIGN",
        ),
    ] = field(name="from", default=())
    from_roads: Annotated[
        Text | None,
        _about("Start from real roads (.xodr, .json), in their class.", "DIR"),
    ] = None
    seed: Annotated[Index | None, _about("Repeats a search. [default: a new one]", "N")] = None
    max_in_flight: Count | None = None
    """Largest number of roads that are proposed and have no result yet."""
    workers: Annotated[
        Count | str | None,
        _about(
            "Drive on N roads at once, or on a Dask cluster, tcp://10.0.0.1:8786. [default: the"
            " cores, or 1]",
            "N|ADDRESS",
        ),
    ] = None
    signed: Signed | None = None
    """User's signature of the code that the spec names, in the spec's file; None if unsigned."""

    def __post_init__(self) -> None:
        """Check the entries and bring each into one form, so that equal runs have equal entries."""
        values = converted(self.user_values, RunEntries)
        values |= {kind: part_word(*read_part(values[kind])) for kind in PARTS if kind in values}
        require_allowed(values.get("conditions", {}))
        if "criteria" in values:
            values |= _split_criteria(values)
        if "roads" in values:
            values["roads"] = roads_entry(read_class(values["roads"]))
        if "odd" in values:
            values["odd"] = read_domain(values["odd"]).entries()
        for name in ("time", "simulated_time"):
            if isinstance(values.get(name), str):
                values[name] = parse_duration(values[name])
        if isinstance(self.workers, str):
            values["workers"] = read_workers(self.workers)
        elif self.workers is not None:
            require_worker_count(self.workers)
        for name, value in values.items():
            structs.force_setattr(self, name, value)

    def __hash__(self) -> int:
        """Return a hash of all entries but tables, which have none."""
        values = structs.astuple(self)
        return hash(tuple(value for value in values if not isinstance(value, dict)))

    @property
    def user_values(self) -> dict[str, Any]:
        """Name of each attribute that the user sets -> its value."""
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        return {name: value for name, value in values.items() if value != _UNSET.get(name)}

    def entries(self) -> dict[str, Any]:
        """Return the entries that the user sets, by their names in a file."""
        entries: dict[str, Any] = to_builtins(self)
        return entries


def _split_criteria(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the criteria among the values, apart from the rules that are named with them.

    Raises:
        ValueError: a rule has another value among the criteria than as an entry.
    """
    entries = converted(criteria_entries(values["criteria"]), RunEntries)
    for rule in sorted(entries.keys() & values.keys() - {"criteria"}):
        if values[rule] != entries[rule]:
            raise ValueError(
                f"{rule} is {values[rule]:g}, and {entries[rule]:g} in the criteria: leave out one"
                " of the two"
            )
    return entries


_UNSET: Final[Mapping[str, Any]] = {"conditions": {}, "start_from": ()}
"""Name of an entry -> its value while it is not set, where this value is not None."""
