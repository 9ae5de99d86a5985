"""Margins of a driver: the failing amount of a quantity on each road, and a quantile."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from frenetic._support.words import counted
from frenetic.analysis.statistics import Share, ValueWithInterval, quantile_estimate
from frenetic.rerun.margin_quantities import MarginQuantity, RequiredAmount
from frenetic.rerun.margin_search import AmountSearch, MarginSearch

SHARE: Final = 0.05
"""Share of the roads that fail at the margin; our choice."""


def _finite(value: Any) -> Any:
    """Return None for an infinite number, which JSON does not have, and other values unchanged."""
    return None if isinstance(value, float) and math.isinf(value) else value


@dataclass(frozen=True)
class RoadLimit:
    """Least amount of a quantity at which a driver fails on a road."""

    road: int
    """Number of a random road, from 1, or id of the test from which the road comes."""
    share: float
    """Share of the measured range at which the driver fails; 0 if it fails as usual, infinite if it
    never fails within the range."""
    fails: float | None
    """Amount at which the driver fails; None if it never fails within the range."""
    passes: float | None
    """Largest amount at which the driver passes below the failing amount; None if there is none."""
    passes_again: float | None
    """Amount above the failing one at which the driver passes; None if there is none."""
    drive: int | None
    """Id of the failing drive in the campaign of the drives; None if the driver never fails."""

    @classmethod
    def of(cls, search: AmountSearch, road: int) -> RoadLimit:
        """Return the limit that a complete search has measured on a road."""
        quantity = search.quantity
        share, passing, again = search.least_failing, search.passing, search.passes_again
        return cls(
            road,
            math.inf if share is None else share,
            None if share is None else quantity.amount(share),
            None if passing is None else quantity.amount(passing),
            None if again is None else quantity.amount(again),
            None if share is None else search.drives[share],
        )

    def as_json(self) -> dict[str, Any]:
        """Return the limit as a JSON object; an infinite number is None."""
        return {name: _finite(value) for name, value in asdict(self).items()}


@dataclass(frozen=True)
class ConditionMargin:
    """Margin of a driver in a quantity."""

    quantity: MarginQuantity
    limits: tuple[RoadLimit, ...]
    """Limit on each random road."""
    demanding: tuple[RoadLimit, ...] = ()
    """Limit on each of a campaign's most demanding roads, which do not count among the random
    roads; empty without a campaign."""

    @cached_property
    def shares(self) -> ValueWithInterval:
        """Share of the measured range at which `SHARE` of the random roads fail.

        It has a 95 % interval between the limits of two roads. An end of the interval is 0 where
        too few roads allow another. What is beyond the range is infinite.
        """
        estimate = quantile_estimate([limit.share for limit in self.limits], SHARE)
        return ValueWithInterval(estimate.value, max(0.0, estimate.low), estimate.high)

    @property
    def amount(self) -> float | None:
        """Amount at which `SHARE` of the random roads fail; None if it is beyond the range."""
        return self._amount(self.shares.value)

    @property
    def interval(self) -> tuple[float | None, float | None]:
        """95 % interval of `amount`, the end next to the usual amount first.

        None is an end beyond the range.
        """
        return self._amount(self.shares.low), self._amount(self.shares.high)

    @property
    def example(self) -> RoadLimit | None:
        """Limit of the random road that is nearest to the amount; None if that is beyond the range.

        Its drive shows how the driver fails at the margin.
        """
        value = self.shares.value
        if math.isinf(value):
            return None
        return min(self.limits, key=lambda limit: abs(limit.share - value))

    @property
    def least(self) -> RoadLimit | None:
        """Limit on the demanding road that fails first; None without demanding roads."""
        return min(self.demanding, key=lambda limit: limit.share, default=None)

    @property
    def never(self) -> Share:
        """Share of the random roads on which the driver never fails within the range."""
        return Share(sum(limit.fails is None for limit in self.limits), len(self.limits))

    @property
    def failing_as_usual(self) -> list[RoadLimit]:
        """Limits of the random roads on which the driver fails at the usual amount."""
        return [limit for limit in self.limits if limit.share == 0.0]

    @property
    def passing_again(self) -> list[RoadLimit]:
        """Limits of the random roads on which the driver passes above the failing amount."""
        return [limit for limit in self.limits if limit.passes_again is not None]

    def _amount(self, share: float) -> float | None:
        """Return the amount at a share of the range; None beyond the range."""
        return None if math.isinf(share) else self.quantity.amount(share)

    def reaches(self, amount: float) -> bool:
        """Return whether the driver begins to fail at this amount or beyond it."""
        return self.shares.value >= min(self.quantity.share(amount), 1.0)

    def amount_text(self) -> str:
        """Return the amount at which the driver begins to fail, with its unit."""
        return self._text(self.amount)

    def interval_text(self) -> str:
        """Return the 95 % interval of the amount; empty if both ends are beyond the range."""
        nearer, farther = self.interval
        if nearer is None:
            return ""
        return f"{self._text(nearer)} to {'beyond' if farther is None else self._text(farther)}"

    def least_text(self) -> str:
        """Return the amount at which the demanding road that fails first fails.

        The text is empty without demanding roads.
        """
        return "" if self.least is None else self._text(self.least.fails)

    def _text(self, amount: float | None) -> str:
        """Return an amount with its unit; for None that the driver never fails in the range."""
        if amount is None:
            return f"never up to {self.quantity.text(self.quantity.end)}"
        return "usual" if amount == self.quantity.usual else self.quantity.text(amount)

    def as_text(self) -> str:
        """Return the margin in a line."""
        interval = f" (95 % interval {text})" if (text := self.interval_text()) else ""
        text = f"{self.quantity.words}: {self.amount_text()}{interval}"
        return f"{text}, never fails on {self.never.count} of {self.never.total} roads"

    def as_json(self) -> dict[str, Any]:
        """Return the margin as a JSON object; what is beyond the range or infinite is None."""
        least, shares = self.least, self.shares
        return {
            **self.quantity.as_json(),
            "amount": _finite(self.amount),
            "interval": [_finite(amount) for amount in self.interval],
            "range_share": _finite(shares.value),
            "range_share_interval": [_finite(shares.low), _finite(shares.high)],
            "drive": None if self.example is None else self.example.drive,
            "never": self.never.as_json(),
            "failing_as_usual": len(self.failing_as_usual),
            "passing_again": len(self.passing_again),
            "most_demanding": None if least is None else _finite(least.fails),
            "roads": [limit.as_json() for limit in self.limits],
            "demanding_roads": [limit.as_json() for limit in self.demanding],
        }


@dataclass(frozen=True)
class Margins:
    """Margins of a driver in several quantities."""

    margins: tuple[ConditionMargin, ...]
    domain: str
    """Roads and conditions in words, such as ``rural-80, 80 km/h``."""
    driver: Mapping[str, Any]
    """Driver, as `frenetic.spec.part_record.describe` records it."""
    simulator: Mapping[str, Any]
    """Simulator, recorded as the driver is."""
    seed: int
    """Seed of the random roads."""
    drives: int
    """Number of drives."""
    folder: Path
    """Folder of the campaign of the drives."""

    @property
    def roads(self) -> int:
        """Number of random roads."""
        return len(self.margins[0].limits)

    @property
    def demanding(self) -> int:
        """Number of demanding roads."""
        return len(self.margins[0].demanding)

    def named(self, condition: str, amount: float) -> ConditionMargin:
        """Return the margin of a condition to the side on which an amount lies.

        Raises:
            ValueError: this side of the condition was not measured.
        """
        for margin in self.margins:
            if margin.quantity.condition == condition and margin.quantity.share(amount) > 0.0:
                return margin
        raise ValueError(f"{condition} was not measured up to {amount:g}")

    def shortfalls(self, at_least: Iterable[RequiredAmount]) -> dict[str, str]:
        """Return which margins are smaller than required: key of a quantity -> it in words.

        Args:
            at_least: amounts that the driver has to bear on all but `SHARE` of the roads.

        Raises:
            ValueError: a condition was not measured to the side of its amount.
        """
        texts = {}
        for name, amount in at_least:
            margin = self.named(name, amount)
            if not margin.reaches(amount):
                quantity = margin.quantity
                begins = f"begins to fail at {margin.amount_text()}"
                if margin.amount == quantity.usual:
                    begins = "fails as usual"
                texts[quantity.key] = f"{name}: {begins}, {quantity.text(amount)} is needed"
        return texts

    @property
    def notes(self) -> list[str]:
        """Notes on roads that fail as usual, and on amounts above a failing one that pass."""
        notes = []
        failing = {limit.road: limit for m in self.margins for limit in m.failing_as_usual}
        if failing:
            drives = ", ".join(str(limit.drive) for limit in failing.values())
            notes.append(
                f"{len(failing)} of {counted(self.roads, 'road')} fail as usual, their margins are"
                f" 0: drives {drives}"
            )
        for margin in self.margins:
            if again := margin.passing_again:
                limit = min(again, key=lambda limit: limit.share)
                quantity = margin.quantity
                assert limit.fails is not None
                assert limit.passes_again is not None
                notes.append(
                    f"{quantity.words}: {counted(len(again), 'road')} pass again beyond the failing"
                    f" amount, which counts; drive {limit.drive} fails at"
                    f" {quantity.text(limit.fails)}, and the road passes at"
                    f" {quantity.text(limit.passes_again)}"
                )
        return notes

    @property
    def headline(self) -> str:
        """What the amounts are, in words."""
        roads = counted(self.roads, "random road")
        return f"Where the driver begins to fail on {100.0 * SHARE:g} % of {roads} of {self.domain}"

    @property
    def shown_drives(self) -> list[int]:
        """Ids of the drives that show the margins; a margin beyond the range has none."""
        examples = [margin.example for margin in self.margins]
        return [each.drive for each in examples if each is not None and each.drive is not None]

    @property
    def columns(self) -> tuple[str, ...]:
        """Titles of the columns of `rows`; a title that begins with > is of numbers."""
        demanding = (f">{self.demanding} most demanding",) if self.demanding else ()
        return (
            "quantity",
            ">usual",
            ">begins to fail",
            ">95 % interval",
            ">drive",
            ">never fails",
            *demanding,
        )

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Texts of a row for each quantity; an empty text stands for no value."""
        return [
            (
                margin.quantity.words,
                margin.quantity.text(margin.quantity.usual),
                margin.amount_text(),
                margin.interval_text(),
                "" if margin.example is None else str(margin.example.drive),
                f"{margin.never.count} of {margin.never.total}",
                *([margin.least_text()] if self.demanding else []),
            )
            for margin in self.margins
        ]

    def as_text(self) -> str:
        """Return the margins in words, a line for each quantity and note."""
        lines = [margin.as_text() for margin in self.margins] + self.notes
        return "\n".join([f"{self.headline}:", *(f"  {line}" for line in lines)])

    def as_json(self) -> dict[str, Any]:
        """Return the margins as a JSON object."""
        return {
            "domain": self.domain,
            "driver": dict(self.driver),
            "simulator": dict(self.simulator),
            "share": SHARE,
            "roads": self.roads,
            "demanding_roads": self.demanding,
            "seed": self.seed,
            "drives": self.drives,
            "folder": str(self.folder),
            "margins": [margin.as_json() for margin in self.margins],
        }


def margins_of(search: MarginSearch) -> tuple[ConditionMargin, ...]:
    """Return the margins that a complete search has measured, in the order of its quantities."""
    return tuple(
        ConditionMargin(
            quantity,
            tuple(RoadLimit.of(limit, i) for i, limit in enumerate(searches, 1)),
            tuple(
                RoadLimit.of(limit, limit.road.test)
                for limit in search.demanding_searches[quantity]
            ),
        )
        for quantity, searches in search.random_searches.items()
    )
