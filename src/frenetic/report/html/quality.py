"""A comparison of two versions of a driver as one HTML file: `write_quality_page`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from frenetic._support.words import capitalised
from frenetic.analysis.quality import QUALITY, Axis, QualityMeasure
from frenetic.analysis.quality_comparison import QualityComparison
from frenetic.analysis.quality_differences import FAILING, CurvePoint, QualityDifference, curve
from frenetic.analysis.quality_text import difference_row, difference_rows, drives_title
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
from frenetic.rerun.versions_by_class import VersionsByClass
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
_MEASURES: Final = (FAILING, *QUALITY.values())
"""All measures, the most important group first."""
_OVER_PARTS: Final = (
    "New minus old in each part of the road, with its interval of 95 %, which is not corrected for"
    " the number of parts."
)
"""Text about charts over an axis."""
_STATISTICS: Final = {
    "old, new": "Median over the roads that both pass, or share of the roads.",
    "difference": "Hodges and Lehmann's estimate of new minus old on the same road, the median of"
    " the means of all pairs of differences, with Wilcoxon's interval of 95 %.",
    "shown": "Wilcoxon's signed-rank test, corrected by Holm for all measures in all conditions of"
    f" this page, is below {SIGNIFICANT:g}, and the difference is at least what anyone would notice"
    " (the least difference of the measure; our choice).",
}


def write_quality_page(
    result: BackToBack | VersionsByClass, path: Path | str, *, command: str | None = None
) -> Path:
    """Write a comparison of two versions as one self-contained HTML file.

    Args:
        result: complete comparison, without missing drives, on roads of one class or of several.
        path: path of the file, which is replaced.
        command: command line that writes the page again.

    Returns:
        The file.

    Raises:
        FreneticError: the file cannot be written.
        ValueError: drives are missing.
    """
    if isinstance(result, VersionsByClass):
        return write_page(classes_report(result, command_line=command), path)
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
    title = _title(result)
    tiles = [_tile(difference) for difference in quality.main]
    fresh = f"{len(result.fresh.pairs)}, seed {result.seed}"
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(result, tiles, fresh),)),
            Section("differences", "Differences on the same roads", tuple(_tables(quality))),
            *(
                Section(
                    f"over-{axis}", f"Over the {axis}", tuple(_charts(quality, axis)), _OVER_PARTS
                )
                for axis in _AXES
            ),
            *_closing_sections(command_line),
        ),
    )


def classes_report(result: VersionsByClass, *, command_line: str | None = None) -> Report:
    """Return the page of a comparison of two versions on roads of several classes.

    It has a section for each class, with charts of the measures that differ there.

    Args:
        result: comparison of two versions.
        command_line: command line that writes the page again.
    """
    title = _title(result)
    qualities = result.qualities
    tiles = [
        _tile(difference, name)
        for name, quality in qualities.items()
        for difference in quality.main[:1]
    ]
    fresh = ", ".join(
        f"{len(of_class.fresh.pairs)} of {name} (seed {of_class.seed})"
        for name, of_class in result.classes.items()
    )
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(result, tiles, fresh),)),
            Section("classes", "Road classes", (_failures_table(result), _overview(qualities))),
            *(
                Section(
                    f"class-{i}",
                    capitalised(name),
                    (*_tables(quality), *_charts_of_class(quality)),
                    proper(f"{capitalised(quality.sentence)}."),
                )
                for i, (name, quality) in enumerate(qualities.items(), 1)
            ),
            *_closing_sections(command_line),
        ),
    )


def _title(result: BackToBack | VersionsByClass) -> str:
    """Return the title of a page, which names both versions."""
    return f"{part_text(result.old)} and {part_text(result.new)} compared"


def _closing_sections(command_line: str | None) -> Iterator[Section]:
    """Yield the sections with definitions, and with the command line that writes the page again."""
    definitions = {measure.title: _definition(measure) for measure in _MEASURES}
    facts = (Facts(definitions, "Measures"), Facts(_STATISTICS, "Statistics"))
    yield Section("measures", "What is measured", facts)
    if command_line is not None:
        block = command(command_line, "Makes this again:")
        yield Section("configuration", "Configuration", (block,))


def _headline(result: BackToBack | VersionsByClass, tiles: Sequence[Tile], fresh: str) -> DataBlock:
    """Return the block with the sentences and the differences that are shown.

    Args:
        result: comparison of two versions.
        tiles: the largest differences.
        fresh: numbers and seeds of the fresh roads.
    """
    return DataBlock(
        "headline",
        {
            "lead": proper(" ".join(f"{capitalised(sentence)}." for sentence in result.sentences)),
            "warning": " ".join(f"{capitalised(note)}." for note in result.notes),
            "tiles": list(tiles),
            "facts": {
                "old": part_text(result.old),
                "new": part_text(result.new),
                "simulator": part_text(result.simulator),
                "fresh roads": fresh,
            },
        },
    )


def _tile(difference: QualityDifference, road_class: str = "") -> Tile:
    """Return the tile of a difference; a road class is named if there are several."""
    measure = difference.measure
    note = f"old {measure.text(difference.old)}"
    if difference.conditions:
        note += f", with {difference.conditions}"
    if road_class:
        note += f", on {road_class}"
    return Tile(
        measure.title,
        proper(f"{measure.text(difference.new)} {measure.unit}"),
        proper(note),
        "fail" if difference.better < 0 else "",
    )


def _failures_table(result: VersionsByClass) -> Table:
    """Return the table of failures on the fresh roads of each class."""
    rows = []
    for name, of_class in result.classes.items():
        old, new = of_class.fresh.failing
        counts = (str(len(of_class.fresh.judged)), str(old), str(new))
        rows.append((name, *counts, proper(of_class.difference_text), of_class.verdict_with_time))
    return Table(
        ("failures", ">fresh roads", ">old fails", ">new fails", ">difference", "verdict"),
        tuple(rows),
    )


def _overview(qualities: Mapping[str, QualityComparison]) -> Table:
    """Return the table of the differences that are shown on some class, a column for each class."""
    shown = {
        name: {
            (difference.measure.name, difference.conditions): difference
            for difference in quality.differences
            if difference.is_shown
        }
        for name, quality in qualities.items()
    }
    kinds = {kind: None for differences in shown.values() for kind in differences}
    order = [measure.name for measure in _MEASURES]
    rows = []
    for name, conditions in sorted(kinds, key=lambda kind: order.index(kind[0])):
        measure = _MEASURES[order.index(name)]
        differences = [of_class.get((name, conditions)) for of_class in shown.values()]
        cells = ["–" if each is None else _overview_text(each) for each in differences]
        rows.append((f"{measure.title} [{measure.unit}]", conditions, *cells))
    caption = (
        "New minus old where both pass, with the version that is better; – if no difference is"
        " shown."
    )
    return Table(("quality", "with", *(f">{name}" for name in qualities)), tuple(rows), caption)


def _overview_text(difference: QualityDifference) -> str:
    """Return a difference with the version that is better, such as ``+0.21, new``."""
    *_, amounts, _ = difference_row(difference)
    better = {1: ", new", -1: ", old", 0: ""}[difference.better]
    return proper(f"{amounts.partition(' ')[0]}{better}")


def _definition(measure: QualityMeasure) -> str:
    """Return the definition of a measure, what is better, and its least difference."""
    better = "" if measure.better == "neither" else f" {capitalised(measure.better)} is better."
    return f"{measure.definition}{better} Least difference: {measure.least:g} {measure.unit}."


def _tables(quality: QualityComparison) -> Iterator[Paragraph | Table]:
    """Yield a title and the table of all measures for each kind of conditions."""
    for drives in quality.drives:
        yield Paragraph(f"{drives_title(drives)}:")
        rows = difference_rows(quality.differences, drives.conditions)
        yield Table(
            ("measure", ">old", ">new", ">difference (95 %)", "shown"),
            tuple(tuple(map(proper, row)) for row in rows),
        )


def _charts_of_class(quality: QualityComparison) -> Iterator[Paragraph | Chart]:
    """Yield charts over each axis of the measures whose difference is shown."""
    shown = {difference.measure.name for difference in quality.shown}
    charts = [
        chart
        for axis in _AXES
        for chart in _charts(quality, axis, [name for name in CHARTED if name in shown])
    ]
    if charts:
        yield Paragraph(_OVER_PARTS)
        yield from charts


def _charts(
    quality: QualityComparison, axis: Axis, names: Sequence[str] = CHARTED
) -> Iterator[Chart]:
    """Yield a chart for each measure: its difference over an axis, a line for each conditions."""
    for name in names:
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
