"""Conditions of a drive, such as noise, fog or friction.

A `Condition` declares a condition once, for the command line, records, reports and
`frenetic.rerun`. A condition is set in one of two ways: by a wrapper around the driver, which works
with every simulator, or by an attribute of the simulator, which may change between two drives.

A package adds conditions by an entry point in the group ``frenetic.conditions``: a tuple of
`Condition` objects.

The command line reads all conditions, so the class of a wrapper is imported only when it is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, Final

from frenetic._support.entry_points import RegisteredPart, imported, installed
from frenetic.conditions.aids import AIDS
from frenetic.conditions.declaration import FARTHEST, Condition
from frenetic.conditions.sensors_and_steering import SENSOR_CONDITIONS, STEERING_CONDITIONS
from frenetic.errors import FreneticError, UnknownNameError
from frenetic.parts.registry import hint

GROUP: Final = "frenetic.conditions"
"""Entry point group of other packages' conditions."""
SEED: Final = "noise_seed"
"""Name under which the conditions of a drive hold the seed of random wrappers."""
SPEED: Final = "speed"
"""Name of the condition that is the speed limit."""
START: Final = "start"
"""Name of the condition that is the place of the start."""
START_SPEED: Final = "start_speed"
"""Name of the condition that is the speed at the start."""
MAX_START_OFFSET: Final = 2.0
"""Largest distance of a start from the ego lane's centre, in m: to the edge of a 4 m wide lane."""
MAX_START_HEADING: Final = math.pi / 4.0
"""Largest angle between the car at the start and the road, in rad; our choice."""

_BUILT_IN: Final = (
    Condition(
        name="friction",
        about="friction of the road, 1 is dry",
        low=0.01,
        high=1.5,
        usual=(0.8, 1.2),
        is_relative=True,
        attribute="friction",
    ),
    Condition(
        name="wet",
        about="friction on one wet stretch of 40 m, as a share of the road's",
        low=0.05,
        high=1.0,
        usual=(0.4, 1.0),
        no_effect=1.0,
        attribute="wet",
        words=("a wetter stretch", "a drier stretch"),
    ),
    Condition(
        name="wet_at",
        about="place of the middle of the wet stretch along the road",
        unit="m",
        low=0.0,
        high=FARTHEST,
        usual=(0.0, 200.0),
        attribute="wet_at",
        place_of="wet",
        words=("an earlier wet stretch", "a later wet stretch"),
    ),
    Condition(
        name="gust",
        about="speed of one gust across 60 m of the road, to the left",
        unit="m/s",
        low=-40.0,
        high=40.0,
        usual=(-15.0, 15.0),
        no_effect=0.0,
        attribute="gust",
        words=("more gust to the right", "more gust to the left"),
    ),
    Condition(
        name="gust_at",
        about="place of the middle of the gust along the road",
        unit="m",
        low=0.0,
        high=FARTHEST,
        usual=(0.0, 200.0),
        attribute="gust_at",
        place_of="gust",
        words=("an earlier gust", "a later gust"),
    ),
    Condition(
        name="load",
        about="mass of passengers and luggage, of which the driver is not told",
        unit="kg",
        low=0.0,
        high=1000.0,
        usual=(0.0, 400.0),
        no_effect=0.0,
        attribute="load",
    ),
    Condition(
        name="overspeed",
        about="what the driver takes the speed limit for above what it is",
        unit="km/h",
        low=0.0,
        high=200.0,
        usual=(0.0, 20.0),
        no_effect=0.0,
        wrapper="frenetic.drivers.wrappers:Hasty",
    ),
    Condition(
        name=SPEED,
        about="speed limit; of a road with several, the highest, and the others in proportion",
        unit="km/h",
        low=1.0,
        high=500.0,
        usual=(0.9, 1.1),
        is_relative=True,
        attribute="rules",
        words=("a lower speed limit", "a higher speed limit"),
    ),
    Condition(
        name="noise",
        about="standard deviation of the driver's error about its lateral place",
        unit="m",
        low=0.0,
        high=10.0,
        usual=(0.0, 0.2),
        no_effect=0.0,
        wrapper="frenetic.drivers.wrappers:Noisy",
        is_seeded=True,
    ),
    Condition(
        name="delay",
        about="time until the driver's controls arrive",
        unit="s",
        low=0.0,
        high=10.0,
        usual=(0.0, 0.1),
        no_effect=0.0,
        wrapper="frenetic.drivers.wrappers:Delayed",
    ),
    Condition(
        name="lag",
        about="time constant of the steering",
        unit="s",
        low=0.005,
        high=2.0,
        usual=(0.5, 1.5),
        is_relative=True,
        attribute="steering_lag",
        words=("less steering lag", "more steering lag"),
    ),
    Condition(
        name=START,
        about="place of the start, to the left of the lane's centre",
        unit="m",
        low=-MAX_START_OFFSET,
        high=MAX_START_OFFSET,
        usual=(-0.3, 0.3),
        attribute="start_offset",
        words=("a start further right", "a start further left"),
    ),
    Condition(
        name="heading",
        about="heading at the start, to the left of the road's direction",
        unit="rad",
        low=-MAX_START_HEADING,
        high=MAX_START_HEADING,
        usual=(-0.03, 0.03),
        attribute="start_heading",
        words=("a start turned to the right", "a start turned to the left"),
    ),
    Condition(
        name=START_SPEED,
        about="speed at the start",
        unit="km/h",
        low=0.0,
        high=500.0,
        usual=(0.0, 50.0),
        no_effect=0.0,
        attribute="start_speed",
        words=("a slower start", "a faster start"),
    ),
    Condition(
        name="view",
        about="length of the road ahead that the driver sees",
        unit="m",
        low=1.0,
        high=FARTHEST,
        usual=(10.0, 50.0),
        no_effect=math.inf,
        wrapper="frenetic.drivers.wrappers:LimitedView",
        words=("a shorter view", "a longer view"),
    ),
    *STEERING_CONDITIONS,
    *SENSOR_CONDITIONS,
    *AIDS,
)

