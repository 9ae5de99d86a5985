"""Presets: the competition's editions, with their setting and published figures.

They stand in presets.toml.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any, Final

from msgspec import Struct, convert

from frenetic.analysis.comparison import Comparison
from frenetic.errors import UnknownNameError
from frenetic.parts.registry import hint

COLUMNS: Final = ("runs", "tests", "valid", "failures", "per 100 valid", "sparseness")
"""Headings of `Figures.cells`."""


class PublishedFigures(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Figures of a tool: means of its runs, as far as they are known."""

    tool: str
    runs: int
    tests: float | None = None
    """Valid and invalid ones."""
    valid: float | None = None
    failures: float
    sparseness: float | None = None
    """The competition's, in edits."""
    source: str = "here"
    """Key of `Preset.sources`."""

    @property
    def per_100_valid(self) -> float | None:
        """Failures of 100 valid tests."""
        return 100.0 * self.failures / self.valid if self.valid else None

    @property
    def cells(self) -> tuple[str | None, ...]:
        """The cells of a table below `COLUMNS`."""

        def text(value: float | None, decimals: int) -> str | None:
            return None if value is None else f"{value:.{decimals}f}"

        return (
            str(self.runs),
            text(self.tests, 0),
            text(self.valid, 0),
            text(self.failures, 1),
            text(self.per_100_valid, 1),
            text(self.sparseness, 1),
        )


class Preset(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An edition of the competition."""

    name: str
    title: str
    setting: str
    """What it drove in, for people."""
    bench: dict[str, Any]
    """Entries of a bench's file."""
    differs: dict[str, str]
    """Name of an entry -> how its value differs from the edition's."""
    published: tuple[PublishedFigures, ...]
    sources: dict[str, str]
    """Name -> where figures were published."""

    def differences(self, entries: Mapping[str, Any]) -> dict[str, str]:
        """Name of each entry in which a bench differs from the edition -> how it does.

        Args:
            entries: entries of the bench; parts without names have none.
        """
        differences = dict(self.differs)
        for name, value in self.bench.items():
            if name in entries and entries[name] != value:
                differences[name] = f"{entries[name]} is given, where the preset has {value}"
        return differences


PRESETS: Final[Mapping[str, Preset]] = {
    name: convert({"name": name, **entries}, Preset)
    for name, entries in tomllib.loads(
        Path(__file__).with_name("presets.toml").read_text(encoding="utf-8")
    ).items()
}
"""Name -> preset, by year."""


def find_preset(name: str) -> Preset:
    """Return the preset of a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in PRESETS:
        raise UnknownNameError(
            f"there is no preset {name!r}{hint(name, PRESETS)} There are {', '.join(PRESETS)}"
        )
    return PRESETS[name]


def measured(comparison: Comparison) -> list[PublishedFigures]:
    """Return the figures of a bench's entrants, in the order of the comparison."""
    figures = []
    for name in comparison.headline.order:
        runs = comparison.groups[name]
        sparse = [r.competition_sparseness for r in runs if math.isfinite(r.competition_sparseness)]
        figures.append(
            PublishedFigures(
                tool=name,
                runs=len(runs),
                tests=fmean(run.simulations + run.counts.invalid for run in runs),
                valid=fmean(run.simulations for run in runs),
                failures=fmean(run.failures for run in runs),
                sparseness=fmean(sparse) if sparse else None,
            )
        )
    return figures
