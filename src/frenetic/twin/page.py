"""A calibration as one HTML file with its pictures, and its tables: `write_calibration`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, evenly
from frenetic._support.words import capitalised, counted, signed
from frenetic.report.html.blocks import (
    Block,
    Chart,
    Column,
    Fact,
    Headline,
    Role,
    Section,
    Series,
    Table,
    Tile,
)
from frenetic.report.html.page import Report, write_page
from frenetic.twin.calibration import Calibration
from frenetic.twin.calibration.driving import OFFSET_MEDIAN
from frenetic.twin.calibration.recordings import GRID
from frenetic.twin.calibration.validation import found_by
from frenetic.twin.profile import Figures, Fitted, Profile

TWIN: Final = "twin"
_ROLES: Final[tuple[Role, ...]] = ("fail", "accent", "pass", "invalid")
_SHOWN: Final = 4
"""Number of drives that are drawn."""
_LINES: Final = 200
"""Most points of a line."""
_ROLE_OF: Final[dict[str, Role | None]] = {"good": "pass", "poor": "fail"}


def write_calibration(calibration: Calibration, profile: Path | str) -> Path:
    """Writes the page of a calibration beside its profile; returns the page, which ends with .html.

    Raises:
        FreneticError: it cannot be written.
    """
    title = f"The twin {calibration.profile.name}"
    outcomes = Section(
        "outcomes",
        "Which roads fail",
        (*_found(calibration), ranking_table(calibration.profile)),
        "Each road is ranked by a twin that has not seen it: the larger its oob share, the"
        " earlier.",
    )
    drives = Section(
        "drives",
        "How it drives",
        tuple(_drives(calibration)),
        "Held-out drives: those whose offset the twin follows best, worst and in between.",
    )
    parameters = Section(
        "parameters",
        "Parameters",
        (parameter_table(calibration.profile),),
        "What the data say about each, and what they leave open.",
    )
    sections = (
        Section("summary", title, (_headline(calibration),)),
        outcomes,
        *([drives] if drives.blocks else []),
        parameters,
    )
    report = Report(title=title, sections=sections)
    return write_page(report, Path(profile).with_suffix(".html"))


def _headline(calibration: Calibration) -> Headline:
    validation, spec = calibration.validation, calibration.profile.spec()
    twin, interval = validation.twin, calibration.auc_interval
    tiles = [
        Tile(
            "AUC",
            signed(twin.auc),
            "" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}",
            _ROLE_OF.get(validation.verdict),
        ),
        Tile("rank correlation", signed(twin.rank_correlation), "of the largest oob share"),
        Tile("top tenth", _cell(twin.top_tenth, "{:.1f} ×"), "fails as often as all"),
    ]
    if twin.offset_error is not None:
        tiles.append(Tile("offset", f"{twin.offset_error:.2f} m", "median error"))
    warning = ""
    if validation.by == "road":
        warning = (
            "There is one run only, so roads were held out, not runs: where a search proposed them,"
            " they resemble each other, and the figures flatter."
        )
    return Headline(
        title="",
        lead=f"{calibration.answer}.",
        warning=warning,
        tiles=tuple(tiles),
        facts=(
            Fact("driver", str(spec.driver.name)),
            Fact(
                "recorded",
                f"{counted(twin.drives, 'drive')} of"
                f" {counted(len(calibration.recordings.runs), 'run')}, {twin.failures} failed",
            ),
            Fact(
                "terms",
                f"{spec.rules.speed_limit:g} km/h, {spec.rules.oob_tolerance:g} of the car may be"
                f" out, lanes of {spec.lane_width:g} m",
            ),
            Fact("held out", f"by {validation.by}, {validation.folds} folds"),
        ),
    )


def _found(calibration: Calibration) -> Iterator[Block]:
    drives = calibration.recordings.drives
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    if not 0.0 < failed.mean() < 1.0:
        return
    lines = []
    rankings = {TWIN: calibration.ranking, **calibration.rankings}
    for (name, score), role in zip(rankings.items(), _ROLES, strict=True):
        roads, found = found_by(score, failed)
        keep = evenly(len(roads), _LINES)
        lines.append(
            Series(
                name,
                tuple((100.0 * roads[keep]).tolist()),
                tuple((100.0 * found[keep]).tolist()),
                role=role,
                dashed=name != TWIN,
            )
        )
    lines.append(Series("by chance", (0.0, 100.0), (0.0, 100.0), role="quiet", dashed=True))
    yield Chart(
        tuple(lines),
        "% of the roads, as ranked",
        "% of the failures",
        "A replay of the record: the recorded failures found if the roads were driven in the"
        " order of a ranking.",
    )


def ranking_table(profile: Profile) -> Table:
    """The figures of the twin and of its baselines."""
    columns = (
        Column("ranking"),
        Column("AUC", True, "Chance that a road that failed ranks above one that did not."),
        Column("rank correlation", True, "Spearman's, with the largest recorded oob share."),
        Column("top tenth", True, "Share of failures in the tenth that ranks first, over all."),
        Column("half found in", True, "Share of the roads that hold half of all failures."),
        Column("same outcome", True),
    )
    validation = profile.validation
    assert validation is not None

    def row(name: str, one: Figures) -> tuple[str, ...]:
        return (
            capitalised(name),
            signed(one.auc),
            signed(one.rank_correlation),
            _cell(one.top_tenth, "{:.1f} ×"),
            _cell(one.early_half, "{:.0%}"),
            _cell(one.agreement, "{:.0%}"),
        )

    ranked = {TWIN: validation.twin, **validation.baselines}
    return Table(columns, tuple(row(*one) for one in ranked.items()))


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)


def parameter_table(profile: Profile) -> Table:
    """The parameters with their intervals."""
    columns = (
        Column("parameter"),
        Column("fitted", True),
        Column("from", True, "Lower end of the values with which a twin follows them as well."),
        Column("to", True, "Upper end."),
        Column("bounds", True),
        Column("the data"),
    )

    def row(one: Fitted) -> tuple[str, ...]:
        told = "determine it" if one.is_determined else "do not determine it"
        return (
            one.name,
            *(f"{value:.4g}" for value in (one.value, one.from_, one.to)),
            f"{one.low:.4g} to {one.high:.4g}",
            f"{told}; its interval ends at a bound" if one.at_bound else told,
        )

    return Table(
        columns,
        tuple(map(row, profile.fitted)),
        "A twin follows the drives as well if its loss is larger by at most 1.96 standard errors of"
        " the difference, over runs, or over roads where there are fewer than five runs. A"
        " parameter is determined if such values take less than half of its bounds.",
        faint=tuple(not one.is_determined for one in profile.fitted),
    )


def _drives(calibration: Calibration) -> Iterator[Block]:
    errors = calibration.rows[:, OFFSET_MEDIAN]
    known = np.flatnonzero(np.isfinite(errors))
    ordered = known[np.argsort(errors[known], kind="stable")]
    for i in ordered[evenly(len(ordered), _SHOWN)] if len(ordered) else ():
        recorded = calibration.recordings.drives[i]
        offset, speed = calibration.held_out_drive(i)
        who = f"{recorded.name} of {recorded.run}: median error of the offset {errors[i]:.2f} m"
        for theirs, ours, title in (
            (recorded.offset, offset, "offset to the left (m)"),
            (recorded.speed, speed, "speed (m/s)"),
        ):
            yield Chart(
                (_along("recorded", theirs, "accent"), _along(TWIN, ours, "fail")),
                "distance along the road (m)",
                title,
                who,
            )


def _along(name: str, values: FloatArray, role: Role) -> Series:
    known = np.flatnonzero(np.isfinite(values))
    return Series(name, tuple((GRID * known).tolist()), tuple(values[known].tolist()), role=role)
