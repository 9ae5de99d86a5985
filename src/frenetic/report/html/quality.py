"""A comparison of two versions of a driver as one HTML file: `write_quality_page`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from frenetic._support.words import capitalised
from frenetic.analysis.quality import QUALITY, Axis, QualityMeasure
from frenetic.analysis.quality_comparison import QualityComparison
from frenetic.analysis.quality_differences import FAILING, CurvePoint, PairedQuality, curve
from frenetic.analysis.quality_text import difference_rows, drives_title
from frenetic.analysis.statistics import SIGNIFICANT
from frenetic.report.html.page import (
    Chart,
    DataBlock,
    Facts,
    Paragraph,
    Report,
    Section,
    Series,
    Table,
    Tile,
    command,
    proper,
    write_page,
)
from frenetic.spec.part_text import part_text

if TYPE_CHECKING:
    from frenetic.rerun.back_to_back import BackToBack

CHARTED: Final = ("rms_offset", "edge_distance", "rms_steering_rate", "rms_lateral_jerk")
"""Names of the measures whose differences are drawn over speed and radius; our choice."""
_AXES: Final[dict[Axis, str]] = {"radius": "radius of the road [m]", "speed": "speed [km/h]"}
"""Axis -> title."""
_WIDE: Final = 1.25
"""Place of the bin of the widest bends and straights, as a multiple of its lower end; our
choice."""
_STATISTICS: Final = {
    "old, new": "Median over the roads that both pass, or share of the roads.",
    "difference": "Hodges and Lehmann's estimate of new minus old on the same road, the median of"
    " the means of all pairs of differences, with Wilcoxon's interval of 95 %.",
    "shown": "Wilcoxon's signed-rank test, corrected by Holm for all measures in all conditions of"
    f" this page, is below {SIGNIFICANT:g}, and the difference is at least what anyone would notice"
    " (the least difference of the measure; our choice).",
}


def write_quality_page(result: BackToBack, path: Path | str, *, command: str | None = None) -> Path:
    """Write a comparison of two versions as one self-contained HTML file.

    Args:
        result: complete comparison, without missing drives.
        path: path of the file, which is replaced.
        command: command line that writes the page again.

    Returns:
        The file.

    Raises:
        FreneticError: the file cannot be written.
        ValueError: drives are missing.
    """
    if result.quality is None:
        raise ValueError(f"{result.missing} drives are missing: compare the versions to the end")
    return write_page(quality_report(result, result.quality, command_line=command), path)


def quality_report(
    result: BackToBack, quality: QualityComparison, *, command_line: str | None = None
) -> Report:
    """Return the page of a comparison of two versions.

    Args:
        result: comparison of two versions.
        quality: its comparison where both pass.
        command_line: command line that writes the page again.
    """
    configuration = []
    if command_line is not None:
        block = command(command_line, "Makes this again:")
        configuration.append(Section("configuration", "Configuration", (block,)))
    measures = (FAILING, *QUALITY.values())
    definitions = {measure.title: _definition(measure) for measure in measures}
    tables = tuple(
        block
        for drives in quality.drives
        for block in (Paragraph(f"{drives_title(drives)}:"), _table(quality, drives))
    )
    title = f"{part_text(result.old)} and {part_text(result.new)} compared"
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(result, quality),)),
            Section("differences", "Differences on the same roads", tables),
            *(
                Section(
                    f"over-{axis}",
                    f"Over the {axis}",
                    tuple(_charts(quality, axis)),
                    "New minus old in each part of the road, with its interval of 95 %, which is"
                    " not corrected for the number of parts.",
                )
                for axis in _AXES
            ),
            Section(
                "measures",
                "What is measured",
                (Facts(definitions, "Measures"), Facts(_STATISTICS, "Statistics")),
            ),
            *configuration,
        ),
    )


def _headline(result: BackToBack, quality: QualityComparison) -> DataBlock:
    """Return the block with the sentences and the differences that are shown."""
    return DataBlock(
        "headline",
        {
            "lead": " ".join(f"{capitalised(sentence)}." for sentence in result.sentences),
            "warning": " ".join(f"{capitalised(note)}." for note in result.notes),
            "tiles": [
                Tile(
                    difference.measure.title,
                    proper(f"{difference.measure.text(difference.new)} {difference.measure.unit}"),
                    proper(
                        f"old {difference.measure.text(difference.old)}"
                        + (f", with {difference.conditions}" if difference.conditions else "")
                    ),
                    "fail" if difference.better < 0 else "",
                )
                for difference in quality.main
            ],
            "facts": {
                "old": part_text(result.old),
                "new": part_text(result.new),
                "simulator": part_text(result.simulator),
                "fresh roads": f"{len(result.fresh.pairs)}, seed {result.seed}",
            },
        },
    )


def _definition(measure: QualityMeasure) -> str:
    """Return the definition of a measure, what is better, and its least difference."""
    better = "" if measure.better == "neither" else f" {capitalised(measure.better)} is better."
    return f"{measure.definition}{better} Least difference: {measure.least:g} {measure.unit}."


def _table(quality: QualityComparison, drives: PairedQuality) -> Table:
    """Return the table of all measures in one kind of conditions."""
    rows = difference_rows(quality.differences, drives.conditions)
    return Table(
        ("measure", ">old", ">new", ">difference (95 %)", "shown"),
        tuple(tuple(map(proper, row)) for row in rows),
    )


def _charts(quality: QualityComparison, axis: Axis) -> Iterator[Chart]:
    """Yield a chart for each measure: its difference over an axis, a line for each conditions."""
    for name in CHARTED:
        measure = QUALITY[name]
        lines = [
            _line(drives.conditions or "as in the campaign", points, f"group-{i}")
            for i, drives in enumerate(quality.drives)
            if len(points := curve(drives, axis, name)) > 1
        ]
        if lines:
            ends = [end for line in lines for end in (line.x[0], line.x[-1])]
            zero = Series("alike", (min(ends), max(ends)), (0.0, 0.0), role="quiet", dashed=True)
            yield Chart(
                (*lines, zero),
                _AXES[axis],
                f"{measure.title}: new minus old [{measure.unit}]",
                _caption(measure, axis),
            )


def _caption(measure: QualityMeasure, axis: Axis) -> str:
    """Return a text about a chart."""
    better = "" if measure.better == "neither" else f"{capitalised(measure.better)} is better."
    if axis == "radius":
        better += " The point on the right holds all wider bends and straights."
    return better.strip()


def _line(name: str, points: list[CurvePoint], role: str) -> Series:
    """Return the line of a difference with its interval."""
    places = [
        0.5 * (point.low + point.high) if math.isfinite(point.high) else _WIDE * point.low
        for point in points
    ]
    shifts = [point.difference for point in points]
    return Series(
        name,
        tuple(places),
        tuple(round(shift.value, 4) for shift in shifts),
        tuple(round(shift.low, 4) for shift in shifts),
        tuple(round(shift.high, 4) for shift in shifts),
        role=role,
    )
