"""Conditions that differ a little from those in which a road was driven.

A *quantity* is a property of a drive's conditions that can vary, such as the road's friction. A
simulator offers those that it can vary as attributes that may be set between two drives: ``rules``,
which every simulator has, and ``friction``, ``start_offset`` and ``start_heading`` if it can.
Quantities of the driver are layers over it, so they work with every simulator.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType
from typing import Final

from msgspec import convert

from frenetic.drivers import Delayed, Driver, Noisy, appearance
from frenetic.drivers.appearance import CameraLayer
from frenetic.drivers.driver import OwnLayer
from frenetic.drivers.layers import HEADING_PER_OFFSET
from frenetic.errors import FreneticError
from frenetic.simulators.capabilities import capabilities, class_name
from frenetic.simulators.simulator import MAX_START_HEADING, MAX_START_OFFSET, Simulator


@dataclass(frozen=True)
class Quantity:
    """A property of a drive's conditions that can vary."""

    name: str
    """Name of the field in `Conditions`."""
    description: str
    unit: str
    """Empty if it has none."""
    low: float
    """Least value allowed."""
    high: float
    """Largest value allowed."""
    attribute: str | None = None
    """Attribute that the simulator must have, None for a layer over the driver."""
    words: tuple[str, str] | None = None
    """Words for a smaller and for a larger value; None for "less" and "more" of its name."""

    @property
    def less(self) -> str:
        """Words for a smaller value, such as "less friction"."""
        return self.words[0] if self.words else f"less {self.name}"

    @property
    def more(self) -> str:
        """Words for a larger value."""
        return self.words[1] if self.words else f"more {self.name}"


_SEEN: Final[Mapping[str, tuple[str, tuple[str, str] | None]]] = {
    "scene": (
        "seed of the asphalt, land, sky and sun that a camera sees",
        ("a scene of a lower seed", "a scene of a higher seed"),
    ),
    "wear": ("share of the markings' paint that is gone", None),
    "fog": ("visibility in the fog that a camera sees", ("thicker fog", "thinner fog")),
    "rain": ("rate of the rain that a camera sees", None),
    "blur": ("time of a camera's exposure", None),
    "light": ("factor of the light, 1 is usual", None),
    "grain": ("standard deviation of a camera's noise, of the values 0 to 255", None),
}
"""Layer of `appearance` -> its description and words; unit and bounds are the layer's."""
_FARTHEST: Final = 100_000.0
"""Largest value of what has no upper bound."""


QUANTITIES: Final[Mapping[str, Quantity]] = MappingProxyType(
    {
        quantity.name: quantity
        for quantity in (
            Quantity("friction", "friction of the road, 1 is dry", "", 0.01, 1.5, "friction"),
            Quantity(
                "speed",
                "speed limit",
                "km/h",
                1.0,
                500.0,
                "rules",
                ("a lower speed limit", "a higher speed limit"),
            ),
            Quantity(
                "noise",
                "standard deviation of the driver's error about its lateral place",
                "m",
                0.0,
                10.0,
            ),
            Quantity("delay", "time until the driver's controls arrive", "s", 0.0, 10.0),
            Quantity(
                "start",
                "place of the start, to the left of the lane's centre",
                "m",
                -MAX_START_OFFSET,
                MAX_START_OFFSET,
                "start_offset",
                ("a start further right", "a start further left"),
            ),
            Quantity(
                "heading",
                "heading at the start, to the left of the road's direction",
                "rad",
                -MAX_START_HEADING,
                MAX_START_HEADING,
                "start_heading",
                ("a start turned to the right", "a start turned to the left"),
            ),
            *(
                Quantity(
                    name,
                    _SEEN[name][0],
                    kind.unit,
                    kind.low,
                    kind.high if math.isfinite(kind.high) else _FARTHEST,
                    words=_SEEN[name][1],
                )
                for name, kind in appearance.ALL.items()
            ),
        )
    }
)
"""Name of a field of `Conditions` -> what it is."""


@dataclass(frozen=True)
class Conditions:
    """Differences of a drive from the campaign's; None where there is none."""

    friction: float | None = None
    """Friction of the road."""
    speed: float | None = None
    """Speed limit, in km/h."""
    noise: float | None = None
    """Offset of a `Noisy` layer in m, in place of the driver's own, if it has one."""
    noise_seed: int = 0
    """Seed of that layer, of rain and of grain."""
    delay: float | None = None
    """Delay of a `Delayed` layer in s, in place of the driver's own, if it has one."""
    start: float | None = None
    """Distance of the car's start to the left of the ego lane's centre, in m."""
    heading: float | None = None
    """Angle of the car's start to the left of the road's direction, in rad."""
    scene: float | None = None
    """Seed of the scene that a camera sees; this and all below in place of the driver's own."""
    wear: float | None = None
    """Share of the markings' paint that is gone."""
    fog: float | None = None
    """Visibility, in m."""
    rain: float | None = None
    """Rate of the rain, in mm/h."""
    blur: float | None = None
    """Time of exposure, in s."""
    light: float | None = None
    """Factor of the light."""
    grain: float | None = None
    """Standard deviation of the camera's noise, of the values 0 to 255."""

    def value(self, name: str) -> float | None:
        """Value of a quantity, None if it is as in the campaign."""
        value: float | None = getattr(self, QUANTITIES[name].name)
        return value


