"""The study of `frenetic rerun --stability`: its progress and its output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from frenetic._support.words import capitalised, counted
from frenetic.cli import echo
from frenetic.cli.console import Log, print_table
from frenetic.cli.rerun_options import interrupted, kept_text, shown_driving

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester
    from frenetic.rerun.campaigns import ReplayOptions
    from frenetic.rerun.stability_study import StabilityStudy

MAX_IDS: Final = 20
"""Largest number of printed IDs of failures that pass (our choice); the JSON has all."""


def study_failures(
    folder: Path, tester: RoadTester, options: ReplayOptions, *, as_json: bool
) -> None:
    """Study the stability of a campaign's failures, and print the counts.

    Args:
        folder: folder of the campaign.
        tester: drives the roads.
        options: tests, conditions and workers.
        as_json: whether to print JSON.

    Raises:
        click.exceptions.Exit: drives are left after Ctrl-C, or no drive could be judged.
    """
    from frenetic.rerun.stability_study import study_stability_with

    log = Log()
    with shown_driving(log, "Driving again") as on_event:
        options["on_event"] = on_event
        study = study_stability_with(folder, tester, **options)
    if as_json:
        echo(json.dumps(study.as_json()))
    elif not study.failures:
        echo(f"{folder} holds no failure")
    else:
        _print(study)
        is_reported = study.is_own and options["out"] is None
        echo(kept_text(study.folder, folder, is_reported=is_reported))
    if study.missing:
        raise interrupted(log, f"{counted(study.missing, 'drive')} to go")
    if study.failures and not study.stability.as_text():  # no drive was judged
        raise click.exceptions.Exit(1)


def _print(study: StabilityStudy) -> None:
    """Print how many failures fail again and keep their cause, in each grip and by cause."""
    from frenetic.analysis.failure_stability import Grip

    stability = study.stability
    total = stability.total
    echo(capitalised(stability.as_text()) or "No drive could be judged")
    print_table(
        ("", ">fail", ">with the same cause"),
        [(str(grip), total.at(grip).fails, total.at(grip).keeps_cause) for grip in Grip],
        title=f"{counted(total.failures, 'failure')}, with 95 % intervals",
    )
    print_table(
        ("what the driver does", ">failures", f">pass {Grip.MORE}", ">keep their cause"),
        [
            (cause.cause, cause.failures, cause.passes_with_more_grip, cause.keeps_cause)
            for cause in stability.causes
        ],
    )
    if passing := study.passing_with_more_grip:
        more = f" and {len(passing) - MAX_IDS} more" if len(passing) > MAX_IDS else ""
        echo(f"Pass {Grip.MORE}: {', '.join(map(str, passing[:MAX_IDS]))}{more}")
