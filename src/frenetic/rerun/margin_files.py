"""Margins in files: a study of margins leaves them beside its drives, and reports read them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_json
from frenetic.errors import CampaignError, FreneticError
from frenetic.parts.records import comparison_key
from frenetic.rerun.campaigns import rerun_folders
from frenetic.rerun.margin_quantities import MarginQuantity
from frenetic.rerun.margin_results import ConditionMargin, Margins, RoadLimit

FILE: Final = "margins.json"
"""Name of the file with the margins, in the folder of the campaign of their drives."""


@dataclass(frozen=True)
class _LimitEntry:
    """Limit on a road as the file has it, see `RoadLimit`; None for an infinite number."""

    road: int
    share: float | None
    passes: float | None
    passes_again: float | None
    drive: int | None

    def limit(self, quantity: MarginQuantity) -> RoadLimit:
        """Return the limit of a quantity, of which the usual amount may be infinite."""
        share = _or_infinite(self.share)
        return RoadLimit(
            self.road,
            share,
            None if math.isinf(share) else quantity.amount(share),
            quantity.usual if self.passes is None and share > 0.0 else self.passes,
            self.passes_again,
            self.drive,
        )


@dataclass(frozen=True)
class _MarginEntry:
    """Margin in a quantity as the file has it; None for an infinite usual amount."""

    condition: str
    usual: float | None
    end: float
    nearest: float
    roads: tuple[_LimitEntry, ...]
    demanding_roads: tuple[_LimitEntry, ...]

    def margin(self) -> ConditionMargin:
        """Return the margin.

        Raises:
            FreneticError: the condition is unknown.
            ValueError: there is no road.
        """
        quantity = MarginQuantity(self.condition, _or_infinite(self.usual), self.end, self.nearest)
        words = quantity.words  # only a known condition has words
        if not self.roads:
            raise ValueError(f"{words} has no road")
        return ConditionMargin(
            quantity,
            tuple(entry.limit(quantity) for entry in self.roads),
            tuple(entry.limit(quantity) for entry in self.demanding_roads),
        )


@dataclass(frozen=True)
class _MarginsEntry:
    """Margins as the file has them, which is as `Margins.as_json` returns them."""

    domain: str
    driver: Mapping[str, Any]
    simulator: Mapping[str, Any]
    seed: int
    drives: int
    margins: tuple[_MarginEntry, ...]


def _or_infinite(value: float | None) -> float:
    """Return a number, which is infinite if JSON has None for it."""
    return math.inf if value is None else value


def write_margins(margins: Margins) -> None:
    """Write margins into the folder of their drives, unless they are there.

    Raises:
        FreneticError: the file cannot be written.
    """
    with suppress(CampaignError):  # a damaged file is replaced
        if read_margins(margins.folder) == margins:
            return
    document = json.dumps(margins.as_json()) + "\n"
    write_file(margins.folder / FILE, document, remedy="make room, or let it be written")


def read_margins(folder: Path) -> Margins | None:
    """Return the margins in the folder of a campaign of drives; None if there are none.

    Raises:
        CampaignError: the file is damaged, or has a condition that is not installed.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        entry = read_json(read_bounded(path), _MarginsEntry)
        margins = tuple(each.margin() for each in entry.margins)
        if not margins:
            raise ValueError("it has no margin")
    except (FreneticError, ValueError) as error:
        raise CampaignError(
            f"{path} is damaged: {error}; remove it, or run frenetic margin again"
        ) from None
    return Margins(
        margins, entry.domain, entry.driver, entry.simulator, entry.seed, entry.drives, folder
    )


def campaign_margins(folder: Path) -> Sequence[Margins]:
    """Return the margins in a campaign's folder and its driving campaigns, the latest first.

    Of the same quantities, measured with the same parts, those on most roads count; of equally many
    the latest.

    Raises:
        CampaignError: a file or a driving campaign is damaged.
    """
    studies = [read_margins(each) for each in (folder, *rerun_folders(folder))]
    largest: dict[str, Margins] = {}
    for margins in filter(None, studies):
        quantities = [each.quantity.as_json() for each in margins.margins]
        key = comparison_key(margins.driver, margins.simulator, quantities, margins.domain)
        before = largest.pop(key, margins)
        largest[key] = before if before.roads > margins.roads else margins
    return tuple(reversed(largest.values()))