SEEDED: Final = ("noise", "rain", "grain")
"""Quantities whose layers draw random numbers, from `Conditions.noise_seed`."""
USUAL: Final = Conditions()
"""The campaign's own."""


def read_conditions(values: Mapping[str, float]) -> Conditions:
    """Conditions by their names.

    Raises:
        ValueError: there is no such condition, or a value is none.
    """
    if unknown := sorted(values.keys() - {item.name for item in fields(Conditions)}):
        raise ValueError(
            f"there is no condition {', '.join(unknown)}: choose from {', '.join(QUANTITIES)}"
        )
    return convert(dict(values), Conditions)


def conditions_document(conditions: Conditions) -> dict[str, float]:
    """The conditions that differ from the campaign's, by their names."""
    values = {name: value for name, value in asdict(conditions).items() if value is not None}
    if not any(name in values for name in SEEDED):
        del values["noise_seed"]
    return values


def check_can_vary(simulator: Simulator, names: Iterable[str]) -> None:
    """Refuses quantities that a simulator cannot vary.

    Raises:
        FreneticError: the simulator cannot vary one of them.
    """
    for name in names:
        attribute = QUANTITIES[name].attribute
        if attribute is not None and attribute not in capabilities(simulator).variable:
            raise FreneticError(
                f"{class_name(simulator)} cannot vary {name}: it has no attribute"
                f" {attribute!r}; leave it out, or use another simulator, such as the embedded one"
            )


@contextmanager
def in_conditions(conditions: Conditions, simulator: Simulator, driver: Driver) -> Iterator[Driver]:
    """Puts a simulator into some conditions for a while; gives the driver for these.

    Raises:
        FreneticError: the simulator cannot be put into them.
    """
    values: dict[str, object] = {}
    if conditions.speed is not None:
        values["rules"] = replace(simulator.rules, speed_limit=conditions.speed)
    for name in ("friction", "start", "heading"):
        wanted = conditions.value(name)
        if wanted is not None:
            check_can_vary(simulator, [name])
            values[str(QUANTITIES[name].attribute)] = wanted
    before = {attribute: getattr(simulator, attribute) for attribute in values}
    try:
        _set(simulator, values)
        yield _layered(conditions, driver)
    finally:
        _set(simulator, before)


def _set(simulator: Simulator, values: Mapping[str, object]) -> None:
    for attribute, value in values.items():
        try:
            setattr(simulator, attribute, value)
        except (AttributeError, TypeError, ValueError) as error:
            raise FreneticError(
                f"{class_name(simulator)} cannot have {attribute} = {value}: {error}"
            ) from error


def _layered(conditions: Conditions, driver: Driver) -> Driver:
    """The driver under the layers of some conditions, each in place of its own of that kind."""
    if conditions.noise is not None:
        driver = Noisy(
            _without(Noisy, driver),
            offset=conditions.noise,
            heading=HEADING_PER_OFFSET * conditions.noise,
            seed=conditions.noise_seed,
        )
    if conditions.delay is not None:
        driver = Delayed(_without(Delayed, driver), seconds=conditions.delay)
    for name, kind in appearance.ALL.items():
        amount = conditions.value(name)
        if amount is not None:
            seed = {"seed": conditions.noise_seed} if name in SEEDED else {}
            try:
                driver = _seen_through(kind, _without(kind, driver), amount, seed)
            except ValueError as error:
                raise FreneticError(str(error)) from None
    return driver


def _without(kind: type[object], driver: Driver) -> Driver:
    """The driver without its layers of a kind."""
    if not isinstance(driver, OwnLayer):
        return driver
    inner = _without(kind, driver.driver)
    return inner if isinstance(driver, kind) else _over(driver, inner)


def _seen_through(
    kind: type[CameraLayer], driver: Driver, amount: float, seed: Mapping[str, int]
) -> Driver:
    """The driver under a layer that is in its place among those of one picture."""
    is_inside = isinstance(driver, CameraLayer) and driver.place >= kind.place
    if isinstance(driver, OwnLayer) and not is_inside:
        return _over(driver, _seen_through(kind, driver.driver, amount, seed))
    return kind(driver, amount, **seed)


def _over(layer: OwnLayer, driver: Driver) -> Driver:
    """The same layer over another driver."""
    layer = copy.copy(layer)
    layer.driver = driver
    return layer