_BUILT_IN_BY_NAME: Final = {condition.name: condition for condition in _BUILT_IN}


def known_conditions() -> Mapping[str, Condition]:
    """Return all conditions by name: built-in conditions, then conditions of installed packages.

    Raises:
        FreneticError: two conditions have the same name.
    """
    return _by_name(installed(GROUP))


@cache
def _by_name(entries: tuple[RegisteredPart, ...]) -> Mapping[str, Condition]:
    """Return the built-in conditions and the conditions of these entry points, by name."""
    conditions = dict(_BUILT_IN_BY_NAME)
    for entry in entries:
        for condition in imported(entry.target):
            if condition.name in conditions:
                raise FreneticError(
                    f"two conditions are named {condition.name!r}, one comes from {entry.origin}:"
                    " uninstall one of them"
                )
            conditions[condition.name] = condition
    return MappingProxyType(conditions)


def condition_names(conditions: Mapping[str, float]) -> list[str]:
    """Return the names in a drive's conditions, without the seed and places such as ``gust_at``."""
    return [name for name in conditions if name != SEED and not condition_named(name).place_of]


def without(conditions: Mapping[str, float], *names: str) -> dict[str, float]:
    """Return the conditions of a drive without the named conditions.

    Places of the named conditions are removed, too, and the seed if no other condition needs it.
    """
    remaining = [name for name in condition_names(conditions) if name not in names]
    needs_seed = any(condition_named(name).is_seeded for name in remaining)

    def stays(name: str) -> bool:
        if name in names:
            return False
        if name == SEED:
            return needs_seed
        return (condition_named(name).place_of or name) in remaining

    return {name: amount for name, amount in conditions.items() if stays(name)}


def as_text(conditions: Mapping[str, float]) -> str:
    """Return the conditions of a drive in words, such as ``friction 0.4, gust 12 m/s at 80 m``."""
    texts = {
        name: condition_named(name).text(conditions[name]) for name in condition_names(conditions)
    }
    for name, amount in conditions.items():
        if name != SEED and (place_of := condition_named(name).place_of) in texts:
            texts[place_of] += f" at {amount:g} m"
    return ", ".join(texts.values())


def attributes() -> frozenset[str]:
    """Return the attributes of simulators that conditions set."""
    return _attributes(installed(GROUP))


@cache
def _attributes(entries: tuple[RegisteredPart, ...]) -> frozenset[str]:
    conditions = _by_name(entries).values()
    return frozenset(condition.attribute for condition in conditions if condition.attribute)


def amounts_in(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the amounts that a simulator's options set, by the names of their conditions."""
    names = {
        condition.attribute: condition.name
        for condition in known_conditions().values()
        if condition.attribute
    }
    return {names[option]: amount for option, amount in options.items() if option in names}


def require_allowed(amounts: Mapping[str, float]) -> None:
    """Check amounts of conditions. Any seed is allowed, and an amount without effect.

    Raises:
        UnknownNameError: no condition has one of the names.
        ValueError: an amount is out of its condition's range.
    """
    for name, amount in amounts.items():
        if name != SEED and amount != condition_named(name).no_effect:
            condition_named(name).require(amount)


def condition_named(name: str) -> Condition:
    """Return the condition with this name.

    Raises:
        UnknownNameError: no condition has this name; the message lists the known names.
    """
    if (built_in := _BUILT_IN_BY_NAME.get(name)) is not None:
        return built_in
    known = known_conditions()
    if name not in known:
        raise UnknownNameError(
            f"unknown condition {name!r}{hint(name, known)} Known: {', '.join(known)}"
        )
    return known[name]
