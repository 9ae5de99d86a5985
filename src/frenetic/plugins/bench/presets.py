"""Presets: editions of the competition, with their setting and published figures.

The presets themselves are in presets.toml.
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
    """Figures of a generator: means over its runs; None where a figure is not known."""

    tool: str
    """Name of the generator."""
    runs: int
    """Number of runs."""
    tests: float | None = None
    """Number of tests, valid and invalid."""
    valid: float | None = None
    """Number of valid tests."""
    failures: float
    """Number of failures."""
    sparseness: float | None = None
    """Sparseness of the failures by the competition's code, in edits."""
    source: str = "here"
    """Where the figures come from: a key of `Preset.sources`, or "here" for the bench."""

    @property
    def per_100_valid(self) -> float | None:
        """Failures per 100 valid tests."""
        return 100.0 * self.failures / self.valid if self.valid else None

    @property
    def cells(self) -> tuple[str | None, ...]:
        """Cells of a table's row, with `COLUMNS` as headings."""

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
    """Name on the command line, such as "sbst2021"."""
    title: str
    """Name in tables, such as "SBST 2021"."""
    setting: str
    """Driver, simulator and rules of the edition, for people."""
    bench: dict[str, Any]
    """Entries of a bench's file that come near to the setting."""
    differs: dict[str, str]
    """Name of an entry in ``bench`` -> how its value differs from the edition's."""
    published: tuple[PublishedFigures, ...]
    """Figures of the edition's generators."""
    sources: dict[str, str]
    """Key of figures -> where they were published."""

    def differences(self, entries: Mapping[str, Any]) -> dict[str, str]:
        """Return name of each entry in which a bench differs from the edition -> how it differs.

        Args:
            entries: entries of the bench, as `Bench.entries` returns them.
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
"""Name -> preset, in the order of the years."""


def find_preset(name: str) -> Preset:
    """Return the preset of this name.

    Raises:
        UnknownNameError: no preset has this name.
    """
    if name not in PRESETS:
        raise UnknownNameError(
            f"there is no preset {name!r}{hint(name, PRESETS)} There are {', '.join(PRESETS)}"
        )
    return PRESETS[name]


def measured(comparison: Comparison) -> list[PublishedFigures]:
    """Return the figures of a bench's entrants, in the order of the comparison's headline."""
    figures = []
    for name in comparison.headline.order:
        runs = comparison.groups[name]
        # Not finite where a run has too few failures.
        sparsenesses = [
            run.competition_sparseness for run in runs if math.isfinite(run.competition_sparseness)
        ]
        figures.append(
            PublishedFigures(
                tool=name,
                runs=len(runs),
                tests=fmean(run.simulations + run.counts.invalid for run in runs),
                valid=fmean(run.simulations for run in runs),
                failures=fmean(run.failures for run in runs),
                sparseness=fmean(sparsenesses) if sparsenesses else None,
            )
        )
    return figures
