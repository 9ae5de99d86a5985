"""A calibration as one HTML file with its pictures: `write_calibration`."""

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
    Facts,
    Headline,
    Paragraph,
    Role,
    Section,
    Series,
    Table,
    Tile,
    percent,
)
from frenetic.report.html.page import Report, made_by, write_page
from frenetic.twin.calibration import Calibration
from frenetic.twin.calibration.driving import FAILED, OFFSET_MEDIAN
from frenetic.twin.calibration.recordings import GRID
from frenetic.twin.calibration.validation import NEAR, found_by
from frenetic.twin.profile import Figures

TWIN: Final = "twin"
_ROLES: Final[tuple[Role, ...]] = ("fail", "accent", "pass", "invalid")
_SHOWN: Final = 4
"""Number of drives that are drawn."""
_MOST_RUNS: Final = 200
_LINES: Final = 200
"""Most points of a line."""
_ROLE_OF: Final[dict[str, Role | None]] = {"good": "pass", "poor": "fail"}


def write_calibration(calibration: Calibration, profile: Path | str) -> Path:
    """Writes the page of a calibration beside its profile.

    Args:
        calibration: of the twin.
        profile: the profile's file; the page ends with .html.

    Returns:
        The page.

    Raises:
        FreneticError: it cannot be written.
    """
    page = Path(profile).with_suffix(".html")
    return write_page(calibration_report(calibration), page)


def calibration_report(calibration: Calibration) -> Report:
    """The page of a calibration."""
    title = f"The twin {calibration.profile.name}"
    sections = [
        Section("summary", title, (_headline(calibration),)),
        Section(
            "outcomes",
            "Which roads fail",
            tuple(_outcomes(calibration)),
            "Each road is ranked by a twin that has not seen it: the larger its oob share, the"
            " earlier.",
        ),
    ]
    if drives := tuple(_drives(calibration)):
        sections.append(
            Section(
                "drives",
                "How it drives",
                drives,
                "Held-out drives: those whose offset the twin follows best, worst and in between.",
            )
        )
    sections += [
        Section(
            "parameters",
            "Parameters",
            tuple(_parameters(calibration)),
            "What the data say about each, and what they leave open.",
        ),
        Section("runs", "Run by run", (_runs(calibration),)),
        Section("fit", "How it was fitted", tuple(_settings(calibration))),
    ]
    return Report(title=title, sections=tuple(sections), made_by=made_by())


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
        Tile("top tenth", _times(twin.top_tenth), "fails as often as all"),
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


# Outcomes


def _rankings(calibration: Calibration) -> dict[str, FloatArray]:
    return {TWIN: calibration.ranking, **calibration.rankings}


def _failed(calibration: Calibration) -> FloatArray:
    return np.array([drive.failed for drive in calibration.recordings.drives], dtype=np.float64)


def _outcomes(calibration: Calibration) -> Iterator[Block]:
    failed = _failed(calibration)
    if 0.0 < failed.mean() < 1.0:
        lines = []
        for (name, score), role in zip(_rankings(calibration).items(), _ROLES, strict=True):
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
    validation = calibration.validation
    columns = (
        Column("ranking"),
        Column("AUC", True, "Chance that a road that failed ranks above one that did not."),
        Column("rank correlation", True, "Spearman's, with the largest recorded oob share."),
        Column("top tenth", True, "Share of failures in the tenth that ranks first, over all."),
        Column("half found in", True, "Share of the roads that hold half of all failures."),
        Column("same outcome", True),
    )
    ranked = {TWIN: validation.twin, **validation.baselines}
    yield Table(columns, tuple(_row(name, one) for name, one in ranked.items()))
    ours = calibration.rows[:, FAILED] > 0.5
    theirs = failed > 0.5
    yield Table(
        (Column("recorded"), Column("twin passes", True), Column("twin fails", True)),
        tuple(
            (word, str(int((~ours & them).sum())), str(int((ours & them).sum())))
            for word, them in (("PASS", ~theirs), ("FAIL", theirs))
        ),
        "Outcomes under the recorded rules. A twin may rank well and yet fail more or less often.",
    )
    twin = validation.twin
    if twin.departure_gap is not None and twin.near_departures is not None:
        yield Paragraph(
            f"In {counted(twin.common_departures, 'drive')} both cars leave the lane:"
            f" {percent(twin.near_departures)} within {NEAR:g} m of each other along the road,"
            f" {twin.departure_gap:.1f} m apart in the median."
        )


def _row(name: str, one: Figures) -> tuple[str, ...]:
    return (
        name,
        signed(one.auc),
        signed(one.rank_correlation),
        _times(one.top_tenth),
        "–" if one.early_half is None else percent(one.early_half),
        "–" if one.agreement is None else percent(one.agreement),
    )


def _times(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} ×"


# Drives


def _chosen(calibration: Calibration) -> list[int]:
    """Drives with a record, from the one that the twin follows best to the one it follows worst."""
    errors = calibration.rows[:, OFFSET_MEDIAN]
    known = np.flatnonzero(np.isfinite(errors))
    if not len(known):
        return []
    ordered = known[np.argsort(errors[known], kind="stable")]
    return [int(ordered[i]) for i in evenly(len(ordered), _SHOWN)]


