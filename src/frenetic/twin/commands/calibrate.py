"""The command that fits a twin to recorded drives: calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import capitalised, counted
from frenetic.cli.console import (
    Log,
    announced_compilation,
    counted_progress,
    print_table,
    shell,
    two_digits,
)
from frenetic.cli.options import (
    WORKERS,
    AskedRange,
    Range,
    Setting,
    as_usage_error,
    count_option,
    file_option,
    json_option,
)
from frenetic.cli.parts import part_choice
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.twin.calibration import Calibration, Model, Recordings
    from frenetic.twin.profile import Figures


class Fits(Range):
    """NAME or NAME=LOW:HIGH, several with commas between them."""

    name = "name[=low:high],..."

    def __init__(self) -> None:
        super().__init__("braking=1:4")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The parameters with their bounds."""
        texts = [text.strip() for text in str(value).split(",")]
        if not all(texts):
            self.fail(f"{value!r} has an empty name", param, ctx)
        return [super(Fits, self).convert(text, param, ctx) for text in texts]


@click.command()
@click.argument(
    "recordings", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RECORDING..."
)
@part_choice(
    "driver",
    "The twin's driver ('frenetic list drivers'), package.module:Class or file.py:Class.",
    required=True,
)
@click.option(
    "--fit",
    "asked",
    type=Fits(),
    multiple=True,
    required=True,
    help="Parameters to fit: options of the driver, vehicle.NAME or layer.delay, such as"
    " --fit aggression,braking=1:4,vehicle.friction. [default bounds: a quarter of the value to"
    " four times it]",
)
@click.option(
    "--vehicle",
    type=Setting(),
    multiple=True,
    help="A parameter of the car, such as mass=1500, or name=metadrive to begin with that car; may"
    " be repeated.",
)
@file_option(
    "--out",
    "Where the profile goes; beside it its page (.html).",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("profile.json"),
    show_default=True,
)
@click.option("--name", metavar="TEXT", help="Name of the twin. [default: that of the file]")
@count_option(
    "--evaluations", "Candidates of each fit. [default: 50 for each parameter, at least 100]"
)
@count_option("--folds", "Folds of the cross-validation, at most.", least=2, default=5)
@count_option(
    "--sample",
    "Drives of each fit, at most: by chance, up to half of them failures.",
    least=10,
    default=300,
)
@click.option(
    "--weight",
    "weights",
    type=Range("speed=0.5"),
    multiple=True,
    help="Weight of a term of the loss: outcome, oob_share, oob_distance, steering, offset, speed;"
    " 0 leaves it out. May be repeated.",
)
@click.option(
    "--speed-shapes",
    is_flag=True,
    help="Compare only the shapes of speeds, where a record's clock is not the simulation's.",
)
@click.option(
    "--speed-limit",
    type=float,
    metavar="KMH",
    help="Of the recorded drives. [default: as recorded, or 70]",
)
@click.option(
    "--oob-tolerance",
    type=float,
    metavar="SHARE",
    help="Of the recorded drives. [default: as recorded, or 0.95]",
)
@click.option(
    "--lane-width",
    type=float,
    metavar="M",
    help="Of the recorded roads. [default: as recorded, or 4]",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the search.")
@click.option(
    "--workers",
    type=WORKERS,
    metavar="N",
    help="Drive in N processes; the result is the same. [default: the cores]",
)
@json_option
def calibrate(
    recordings: tuple[Path, ...],
    driver: str,
    asked: tuple[list[AskedRange], ...],
    driver_options: tuple[tuple[str, Any], ...],
    vehicle: tuple[tuple[str, Any], ...],
    out: Path,
    name: str | None,
    evaluations: int | None,
    folds: int,
    sample: int,
    weights: tuple[AskedRange, ...],
    speed_shapes: bool,
    speed_limit: float | None,
    oob_tolerance: float | None,
    lane_width: float | None,
    seed: int,
    workers: int | None,
    as_json: bool,
) -> None:
    """Fit a twin to recorded drives: a driver and a car of the embedded simulator.

    A RECORDING is a campaign (of any simulator), a folder of campaigns, a folder of the
    competition's test files or one of them, or a table of drives: JSON Lines, CSV or Parquet. The
    twin is cross-validated: by run where there are several, else by road. The command says how well
    it follows drives that it has not seen, whether it is good enough to screen with, and which
    parameters the data do not determine. The profile is for --as. The same command goes on
    after Ctrl-C or a crash.
    """
    from frenetic._support.interrupt import catch_interrupt
    from frenetic.campaign.workers import available_cores
    from frenetic.report.html.page import made_by
    from frenetic.twin.calibration import Settings, Terms, read_recordings
    from frenetic.twin.calibration import calibrate as calibrate_twin
    from frenetic.twin.page import write_calibration

    if out.suffix.lower() != ".json":
        raise click.UsageError(f"--out {out}: a profile's name ends with .json")
    log = Log()
    given = Terms(speed_limit, oob_tolerance, lane_width)
    with log.status("Reading the recordings"):
        found = read_recordings(recordings, given)
    model = _model(driver, asked, driver_options, vehicle)
    _announce(log, found, model)
    state = out.with_name(f"{out.stem}.fit.jsonl")
    with (
        announced_compilation(log) as compiled,
        counted_progress(log, "Driving candidates") as show,
        catch_interrupt(log.stopping) as interrupt,
        as_usage_error(),
    ):

        def progress(done: int, total: int) -> None:
            compiled()
            show(done, total)

        result = calibrate_twin(
            found,
            model,
            Settings(
                seed=seed,
                evaluations=evaluations,
                folds=folds,
                sample=sample,
                weights={one.name: _weight(one) for one in weights},
                shapes=speed_shapes,
            ),
            name=name or out.stem,
            workers=workers or available_cores(),
            state=state,
            on_progress=progress,
            should_stop=lambda: interrupt.requested,
            version=made_by(),
        )
    if result is None:
        log.print("Interrupted; the same command goes on")
        raise click.exceptions.Exit(130)
    result.profile.write(out)
    with log.status("Drawing"):
        page = write_calibration(result, out)
    if as_json:
        click.echo(out.read_text(encoding="utf-8"), nl=False)
    else:
        _print(result, out, page)


def _weight(one: AskedRange) -> float:
    if one.limits is None or one.limits[0] != one.limits[1]:
        raise click.UsageError(f"--weight {one.name}: NAME=NUMBER is needed, as in speed=0.5")
    return one.limits[0]


def _model(
    driver: str,
    asked: tuple[list[AskedRange], ...],
    driver_options: tuple[tuple[str, Any], ...],
    vehicle: tuple[tuple[str, Any], ...],
) -> Model:
    from frenetic.twin.calibration import Asked, Model

    wanted = [
        Asked(one.name, *(one.limits or (None, None))) for several in asked for one in several
    ]
    try:
        return Model.of(driver, wanted, driver_options=dict(driver_options), vehicle=dict(vehicle))
    except ValueError as error:
        raise FreneticError(f"--vehicle: {error}") from None


def _announce(log: Log, found: Recordings, model: Model) -> None:
    failed = sum(drive.failed for drive in found.drives)
    skipped = f"; {counted(found.skipped, 'other test')} left out" if found.skipped else ""
    log.print(
        f"{counted(len(found.drives), 'recorded drive')} of {counted(len(found.runs), 'run')},"
        f" {failed} failed{skipped}",
        markup=False,
    )
    for one in model.parameters:
        log.print(f"  {one}: {one.start:.4g}, from {one.low:.4g} to {one.high:.4g}", markup=False)
    if len(found.runs) == 1:
        log.print("There is one run only: the cross-validation holds roads out, not runs.")


def _print(result: Calibration, out: Path, page: Path) -> None:
    validation = result.validation
    print_table(
        ("parameter", ">fitted", ">from", ">to", "bounds", "the data"),
        [
            (
                str(one.parameter),
                f"{one.value:.4g}",
                f"{one.low:.4g}",
                f"{one.high:.4g}",
                f"{one.parameter.low:.4g} to {one.parameter.high:.4g}",
                str(one).removeprefix("the data "),
            )
            for one in result.parameters
        ],
    )
    figures = {"twin": validation.twin, **validation.baselines}
    print_table(
        ("held out", ">AUC", ">rank corr.", ">top tenth", ">half found in", ">same outcome"),
        [_row(name, one) for name, one in figures.items()],
    )
    twin = validation.twin
    unit = "of the mean" if result.settings.shapes else "m/s"
    if twin.offset_error is not None and twin.speed_error is not None:
        click.echo(
            f"Median errors of held-out drives: {twin.offset_error:.2f} m of offset,"
            f" {twin.speed_error:.2f} {unit} of speed"
        )
    if twin.departure_gap is not None and twin.near_departures is not None:
        click.echo(
            f"Both leave the lane in {counted(twin.common_departures, 'drive')},"
            f" {twin.departure_gap:.0f} m apart (median), {twin.near_departures:.0%} within 20 m"
        )
    click.echo(result.answer)
    click.echo(f"Profile:     {out}")
    click.echo(f"Report:      {page}")
    click.echo(f"Use it:      frenetic run --as {shell(out)}")


def _row(name: str, one: Figures) -> tuple[object, ...]:
    percent = (
        f"{value:.0%}" if value is not None else None for value in (one.early_half, one.agreement)
    )
    return (
        capitalised(name),
        two_digits(one.auc),
        two_digits(one.rank_correlation),
        None if one.top_tenth is None else f"{one.top_tenth:.1f} x",
        *percent,
    )
