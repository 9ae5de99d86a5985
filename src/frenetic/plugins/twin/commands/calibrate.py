"""The command ``frenetic calibrate``, which fits a twin to recorded drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted, signed
from frenetic.cli import echo
from frenetic.cli.console import Log, counted_progress, print_table, shell
from frenetic.cli.entries import complete_names, was_given
from frenetic.cli.options import as_usage_error, file_option, json_option

if TYPE_CHECKING:
    from frenetic.plugins.twin.profile import PredictionFigures, TwinProfile


@click.command()
@click.argument(
    "recordings", type=click.Path(), nargs=-1, required=True, metavar="FILE.toml | RECORDING..."
)
@click.option(
    "--driver",
    metavar="DRIVER",
    shell_complete=complete_names("driver"),
    help="The twin's driver with its options: planner,aggression=1.2 ('frenetic list drivers').",
)
@click.option(
    "--fit",
    multiple=True,
    metavar="NAME[=LOW:HIGH],...",
    help="Parameters to fit: options of the driver, vehicle.NAME or condition.delay, such as"
    " --fit aggression,braking=1:4,vehicle.friction. [default bounds: a quarter of the value to"
    " four times it]",
)
@click.option(
    "--vehicle",
    metavar="NAME",
    help="The car with which the fit begins, and its parameters: metadrive,mass=1500.",
)
@file_option(
    "--out",
    "File for the profile. [default: profile.json]",
    type=click.Path(dir_okay=False),
)
@json_option
@click.pass_context
def calibrate(
    context: click.Context, /, recordings: tuple[str, ...], as_json: bool, **options: Any
) -> None:
    """Fit a twin to recorded drives: a driver and a car of the embedded simulator.

    A RECORDING is a campaign (of any simulator), a folder of campaigns, a folder of the
    competition's test files, or a table of drives in JSON Lines. FILE.toml holds the options, the
    recordings, and terms of their drives (speed_limit). Options beside it replace its entries.

    The twin is cross-validated: by run where there are several, else by road. The command says how
    well the twin follows drives that it was not fitted to, whether it is good enough to start a
    search from, and which parameters the drives do not determine. The profile is for --as.
    """
    # Imported here: they take too long for --help.
    from msgspec import structs

    from frenetic.plugins.twin.calibration import CalibrationFile
    from frenetic.plugins.twin.calibration import calibrate as calibrate_twin
    from frenetic.plugins.twin.recordings import read_recordings
    from frenetic.plugins.twin.verdict import answer
    from frenetic.spec import read_entries

    entries = CalibrationFile(recordings=recordings)
    if len(recordings) == 1 and recordings[0].endswith(".toml"):
        entries = read_entries(Path(recordings[0]), CalibrationFile, "a calibration")
    given_options = {name: value for name, value in options.items() if was_given(context, name)}
    if "fit" in given_options:
        given_options["fit"] = [name for text in given_options["fit"] for name in text.split(",")]
    entries = structs.replace(entries, **given_options)
    out = Path(entries.out)
    if out.suffix.lower() != ".json":
        raise click.UsageError(f"{out}: a profile's name ends with .json")
    log = Log()
    with log.status("Reading the recordings"):
        recorded = read_recordings(entries.recordings, entries.terms)
    with as_usage_error():
        model = entries.model()
    log.print(
        f"{counted(len(recorded.drives), 'recorded drive')} of"
        f" {counted(len(recorded.runs), 'run')},"
        f" {sum(drive.failed for drive in recorded.drives)} failed"
        + (f"; {counted(recorded.skipped, 'other test')} left out" if recorded.skipped else ""),
        markup=False,
    )
    with counted_progress(log, "Fitting") as show:
        profile = calibrate_twin(
            recorded, model, name=out.stem, places=entries.recordings, on_progress=show
        )
    profile.write(out)
    if as_json:
        echo(out.read_text(encoding="utf-8"), nl=False)
        return
    _print_tables(profile)
    echo(answer(profile))
    echo(f"Profile:     {out}")
    echo(f"Use it:      frenetic run --as {shell(out)}")


def _print_tables(profile: TwinProfile) -> None:
    """Print the parameters with their intervals, and the figures beside the baselines' figures."""
    print_table(
        ("parameter", ">fitted", ">from", ">to", ">bounds", "the data"),
        [
            (
                parameter.name,
                *(f"{value:.4g}" for value in (parameter.value, parameter.from_, parameter.to)),
                f"{parameter.low:.4g} to {parameter.high:.4g}",
                ("determine it" if parameter.is_determined else "do not determine it")
                + ("; its interval ends at a bound" if parameter.at_bound else ""),
            )
            for parameter in profile.fitted
        ],
    )
    assert profile.validation is not None
    rankings = {"twin": profile.validation.twin, **profile.validation.baselines}
    print_table(
        ("ranking", ">AUC", ">top tenth", ">same outcome", ">offset error"),
        [(name, *_cells(figures)) for name, figures in rankings.items()],
    )


def _cells(figures: PredictionFigures) -> tuple[str | None, ...]:
    """Return a ranking's cells of the table of figures; None for an unknown figure."""

    def text(value: float | None, pattern: str) -> str | None:
        return None if value is None else pattern.format(value)

    return (
        signed(figures.auc),
        text(figures.top_tenth, "{:.1f} ×"),
        text(figures.agreement, "{:.0%}"),
        text(figures.offset_error, "{:.2f} m"),
    )
