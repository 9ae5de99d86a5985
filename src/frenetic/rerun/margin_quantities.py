"""Quantities of which a driver's margin is measured: a condition, to one side of its usual amount.

The size of the road, `RADIUS`, is a quantity, too, though no condition of a drive. A quantity runs
from the usual amount, such as no delay, to the end of the measured range. Where the usual amount is
infinite, as of the view, amounts are spaced by equal factors, else evenly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeAlias

from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import condition_named
from frenetic.conditions.declaration import Condition
from frenetic.errors import FreneticError
from frenetic.simulators.conditions import check_can_vary, check_pair_in, usual_amount

DEFAULT_CONDITIONS: Final = (
    "overspeed",
    "delay",
    "lag",
    "friction",
    "noise",
    "steering_gain",
    "steering_offset",
    "steering_dead_band",
    "lateral_bias",
    "heading_bias",
    "load",
    "gust",
)
"""Conditions whose margins are measured by default, if simulator and driver can have them."""
RADIUS: Final = Condition(
    name="radius",
    about="radius of the road's bends, as a factor: the road is smaller, after a straight",
    low=0.05,
    high=1.0,
    usual=(0.92, 1.0),
    no_effect=1.0,
    words=("tighter bends, radius as a factor", "wider bends, radius as a factor"),
)
"""Declaration of the road's size, which is measured on roads of a class."""
RequiredAmount: TypeAlias = tuple[str, float]
"""Name of a condition, and the amount that a driver has to bear."""
_REACH: Final = 10.0
"""Measured range, as a multiple of the distance by which the usual range leaves the usual amount;
our choice."""
_DIGITS: Final = 4
"""Significant digits of an amount; our choice."""
_RESOLUTION: Final = 0.03
"""Distance of the least failing amount from a passing one, as a share of the failing amount's
distance from the usual amount; our choice."""
_LEAST_RESOLUTION: Final = 0.003
"""The same distance, as a share of the measured range, below which it always suffices; our
choice."""


@dataclass(frozen=True)
class MarginQuantity:
    """A condition, to one side of its usual amount."""

    condition: str
    """Name of the condition in `frenetic.conditions`."""
    usual: float
    """Usual amount, which may be infinite."""
    end: float
    """Amount at the end of the measured range, which differs from the usual amount."""
    nearest: float
    """Amount from which on amounts are spaced by equal factors, if the usual amount is infinite;
    else the usual amount."""

    @property
    def side(self) -> str:
        """``more`` or ``less``, as the amounts are larger or smaller than the usual amount."""
        return "more" if self.end > self.usual else "less"

    @property
    def key(self) -> str:
        """Name of condition and side, such as ``friction, less``."""
        return f"{self.condition}, {self.side}"

    @property
    def declaration(self) -> Condition:
        """Declaration of the condition."""
        return _declaration(self.condition)

    @property
    def words(self) -> str:
        """Phrase for larger demands, such as "more delay" or "less friction"."""
        return self.declaration.more if self.side == "more" else self.declaration.less

    def amount(self, share: float) -> float:
        """Return the amount at a share of the measured range, 0..1; 0 stands for the usual amount.

        The amount has `_DIGITS` significant digits.
        """
        if share <= 0.0:
            return self.usual
        if share >= 1.0:
            return self.end
        if math.isinf(self.usual):
            value = self.nearest * (self.end / self.nearest) ** share
        else:
            value = self.usual + share * (self.end - self.usual)
        return float(f"{value:.{_DIGITS}g}")

    def share(self, amount: float) -> float:
        """Return the share of the measured range at an amount: the inverse of `amount`.

        The share is negative for an amount on the other side of the usual amount.
        """
        if not math.isinf(self.usual):
            return (amount - self.usual) / (self.end - self.usual)
        if math.isinf(amount):
            return 0.0
        return math.log(amount / self.nearest) / math.log(self.end / self.nearest)

    def is_resolved(self, passing: float, failing: float) -> bool:
        """Return whether two shares of the range are near enough to end a bisection."""
        resolution = _RESOLUTION * failing
        if math.isinf(self.usual):  # there, a share of the range stands for a factor
            resolution = _RESOLUTION / abs(math.log(self.end / self.nearest))
        return failing - passing <= max(resolution, _LEAST_RESOLUTION)

    def text(self, amount: float) -> str:
        """Return an amount with its unit."""
        unit = self.declaration.unit
        if math.isinf(amount):
            return "unlimited"
        digits = max(3, len(f"{abs(amount):.0f}"))  # 1000, not 1e+03
        return f"{amount:.{digits}g}{' ' if unit else ''}{unit}"

    def as_json(self) -> dict[str, Any]:
        """Return the quantity as a JSON object; an infinite amount is None."""
        values = {**asdict(self), "side": self.side, "unit": self.declaration.unit}
        return {
            name: None if isinstance(value, float) and math.isinf(value) else value
            for name, value in values.items()
        }