def _drives(calibration: Calibration) -> Iterator[Block]:
    chosen = _chosen(calibration)
    if not chosen:
        return
    twin = calibration.validation.twin
    shapes = calibration.settings.shapes
    unit = "of the mean speed" if shapes else "m/s"
    yield Paragraph(
        f"The median absolute error of a drive is {signed(twin.offset_error)} m of lateral offset"
        f" and {signed(twin.speed_error)} {unit} in the median over the drives, along the distance"
        " that both cars come."
    )
    for i in chosen:
        recorded = calibration.recordings.drives[i]
        offset, speed = calibration.held_out_drive(i)
        error = calibration.rows[i, OFFSET_MEDIAN]
        who = f"{recorded.name} of {recorded.run}: median error of the offset {error:.2f} m"
        theirs_speed, title_of_speed = recorded.speed, "speed (m/s)"
        if shapes:
            theirs_speed, speed = shape_of(theirs_speed), shape_of(speed)
            title_of_speed = "speed over its mean"
        for theirs, ours, title in (
            (recorded.offset, offset, "offset to the left (m)"),
            (theirs_speed, speed, title_of_speed),
        ):
            yield Chart(
                (_along("recorded", theirs, "accent"), _along(TWIN, ours, "fail")),
                "distance along the road (m)",
                title,
                who,
            )


def shape_of(speed: FloatArray) -> FloatArray:
    """Speeds over their mean, (n,); a car that stands still stays at 0. NaN where unknown."""
    mean = float(np.nanmean(speed))
    return speed / mean if mean > 0.0 else speed


def _along(name: str, values: FloatArray, role: Role) -> Series:
    known = np.flatnonzero(np.isfinite(values))
    return Series(name, tuple((GRID * known).tolist()), tuple(values[known].tolist()), role=role)


# Parameters


def _parameters(calibration: Calibration) -> Iterator[Block]:
    columns = (
        Column("parameter"),
        Column("fitted", True),
        Column("from", True, "Lower end of the values with which a twin follows them as well."),
        Column("to", True, "Upper end."),
        Column("bounds", True),
        Column("in the folds", True, "Values that the folds found, each without what it held out."),
        Column("finding"),
    )
    rows = []
    for one in calibration.parameters:
        folds = [values[str(one.parameter)] for values in calibration.folds]
        rows.append(
            (
                str(one.parameter),
                f"{one.value:.4g}",
                f"{one.low:.4g}",
                f"{one.high:.4g}",
                f"{one.parameter.low:.4g} to {one.parameter.high:.4g}",
                f"{min(folds):.4g} to {max(folds):.4g}",
                capitalised(str(one)),
            )
        )
    yield Table(
        columns,
        tuple(rows),
        "A twin follows the drives as well if its loss is larger by at most 1.96 standard errors of"
        " the difference, over runs, or over roads where there are fewer than five runs. A"
        " parameter is determined if such values take less than half of its bounds.",
        faint=tuple(not one.is_determined for one in calibration.parameters),
    )
    for one in calibration.parameters:
        values, losses, errors = (tuple(column) for column in zip(*one.curve, strict=True))
        if max(losses) >= 10.0:  # a refused value would hide the rest
            kept = [k for k, loss in enumerate(losses) if loss < 10.0]
            values, losses, errors = (
                tuple(column[k] for k in kept) for column in (values, losses, errors)
            )
        if len(values) < 2:
            continue
        yield Chart(
            (
                Series(
                    "loss",
                    values,
                    losses,
                    tuple(a - 1.96 * b for a, b in zip(losses, errors, strict=True)),
                    tuple(a + 1.96 * b for a, b in zip(losses, errors, strict=True)),
                ),
            ),
            str(one.parameter),
            "loss",
            f"{one.parameter} moved alone; the band is that of the difference from the best.",
        )


# Runs and settings


def _runs(calibration: Calibration) -> Table:
    rows = [
        (
            run,
            str(one.drives),
            str(one.failures),
            signed(one.auc),
            signed(one.rank_correlation),
            signed(one.offset_error),
        )
        for run, one in calibration.by_run().items()
    ]
    left = len(rows) - _MOST_RUNS
    return Table(
        (
            Column("run"),
            Column("drives", True),
            Column("failures", True),
            Column("AUC", True),
            Column("rank correlation", True),
            Column("offset error (m)", True),
        ),
        tuple(rows[:_MOST_RUNS]),
        f"{left} more runs are left out." if left > 0 else "",
        tall=len(rows) > 15,
    )


def _settings(calibration: Calibration) -> Iterator[Block]:
    profile = calibration.profile
    assert profile.fit is not None
    weights = profile.fit.weights
    yield Table(
        (Column("term of the loss"), Column("weight", True), Column("held out", True)),
        tuple(
            (name, f"{weights.get(name, 0.0):g}", f"{value:.3f}")
            for name, value in calibration.terms.items()
        ),
        "0 is a twin that drives as recorded, 1 one that says nothing.",
    )
    yield Facts(
        (
            Fact("seed", str(profile.fit.seed)),
            Fact("candidates of each fit", str(profile.fit.evaluations)),
            Fact("drives of the last fit", str(profile.fit.sample)),
            Fact("loss on them", f"{profile.fit.loss:.3f}"),
            Fact("least loss before", f"{calibration.losses[0]:.3f}, of the model as it was"),
        )
    )
    yield Table(
        (Column("recording"), Column("drives", True), Column("failures", True), Column("SHA-256")),
        tuple(
            (one.name, str(one.drives), str(one.failures), one.sha256[:16])
            for one in profile.recordings
        ),
    )