def measured_quantities(
    tester: RoadTester,
    ends: Mapping[str, float | None] | None = None,
    at_least: Iterable[RequiredAmount] = (),
) -> list[MarginQuantity]:
    """Return the quantities of which margins are measured.

    Args:
        tester: drives with a simulator, a driver and usual amounts.
        ends: name of a condition -> end of its range. None as an end means both sides, each ten
            times as far as the condition's usual range. By default all of `DEFAULT_CONDITIONS` that
            simulator and driver can have and, for roads of a class, `RADIUS`.
        at_least: amounts that the driver has to bear. Their conditions are measured, too, at least
            up to these amounts.

    Raises:
        FreneticError: a condition is unknown, or simulator or driver cannot have it.
        ValueError: an end is the usual amount, or not allowed; or a condition is no quantity.
    """
    quantities: dict[str, MarginQuantity] = {}
    by_default = ends is None
    defaults = dict.fromkeys((*DEFAULT_CONDITIONS, RADIUS.name))
    for name, end in (defaults if ends is None else ends).items():
        with suppress(*(FreneticError, ValueError) if by_default else ()):
            _add(quantities, tester, name, end)
    for name, amount in at_least:
        required = _quantity_to(tester, name, amount)
        measured = quantities.get(required.key)
        if measured is None or measured.share(amount) > 1.0:
            _check(tester, name, amount)
            quantities[required.key] = required
    return list(quantities.values())


def _declaration(name: str) -> Condition:
    """Return the declaration of a condition or of the road's size.

    Raises:
        FreneticError: the condition is unknown.
    """
    return RADIUS if name == RADIUS.name else condition_named(name)


def _add(
    quantities: dict[str, MarginQuantity], tester: RoadTester, name: str, end: float | None
) -> None:
    """Add the quantities of a condition, by their keys.

    Raises:
        FreneticError: the condition is unknown, or simulator or driver cannot have it.
        ValueError: the end is the usual amount, or not allowed; or the condition is no quantity.
    """
    if end is not None:
        added = [_quantity_to(tester, name, end)]
    else:
        added = [_quantity_to(tester, name, far) for far in _ends(tester, name)]
    for quantity in added:
        _check(tester, name, quantity.end)
    quantities |= {quantity.key: quantity for quantity in added}


def _check(tester: RoadTester, name: str, amount: float) -> None:
    """Check that simulator and driver can have an amount of a condition.

    Raises:
        FreneticError: they cannot.
        ValueError: the roads have no class, and the condition is their radius.
    """
    if name == RADIUS.name:
        if tester.terms.road_class is None:
            raise ValueError(
                "the bends of the competition's roads are as tight as its rules allow: name a road"
                " class to measure the radius"
            )
        return
    amounts = tester.terms.conditions_of({name: amount})
    check_pair_in(amounts, tester.simulator, tester.driver)


def _quantity_to(tester: RoadTester, name: str, end: float) -> MarginQuantity:
    """Return the quantity of a condition from its usual amount to an end.

    Raises:
        FreneticError: the condition is unknown, or the simulator cannot have it.
        ValueError: the end is the usual amount, or not allowed; or the condition is no quantity.
    """
    condition = _declaration(name)
    usual = _usual_amount(tester, condition)
    if condition.require(end) == usual:
        raise ValueError(f"{condition.text(end)} is the usual amount: another amount is needed")
    nearest = usual
    if math.isinf(usual):
        nearest = max(_REACH * condition.usual[1], 2.0 * end)
    return MarginQuantity(name, usual, float(end), nearest)


def _usual_amount(tester: RoadTester, condition: Condition) -> float:
    """Return the amount of a condition in the tester's drives, where nothing else is said.

    Raises:
        FreneticError: the simulator cannot have the condition.
        ValueError: the condition is a place or a seed, not a quantity, or has no usual amount.
    """
    name = condition.name
    if condition is RADIUS:
        return 1.0
    check_can_vary(tester.simulator, [name])
    if name in tester.terms.conditions:
        return float(tester.terms.conditions[name])
    usual = usual_amount(tester.simulator, name)
    if usual is None:
        raise ValueError(f"{name} has no usual amount: a condition with a usual amount is needed")
    return float(usual)


def _ends(tester: RoadTester, name: str) -> list[float]:
    """Return the ends of the default ranges of a condition, one or two amounts."""
    condition = _declaration(name)
    usual = _usual_amount(tester, condition)
    low, high = condition.usual
    if math.isinf(usual):
        return [max(condition.low, low / _REACH)]
    if condition.is_relative:
        distances = (1.0 - low) * usual, (high - 1.0) * usual
    else:
        middle = 0.5 * (low + high) if condition.no_effect is None else condition.no_effect
        if math.isinf(middle):  # the user has set an amount of, say, the view
            distances = 0.5 * usual / _REACH, 0.5 * usual / _REACH
        else:
            distances = max(0.0, middle - low), max(0.0, high - middle)
    ends = usual - _REACH * distances[0], usual + _REACH * distances[1]
    rounded = (float(f"{end:.{_DIGITS}g}") for end in ends)
    allowed = (min(max(end, condition.low), condition.high) for end in rounded)
    return [end for end in allowed if end != usual]
